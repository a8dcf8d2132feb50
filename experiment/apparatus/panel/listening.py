"""What an accelerometer hears of each stimulus of a session, beside what the measured panel makes of its samples.

It hears whatever shakes the panel: a foot's own impact, too. Its port and the actuator's each have a latency, which is
in the delay.
"""

from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from math import gcd
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from palpate.experiment.apparatus.audio.actuator import align
from palpate.experiment.apparatus.panel.accelerometer import PcmAccelerometer, listener
from palpate.experiment.apparatus.panel.conditioning import Played
from palpate.experiment.apparatus.panel.drift import is_heard
from palpate.experiment.apparatus.panel.movement import Movement, open_movement
from palpate.experiment.apparatus.ports import Actuator
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.clock import Clock
from palpate.experiment.errors import RecordingError
from palpate.experiment.records.stimulus import Heard
from palpate.experiment.synthesis.noticing import third_octave_energies
from palpate.experiment.synthesis.waveforms import Waveform

BEFORE_S, AFTER_S = 0.02, 0.15
"""From so long before a stimulus is due until so long after its end the panel is listened to, s. Ours."""

QUIETEST_DB = -200.0
"""A lower level is this one, dB."""


def compare(heard_m_s2: NDArray[np.float64], moved_m_s2: NDArray[np.float64], *, rate_hz: int, lasts: int) -> Heard:
    """Return what was heard, shape (m,), from `BEFORE_S` before a movement, (n,), was due.

    The first `lasts` points of the movement, m or fewer, are looked for; later ones ring. One of nothing is nowhere.
    """
    # On one grid of frequencies: a low third octave has few, and its level hangs on where they lie.
    size = max(heard_m_s2.size, moved_m_s2.size)

    def thirds_db(waveform: NDArray[np.float64]) -> tuple[float, ...]:
        energies = third_octave_energies(waveform, size, rate_hz) / (size * lasts)
        return tuple(np.round(10 * np.log10(np.maximum(energies, 10 ** (QUIETEST_DB / 10))), 2).tolist())

    found = align(heard_m_s2, moved_m_s2[:lasts], gain=1.0) if moved_m_s2[:lasts].any() else None
    return Heard(
        peak_m_s2=float(np.abs(heard_m_s2).max()),
        thirds_db=thirds_db(heard_m_s2),
        sent_thirds_db=thirds_db(moved_m_s2),
        delay_ms=None if found is None else round((found.onset / rate_hz - BEFORE_S) * 1e3, 3),
        gain=None if found is None else found.gain,
    )


@dataclass
class HeardActuator:
    """An actuator, and what the accelerometer heard of each of its stimuli, which goes on record with it."""

    actuator: Actuator
    sensor: PcmAccelerometer
    movement: Movement
    clock: Clock
    _due_ns: list[int] = field(default_factory=list, init=False)
    """Of the newest stimulus: when it was due, as it was aimed last or else when it was set off."""

    def prepare(self, stimulus: Waveform) -> Played:
        """As the actuator does."""
        made, due_ns = self.actuator.prepare(stimulus), list[int]()
        self._due_ns = due_ns
        return replace(made, heard=lambda: self._heard(made, due_ns))

    def aim(self, onset_ns: int) -> bool:
        """As the actuator does."""
        taken = self.actuator.aim(onset_ns)
        if taken and self.actuator.lead_ns:
            self._due_ns.append(onset_ns)
        return taken

    def landed(self, contact_ns: int) -> None:
        """As the actuator does."""
        if not self._due_ns:
            self._due_ns.append(self.clock.now_ns())
        self.actuator.landed(contact_ns)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.actuator, name)

    def _heard(self, played: Played, due_ns: list[int]) -> Heard | None:
        """Return what was heard of a stimulus; None before it was due. It waits for the sensor's last sample."""
        if not due_ns:
            return None
        rate_hz, played_hz = self.sensor.rate_hz, self.movement.rate_hz
        common = gcd(rate_hz, played_hz)
        moved = self.movement.moved_m_s2(played.samples)
        moved = np.asarray(signal.resample_poly(moved, rate_hz // common, played_hz // common))
        lasts = -(-played.samples.size * rate_hz // played_hz)
        begin_ns = due_ns[-1] - round(BEFORE_S * 1e9)
        try:
            heard = self.sensor.samples_from(begin_ns, lasts + round((BEFORE_S + AFTER_S) * rate_hz))
        except RecordingError as error:
            return Heard(problem=error.sentence())
        lost_ms = tuple((round((gap.at_s - BEFORE_S) * 1e3, 1), round(gap.lasts_s * 1e3, 1)) for gap in heard.gaps)
        compared = compare(heard.samples_m_s2, moved, rate_hz=rate_hz, lasts=lasts)
        return compared.model_copy(update={"lost_ms": lost_ms})


def open_heard(actuator: Actuator, rig: Rig, folder: Path, clock: Clock, opened: ExitStack, trial_s: float) -> Actuator:
    """Return an actuator of a panel that `drift.is_heard`, listened to from now on until `opened` closes; else itself.

    What is heard is held for as long as a trial presents, `trial_s`, and `accelerometer.RING_S` besides.

    Raises `RigError` for the response in `folder`, and `RecordingError` for a sensor that sends nothing.
    """
    if (measured := rig.actuator.measured) is None or not is_heard(rig):
        return actuator
    movement = open_movement(folder, measured, rate_hz=rig.actuator.rate_hz)
    sensor = listener(rig, clock=clock)
    opened.callback(sensor.close)
    sensor.arm(round(trial_s * sensor.rate_hz))
    return cast("Actuator", HeardActuator(actuator, sensor, movement, clock))
