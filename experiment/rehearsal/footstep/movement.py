"""REHEARSAL: how a simulated foot moves in one step, and what is true of it.

Reaching movements are close to minimum jerk (Flash and Hogan 1985, "The coordination of arm movements: an
experimentally confirmed mathematical model", J. Neurosci. 5(7)): x(s) = 10 s^3 - 15 s^4 + 6 s^5. A step aims below the
panel, as a foot that is put down does, so it meets the panel at speed. Its pace wavers a little, and some hesitate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Hesitation = Literal["none", "pause", "dip", "stop", "turn"]
"""Before the passage that leads to contact, a foot may pause above the gate, or dip into it and go back. One that stops
or turns back between gate and panel does not land."""

GATE_TOP_MM = 20.0
GATE_BOTTOM_MM = 10.0
"""The published gate: a foot's speed is its mean speed from 20 mm to 10 mm above the panel."""

HESITATES = 0.1
"""Part of the steps that hesitate: half pause above the gate, half dip into it and withdraw first."""

BRAKES_MM = 3.0
"""Travel in which a foot that will not land comes to a halt, mm."""

_DENSITY_HZ = 4000
"""Knots of a trajectory a second; straight lines between them are within 10^-4 mm."""

Curve = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Time, s, from 0, and height, mm, shape (n,) each."""


@dataclass(frozen=True)
class Trajectory:
    """One step of a foot: it comes down, rests on the panel, and goes up again.

    Attributes:
        us: times of the knots, microseconds, from 0, float64, shape (n,).
        height_mm: height of the sole there, mm, shape (n,); straight lines between them are the truth.
        gate_top_us: when the passage that leads to contact crosses 20 mm, microseconds.
        gate_bottom_us: when it crosses 10 mm.
        contact_us: when it reaches the panel; infinity if it never does.
        lift_us: when it leaves the panel again, 0.22 s or more after contact; the end of a step that never lands.
        speed_mm_s: its mean speed from 20 mm to 10 mm.
        hesitation: what came before it.
        noise_seed: names the sensor's noise during this step.
    """

    us: NDArray[np.float64]
    height_mm: NDArray[np.float64]
    gate_top_us: float
    gate_bottom_us: float
    contact_us: float
    lift_us: float
    speed_mm_s: float
    hesitation: Hesitation
    noise_seed: int

    @property
    def duration_us(self) -> float:
        return float(self.us[-1])

    def at(self, us: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """Height at each time, mm; before and after the step that of its ends.

        Args:
            us: times from the step's beginning, microseconds, shape (n,).
        """
        height_mm: NDArray[np.float64] = np.interp(us, self.us, self.height_mm)
        return height_mm


def trajectory(
    rng: np.random.Generator, speed_mm_s: float, *, rest_mm: float = 70.0, hesitation: Hesitation | None = None
) -> Trajectory:
    """A step with the given mean speed through the gate.

    Args:
        rng: draws everything else.
        speed_mm_s: mean speed from 20 mm to 10 mm above the panel, mm/s.
        rest_mm: height at which the foot waits before and after the step, mm, above 45.
        hesitation: what comes before the passage that leads to contact, or instead of it; None to draw one of a step
            that lands.
    """
    if hesitation is None:
        hesitation = "none" if rng.random() >= HESITATES else ("pause" if rng.random() < 0.5 else "dip")
    if hesitation in ("stop", "turn"):
        return _in_vain(rng, speed_mm_s, rest_mm, hesitation)
    before, start_mm = _before(rng, hesitation, speed_mm_s, rest_mm)
    descent, contact_mm_s = _descent(rng, start_mm, speed_mm_s)
    landing = _landing(rng, contact_mm_s)
    lift = _minimum_jerk(float(landing[1][-1]), rest_mm, rng.uniform(0.3, 0.45))
    time_s, height_mm = _joined([*before, descent, landing, lift])
    begun_us = float(sum(curve[0][-1] for curve in before)) * 1e6
    top_us, bottom_us = (begun_us + _passes(descent, level) * 1e6 for level in (GATE_TOP_MM, GATE_BOTTOM_MM))
    contact_us = begun_us + float(descent[0][-1]) * 1e6
    return Trajectory(
        us=time_s * 1e6,
        height_mm=height_mm,
        gate_top_us=top_us,
        gate_bottom_us=bottom_us,
        contact_us=contact_us,
        lift_us=contact_us + float(landing[0][-1]) * 1e6,
        speed_mm_s=(GATE_TOP_MM - GATE_BOTTOM_MM) * 1e6 / (bottom_us - top_us),
        hesitation=hesitation,
        noise_seed=int(rng.integers(2**63)),
    )


def _in_vain(rng: np.random.Generator, speed_mm_s: float, rest_mm: float, hesitation: Hesitation) -> Trajectory:
    """A step whose foot stops between gate and panel, or turns back there, and goes back to rest."""
    turn_mm = rng.uniform(4.0, 7.0)
    waits_s = rng.uniform(0.2, 0.5) if hesitation == "stop" else 0.001
    still = _still(rest_mm, rng.uniform(0.05, 0.15))
    # A reach that would end far below the panel is at full speed in the gate; it is braked in the last millimetres.
    fall, mm_s = _descent(rng, rest_mm, speed_mm_s)
    kept = fall[1] > turn_mm
    fall = fall[0][kept], fall[1][kept]
    brake_s = _times(2 * BRAKES_MM / mm_s)
    brake = brake_s, float(fall[1][-1]) - mm_s * brake_s + mm_s * brake_s**2 / (2 * brake_s[-1])
    rise = _minimum_jerk(float(brake[1][-1]), rest_mm, rng.uniform(0.3, 0.45))
    time_s, height_mm = _joined([still, fall, brake, _still(float(brake[1][-1]), waits_s), rise])
    top_us, bottom_us = ((float(still[0][-1]) + _passes(fall, level)) * 1e6 for level in (GATE_TOP_MM, GATE_BOTTOM_MM))
    return Trajectory(
        us=time_s * 1e6,
        height_mm=height_mm,
        gate_top_us=top_us,
        gate_bottom_us=bottom_us,
        contact_us=math.inf,
        lift_us=float(time_s[-1]) * 1e6,
        speed_mm_s=(GATE_TOP_MM - GATE_BOTTOM_MM) * 1e6 / (bottom_us - top_us),
        hesitation=hesitation,
        noise_seed=int(rng.integers(2**63)),
    )


def _before(
    rng: np.random.Generator, hesitation: Hesitation, speed_mm_s: float, rest_mm: float
) -> tuple[list[Curve], float]:
    """What comes before the passage that leads to contact, and the height from which that begins."""
    curves = [_still(rest_mm, rng.uniform(0.05, 0.15))]
    if hesitation == "none":
        return curves, rest_mm
    if hesitation == "pause":
        hold_mm = rng.uniform(28.0, 45.0)
        curves += [_unhurried(rest_mm, hold_mm, speed_mm_s), _still(hold_mm, rng.uniform(0.15, 0.4))]
        return curves, hold_mm
    turn_mm, start_mm = rng.uniform(6.0, 17.0), rng.uniform(26.0, 40.0)
    curves += [_unhurried(rest_mm, turn_mm, speed_mm_s), _unhurried(turn_mm, start_mm, speed_mm_s)]
    return curves, start_mm


def _descent(rng: np.random.Generator, start_mm: float, speed_mm_s: float) -> tuple[Curve, float]:
    """From rest to the panel with the wanted speed through the gate; and the speed of contact, mm/s."""
    aim_mm = -rng.uniform(10.0, 25.0)
    s = np.linspace(0.0, 1.0, 2001)
    height_mm = start_mm + (aim_mm - start_mm) * _progress(s)
    pace = s + sum(
        share / (2 * np.pi * k) * (np.sin(2 * np.pi * k * s + phase) - np.sin(phase))
        for k, share, phase in zip((1, 2, 3), rng.uniform(0.0, 0.15, 3), rng.uniform(0.0, 2 * np.pi, 3), strict=True)
    )
    gate = _passes((pace, height_mm), GATE_BOTTOM_MM) - _passes((pace, height_mm), GATE_TOP_MM)
    time_s = pace * (GATE_TOP_MM - GATE_BOTTOM_MM) / (speed_mm_s * gate)
    contact_s = _passes((time_s, height_mm), 0.0)
    last = int(np.searchsorted(time_s, contact_s))
    contact_mm_s = float((height_mm[last - 1] - height_mm[last]) / (time_s[last] - time_s[last - 1]))
    return (np.append(time_s[:last], contact_s), np.append(height_mm[:last], 0.0)), contact_mm_s


def _landing(rng: np.random.Generator, contact_mm_s: float) -> Curve:
    """Sole and panel give way and come to rest a little below zero."""
    time_s = _times(rng.uniform(0.22, 0.3))
    yielding_s, settling_s, sag_mm = 0.004, 0.01, rng.uniform(0.05, 0.2)
    dent_mm = contact_mm_s * time_s * np.exp(-time_s / yielding_s)
    return time_s, -dent_mm - sag_mm * (1 - np.exp(-time_s / settling_s))


def _progress(s: NDArray[np.float64]) -> NDArray[np.float64]:
    return s**3 * (10 - 15 * s + 6 * s**2)


def _minimum_jerk(from_mm: float, to_mm: float, duration_s: float) -> Curve:
    time_s = _times(duration_s)
    return time_s, from_mm + (to_mm - from_mm) * _progress(time_s / time_s[-1])


def _unhurried(from_mm: float, to_mm: float, speed_mm_s: float) -> Curve:
    return _minimum_jerk(from_mm, to_mm, float(np.clip(1.5 * abs(to_mm - from_mm) / speed_mm_s, 0.15, 0.8)))


def _still(height_mm: float, duration_s: float) -> Curve:
    return np.array([0.0, duration_s]), np.array([height_mm, height_mm])


def _times(duration_s: float) -> NDArray[np.float64]:
    return np.linspace(0.0, duration_s, 2 + round(duration_s * _DENSITY_HZ))


def _passes(falling: Curve, level_mm: float) -> float:
    """When a falling curve passes a level."""
    time, height_mm = falling
    return float(np.interp(-level_mm, -height_mm, time))


def _joined(curves: list[Curve]) -> Curve:
    """One curve after the other; each begins where the one before ends."""
    begin_s = np.cumsum([0.0, *(curve[0][-1] for curve in curves[:-1])])
    first_s, first_mm = curves[0]
    time_s = [first_s, *(begin + curve[0][1:] for begin, curve in zip(begin_s[1:], curves[1:], strict=True))]
    return np.concatenate(time_s), np.concatenate([first_mm, *(curve[1][1:] for curve in curves[1:])])
