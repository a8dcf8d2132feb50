"""REHEARSAL: how hard a simulated foot presses on the panel. It changes nothing that is felt."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

MEDIAN_N = 40.0
"""The load under which Okamoto et al. measured their panel: "close to the foot force of a typical user"."""

AMONG, WITHIN = 0.25, 0.15
"""By how much the logarithm differs between participants, and between steps of one: chosen, not measured."""

SETTLES_S, SWINGS_HZ = 0.02, 12.0
"""How fast the force of a foot that lands comes to rest, s, and how it swings meanwhile: chosen, not measured."""

OWN_DRAW = 42
"""Names the draw of a participant's force, which is the same in all tasks."""


def drawn_n(entropy: Sequence[int], of_step: np.random.Generator) -> float:
    """Return how hard a foot presses in a step, N, by what names the draws of seed, participant and task."""
    own = np.random.default_rng([*entropy[:2], OWN_DRAW])
    return float(MEDIAN_N * np.exp(AMONG * own.normal() + WITHIN * of_step.normal()))


def pressing_n(us: NDArray[np.floating[Any]], force_n: float, contact_us: float, lift_us: float) -> NDArray[np.float64]:
    """Return the force on the panel at each time of a step, N: it swings to `force_n` on contact, until the lift."""
    since_s = np.clip(us - min(contact_us, lift_us), 0.0, None) / 1e6
    swing = 1 - np.exp(-since_s / SETTLES_S) * np.cos(2 * np.pi * SWINGS_HZ * since_s)
    return np.asarray(np.where(us < lift_us, force_n * swing, 0.0))
