"""What is heard of a stimulus beside what the panel makes of it."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.panel import listening
from palpate.experiment.apparatus.panel.accelerometer import Gap, Window
from palpate.experiment.apparatus.panel.conditioning import Conditioner
from palpate.experiment.apparatus.panel.listening import AFTER_S, BEFORE_S, QUIETEST_DB, HeardActuator, compare
from palpate.experiment.errors import RecordingError
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.synthesis.noticing import THIRDS_HZ
from palpate.experiment.synthesis.waveforms import Ring

RATE_HZ = 5000
TONE = 3.0 * np.sin(2 * np.pi * 100 * np.arange(RATE_HZ // 2) / RATE_HZ)
"""Half a second of 100 Hz, 3 m/s^2."""


def heard_late(late_s: float, gain: float = 1.0) -> np.ndarray:
    before, after = round((BEFORE_S + late_s) * RATE_HZ), round((AFTER_S - late_s) * RATE_HZ)
    return np.pad(gain * TONE, (before, after))


def test_delay_gain_peak_and_levels_are_those_of_what_was_heard() -> None:
    # A tone whose amplitude falls, so that one period is not like another.
    falls = TONE * np.linspace(1, 0.2, TONE.size)
    heard = np.pad(0.8 * falls, (round((BEFORE_S + 0.013) * RATE_HZ), round((AFTER_S - 0.013) * RATE_HZ)))
    found = compare(heard, falls, rate_hz=RATE_HZ, lasts=falls.size)
    assert found.delay_ms == pytest.approx(13.0)
    assert found.gain == pytest.approx(0.8)
    assert found.peak_m_s2 == np.abs(heard).max()
    # The same movement, later and weaker: in decibels the gain, in every third octave.
    assert np.subtract(found.thirds_db, found.sent_thirds_db) == pytest.approx(20 * np.log10(0.8), abs=0.011)


def test_a_tone_has_its_rms_in_its_third_octave() -> None:
    """The rms of a sine is its amplitude over the square root of two."""
    found = compare(heard_late(0.0), TONE, rate_hz=RATE_HZ, lasts=TONE.size)
    assert THIRDS_HZ[10] == pytest.approx(100)
    assert found.thirds_db[10] == pytest.approx(20 * np.log10(3.0 / np.sqrt(2)), abs=0.1)
    assert max(found.thirds_db[:9]) < found.thirds_db[10] - 15


def test_of_silence_nothing_is_found() -> None:
    silent = compare(np.zeros(RATE_HZ), np.zeros(RATE_HZ), rate_hz=RATE_HZ, lasts=RATE_HZ // 2)
    assert (silent.peak_m_s2, silent.delay_ms, silent.gain) == (0.0, None, None)
    assert set(silent.thirds_db) == {QUIETEST_DB}


class Devices:
    """An actuator that plays at once, a panel that moves by its samples, and a sensor that hears it, or broke."""

    rate_hz, lead_ns = RATE_HZ, 0

    def __init__(self, clock: ManualClock, *, broken: bool) -> None:
        self.clock, self.broken = clock, broken
        self.asked: list[tuple[int, int]] = []

    def prepare(self, stimulus: Ring) -> Any:
        return Conditioner(full_scale=1.0, limit_m_s2=10.0)(stimulus)

    def aim(self, onset_ns: int) -> bool:
        return onset_ns > 0

    def landed(self, contact_ns: int) -> None:
        self.clock.sleep_ns(10**9)

    def is_silent(self) -> bool:
        return True

    def moved_m_s2(self, samples: np.ndarray) -> np.ndarray:
        return np.pad(samples.astype(np.float64), (0, 100))

    def samples_from(self, begin_ns: int, samples: int) -> Window:
        self.asked.append((begin_ns, samples))
        if self.broken:
            raise RecordingError("accelerometer", "the stream ended")
        return Window(np.pad(TONE / 10, (samples - TONE.size, 0)), 0, (Gap(0.05, 0.008),))


@pytest.mark.parametrize("broken", [False, True])
def test_what_was_heard_goes_on_record_with_its_stimulus_once_that_was_due(broken: bool) -> None:
    clock = ManualClock(5 * 10**9)
    devices: Any = Devices(clock, broken=broken)
    one = HeardActuator(devices, devices, devices, clock)
    assert one.is_silent()
    played = one.prepare(Ring(TONE / 10, RATE_HZ))
    assert played.on_record().heard is None
    assert one.aim(clock.now_ns())
    one.landed(clock.now_ns())
    one.prepare(Ring(TONE / 20, RATE_HZ))
    heard = played.on_record().heard
    assert heard is not None
    assert devices.asked == [(round((5 - BEFORE_S) * 1e9), TONE.size + round((BEFORE_S + AFTER_S) * RATE_HZ))]
    assert (heard.peak_m_s2 is None, heard.problem != "") == (broken, broken)
    assert heard.lost_ms == (() if broken else ((round((0.05 - BEFORE_S) * 1e3, 1), 8.0),))


def test_what_was_heard_first_is_still_there_after_the_last_stimulus_of_a_trial(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    armed: list[int] = []

    class Sensor(Devices):
        def __init__(self, settings: Any, *, clock: ManualClock) -> None:
            super().__init__(clock, broken=settings is None)

        def arm(self, samples: int) -> None:
            armed.append(samples)

        def close(self) -> None:
            pass

    clock = ManualClock(0)
    monkeypatch.setattr(listening, "listener", Sensor)
    monkeypatch.setattr(listening, "open_movement", lambda *_, **__: Devices(clock, broken=False))
    rig: Any = rigs.load(shipped("rigs/rehearsal.toml"))
    measured = rig.model_copy(update={"actuator": rig.actuator.model_copy(update={"measured": object()})})
    monkeypatch.setattr(listening, "is_heard", lambda _: True)
    devices: Any = Devices(clock, broken=False)
    for trial_s in (0.0, 21.5):
        with ExitStack() as opened:
            listening.open_heard(devices, measured, Path(), clock, opened, trial_s)
    assert armed == [0, round(21.5 * RATE_HZ)]
