"""What a measured panel makes of a stimulus beside what was asked for: third octaves, how loud it is over time, and how
probably a person notices the difference, by a model.

All follow from the panel's complex response, so that what its phase does to a vibration is in them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus.panel.conditioning import Played
from palpate.experiment.apparatus.panel.movement import open_movement
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.synthesis.noticing import SOLE, noticed, third_octave_energies

LEAST_SHARE = 1e-3
"""A third octave with less of the energy than this does not count."""

WINDOW_S = 0.02
"""How long the level of a vibration is averaged, s: ours."""

QUIETEST_DB = 20.0
"""A window so far below the loudest one does not count."""


@dataclass(frozen=True)
class Felt:
    """By how much a movement differs from what was asked for at the worst, in magnitude, dB.

    `third_octave_db` is of third octaves, `envelope_db` of the levels of windows in time. The difference is noticed
    with these probabilities, by the model of `synthesis/noticing.py`.
    """

    third_octave_db: float
    envelope_db: float
    noticed_at_least: float
    noticed_at_most: float


def felt_on(stimuli: Mapping[str, Sequence[Played]], *, rig: Rig, rig_folder: Path) -> dict[str, tuple[Felt, ...]]:
    """Return what a rig's panel makes of what it plays, by material; nothing of each where nobody measured the panel.

    Raises `RigError` for the response.
    """
    actuator = rig.actuator
    if actuator.measured is None:
        return dict.fromkeys(stimuli, ())
    movement = open_movement(rig_folder, actuator.measured, rate_hz=actuator.rate_hz)
    ahead = round((actuator.inverse_ahead_ms or 0.0) / 1e3 * actuator.rate_hz)
    return {
        material: tuple(
            felt(one.stimulus.waveform_m_s2, movement.moved_m_s2(one.samples)[ahead:], rate_hz=actuator.rate_hz)
            for one in each
        )
        for material, each in stimuli.items()
    }


def felt(asked_m_s2: NDArray[np.float64], moved_m_s2: NDArray[np.float64], *, rate_hz: int) -> Felt:
    """Return how a movement, shape (m,), differs from what was asked for, (n,), from the same moment on; m >= n.

    A request of silence differs from no movement by nothing.
    """
    size = moved_m_s2.size
    wanted, found = (third_octave_energies(one, size, rate_hz) for one in (asked_m_s2, moved_m_s2))
    thirds = _worst_db(wanted, found, LEAST_SHARE * float(wanted.sum()))
    before, after = (_window_energies(one, size, rate_hz) for one in (asked_m_s2, moved_m_s2))
    envelope = _worst_db(before, after, float(before.max()) * 10 ** (-QUIETEST_DB / 10))
    with np.errstate(divide="ignore"):
        asked_db, moved_db = (10 * np.log10(one / (size * asked_m_s2.size)) for one in (wanted, found))
    return Felt(thirds, envelope, *noticed(asked_db, moved_db, SOLE))


def _window_energies(waveform_m_s2: NDArray[np.float64], size: int, rate_hz: int) -> NDArray[np.float64]:
    """Return the energy of one window after the other."""
    window = round(WINDOW_S * rate_hz)
    whole = -(-size // window) * window
    return np.asarray(np.square(np.pad(waveform_m_s2, (0, whole - waveform_m_s2.size))).reshape(-1, window).sum(axis=1))


def _worst_db(wanted: NDArray[np.float64], found: NDArray[np.float64], least: float) -> float:
    counts = wanted > least if least > 0 else wanted > 0
    if not counts.any():
        return 0.0
    return float(np.abs(10 * np.log10(np.maximum(found[counts], 1e-12 * wanted[counts]) / wanted[counts])).max())
