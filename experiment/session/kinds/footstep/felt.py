"""What a measured panel makes of a stimulus beside what was asked for: third octaves, how loud it is over time, and how
probably a person notices the difference, by a model.

All follow from the panel's complex response, so that what its phase does to a vibration is in them.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from math import inf
from operator import attrgetter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus.panel.conditioning import INVERSE, Played
from palpate.experiment.apparatus.panel.movement import DRIFT_DB, Movement, open_movement
from palpate.experiment.apparatus.rig import MeasuredRig, Rig
from palpate.experiment.synthesis.budget import Budget
from palpate.experiment.synthesis.noticing import SOLE, noticed, third_octave_energies

LEAST_SHARE = 1e-3
"""A third octave with less of the energy than this does not count."""

WINDOW_S = 0.02
"""How long the level of a vibration is averaged, s: ours."""

QUIETEST_DB = 20.0
"""A window so far below the loudest one does not count."""


CREST = 3.4
"""How many times its rms the multisine that finds compression peaks at the most: of `multisine.DRAWS` the lowest."""


def gain_sentence(one: Budget) -> str:
    """Return how far the inverse of a panel goes, by the budget of a stimulus, and what is shown of it."""
    most = import_module(INVERSE).MOST_GAIN
    return (
        f"The inverse has a gain of up to {one.gain:.3g} at {one.gain_hz:.0f} Hz, relative to the mean of the panel's "
        f"usable band. The gain is limited to {most:g}; above that, the vibration is weaker than requested. "
        "'Before onset, by the inverse': how much the panel moves before a vibration begins."
    )


@dataclass(frozen=True)
class Felt:
    """By how much a movement differs from what was asked for at the worst, in magnitude, dB.

    `third_octave_db` is of third octaves, `envelope_db` of the levels of windows in time; each with the interval that a
    soft coil, and drift that no comparison refuses or warns of, leave it. On a panel that got 3 % heavier and on a soft
    coil these hold the truth in 320 of 320 SIMULATED stimuli, and 34 of the 160 by an inverse are wider than twice the
    truth, for the drift alone is (`python -m tests.benchmarks.felt`). The difference is noticed with these
    probabilities, by the model of `synthesis/noticing.py`.
    """

    third_octave_db: float
    envelope_db: float
    noticed_at_least: float
    noticed_at_most: float
    third_octave_between_db: tuple[float, float] = (0.0, inf)
    envelope_between_db: tuple[float, float] = (0.0, inf)


FELT_ROWS: tuple[tuple[str, Callable[[Felt], float], Callable[[float], str]], ...] = (
    ("third octaves, dB", attrgetter("third_octave_db"), "{:.1f}".format),
    ("third octaves at most, dB", lambda felt: felt.third_octave_between_db[1], "{:.1f}".format),
    ("envelope, dB", attrgetter("envelope_db"), "{:.1f}".format),
    ("envelope at most, dB", lambda felt: felt.envelope_between_db[1], "{:.1f}".format),
    ("noticed at least, %", attrgetter("noticed_at_least"), lambda share: f"{share * 100:.0f}"),
    ("noticed at most, %", attrgetter("noticed_at_most"), lambda share: f"{share * 100:.0f}"),
)
"""Each line of a measured panel, the value of `Felt`, and how it is shown."""

FELT = (
    "Third octaves and envelope compare the requested vibration with the panel's movement, computed from its "
    f"measured response with phase: the worst third octave from 10 to 500 Hz with at least {LEAST_SHARE:.1%} of the "
    f"energy, and the worst {WINDOW_S * 1e3:g} ms within {QUIETEST_DB:g} dB of the loudest. 'At most' assumes that "
    f"the panel's response has drifted by {DRIFT_DB:g} dB, or that its coil is soft. 'Noticed': probability that a "
    f"person notices the difference, excluding guesses, by an untested model from published thresholds ({SOLE.source})."
)
"""What the lines of a measured panel are."""


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
            felt_with_intervals(one.stimulus.waveform_m_s2, one.samples, movement, ahead=ahead) for one in each
        )
        for material, each in stimuli.items()
    }


def felt_with_intervals(
    asked_m_s2: NDArray[np.float64], samples: NDArray[np.float32], movement: Movement, *, ahead: int = 0
) -> Felt:
    """Return what a panel makes of samples that begin so many before a stimulus, with intervals.

    They go from the less to the more of a straight and a soft coil, and by the movement's `louder_db` on either side.
    """
    straight, soft = (
        felt(asked_m_s2, movement.moved_m_s2(one)[ahead:], rate_hz=movement.rate_hz)
        for one in (samples, after_soft_coil(samples, movement.measured))
    )

    def interval(one_db: float, other_db: float) -> tuple[float, float]:
        low, high = sorted((one_db, other_db))
        return max(low - movement.louder_db, 0.0), high + movement.louder_db

    return replace(
        straight,
        third_octave_between_db=interval(straight.third_octave_db, soft.third_octave_db),
        envelope_between_db=interval(straight.envelope_db, soft.envelope_db),
    )


def after_soft_coil(samples: NDArray[np.float32], measured: MeasuredRig) -> NDArray[np.float32]:
    """Return samples as a coil passes them on that is at least as soft as it was measured to be.

    s - a s^3 takes 3 a times the mean square from the gain of a noise (Bussgang 1952, MIT Res. Lab. Electronics, Tech.
    Rep. 216), which of a multisine is at least its peak by `CREST`, squared.
    """
    lost = max(1 - 10 ** (-measured.compression_db / 20), 0.0)
    a = lost * CREST**2 / (3 * measured.loudest**2)
    return (samples / np.sqrt(1 + 2 * a * np.square(samples))).astype(np.float32)


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
