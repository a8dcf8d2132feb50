"""Whether a device bears a block: the damping that it needs for a sampled block to be passive.

The condition is Colgate and Schenkel's (`sampled.passive_from_n_s_m`). H is that of spring and damper on what the
observer believes, with the force that is sent fed back to it. Where nothing is known of the device's mass, speed is the
difference of two samples, and the bound is b > K T / 2 + C. A force with a crossover rests on such differences too: the
filter calms them, and an observer behind it would ask for more damping. Of several crossovers the worst counts.
"""

from __future__ import annotations

from math import ceil, inf
from typing import TYPE_CHECKING

import numpy as np

from palpate.experiment.apparatus.servo.observer import least_kg, observer_of
from palpate.experiment.apparatus.servo.process import SILENT_NS
from palpate.experiment.errors import RigError
from palpate.experiment.synthesis.contact.observer import Observer
from palpate.experiment.synthesis.contact.sampled import Complexes, passive_from_n_s_m
from palpate.experiment.synthesis.contact.sampled import needed_damping_n_s_m as differences

if TYPE_CHECKING:
    from palpate.experiment.apparatus.servo.settings import ServoRig
    from palpate.experiment.apparatus.tracker.settings import TrackerRig
    from palpate.experiment.protocol.kinds.tapping import Tapping

NEARLY = 1.1
"""A tracker faster than the servo by no more than this has one sample a force. Ours."""


def needed_damping_n_s_m(
    observer: Observer, *, stiffness_n_m: float, damping_n_s_m: float, delay_s: float = 0.0, samples: int = 1
) -> float:
    """Return the physical damping b that a device and a hand need together, N s/m.

    Arguments are K, N/m, and C, N s/m, of a block that is held, how late its force arrives, s, and for how many samples
    a force is held.
    """
    period_s = observer.period_s
    alpha, beta, gamma = observer.gains
    gains = np.array([alpha, beta / period_s, gamma / period_s**2])
    moves = np.array([[1.0, period_s, period_s**2 / 2], [0.0, 1.0, period_s], [0.0, 0.0, 1.0]])
    pushed = np.array([period_s**2 / 2, period_s, 0.0]) / observer.mass_kg
    law = np.array([stiffness_n_m, damping_n_s_m, 0.0])
    corrected = np.eye(3) - np.outer(gains, [1.0, 0.0, 0.0])
    steps = [np.linalg.matrix_power(corrected @ moves, n) for n in range(samples + 1)]
    told = np.outer(sum(steps[:-1]) @ corrected @ pushed, law)

    def answers(before: Complexes, each: Complexes) -> Complexes:
        loop = np.eye(3) - before[:, None, None] * (steps[-1] - told)
        drive = sum(each[..., None] ** n * (steps[n] @ gains) for n in range(samples))
        force: Complexes = np.linalg.solve(loop, np.moveaxis(drive, 0, -1)).swapaxes(1, 2) @ law
        return force

    return passive_from_n_s_m(answers, period_s=period_s, delay_s=delay_s, samples=samples)


HALVINGS = 12
"""So often the range of a damping is halved to find what a device bears."""


def follower(virtual: Tapping, device: ServoRig, tracker: TrackerRig) -> Observer | None:
    """Return what tells the servo where its hand is; None for the difference of two samples.

    That is so, too, where it alone is passive: an observer's lag asks a block with little damping for more.
    """
    observer = observer_of(virtual, device, tracker)
    lags = observer is not None and not _suffices(virtual, device, tracker, observer)
    return None if lags and _suffices(virtual, device, tracker, None) else observer


def bearable_n_s_m(virtual: Tapping, device: ServoRig, tracker: TrackerRig) -> float:
    """Return a damping C, N s/m, up to a block's own, with which a device bears the block; 0 where none was found."""
    low, high = 0.0, virtual.damping_n_s_m
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        block = virtual.model_copy(update={"damping_n_s_m": middle})
        fits = _suffices(block, device, tracker, follower(block, device, tracker))
        low, high = (middle, high) if fits else (low, middle)
    return low


def _suffices(virtual: Tapping, device: ServoRig, tracker: TrackerRig, observer: Observer | None) -> bool:
    if observer is not None and observer.mass_kg < least_kg(virtual, tracker):
        return False
    return _needed(virtual, device, tracker, observer)[0] <= device.borne_n_s_m


def _needed(virtual: Tapping, device: ServoRig, tracker: TrackerRig, observer: Observer | None) -> tuple[float, float]:
    """Return the damping that a block needs, N s/m, and the crossover that asks for it, Hz."""
    k, c, samples = virtual.stiffness_n_m, virtual.damping_n_s_m, ceil(tracker.rate_hz / (NEARLY * virtual.rate_hz))
    delay_s = device.delay_ms / 1e3
    if (longer_s := 1 / virtual.rate_hz - samples / tracker.rate_hz) > 0:
        # So much longer a force is held, and the sample behind it has any age within a period.
        delay_s += longer_s + 0.5 / tracker.rate_hz
    if observer is None:
        period_s = 1 / min(virtual.rate_hz, tracker.rate_hz)
        given = {"stiffness_n_m": k, "damping_n_s_m": c, "period_s": period_s, "delay_s": delay_s}
        return max((differences(**given, crossover_hz=hz), hz) for hz in virtual.crossovers_hz or (inf,))
    needed = needed_damping_n_s_m(observer, stiffness_n_m=k, damping_n_s_m=c, delay_s=delay_s, samples=samples)
    return needed, inf


def judged(virtual: Tapping, device: ServoRig, tracker: TrackerRig) -> tuple[bool, str]:
    """Return whether a device may render a protocol's block, and in sentences what damping that takes, and why."""
    k, c, observer = virtual.stiffness_n_m, virtual.damping_n_s_m, follower(virtual, device, tracker)
    block = f"The block has a stiffness of {k:g} N/m and a damping of {c:g} N s/m, "
    block += f"at {virtual.rate_hz} Hz with a delay of {device.delay_ms:g} ms"
    has = f"this one has {device.damping_n_s_m:g} N s/m"
    if device.hand_damping_n_s_m:
        has += f", plus {device.hand_damping_n_s_m:g} N s/m assumed for the hand ({device.hand_damping_source})"
    if observer is not None and observer.mass_kg < (least := least_kg(virtual, tracker)):
        return False, f"{block}; it oscillates below {least:g} kg, and the device's mass is {observer.mass_kg:g} kg."
    needed, worst_hz = _needed(virtual, device, tracker, observer)
    if observer is None:
        speed = "; the hand's speed is the difference between two samples"
        speed += f"; the crossover at {worst_hz:g} Hz needs the most damping" if virtual.crossovers_hz else ""
    else:
        speed = f"; the servo estimates motion from the force that it sent and a mass of {observer.mass_kg:g} kg"
    fits = needed <= device.borne_n_s_m
    told = f"{block}{speed}. It is passive if the device has at least {needed:.4g} N s/m of damping; {has}."
    return fits, f"{told} {_of_a_late_cycle(virtual, device)}" if fits else told


def _of_a_late_cycle(virtual: Tapping, device: ServoRig) -> str:
    """Return what a late cycle costs: its force at most, times the fastest hand, for as long as that is no fault."""
    late_ms = SILENT_NS / 1e6
    most_mj = device.full_scale_n * virtual.fastest_mm_s / 1e3 * late_ms
    return (
        f"A cycle may be up to {late_ms:g} ms late before the force ends. In this time, the force can give the hand up "
        f"to {most_mj:.3g} mJ ({device.full_scale_n:g} N times {virtual.fastest_mm_s:g} mm/s times {late_ms:g} ms)."
    )


def refuse_beyond(virtual: Tapping, device: ServoRig, tracker: TrackerRig, *, rig: str) -> None:
    """Refuse, with a `RigError`, a block that the device of that rig does not bear."""
    fits, why = judged(virtual, device, tracker)
    if not fits:
        weigh = "Weigh the device's tip (servo.tip_mass_kg), or use " if device.tip_mass_kg is None else "Use "
        lowered = bearable_n_s_m(virtual, device, tracker)
        less = f"less damping (at most {lowered:.3g} N s/m)" if lowered else "less damping"
        raise RigError(
            f"rig '{rig}'",
            "got a block that is not passive",
            allowed=f"a passive block. {why} {weigh}a softer block, {less}, a faster servo, or a device with more "
            "damping",
        )
