"""What a servo's observer is told of its device: noise, and the mass that the force moves."""

from __future__ import annotations

from itertools import pairwise
from math import hypot
from typing import TYPE_CHECKING

from palpate.experiment.apparatus.tracker.landing import QUIETEST_MM
from palpate.experiment.synthesis.contact.observer import Observer

if TYPE_CHECKING:
    from palpate.experiment.apparatus.servo.settings import ServoRig
    from palpate.experiment.apparatus.tracker.settings import TrackerRig
    from palpate.experiment.protocol.kinds.tapping import Tapping


TOLD_KG = 0.05
"""Told no more mass than is needed, kg: the less, the less damping the device needs. Ours, by the same simulation."""

LEAST_TOLD = 1.25
"""Told less than so many times C T, or more than is moved, the loop would be unstable. Ours, likewise."""

QUANTUM_SD = 12**-0.5
"""SD of what rounding to whole counts adds, in counts."""


def least_kg(virtual: Tapping, tracker: TrackerRig) -> float:
    """Return the least mass, kg, that bears a block's damping from sample to sample without trembling."""
    return LEAST_TOLD * virtual.damping_n_s_m / min(virtual.rate_hz, tracker.rate_hz)


def observer_of(virtual: Tapping, device: ServoRig, tracker: TrackerRig) -> Observer | None:
    """Return what tells a servo where its hand is; None where nothing is known of the device's mass.

    None also for a force with crossovers: its filter calms the difference of two samples as well, and asks for less.
    """
    if device.tip_mass_kg is None or virtual.crossovers_hz:
        return None
    count_mm = max(abs((b.mm - a.mm) / (b.counts - a.counts)) for a, b in pairwise(tracker.calibration))
    noise_mm = hypot(QUIETEST_MM if tracker.noise_mm is None else tracker.noise_mm, QUANTUM_SD * count_mm)
    told_kg = min(max(TOLD_KG, least_kg(virtual, tracker)), device.tip_mass_kg)
    return Observer(1 / tracker.rate_hz, noise_mm * 1e-3, told_kg)
