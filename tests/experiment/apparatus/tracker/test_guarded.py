"""Somebody else's driver may raise anything, at any moment: it is told as the driver's fault, in one line."""

from __future__ import annotations

import os
import py_compile
import re
import traceback
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest

from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.ports import Tracker
from palpate.experiment.apparatus.rig import tracker_of
from palpate.experiment.apparatus.tracker import guarded
from palpate.experiment.errors import RigError, TrackerError
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.clock import ManualClock
from tests.approved import Refuses

DRIVER = """
from palpate.experiment.apparatus.tracker.frames import LinkCounts


class Tracker:
    counts, clock_map = LinkCounts(), None

    def __init__(self, port, settings, *, clock, clock_map):
        {opens}

    def drain(self):
        pass

    def read(self):
        {reads}

    def reconnect(self, timeout_s):
        pass

    def close(self):
        {closes}
"""

Opens = Callable[..., Tracker]


@pytest.fixture
def opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> Opens:
    """Opens a driver that does what is said in its `__init__`, `read` and `close`; `more` stands below its class."""
    monkeypatch.syspath_prepend(tmp_path)
    module = f"driver_{abs(hash(request.node.nodeid))}"

    def open_it(
        *, opens: str = "pass", reads: str = "pass", closes: str = "pass", more: str = "", planar: bool = False
    ) -> Tracker:
        (tmp_path / f"{module}.py").write_text(DRIVER.format(opens=opens, reads=reads, closes=closes) + more, "utf-8")
        before = rigs.load(shipped("rigs/rehearsal.toml"))
        along = tracker_of(before).calibration if planar else None
        settings = tracker_of(before).model_copy(update={"driver": f"{module}:Tracker", "along_calibration": along})
        rig = before.model_copy(update={"tracker": settings})
        return guarded.open_guarded(rig, "none", clock=ManualClock(0), clock_map=None)

    return open_it


def test_a_port_that_is_gone_is_told_once(opened: Opens) -> None:
    """By pyserial 3.5, `SerialException` of `serialposix.Serial.open`, which holds the system's words again."""
    gone = "[Errno 2] could not open port /dev/none: [Errno 2] No such file or directory: '/dev/none'"
    with pytest.raises(TrackerError) as refused:
        opened(opens=f"import serial; raise serial.SerialException({gone!r})")
    assert str(refused.value).count("Errno 2") == str(refused.value).count("/dev/none") == 1


def test_a_driver_that_exits_ends_nothing(opened: Opens, refuses: Refuses) -> None:
    with refuses(TrackerError):
        opened(opens="raise SystemExit(7)")


def test_a_driver_that_exits_while_it_is_read_ends_nothing(opened: Opens, refuses: Refuses) -> None:
    with refuses(TrackerError):
        opened(reads="raise SystemExit('no more')").read()


def test_a_module_that_exits_while_it_is_imported_is_refused(opened: Opens, refuses: Refuses) -> None:
    with refuses(RigError):
        opened(more="raise SystemExit(7)\n")


def test_the_keyboard_still_ends_a_driver(opened: Opens) -> None:
    with pytest.raises(KeyboardInterrupt):
        opened(reads="raise KeyboardInterrupt").read()


@pytest.mark.parametrize("given", ["None", "(1, 0, 0, 0)", "{}"])
def test_counts_that_are_none_are_the_drivers_fault(opened: Opens, given: str) -> None:
    tracker = opened(opens=f"self.counts = {given}")
    with pytest.raises(TrackerError, match=r"failed at `counts` \(TypeError: got .*, not LinkCounts\)"):
        _ = tracker.counts


@pytest.mark.parametrize("given", ["5", "(0, 1)", "False"])
def test_a_clock_map_that_is_none_is_the_drivers_fault(opened: Opens, given: str) -> None:
    tracker = opened(opens=f"self.clock_map = {given}")
    with pytest.raises(TrackerError, match=r"failed at `clock_map` \(TypeError: got .*, neither a ClockMap"):
        _ = tracker.clock_map


def test_a_driver_without_counts_is_at_fault(opened: Opens, refuses: Refuses) -> None:
    tracker = opened(more="del Tracker.counts\n")
    with refuses(TrackerError):
        _ = tracker.counts


def test_what_is_no_samples_is_the_drivers_fault(opened: Opens, refuses: Refuses) -> None:
    with refuses(TrackerError):
        opened(reads="return [1, 2]").read()


def test_a_driver_that_fails_to_close_too_hides_nothing(opened: Opens) -> None:
    tracker = opened(reads="1 / 0", closes="raise RuntimeError('close too')")
    both = r"`read` \(ZeroDivisionError: division by zero\).*; .*`close` \(RuntimeError: close too\)"
    with pytest.raises(TrackerError, match=both), ExitStack() as stack:
        stack.callback(tracker.close)
        tracker.read()


def test_a_driver_that_only_fails_to_close_is_told_so(opened: Opens, refuses: Refuses) -> None:
    tracker = opened(closes="raise RuntimeError('stuck')")
    with refuses(TrackerError):
        tracker.close()


@pytest.mark.parametrize("error", ["ValueError", "TypeError", "AttributeError"])
def test_a_driver_whose_own_opening_fails_is_still_a_driver(opened: Opens, error: str, refuses: Refuses) -> None:
    with refuses(TrackerError):
        opened(opens=f"raise {error}('no device')")


def test_a_class_that_is_called_otherwise_is_no_driver(opened: Opens, refuses: Refuses) -> None:
    with refuses(RigError):
        opened(more="Tracker.__init__ = lambda self, port, settings: None\n")


READ = """from types import SimpleNamespace
        import numpy as np
        from palpate.experiment.apparatus.tracker.frames import Samples
        self.n = getattr(self, "n", 0) + 1
        a = SimpleNamespace(us=np.array([1000, 2000]) + 2000 * self.n, mm=np.array([5.0, 4.9]), ends=np.array([12, 24]))
        a.raw, a.at = bytes(24), 10**18 + self.n
        if self.n == 2:
            {spoils}
        return Samples(a.us, a.mm, a.raw, a.ends, a.at)"""


@pytest.mark.parametrize(
    "spoils",
    [
        "a.mm[1] = np.nan",
        "a.mm[0] = -np.inf",
        "a.us[1] = a.us[0]",
        "a.us[1] = 7",
        "a.us -= 1000",
        "a.us = a.us + np.inf",
        "a.us = a.us[:, None]; a.mm = a.mm[:, None]; a.ends = a.ends[:, None]",
        "a.ends[1] = 25",
        "a.at = 5",
        "a.at = float('nan')",
    ],
)
def test_readings_that_cannot_be_are_the_drivers_fault(opened: Opens, spoils: str, refuses: Refuses) -> None:
    tracker = opened(reads=READ.format(spoils=spoils))
    assert tracker.read().device_us.tolist() == [3000, 4000]
    with refuses(TrackerError) as failed:
        tracker.read()
    assert "\n" not in str(failed.value)


@pytest.mark.parametrize(
    ("along", "told"),
    [
        ("None", "ValueError: along_mm, which a planar tracker needs, does not have the same length"),
        ("np.zeros(3)", "ValueError: along_mm, which a planar tracker needs, does not have the same length"),
        ("np.array([0.0, np.nan])", "ValueError: got a position along the face of nan mm"),
    ],
)
def test_places_along_the_face_that_cannot_be_are_the_fault_of_a_planar_driver(
    opened: Opens, along: str, told: str
) -> None:
    reads = READ.format(spoils=f"return Samples(a.us, a.mm, a.raw, a.ends, a.at, {along})")
    reads = reads.replace("a.ends, a.at)", "a.ends, a.at, np.zeros(2))")
    reads = reads.replace("bytes(24)", "b''.join(encode(n, 1000 * n, 7, 7) for n in (1, 2))").replace("24]", "28]")
    tracker = opened(reads=reads.replace("import Samples", "import Samples, encode"), planar=True)
    assert tracker.read().along_mm is not None
    with pytest.raises(TrackerError, match=rf"failed at `read` \({re.escape(told)}"):
        tracker.read()


def test_a_planar_driver_that_encodes_one_reading_is_refused_before_a_session_keeps_it(
    opened: Opens, refuses: Refuses
) -> None:
    reads = READ.format(spoils="pass").replace("a.ends, a.at)", "a.ends, a.at, np.zeros(2))")
    reads = reads.replace("bytes(24)", "b''.join(encode(n, 1000 * n, 7) for n in (1, 2))")
    tracker = opened(reads=reads.replace("import Samples", "import Samples, encode"), planar=True)
    with refuses(TrackerError):
        tracker.read()


def test_a_device_that_was_plugged_in_again_may_count_from_anew(opened: Opens) -> None:
    tracker = opened(reads=READ.format(spoils="a.us -= 3000"))
    tracker.read()
    tracker.reconnect(1.0)
    assert tracker.read().device_us.tolist() == [2000, 3000]


def beside(folder: Path, source: str) -> rigs.Rig:
    """Return a rig whose file names the class `Ours` of a driver beside it."""
    (folder / "our_tracker.py").write_text(source, "utf-8")
    text = shipped("rigs/rehearsal.toml").read_text("utf-8")
    named = text.replace("[tracker]", '[tracker]\ndriver = "our_tracker:Ours"')
    (folder / "rig.toml").write_text(named, "utf-8")
    return rigs.load(folder / "rig.toml")


OURS = DRIVER.replace("class Tracker", "class Ours")


def test_a_driver_beside_the_rig_file_is_executed_from_its_own_bytes(tmp_path: Path) -> None:
    """A compiled file beside it that counts as newer, with the same size and time, is somebody else's."""
    says = OURS.format(opens="raise ValueError('{}')", reads="pass", closes="pass")
    rig, file = beside(tmp_path, says.format("other")), tmp_path / "our_tracker.py"
    other = Path(py_compile.compile(str(file), doraise=True) or "")
    before = file.stat()
    file.write_text(says.format("right"), "utf-8")
    os.utime(file, ns=(before.st_atime_ns, before.st_mtime_ns))
    with pytest.raises(TrackerError, match="ValueError: right"):
        guarded.open_guarded(rig, "none", clock=ManualClock(0), clock_map=None)
    assert list(other.parent.iterdir()) == [other]


def test_a_fault_of_a_driver_beside_the_rig_file_is_traced_to_its_line(tmp_path: Path) -> None:
    rig = beside(tmp_path, OURS.format(opens="raise ValueError", reads="pass", closes="pass"))
    with pytest.raises(TrackerError) as failed:
        guarded.open_guarded(rig, "none", clock=ManualClock(0), clock_map=None)
    cause = failed.value.__cause__
    assert cause is not None
    last = traceback.extract_tb(cause.__traceback__)[-1]
    assert (last.filename, last.line) == (str(tmp_path / "our_tracker.py"), "raise ValueError")


@pytest.mark.parametrize("module", ["experiment", "experiment.apparatus"])
def test_a_driver_that_imports_by_the_former_name_is_given_the_new_one(tmp_path: Path, module: str) -> None:
    rig = beside(tmp_path, f"from {module} import Samples\n")
    with pytest.raises(RigError, match=r" palpate\.experiment\.apparatus$"):
        guarded.open_guarded(rig, "none", clock=ManualClock(0), clock_map=None)


def test_no_name_of_palpates_own_modules_stands_in_what_is_said_of_a_driver(tmp_path: Path, refuses: Refuses) -> None:
    rig = beside(tmp_path, "class Other: pass\n")
    with refuses(RigError):
        guarded.open_guarded(rig, "none", clock=ManualClock(0), clock_map=None)


@pytest.mark.parametrize("given", ["-1", "0.5", "float('nan')"])
def test_counts_that_no_link_can_have_are_the_drivers_fault(opened: Opens, given: str) -> None:
    tracker = opened(opens=f"self.counts = LinkCounts(lost={given})")
    with pytest.raises(
        TrackerError, match=r"failed at `counts` \(ValueError: got .*, not whole numbers that never decrease"
    ):
        _ = tracker.counts
