"""SIMULATED hand on a force device: how far a tap is moved by the force that the servo sends.

The hand goes where it means to, as far as nothing pushes it: its muscles know the device's mass and damping. What the
force does is added: m d" + (b + c) d' + k d = F, with the device's tip mass and damping, and a hand of `HAND_N_M`,
`HAND_N_S_M` and `HAND_KG`, out of the block and along its face.

The far end of the tracker's line knows the force beforehand: it samples, with the sensor's noise and counts, and steps
palpate's own servo, which gets the same samples in simulated time and so sends the same force. In real time the servo's
may differ by what it saw while the hand rested, and nothing moves the hand where the servo fell silent. Of blocks with
crossovers, that of the highest moves the hand, whichever lies there.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from palpate.experiment.apparatus.rig import Rig, tracker_of
from palpate.experiment.apparatus.servo import rendering
from palpate.experiment.apparatus.servo.opening import servo_of
from palpate.experiment.apparatus.servo.passivity import follower
from palpate.experiment.apparatus.servo.rendering import NO_FORCE, Rendered, bounded
from palpate.experiment.apparatus.tracker.settings import CalibrationPoint, TrackerRig
from palpate.experiment.protocol.kinds.tapping import Tapping
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.rehearsal.wires.foot import Trajectory
from palpate.experiment.session.kinds.tapping.virtual import blocks, limit_n
from palpate.experiment.synthesis.contact.block import Block, Pair
from palpate.experiment.synthesis.contact.force import HAND_KG, HAND_N_M, HAND_N_S_M
from palpate.experiment.synthesis.contact.observer import Observer

Floats = NDArray[np.float64]

TIP_KG = 0.1
"""Of a device whose tip nobody has weighed, kg. Ours."""

LITTLE_MM = 1e-4
"""A hand that nothing pushes is where it means to be, mm, where it is off by no more. Ours."""


@dataclass(frozen=True)
class Device:
    """What a hand holds, and what renders to it; forces are at most `limit_n`."""

    tracker: TrackerRig
    block: Block
    observer: Observer | None
    limit_n: float
    kg: float
    damping_n_s_m: float

    @cached_property
    def steps(self) -> list[list[float]]:
        """What a period makes of place, mm, speed, mm/s, and a force that stays, N: a row each of the first two."""
        kg, damping_n_s_m = self.kg + HAND_KG, self.damping_n_s_m + HAND_N_S_M
        plant = [[0.0, 1.0, 0.0], [-HAND_N_M / kg, -damping_n_s_m / kg, 1e3 / kg], [0.0, 0.0, 0.0]]
        moves: list[list[float]] = expm(np.array(plant) / self.tracker.rate_hz)[:2].tolist()
        return moves


def device_of(protocol: Protocol, rig: Rig) -> Device:
    """Return what a study's hand holds on a rig."""
    virtual, servo, tracker = protocol.table(Tapping), servo_of(rig), tracker_of(rig)
    return Device(
        tracker,
        max(blocks(virtual, tracker_hz=tracker.rate_hz).values(), key=lambda one: one.crossover_hz),
        follower(virtual, servo, tracker),
        limit_n(protocol, rig),
        servo.tip_mass_kg or TIP_KG,
        servo.damping_n_s_m,
    )


def moved(path: Trajectory, device: Device) -> Trajectory:
    """Return a tap as the force moves it, a knot a sample of the tracker."""
    tracker = device.tracker
    us = np.arange(int(path.duration_us * tracker.rate_hz / 1e6) + 1, dtype=np.float64) * (1e6 / tracker.rate_hz)
    noise_mm = np.random.default_rng(path.noise_seed).normal(0.0, tracker.noise_mm or 0.0, (tracker.readings, us.size))
    true = np.column_stack([path.at(us), path.along_at(us)])
    read, noise, again = read_all(tracker, true, noise_mm).tolist(), noise_mm.T.tolist(), one_read(tracker)
    (a, b, g), (d, e, f) = device.steps
    # Off what is meant, mm, and how fast that grows, mm/s, out of the block and along it.
    out = along = out_s = along_s = 0.0
    at, force_n = Rendered(), NO_FORCE
    for n, at_us in enumerate(np.rint(us).astype(int).tolist()):
        if out or along:
            true[n] += out, along
            read[n] = again(true[n].tolist(), noise[n])
        place_mm = read[n][0], read[n][1]
        at, _ = rendering.step(device.block, at, at_us, place_mm, device.observer, force_n, device.limit_n)
        force_n = bounded(at.force_n, device.limit_n)
        out, out_s = a * out + b * out_s + g * force_n[0], d * out + e * out_s + f * force_n[0]
        along, along_s = a * along + b * along_s + g * force_n[1], d * along + e * along_s + f * force_n[1]
        if not any(force_n) and max(abs(out), abs(along)) < LITTLE_MM:
            out = along = out_s = along_s = 0.0
    # It lasts as long as it was meant to.
    height_mm, along_mm = np.vstack([true, true[-1]]).T
    return replace(path, us=np.append(us, path.duration_us), height_mm=height_mm, along_mm=along_mm)


def read_all(tracker: TrackerRig, true_mm: Floats, noise_mm: Floats) -> Floats:
    """Return what a sensor makes of places, mm, shape (n, 2); along the face 0 unless it is planar."""
    heights = tracker.height_mm(tracker.counts(true_mm[:, 0] + noise_mm[0]))
    along = None
    if tracker.along_calibration is not None:
        along = tracker.along_mm(tracker.second_counts(true_mm[:, 1] + noise_mm[1]))
    return np.column_stack([heights, np.zeros(heights.size) if along is None else along])


def one_read(tracker: TrackerRig) -> Callable[[Pair, Sequence[float]], Pair]:
    """Return what makes of one place and its noise what `read_all` makes of many, at a tenth of its cost."""
    heights = _reader(tracker.calibration)
    if tracker.along_calibration is None:
        return lambda true_mm, noise_mm: (heights(true_mm[0] + noise_mm[0]), 0.0)
    along = _reader(tracker.along_calibration)
    return lambda true_mm, noise_mm: (heights(true_mm[0] + noise_mm[0]), along(true_mm[1] + noise_mm[1]))


def _reader(calibration: Sequence[CalibrationPoint]) -> Callable[[float], float]:
    """Return what a sensor with this calibration reads, mm, of a place, mm."""
    points = [(one.mm, float(one.counts)) for one in calibration]
    to_counts, to_mm = _line(sorted(points)), _line([(counts, mm) for mm, counts in points])
    return lambda mm: to_mm(float(round(to_counts(mm))))


def _line(points: Sequence[Pair]) -> Callable[[float], float]:
    """Return the straight line from point to point, level beyond them, as `numpy.interp` draws it."""
    xs, ys = [x for x, _ in points], [y for _, y in points]
    slopes = [(high - low) / (right - left) for (left, low), (right, high) in pairwise(points)]

    def at(x: float) -> float:
        if not xs[0] <= x < xs[-1]:
            return ys[0] if x < xs[0] else ys[-1]
        n = bisect_right(xs, x) - 1
        return slopes[n] * (x - xs[n]) + ys[n]

    return at
