"""`palpate doctor` on real sound: loopback, stream and card as the rig file says, and each otherwise."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import date, timedelta
from pathlib import Path
from typing import Any

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.audio import calibration
from palpate.experiment.apparatus.audio.stream import AudioStream
from palpate.experiment.apparatus.doctor import devices
from palpate.experiment.apparatus.rig import AudioRig
from palpate.experiment.apparatus.tracker.settings import TrackerRig
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.wires.foot import Foot
from palpate.experiment.rehearsal.wires.serial_line import SerialLine
from tests.conftest import Palpate
from tests.rig import sound
from tests.rig.laboratory import write_rig
from tests.rig.verdicts import red, verdicts

pytestmark = pytest.mark.alone


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
    assert re.findall(r"\d+\.\d+ ms", found["loopback latency"]["measured"]) == ["5.333 ms", "0.000 ms"]


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
            name: {check.check: check.verdict for check in devices.loopback(stream, rig)}
            for name, rig in (
                ("as calibrated", streamed()),
                ("late", streamed(output_ms=256 / 48 - 2.1)),
                ("loud", streamed(loopback_gain=0.85)),
            )
        }
        unheard = devices.loopback(
            stream, STREAMED.model_copy(update={"channels": STREAMED.channels.model_copy(update={"loopback": None})})
        )
    good = {"loopback latency": "passes", "loopback level": "passes", "loopback residual": "passes"}
    assert found == {
        "as calibrated": good,
        "late": good | {"loopback latency": "refuses"},
        "loud": good | {"loopback level": "refuses"},
    }
    assert [(check.check, check.verdict) for check in unheard] == [("loopback", "unknown")]


def test_a_loopback_whose_cable_was_pulled_is_red(approved: SnapshotAssertion) -> None:
    with sound.sound_card() as card, sound.stream() as stream:
        card.disconnect(2)
        [found] = devices.loopback(stream, streamed())
    assert (found.verdict, "on input 2" in found.what) == ("refuses", True)
    assert found.remedy == approved


def test_a_running_stream_is_watched_and_one_whose_server_hangs_is_red(approved: SnapshotAssertion) -> None:
    with sound.sound_card() as card, sound.stream() as stream:
        since = stream.health
        found = devices.steady(stream, streamed(), since=since, exact=True)
        watched = stream.health.frames - since.frames
        with sound.halted(card):
            [hanging] = devices.steady(stream, streamed(), since=stream.health, exact=True)
    assert watched >= devices.RUN_S * sound.RATE_HZ
    assert [check.check for check in found] == ["audio stream", "audio timeline"]
    assert hanging.verdict == "refuses"
    assert hanging.remedy == approved


@pytest.mark.parametrize(
    ("changed", "said", "remedy"),
    [
        ({"device": '"hw:9"'}, "got no device with this name", "plug it in, start its server"),
        ({"actuator": "9"}, "got 4 outputs and 2 inputs", "correct audio.channels"),
        ({"loopback": "3"}, "got 4 outputs and 2 inputs", "correct audio.channels"),
        (
            {"rate_hz": "44100"},
            "Invalid sample rate",
            "set it to that rate, or correct audio.rate_hz in the rig file",
        ),
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
    probing: Callable[..., AudioStream] = calibration.open_probing
    with sound.sound_card() as card:

        def laid(*given: Any, **named: Any) -> AudioStream:
            opened = probing(*given, **named)
            card.disconnect(2)
            card.connect(3, 2)
            return opened

        monkeypatch.setattr(calibration, "open_probing", laid)
        code, out, _ = palpate("doctor", "--rig", rig, "--json", "--dataset", tmp_path)
    foot.close()
    found = verdicts(out)
    # Nothing is plugged into the microphone of this card.
    assert (code, red(found)) == (2, {"audio calibration", "microphone"}), out
    assert re.findall(r"\d+\.\d+ ms", found["loopback latency"]["measured"])[:2] == ["10.667 ms", "0.000 ms"]
