"""When a falling foot will meet the panel, when it did, and whether it still falls: from its heights since the gate.

A Kalman filter follows height, speed and acceleration. The acceleration wanders at random, by about v^2 / `WANDER_MM`
within `WANDER_MM` (white jerk of density v^5 / WANDER_MM^3), whatever the gait. So the filter forgets by distance: it
looks back far for a slow foot and a noisy sensor, and briefly for a fast foot and a quiet one.

Contact is where the parabola through the estimate meets the panel; its standard error holds noise and wander. A foot
whose speed has surely (by `SURE` standard errors) fallen below `FALLS_PART` of its speed through the gate has stopped
or hesitates; one that surely rises has turned back. Neither is predicted to land.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

from palpate.experiment.apparatus.tracker.gate import Contact, Gate
from palpate.experiment.protocol.models import Step

WANDER_MM = 30.0
"""Over this travel, mm, the acceleration changes by v^2 divided by it."""

FALLS_PART = 0.2
"""A foot slower than this part of its speed through the gate hesitates."""

SURE = 2.0
"""Standard errors by which it must be slower."""

FIRST_MM_S = 150.0
"""Speed expected before the second sample, mm/s, with a standard deviation as large."""

SLOWEST_MM_S, FASTEST_MM_S = 20.0, 1000.0
"""The scale of wander stays within these speeds, mm/s."""

QUIETEST_MM = 0.003
"""No sensor is taken to be more exact than this, mm rms."""

NOISE_MM = 0.1
"""Noise of a sensor whose rig file does not state it, mm rms."""

STOPPED_BY_PANEL = 3.0
"""A sample that lies so many standard errors higher than a falling foot would is of one that the panel stops."""

HOVERS_US = 50_000.0
"""A foot that does not land within this time, microseconds, hovers: its contact is only known to be in that time."""

TURNED_BACK = "the foot turned back above the panel"
STOPPED = "the foot stopped or hesitated above the panel"


class Falling(NamedTuple):
    """A foot at its newest sample: estimates and the upper half of their covariance (mm, s), rising counted positive.

    Attributes:
        us: device time of the sample, microseconds.
        mm: height above contact; `mm_s`: its rate; `mm_s2`: the rate of that.
        hh: variance of height; `hv`, `ha`, `vv`, `va`, `aa`: the other covariances.
    """

    us: int
    mm: float
    mm_s: float
    mm_s2: float
    hh: float
    hv: float
    ha: float
    vv: float
    va: float
    aa: float


@dataclass(frozen=True)
class Landing:
    """A contact, predicted or past, its standard error and the newest sample it rests on; device time, microseconds."""

    us: float
    standard_error_us: float
    from_us: int


class Touch(NamedTuple):
    """A foot that a `Contact` was given for: its state, and the contact by the samples so far; `done` if by all."""

    falling: Falling | None
    landing: Landing
    done: bool = False


class LandingPredictor:
    """Follows a foot sample by sample; the same however reads were cut."""

    def __init__(self, step: Step, *, noise_mm: float, wander_mm: float = WANDER_MM) -> None:
        """Take a protocol's gate and contact, the SD of a sensor's noise, and the scale of wander, mm."""
        self._top_mm = step.gate_top_mm
        self._contact_mm = step.contact_mm
        self._variance_mm2 = max(noise_mm, QUIETEST_MM) ** 2
        self._wander_mm = wander_mm

    def init(self) -> Falling | None:
        """Return the state before the first sample."""
        return None

    def step(self, state: Falling | None, us: int, height_mm: float) -> Falling | None:
        """Return the state after a later sample, microseconds, mm above the panel; None above the gate."""
        if height_mm > self._top_mm:
            return None
        measured_mm, noise_mm2 = height_mm - self._contact_mm, self._variance_mm2
        if state is None:
            curve_mm_s2 = FIRST_MM_S**2 / self._wander_mm
            return Falling(us, measured_mm, -FIRST_MM_S, 0.0, noise_mm2, 0.0, 0.0, FIRST_MM_S**2, 0.0, curve_mm_s2**2)
        mm, mm_s, mm_s2, hh, hv, ha, vv, va, aa = _moved(state, (us - state.us) / 1e6, self._wander_mm)
        off_mm = measured_mm - mm
        gain = hh / (hh + noise_mm2), hv / (hh + noise_mm2), ha / (hh + noise_mm2)
        return Falling(
            us,
            mm + gain[0] * off_mm,
            mm_s + gain[1] * off_mm,
            mm_s2 + gain[2] * off_mm,
            hh - gain[0] * hh,
            hv - gain[0] * hv,
            ha - gain[0] * ha,
            vv - gain[1] * hv,
            va - gain[1] * ha,
            aa - gain[2] * ha,
        )

    def landing(self, state: Falling) -> Landing | None:
        """Return the contact to expect; None for a foot that does not fall."""
        mm, mm_s, mm_s2 = max(state.mm, 0.0), state.mm_s, state.mm_s2
        if mm_s >= 0:
            return None
        root = mm_s**2 - 2 * mm_s2 * mm
        # A parabola that turns above the panel belongs to a foot that will stop; it lands no later than this.
        left_s = 2 * mm / (math.sqrt(root) - mm_s) if root > 0 else -mm / mm_s
        _, then_mm_s, _, hh, *_ = _moved(state, left_s, self._wander_mm)
        return Landing(
            state.us + left_s * 1e6, math.sqrt(max(hh, 0.0)) / max(-then_mm_s, -mm_s * FALLS_PART) * 1e6, state.us
        )

    def touching(self, state: Falling | None, contact: Contact) -> Touch:
        """Return the contact before its sample is followed, by the state before; a foot not seen to fall hovers."""
        landing = None if state is None else self.landing(state)
        return Touch(state, landing or Landing(contact.us, HOVERS_US / math.sqrt(12), contact.given_us))

    def touch(self, state: Touch, us: int, height_mm: float, contact: Contact) -> Touch:
        """Return the contact after a next sample, from the one that gave it on; what follows the last is ignored."""
        falling, landing, done = state
        if done or landing.us <= us or self._stopped(falling, us, height_mm):
            return state._replace(done=True)
        latest_us = contact.given_us + HOVERS_US
        if us > latest_us:
            return Touch(falling, Landing(latest_us, HOVERS_US / math.sqrt(12), landing.from_us), done=True)
        falling = self.step(falling, us, height_mm)
        predicted = None if falling is None else self.landing(falling)
        return Touch(falling, predicted or landing)

    def _stopped(self, state: Falling | None, us: int, height_mm: float) -> bool:
        """Return whether a sample lies higher than a foot can that still falls."""
        if state is None:
            return False
        mm, _, _, hh, *_ = _moved(state, (us - state.us) / 1e6, self._wander_mm)
        return height_mm - self._contact_mm - mm > STOPPED_BY_PANEL * math.sqrt(hh + self._variance_mm2)

    def hesitates(self, state: Falling | None, gate: Gate) -> str:
        """Return why a foot that passed the gate is no longer expected to land; empty while it falls."""
        if state is None:
            return TURNED_BACK
        error_mm_s = SURE * math.sqrt(max(state.vv, 0.0))
        if state.mm_s > error_mm_s:
            return TURNED_BACK
        if -state.mm_s + error_mm_s < FALLS_PART * gate.speed_mm_s:
            return STOPPED
        return ""


def _moved(
    state: Falling, seconds: float, wander_mm: float
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Return the state without its time, `seconds` later: x <- F x, P <- F P F' + Q of an acceleration that wanders."""
    _, mm, mm_s, mm_s2, hh, hv, ha, vv, va, aa = state
    s, s2 = seconds, seconds * seconds
    scale_mm_s = min(max(-mm_s, SLOWEST_MM_S), FASTEST_MM_S)
    q = scale_mm_s**5 / wander_mm**3 * s
    return (
        mm + s * mm_s + s2 / 2 * mm_s2,
        mm_s + s * mm_s2,
        mm_s2,
        hh + 2 * s * hv + s2 * (vv + ha) + s * s2 * va + s2 * s2 / 4 * aa + q * s2 * s2 / 20,
        hv + s * (vv + ha) + 1.5 * s2 * va + s * s2 / 2 * aa + q * s * s2 / 8,
        ha + s * va + s2 / 2 * aa + q * s2 / 6,
        vv + 2 * s * va + s2 * aa + q * s2 / 3,
        va + s * aa + q * s / 2,
        aa + q,
    )
