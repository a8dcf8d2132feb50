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

from experiment import doctor
from experiment.apparatus import opening_audio, priority
from experiment.apparatus import rig as rigs
from experiment.apparatus.audio.stream import AudioStream
from experiment.apparatus.rig import TrackerRig
from experiment.apparatus.rig_audio import AudioRig
from experiment.apparatus.serial_tracker import SerialTracker
from experiment.checks import audio as audio_checks
from experiment.checks import disk, machine
from experiment.checks import tracker as tracker_checks
from experiment.checks.tracker import Heard
from experiment.clock import MonotonicClock
from experiment.protocol.shipped import shipped
from experiment.rehearsal.foot import Faults, Foot
from experiment.rehearsal.panel import Panel
from experiment.rehearsal.serial_line import SerialLine
from tests.conftest import Palpate
from tests.rig import sound
from tests.rig.laboratory import NOISE_MM, write_rig

HEARD_S = 1.0


@pytest.fixture(scope="module")
def settings() -> TrackerRig:
    tracker = rigs.load(shipped("rigs/rehearsal.toml")).tracker
    return tracker.model_copy(update={"noise_mm": NOISE_MM})


@pytest.fixture
def line() -> Iterator[SerialLine]:
    with SerialLine() as laid:
        yield laid


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
        return tracker_checks.listen(tracker, clock=MonotonicClock(), seconds=seconds)


LOAD = {"tracker arrival", "audio stream", "audio timeline", "disk writing", "machine load"}
"""What measures how loaded the machine is, which these tests do not set; tests/experiment/checks judges them."""


def red(found: dict[str, dict[str, str]]) -> set[str]:
    """What is red, load apart."""
    return {name for name, check in found.items() if check["verdict"] == "red"} - LOAD


def verdicts(out: str) -> dict[str, dict[str, str]]:
    return {check["name"]: check for check in json.loads(out)["checks"]}


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
    assert panel.felt(0) is None
    panel.close()
    assert err == "Keep feet and hands off the panel: checking the loopback moves it.\n"
    *rows, last = out.splitlines()
    assert {row[13:32].strip() for row in rows if row.startswith("red")} <= LOAD, out
    assert (code, last == "Nothing is red.") in ((0, True), (2, False))
    found = verdicts(document)
    assert (red(found), json.loads(document)["ready"]) == (set(), again == 0)
    assert {check["verdict"] for name, check in found.items() if name not in LOAD} == {"green"}
    assert "\x1b" not in out
    assert "SIMULATED" not in out
    assert not (tmp_path / "dataset").exists()


def test_everything_that_is_wrong_is_told_at_once(
    line: SerialLine, settings: TrackerRig, palpate: Palpate, tmp_path: Path
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
    assert re.search(r"red +tracker calibration .*\n +run palpate calibrate tracker", out)
    assert re.search(r"red +tracker port .* holds it\n +close that program", out)
    assert re.search(r"red +response table .* got a table with sha256 .*\n +restore the table", out)
    assert re.search(r"red +actuator .* nothing answers there .*\n +start its server, or correct actuator.address", out)
    assert re.search(r"red +gate .* this protocol needs -1 to 25 mm.*\n +calibrate further", out)
    assert re.search(r"^\d+ of \d+ checks are red.$", out.splitlines()[-1])


def test_a_silent_port_is_red(line: SerialLine, palpate: Palpate, tmp_path: Path) -> None:
    rig = write_rig(tmp_path, "rehearsal", port=f'"{line.url}"', address='"127.0.0.1:9"')
    rig.write_text(rig.read_text("utf-8").replace("[tracker]", "[tracker]\nzeroing_mm = 3.0"), "utf-8")
    code, out, _ = palpate("doctor", "--rig", rig, "--json")
    assert verdicts(out)["tracker zero"]["measured"].startswith("each session takes it from the participant's foot")
    found = verdicts(out)["tracker frames"]
    assert (code, found["verdict"]) == (2, "red")
    assert found["measured"].endswith("no frame for 200 ms")
    assert found["remedy"].startswith("see that the device is powered")
    assert json.loads(out)["ready"] is False


def test_what_is_timed_is_timed_at_the_priority_of_a_session(
    line: SerialLine, palpate: Palpate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def standing() -> tuple[int, int]:
        return os.sched_getscheduler(0), os.getpriority(os.PRIO_PROCESS, 0)

    before = standing()
    with priority.raised() as got:
        session = standing()
    seen: list[tuple[int, int]] = []

    def looked(check: Callable[..., Any]) -> Callable[..., Any]:
        def look(*given: Any, **named: Any) -> Any:
            seen.append(standing())
            return check(*given, **named)

        return look

    for module, name in ((tracker_checks, "checks"), (disk, "writing"), (machine, "waking")):
        monkeypatch.setattr(module, name, looked(getattr(module, name)))
    rig = write_rig(tmp_path, "rehearsal", port=f'"{line.url}"', address='"127.0.0.1:9"')
    _, out, _ = palpate("doctor", "--rig", rig, "--json")
    assert seen == [session] * 3
    assert standing() == before
    assert verdicts(out)["priority"]["measured"] == f"{got}; as sessions have it"


BROKEN = """
from experiment.apparatus.samples import LinkCounts

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
    assert found[name]["remedy"].startswith(("see to the device", "have the driver mended", "install the package"))
    assert {"actuator", "disk writing", "machine load", "wall clock"} < set(found)


def test_a_fault_of_our_own_is_no_red_line(
    line: SerialLine, settings: TrackerRig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def defect(*_: object, **__: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(tracker_checks, "listen", defect)
    rig = write_rig(tmp_path, "rehearsal", port=f'"{line.url}"', address='"127.0.0.1:9"')
    with pytest.raises(ZeroDivisionError):
        list(doctor.examine(rig_path=rig, protocol_path=None, root=tmp_path, clock=MonotonicClock()))


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
        found = tracker_checks.frames(tracker_checks.listen(tracker, clock=MonotonicClock(), seconds=HEARD_S))
    assert found.verdict == "red"
    assert found.measured.endswith("received, 2 lost, 1 damaged, 1 repeated")


def test_another_rate_than_the_rig_files_is_red(line: SerialLine, settings: TrackerRig) -> None:
    foot = Foot(line, settings.model_copy(update={"rate_hz": 2000}), real_time=True)
    found = tracker_checks.rate(heard(line, settings, foot), settings)
    assert (found.verdict, found.measured) == ("red", "2000.0 Hz by the device's clock")
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
    found = tracker_checks.drift(heard(line, settings, foot, tracker_checks.LISTEN_S))
    assert (found.verdict, "drift -10000 ppm" in found.measured) == ("red", True)


def test_a_sensor_beyond_its_calibration_is_red(line: SerialLine, settings: TrackerRig) -> None:
    foot = Foot(line, settings, real_time=True, rest_mm=150.0)
    with listening(line, settings, foot) as tracker:
        found = tracker_checks.reading(tracker, settings)
    assert (found.verdict, found.measured) == (
        "red",
        "tracker: got readings at or beyond 100 mm, where its calibration ends",
    )
    assert found.allowed.startswith("-5 to 100 mm")


@pytest.mark.parametrize(("noise_mm", "verdict"), [(0.15, "green"), (0.3, "red")])
def test_a_sensor_that_became_noisy_is_red(
    noise_mm: float, verdict: str, line: SerialLine, settings: TrackerRig
) -> None:
    foot = Foot(line, settings, real_time=True, noise_mm=noise_mm)
    at_rest = heard(line, settings, foot)
    assert tracker_checks.noise(at_rest, settings).verdict == verdict
    unknown = tracker_checks.noise(at_rest, settings.model_copy(update={"noise_mm": None}))
    assert (unknown.verdict, unknown.remedy) == ("not checked", "run palpate calibrate tracker, which writes it")


def test_the_simulated_rig_with_sound_is_green_and_says_what_it_is(palpate: Palpate, tmp_path: Path) -> None:
    with sound.sound_card():
        pass
    _, out, _ = palpate("doctor", "--rig", shipped("rigs/headless.toml"), "--json", "--dataset", tmp_path)
    found = verdicts(out)
    assert red(found) == set(), out
    of_parts = [
        name for name in found if name.startswith(("tracker ", "audio ", "loopback ")) and name[-11:] != "calibration"
    ]
    assert len(of_parts) == 13
    assert all(found[name]["measured"].startswith("SIMULATED: ") for name in ("rig file", *of_parts))
    assert found["loopback latency"]["measured"].startswith("SIMULATED: 5.333 ms out and in, spread 0.000 ms")


AUDIO = rigs.load(shipped("rigs/headless.toml")).audio
assert AUDIO is not None
STREAMED = AUDIO.model_copy(update={"block": sound.BLOCK, "device": "system"})
"""The audio tables of the rehearsal's rig, on the tests' card."""


def streamed(**latency: float) -> AudioRig:
    """What `palpate calibrate audio` finds there, 2 blocks of 256 frames round, or something else."""
    calibrated = {"output_ms": 256 / 48, "input_ms": 256 / 48, **latency}
    return STREAMED.model_copy(update={"latency": STREAMED.latency.model_copy(update=calibrated)})


@contextmanager
def wired() -> Iterator[AudioStream]:
    with sound.sound_card() as card, sound.stream() as opened:
        card.disconnect(2)
        card.connect(3, 2)
        yield opened


def test_a_loopback_that_answers_otherwise_than_calibrated_is_red() -> None:
    with wired() as stream:
        found = {
            name: {check.name: check.verdict for check in audio_checks.loopback(stream, rig)}
            for name, rig in (
                ("as calibrated", streamed()),
                ("late", streamed(output_ms=256 / 48 - 2.1)),
                ("loud", streamed(loopback_gain=0.85)),
            )
        }
        unheard = audio_checks.loopback(
            stream, STREAMED.model_copy(update={"channels": STREAMED.channels.model_copy(update={"loopback": None})})
        )
    good = {"loopback latency": "green", "loopback level": "green", "loopback residual": "green"}
    assert found == {
        "as calibrated": good,
        "late": good | {"loopback latency": "red"},
        "loud": good | {"loopback level": "red"},
    }
    assert [(check.name, check.verdict) for check in unheard] == [("loopback", "not checked")]


def test_a_loopback_whose_cable_was_pulled_is_red() -> None:
    with sound.sound_card() as card, sound.stream() as stream:
        card.disconnect(2)
        [found] = audio_checks.loopback(stream, streamed())
    assert (found.verdict, "was not heard on input 2" in found.measured) == ("red", True)
    assert found.remedy.startswith("lay the loopback's cable")


def test_a_running_stream_is_watched_and_one_whose_server_hangs_is_red() -> None:
    with sound.sound_card() as card, sound.stream() as stream:
        since = stream.health
        found = audio_checks.steady(stream, streamed(), since=since, exact=True)
        watched = stream.health.frames - since.frames
        with card.held():
            [hanging] = audio_checks.steady(stream, streamed(), since=stream.health, exact=True)
    assert watched >= audio_checks.RUN_S * sound.RATE_HZ
    assert [check.name for check in found] == ["audio stream", "audio timeline"]
    assert (hanging.verdict, "see that the device is plugged in" in hanging.remedy) == ("red", True)


@pytest.mark.parametrize(
    ("changed", "said", "remedy"),
    [
        ({"device": '"hw:9"'}, "got no device of this name", "plug it in, start its server"),
        ({"actuator": "9"}, "got 4 outputs and 2 inputs", "or correct audio.channels, or choose another device"),
        ({"loopback": "3"}, "got 4 outputs and 2 inputs", "or correct audio.channels, or choose another device"),
        ({"rate_hz": "44100"}, "Invalid sample rate", "set the device to it, or correct audio.rate_hz in the rig file"),
    ],
    ids=["device", "output", "input", "rate"],
)
def test_a_card_that_is_not_what_the_rig_file_says_is_red(
    changed: dict[str, str], said: str, remedy: str, line: SerialLine, palpate: Palpate, tmp_path: Path
) -> None:
    rig = write_rig(tmp_path, "headless", **({"port": f'"{line.url}"', "device": '"system"'} | changed))
    if "rate_hz" in changed:
        rig.write_text(rig.read_text("utf-8").replace("rate_hz = 44100", "rate_hz = 1000", 1), "utf-8")
    with sound.sound_card():
        code, out, _ = palpate("doctor", "--rig", rig, "--json")
    found = verdicts(out)["audio device"]
    assert (code, found["verdict"], said in found["measured"]) == (2, "red", True), found
    assert remedy in found["remedy"]
    assert not any(name.startswith("loopback") for name in verdicts(out))


def test_a_laboratorys_card_is_green_and_an_old_calibration_red(
    line: SerialLine,
    settings: TrackerRig,
    palpate: Palpate,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    here = {"port": f'"{line.url}"', "device": '"system"', "block": "256", "output_ms": "5.333", "input_ms": "5.333"}
    rig = write_rig(tmp_path, "headless", **here)
    files, latency = rig.read_text("utf-8").split("[audio.latency]")
    latency = re.sub(r"calibrated_on = \S+", f"calibrated_on = {date.today() - timedelta(31)}", latency)
    files = re.sub(r"calibrated_on = \S+", f"calibrated_on = {date.today()}", files)
    rig.write_text(f"{files}[audio.latency]{latency}", "utf-8")
    foot = Foot(line, settings, real_time=True)
    probing: Callable[..., AudioStream] = opening_audio.open_probing
    with sound.sound_card() as card:

        def laid(*given: Any, **named: Any) -> AudioStream:
            opened = probing(*given, **named)
            card.disconnect(2)
            card.connect(3, 2)
            return opened

        monkeypatch.setattr(opening_audio, "open_probing", laid)
        code, out, _ = palpate("doctor", "--rig", rig, "--json", "--dataset", tmp_path)
    foot.close()
    found = verdicts(out)
    assert (code, red(found)) == (2, {"audio calibration"}), out
    assert found["loopback latency"]["measured"].startswith("10.667 ms out and in, spread 0.000 ms")
