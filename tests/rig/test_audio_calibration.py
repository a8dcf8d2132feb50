"""Audio devices as the experimenter meets them: listed, calibrated by loopback, missing, too small, at another rate."""

from __future__ import annotations

import json
import os
import re
import shutil
from datetime import date
from pathlib import Path

import numpy as np
import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.apparatus import rig
from palpate.experiment.apparatus.audio import actuator, calibration
from palpate.experiment.apparatus.audio.stream import AudioStream, StreamSettings, looking_anew
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.errors import AudioError, RigError
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.wires.sound_card import DEVICE, SoundCard
from tests.approved import Refuses, on_any_machine
from tests.conftest import Palpate
from tests.rig import sound

pytestmark = pytest.mark.clocked


@pytest.fixture
def parts() -> None:
    """Skips where what a simulated sound card needs is not installed."""
    with sound.sound_card():
        pass


def test_calibration_finds_the_way_round_and_writes_the_rig(
    palpate: Palpate, tmp_path: Path, parts: None, approved: SnapshotAssertion
) -> None:
    text = shipped("rigs/headless.toml").read_text("utf-8")
    rig_file = tmp_path / "rig.toml"
    rig_file.write_text(text.replace("loopback_gain = 1.0 ", "loopback_gain = 0.5 ").replace("2.667", "0.1"), "utf-8")
    code, out, err = palpate("calibrate", "audio", "--rig", rig_file, "--out", tmp_path / "new.toml", "--probes", 5)
    assert code == 0
    assert err == approved
    assert re.findall(r"\d+(?:\.\d+)?", out.splitlines()[0])[:5] == ["5", "256", "0", "1", "0.00"]
    found, shipped_rig = rig.load(tmp_path / "new.toml").audio, rig.load(shipped("rigs/headless.toml")).audio
    assert found is not None
    assert shipped_rig is not None
    today = found.latency.calibrated_on
    assert today > date(2026, 11, 1)
    assert found.model_copy(update={"latency": None}) == shipped_rig.model_copy(update={"latency": None})
    assert found.latency == shipped_rig.latency.model_copy(update={"calibrated_on": today})
    code, _, err = palpate("calibrate", "audio", "--rig", rig_file, "--out", tmp_path / "new.toml")
    assert code == 2
    assert on_any_machine(err, tmp_path) == approved


def test_a_measurement_that_something_else_disturbs_is_refused_and_nothing_written(
    palpate: Palpate, tmp_path: Path, parts: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    schedule = AudioStream.schedule
    rng = np.random.default_rng(1)

    def disturbed(self: AudioStream, waveform: np.ndarray, **where: int) -> object:
        return schedule(self, waveform + rng.normal(0, 0.02, waveform.size), **where)

    # What comes back is not the sweep alone.
    monkeypatch.setattr(AudioStream, "schedule", disturbed)
    where = ["--rig", shipped("rigs/headless.toml"), "--out", tmp_path / "new.toml", "--probes", 2]
    code, out, err = palpate("calibrate", "audio", *where)
    assert (code, out) == (2, "")
    assert re.search(r"after 3 .* -\d+ dB in 2 probes \(allowed: -20 dB .*\); close", err)
    assert not (tmp_path / "new.toml").exists()


def test_the_latency_is_rewritten_and_all_else_stays() -> None:
    assert calibration.rewritten("[audio]\nlatency = { output_ms = 1.0 }\n", {"output_ms": "2.0"}) == (
        "[audio]\nlatency = { output_ms = 2.0 }\n"
    )
    before = "# ours\n[audio.latency]\noutput_ms = 1.0  # measured\ncalibrated_on = 2026-01-02\n\n[other]\nx = 1\n"
    after = calibration.rewritten(before, {"output_ms": "2.667", "calibrated_on": "2026-11-21"})
    assert after == before.replace("1.0", "2.667").replace("2026-01-02", "2026-11-21")


def test_a_rig_without_a_latency_table_is_not_rewritten(refuses: Refuses) -> None:
    with refuses(RigError):
        calibration.rewritten("[audio.latency]\noutput_ms = 1.0\n[other]\ninput_ms = 1.0\n", {"input_ms": "2.0"})


def test_a_cable_that_is_missing_is_said(parts: None, refuses: Refuses) -> None:
    with sound.sound_card() as card, sound.stream() as opened:
        card.disconnect(1)
        with refuses(AudioError):
            calibration.measure(opened, output=1, entry=1, peak=0.1, probes=3)


def test_devices_are_listed_as_a_rig_file_names_them(palpate: Palpate) -> None:
    with sound.sound_card(inputs=2, outputs=6):
        code, out, _ = palpate("devices")
        assert json.loads(palpate("devices", "--json")[1])["audio"][-1]["outputs"] == 6
    assert code == 0
    assert f'host_api = "{sound.HOST_API}"  device = "{DEVICE}"  inputs 2, outputs 6, 48000 Hz' in out


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (
            {"device": "hw:9"},
            r"audio device 'hw:9' of JACK Audio Connection Kit: got no device with this name; allowed: ",
        ),
        ({"host_api": "ASIO"}, r"audio device 'system' of ASIO: got no device with this name"),
        ({"outputs": 9}, r"got 4 outputs and 2 inputs; allowed: at least 9 and 2, as in audio\.channels"),
        ({"inputs": 3}, r"got 4 outputs and 2 inputs; allowed: at least 4 and 3"),
        ({"rate_hz": 44_100}, r"Invalid sample rate.*: it does not run at 44100 Hz; set it to that rate, or correct"),
    ],
    ids=["device", "host API", "outputs", "inputs", "rate"],
)
def test_what_the_rig_names_and_the_machine_has_not_is_said(changed: dict[str, object], said: str) -> None:
    asked: dict[str, object] = {"host_api": sound.HOST_API, "device": DEVICE, "rate_hz": sound.RATE_HZ, "outputs": 4}
    asked |= {"inputs": 2} | changed
    outputs = asked.pop("outputs")
    assert isinstance(outputs, int)
    with sound.sound_card(), pytest.raises(AudioError, match=said):
        AudioStream(StreamSettings(block=sound.BLOCK, ceilings=(1.0,) * outputs, **asked), MonotonicClock())  # type: ignore[arg-type]


def test_pulseaudio_carries_a_stream_too(
    pulseaudio: tuple[str, dict[str, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, environment = pulseaudio
    with looking_anew():
        for name, value in environment.items():
            monkeypatch.setenv(name, value)
    settings = StreamSettings("ALSA", "pulse", 48_000, 512, 1, (1.0,))
    wave = np.random.default_rng(1).uniform(-0.5, 0.5, 4800).astype(np.float32)
    opened = AudioStream(settings, MonotonicClock())
    try:
        opened.wait(opened.next_frame + 24_000)
        cue = opened.schedule(wave, channel=0, frame=opened.next_frame + 4096)
        # Its way round is long and not always the same, and under load it tears: found, but not to the sample.
        found = actuator.align(opened.recorded_inputs(cue.frame, 144_000)[:, 0], wave, gain=1.0)
    finally:
        opened.close()
    assert cue.started == cue.frame
    assert found is not None
    assert found.onset > 0


def test_without_jack_a_simulated_sound_card_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, refuses: Refuses
) -> None:
    monkeypatch.setattr(shutil, "which", lambda _: None)
    with refuses(AudioError):
        SoundCard(rate_hz=48_000, block=256, inputs=1, outputs=1)


def test_a_server_that_does_not_start_is_said_with_its_own_words(
    parts: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, refuses: Refuses
) -> None:
    refusing = tmp_path / "jackd"
    refusing.write_text("#!/bin/sh\necho 'no room for another server'\nexit 1\n", "utf-8")
    refusing.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    before = dict(os.environ)
    with refuses(AudioError):
        SoundCard(rate_hz=48_000, block=256, inputs=1, outputs=1)
    assert dict(os.environ) == before
