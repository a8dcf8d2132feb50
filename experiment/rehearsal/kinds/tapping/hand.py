"""SIMULATED hand: how it taps, at the far end of the tracker's line; `wires.foot` is its sensor and firmware.

A tap is meant as a minimum jerk reach that aims below the face, slows down in there, and is lifted. Meanwhile it
reaches along the face and back, which a planar tracker sees. `pushed` has what the force makes of it. Speeds are ours,
mostly below the 175 mm/s of Wellman and Howe.
"""

import numpy as np

from palpate.experiment.apparatus.rig import Rig, tracker_of
from palpate.experiment.rehearsal.wires.foot import Foot, Trajectory, progress
from palpate.experiment.rehearsal.wires.serial_line import SerialLine

REST_MM = 8.0
"""Where the hand waits above the face, mm. Ours."""

SPEED_MEDIAN_MM_S, SPEED_SIGMA = 110.0, 0.2
"""Speeds of touch are log-normal, mm/s: one in 100 is above 175. Ours."""

PRESSES_S, LIFTS_S = 0.04, 0.1
"""How long a tap goes on below the face, and how long the lift takes, s. Ours."""

SLIDES_MM = 2.0
"""Standard deviation of how far it moves along the face, either way, mm. Ours."""

_KNOT_S = 0.00025


def tap(rng: np.random.Generator, speed_mm_s: float | None = None) -> Trajectory:
    """Return one tap from `REST_MM`, as it is meant; a speed of touch, mm/s, is drawn unless it is given."""
    if speed_mm_s is None:
        speed_mm_s = float(rng.lognormal(np.log(SPEED_MEDIAN_MM_S), SPEED_SIGMA))
    # Minimum jerk over 2 REST_MM has its largest speed, 15/8 of the mean, at the face.
    falls_s = 15 / 8 * 2 * REST_MM / speed_mm_s
    s = np.arange(0.0, 0.5, _KNOT_S / falls_s)
    down_s, down_mm = s * falls_s, REST_MM - 2 * REST_MM * progress(s)
    after_s = np.arange(0.0, PRESSES_S, _KNOT_S)
    s = after_s / PRESSES_S
    press_mm = -speed_mm_s * PRESSES_S * (s - s**3 + s**4 / 2)
    s = np.arange(0.0, 1.0, _KNOT_S / LIFTS_S)
    lift_mm = press_mm[-1] + (REST_MM - press_mm[-1]) * progress(s)
    contact_s, lifted_s = falls_s / 2, falls_s / 2 + PRESSES_S
    time_s = np.concatenate([down_s, contact_s + after_s, lifted_s + s * LIFTS_S])
    noise_seed, slides_mm = int(rng.integers(2**63)), float(rng.normal(0.0, SLIDES_MM))
    there, back = progress(np.minimum(time_s / lifted_s, 1.0)), progress(np.maximum(time_s - lifted_s, 0.0) / LIFTS_S)
    return Trajectory(
        us=time_s * 1e6,
        height_mm=np.concatenate([down_mm, press_mm, lift_mm]),
        gate_top_us=0.0,
        gate_bottom_us=0.0,
        contact_us=contact_s * 1e6,
        lift_us=float(time_s[-1]) * 1e6,
        speed_mm_s=speed_mm_s,
        hesitation="none",
        noise_seed=noise_seed,
        along_mm=slides_mm * (there - back),
    )


def moves(line: SerialLine, rig: Rig, *, real_time: bool) -> Foot:
    """Return a hand at rest, at the far end of a line of a simulated rig's tracker."""
    tracker = tracker_of(rig)
    noise_mm, tick_s = tracker.noise_mm or 0.0, 1 / tracker.rate_hz
    return Foot(line, tracker, real_time=real_time, rest_mm=REST_MM, noise_mm=noise_mm, tick_s=tick_s)
