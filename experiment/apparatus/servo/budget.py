"""How far the force that a hand feels of a rig's device is from the block's law, cause by cause."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

from palpate.experiment.apparatus.servo.observer import QUANTUM_SD
from palpate.experiment.apparatus.servo.passivity import follower
from palpate.experiment.errors import Finding, RigError
from palpate.experiment.synthesis.contact.force import ForceBudget, Loop

if TYPE_CHECKING:
    from palpate.experiment.apparatus.servo.settings import ServoRig
    from palpate.experiment.apparatus.tracker.settings import TrackerRig
    from palpate.experiment.protocol.kinds.tapping import Tapping

UNKNOWN = (
    "The force error is unknown. Computing it requires the mass of the device's tip (servo.tip_mass_kg) and a block "
    "with constant stiffness and no crossovers."
)


def judged(virtual: Tapping, device: ServoRig, tracker: TrackerRig, *, limit_n: float) -> tuple[bool, str]:
    """Return whether the force is as right as a protocol asks, and in sentences how right it is."""
    budget, most = force_budget(virtual, device, tracker, limit_n=limit_n), virtual.force_error_max
    if budget is None:
        return most is None, UNKNOWN
    return most is None or budget.worst.error <= most, budget.sentence()


def refuse_beyond(virtual: Tapping, device: ServoRig, tracker: TrackerRig, *, limit_n: float, rig: str) -> None:
    """Refuse, with a `RigError`, a rig whose force is off by more than the protocol allows."""
    if virtual.force_error_max is None:
        return
    right, told = judged(virtual, device, tracker, limit_n=limit_n)
    if not right:
        raise RigError.at(refusal(virtual, told, rig=rig))


def refusal(virtual: Tapping, told: str, *, rig: str) -> Finding:
    """Return why no participant is run on a rig of which `judged` says so."""
    return Finding(
        "got a force error that is too large or unknown",
        f"rig '{rig}'",
        allowed=f"{100 * (virtual.force_error_max or 0.0):.6g} % (tapping.force_error_max). {told}",
        remedy="use a sensor with less noise, a faster servo, or a block with less damping",
    )


def force_budget(virtual: Tapping, device: ServoRig, tracker: TrackerRig, *, limit_n: float) -> ForceBudget | None:
    """Return what of a protocol's force a rig's device gets right.

    None where nothing is known of the mass of its tip, for a block that gives way or has crossovers, and for one
    without stiffness, which asks for nothing of a hand at rest.
    """
    observer, alone = follower(virtual, device, tracker), virtual.mass_kg is not None or not virtual.stiffness_n_m
    if observer is None or device.tip_mass_kg is None or alone:
        return None
    count_m = 1e-3 * max(abs((b.mm - a.mm) / (b.counts - a.counts)) for a, b in pairwise(tracker.calibration))
    loop = Loop(
        k=virtual.stiffness_n_m,
        c=virtual.damping_n_s_m,
        limit_n=limit_n,
        observer=observer,
        noise_m=max(observer.noise_m**2 - (QUANTUM_SD * count_m) ** 2, 0.0) ** 0.5,
        count_m=count_m,
        tip_kg=device.tip_mass_kg,
        tip_n_s_m=device.damping_n_s_m,
        delay_s=device.delay_ms * 1e-3,
        band_hz=device.band_hz,
        samples=max(round(tracker.rate_hz / virtual.rate_hz), 1),
    )
    return loop.budget(virtual.fastest_mm_s)
