"""`palpate doctor` on real parts: a rig in order is green, and each thing that goes wrong is red with its remedy."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import date, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.apparatus import host
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.doctor import checks, devices, doctor, foot_force
from palpate.experiment.apparatus.doctor.devices import Heard
from palpate.experiment.apparatus.rig import tracker_of
from palpate.experiment.apparatus.tracker.serial_tracker import SerialTracker
from palpate.experiment.apparatus.tracker.settings import TrackerRig
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.session import simulated_far_ends
from palpate.experiment.rehearsal.wires.foot import Foot
from palpate.experiment.rehearsal.wires.panel import Panel
from palpate.experiment.rehearsal.wires.serial_line import SerialLine
from tests.conftest import Palpate
from tests.rig.faults import Faults
from tests.rig.laboratory import write_rig
from tests.rig.verdicts import LOAD, red, verdicts

pytestmark = pytest.mark.clocked


@pytest.fixture(autouse=True)
def wide(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each check stands on one line."""
    monkeypatch.setenv("COLUMNS", "1000")


HEARD_S = 1.0


@contextmanager
def listening(line: SerialLine, settings: TrackerRig, foot: Foot) -> Iterator[SerialTracker]:
    tracker = SerialTracker(line.url, settings)
    try:
        yield tracker
    finally:
        foot.close()
        tracker.close()


def heard(line: SerialLine, settings: TrackerRig, foot: Foot, seconds: float = HEARD_S) -> Heard:
    with listening(line, settings, foot) as tracker:
        return devices.listen(tracker, clock=MonotonicClock(), seconds=seconds)


def test_a_rig_in_order_is_green_and_nothing_moves(
    line: SerialLine, settings: TrackerRig, palpate: Palpate, tmp_path: Path
) -> None:
    panel = Panel(rigs.load(shipped("rigs/rehearsal.toml")).actuator)
    foot = Foot(line, settings, real_time=True)
    rig = write_rig(tmp_path, "rehearsal", port=f'"{line.url}"', address=f'"{panel.address}"')
    where = ["--protocol", shipped("okamoto2012.toml"), "--dataset", tmp_path / "dataset"]
    code, out, err = palpate("doctor", "--rig", rig, *where)
    again, document, _ = palpate("doctor", "--rig", rig, *where, "--json")
    foot.close()
    while (played := panel.felt(0)) is not None:
        assert not played.any()
    panel.close()
    # No loopback moves the panel of this rig.
    assert err == ""
    *rows, last = out.splitlines()
    assert {row[13:32].strip() for row in rows if row.startswith("red")} <= LOAD, out
    assert (code, last == "Nothing is red.") in ((0, True), (2, False))
    found = verdicts(document)
    assert (red(found), json.loads(document)["ready"]) == (set(), again == 0)
    aside = {name for name, check in found.items() if name not in LOAD and check["verdict"] != "green"}
    assert aside == {"left out", "masker", "undelivered", "participant's stop", "panel's load"}
    # Nothing was recorded here yet.
    assert found["left out"]["verdict"] == "not checked"
    assert "\x1b" not in out
    # What the table of the response says of itself is told as it stands there.
    assert [row[13:32].strip() for row in rows if "its comments: Frequency response" in row] == ["response table"]
    assert not (tmp_path / "dataset").exists()


def test_everything_that_is_wrong_is_told_at_once(
    line: SerialLine, settings: TrackerRig, palpate: Palpate, tmp_path: Path, approved: SnapshotAssertion
) -> None:
    nobody = Panel(rigs.load(shipped("rigs/rehearsal.toml")).actuator)
    nobody.close()
    rig = write_rig(tmp_path, "rehearsal", port=f'"{line.url}"', address=f'"{nobody.address}"')
    text = rig.read_text("utf-8").replace(str(date.today()), str(date.today() - timedelta(31)))
    text = re.sub(r"\[\[tracker.calibration\]\]\ncounts = (2248|4095)\n.*\n", "", text).replace("1072", "4095")
    rig.write_text(text, "utf-8")
    (tmp_path / "rehearsal-response.csv").write_text("measured anew\n", "utf-8")
    holder = SerialTracker(line.url, settings)
    code, out, _ = palpate("doctor", "--rig", rig, "--protocol", shipped("okamoto2012.toml"))
    holder.close()
    assert code == 2
    remedies = dict(re.findall(r"^red +(\S.{18}) .*\n +(.*)", out, re.MULTILINE))
    names = ("tracker calibration", "tracker port", "response table", "actuator", "gate")
    assert [remedies[f"{name:19}"] for name in names] == approved
    assert re.search(r"got a table with sha256 ", out)
    assert re.search(r"gate .* -1 to 25 mm", out)
    assert re.search(r"^\d+ of \d+ checks are", out.splitlines()[-1])


def test_a_silent_port_is_red(line: SerialLine, palpate: Palpate, tmp_path: Path, approved: SnapshotAssertion) -> None:
    rig = write_rig(tmp_path, "rehearsal", port=f'"{line.url}"', address='"127.0.0.1:9"')
    rig.write_text(rig.read_text("utf-8").replace("[tracker]", "[tracker]\nzeroing_mm = 3.0"), "utf-8")
    code, out, _ = palpate("doctor", "--rig", rig, "--json")
    assert verdicts(out)["tracker zero"]["measured"] == approved
    found = verdicts(out)["tracker frames"]
    assert (code, found["verdict"]) == (2, "red")
    assert found["measured"].endswith(" 200 ms")
    assert found["remedy"] == approved
    assert json.loads(out)["ready"] is False


def test_what_is_timed_is_timed_at_the_priority_of_a_session(
    line: SerialLine, palpate: Palpate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def standing() -> tuple[int, int]:
        return os.sched_getscheduler(0), os.getpriority(os.PRIO_PROCESS, 0)

    before = standing()
    with host.raised() as got:
        session = standing()
    seen: list[tuple[int, int]] = []

    def looked(check: Callable[..., Any]) -> Callable[..., Any]:
        def look(*given: Any, **named: Any) -> Any:
            seen.append(standing())
            return check(*given, **named)

        return look

    for module, name in ((devices, "checks"), (checks, "writing"), (checks, "waking")):
        monkeypatch.setattr(module, name, looked(getattr(module, name)))
    rig = write_rig(tmp_path, "rehearsal", port=f'"{line.url}"', address='"127.0.0.1:9"')
    _, out, _ = palpate("doctor", "--rig", rig, "--json")
    assert seen == [session] * 3
    assert standing() == before
    # Whether a core is free for one thread alone changes from moment to moment.
    level, *_ = got.split(",")
    assert re.split("[,;]", verdicts(out)["priority"]["measured"])[0] == level


BROKEN = """
from palpate.experiment.apparatus.tracker.frames import LinkCounts

class Tracker:
    counts, clock_map = LinkCounts(), None
    def __init__(self, port, settings, *, clock, clock_map=None): {open}
    def drain(self): {drain}
    def read(self): {read}
    def reconnect(self, timeout_s): pass
    def close(self): {close}
"""


@pytest.mark.parametrize(
    ("part", "fault", "name", "said"),
    [
        ("open", "raise RuntimeError('no licence')", "tracker port", "failed at `open` (RuntimeError: no licence)"),
        ("open", "raise OSError(16, 'Busy')", "tracker port", "failed at `open` (OSError: [Errno 16] Busy)"),
        ("open", "raise SystemExit(7)", "tracker port", "failed at `open` (SystemExit: 7)"),
        (
            "open",
            "self.x.y()",
            "tracker port",
            "failed at `open` (AttributeError: 'Tracker' object",
        ),
        ("drain", "1 / 0", "tracker frames", "failed at `drain` (ZeroDivisionError: division by zero)"),
        ("read", "raise KeyError", "tracker frames", "failed at `read` (KeyError)"),
        ("read", "pass", "tracker frames", "failed at `read` (TypeError: got None, not Samples)"),
        ("close", "raise RuntimeError('stuck')", "tracker closing", "failed at `close` (RuntimeError: stuck)"),
    ],
)
def test_whatever_a_drivers_fault_it_is_red_and_the_rest_is_still_checked(
    part: str,
    fault: str,
    name: str,
    said: str,
    request: pytest.FixtureRequest,
    palpate: Palpate,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    module = f"broken_{part}_{request.node.callspec.indices['part']}"
    (tmp_path / f"{module}.py").write_text(
        BROKEN.format(**(dict.fromkeys(("open", "drain", "read", "close"), "pass") | {part: fault})), "utf-8"
    )
    monkeypatch.syspath_prepend(tmp_path)
    rig = write_rig(tmp_path, "rehearsal", port='"nowhere"', address='"127.0.0.1:9"')
    rig.write_text(rig.read_text("utf-8").replace("[tracker]", f'[tracker]\ndriver = "{module}:Tracker"'), "utf-8")
    code, out, err = palpate("doctor", "--rig", rig, "--json")
    found = verdicts(out)
    assert (code, found[name]["verdict"]) == (2, "red"), err
    assert said in found[name]["measured"]
    assert module in found[name]["measured"]
    assert found[name]["remedy"].startswith(("restart the", "have the driver", "install the"))
    assert {"actuator", "disk writing", "machine load", "wall clock"} < set(found)


def test_a_fault_of_our_own_is_no_red_line(
    line: SerialLine, settings: TrackerRig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def defect(*_: object, **__: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(devices, "listen", defect)
    rig = write_rig(tmp_path, "rehearsal", port=f'"{line.url}"', address='"127.0.0.1:9"')
    with pytest.raises(ZeroDivisionError):
        list(
            doctor.examine(
                rig_path=rig, protocol_path=None, root=tmp_path, clock=MonotonicClock(), simulate=simulated_far_ends
            )
        )


def test_a_rig_file_that_cannot_be_used_is_red_and_the_machine_is_still_checked(
    palpate: Palpate, tmp_path: Path
) -> None:
    rig = write_rig(tmp_path, "rehearsal", baud="9600")
    code, out, _ = palpate("doctor", "--rig", rig, "--json")
    found = verdicts(out)
    assert (code, found["rig file"]["verdict"], found["devices"]["verdict"]) == (2, "red", "not checked")
    assert "at least 120000" in found["rig file"]["measured"]
    assert {"disk space", "disk writing", "clock resolution", "machine load", "wall clock"} < set(found)


def test_frames_that_are_lost_spoilt_or_sent_twice_are_red(line: SerialLine, settings: TrackerRig) -> None:
    foot = Foot(line, settings, real_time=True)
    step = foot.trajectory(np.random.default_rng(3), 200.0, "none")
    with listening(line, settings, foot) as tracker:
        faults = Faults(drop=frozenset({100, 101}), corrupt=frozenset({200}), repeat=frozenset({300}))
        foot.step(step, foot.free_us + 300_000, faults)
        found = devices.frames(devices.listen(tracker, clock=MonotonicClock(), seconds=HEARD_S))
    assert found.verdict == "refuses"
    assert re.findall(r"(\d+) (\w+)", found.what)[-3:] == [("2", "lost"), ("1", "damaged"), ("1", "repeated")]


def test_another_rate_than_the_rig_files_is_red(line: SerialLine, settings: TrackerRig) -> None:
    foot = Foot(line, settings.model_copy(update={"rate_hz": 2000}), real_time=True)
    found = devices.rate(heard(line, settings, foot), settings)
    assert found.verdict == "refuses"
    assert found.what.startswith("2000.0 Hz")
    assert found.allowed == "990 to 1010 Hz"


class Fast(MonotonicClock):
    """A device's clock that runs two hundredths too fast."""

    def __init__(self) -> None:
        super().__init__()
        self._begun_ns = super().now_ns()

    def now_ns(self) -> int:
        return self._begun_ns + (super().now_ns() - self._begun_ns) * 102 // 100


def test_a_clock_that_runs_off_is_red(line: SerialLine, settings: TrackerRig) -> None:
    foot = Foot(line, settings, real_time=True, clock=Fast())
    found = devices.drift(heard(line, settings, foot, devices.LISTEN_S))
    assert (found.verdict, "drift -10000 ppm" in found.what) == ("refuses", True)


def test_a_sensor_beyond_its_calibration_is_red(line: SerialLine, settings: TrackerRig) -> None:
    foot = Foot(line, settings, real_time=True, rest_mm=150.0)
    with listening(line, settings, foot) as tracker:
        found = devices.reading(tracker, settings)
    assert (found.verdict, found.where) == ("refuses", "tracker")
    assert "beyond 100 mm" in found.what
    assert found.allowed.startswith("-5 to 100 mm")


FORCES = [
    ("as calibrated", (0, -20.0), (4095, 307.6), "passes"),
    ("a heavier panel", (0, -50.0), (4095, 277.6), "passes"),
    ("stuck", (250, -1.0), (251, 1e6), "refuses"),
    ("without power", (0, 10.0), (4095, 337.6), "refuses"),
    ("amplifier at its end", (4000, -20.0), (8095, 307.6), "refuses"),
]


@pytest.mark.parametrize(("low", "high", "verdict"), [one[1:] for one in FORCES], ids=[one[0] for one in FORCES])
def test_a_force_sensor_that_is_dead_with_nobody_on_the_panel_is_red(
    low: tuple[int, float], high: tuple[int, float], verdict: str, line: SerialLine
) -> None:
    """The foot's own sensor reads as no longer calibrated, or not at all."""
    known = tracker_of(rigs.load(shipped("rigs/weight.toml")))
    document = known.model_dump(exclude_none=True)
    document["force"]["calibration"] = tuple({"counts": counts, "n": n} for counts, n in (low, high))
    changed = TrackerRig.model_validate(document)
    found = foot_force.at_rest(heard(line, known, Foot(line, changed, real_time=True), 0.3).raw, known)
    assert (found.check, found.verdict) == ("foot force", verdict)
    if verdict == "passes":
        zero_n, spread_n = map(float, re.findall(r"-?\d+\.\d+", found.what))
        assert zero_n == pytest.approx(-20.0 - low[1], abs=0.1)
        assert spread_n == pytest.approx(0.1, abs=0.03)


def test_the_force_is_looked_at_with_the_tracker(line: SerialLine) -> None:
    tracker = tracker_of(rigs.load(shipped("rigs/weight.toml")))
    with listening(line, tracker, Foot(line, tracker, real_time=True)) as device:
        found = {one.check: one.verdict for one in devices.checks(device, tracker, clock=MonotonicClock())}
    assert found["foot force"] == "passes"


@pytest.mark.parametrize(("noise_mm", "verdict"), [(0.15, "passes"), (0.3, "refuses")])
def test_a_sensor_that_became_noisy_is_red(
    noise_mm: float, verdict: str, line: SerialLine, settings: TrackerRig
) -> None:
    foot = Foot(line, settings, real_time=True, noise_mm=noise_mm)
    at_rest = heard(line, settings, foot)
    assert devices.noise(at_rest, settings).verdict == verdict
    unknown = devices.noise(at_rest, settings.model_copy(update={"noise_mm": None}))
    assert unknown.verdict == "unknown"
    assert "palpate calibrate tracker" in str(unknown.remedy)
