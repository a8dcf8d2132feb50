"""The virtual block of a tapping study, and how the hand stands to it: equations (4) to (6) of Wellman and Howe.

A block is a mass behind a plane face, with a spring and a damper along the face's normal and along the face (K, C and M
are diagonal). Penetration r is counted from the face, along the normal. While the hand touches,

    F = -K r - C dr/dt    (4)        M d2r/dt2 = F    (5)        -F pushes the hand out    (6)

Two laws say when the force acts:

- `clamped`, the default: while r > 0 and K r + C dr/dt > 0, so it never pulls.
- `printed`: while r > 0, as in the paper; it pulls at the end.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import inf, isfinite, pi
from typing import Literal, NamedTuple

from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis.contact.oscillator import Carry, Oscillator, carry, oscillator

Law = Literal["clamped", "printed"]
Pair = tuple[float, float]

FREE, ENTERING, RETURNING = 0, 1, 2
"""Phases of a contact: none; before the hand was deepest; since then."""


@dataclass(frozen=True)
class Block:
    """One block; pairs are (along the normal, along the face).

    The diagonals are `stiffness_n_m` of K, N/m, `damping_n_s_m` of C, N s/m, and `mass_kg` of M, kg, infinite for a
    fixed block. `face_m` is a point (x, y) of the face, `into` the unit vector into the block; `force_n` presses block
    and hand together, N. Steps of `nominal_s` are prepared and so faster, others as exact. A servo renders a force
    that is low-passed at `crossover_hz` (`lowpass`), and steppers that before it.
    """

    stiffness_n_m: Pair
    damping_n_s_m: Pair
    mass_kg: Pair
    law: Law = "clamped"
    face_m: Pair = (0.0, 0.0)
    into: Pair = (1.0, 0.0)
    force_n: Pair = (0.0, 0.0)
    nominal_s: float = 0.0
    crossover_hz: float = inf

    def __post_init__(self) -> None:
        """Refuse what no equation accepts. Raises `SynthesisError`."""
        if not all(map(isfinite, (*self.face_m, *self.into))) or abs(self.into[0] ** 2 + self.into[1] ** 2 - 1) > 1e-9:
            raise SynthesisError(
                f"block: got the face {self.face_m} and the direction {self.into}; allowed: finite numbers, and a "
                "direction of length 1; correct them"
            )
        if not 0 <= self.nominal_s < inf:
            raise SynthesisError(f"nominal_s: got {self.nominal_s} s; allowed: zero or more; correct it")
        _ = self.ready

    @cached_property
    def normal(self) -> Oscillator:
        """The motion along the normal while the hand touches."""
        return self._axis(0)

    @cached_property
    def along(self) -> Oscillator:
        """The motion along the face while the hand touches."""
        return self._axis(1)

    @cached_property
    def ready(self) -> tuple[float, float, float, float, bool, bool, float, Carry, Carry]:
        """`pulls`, pushes along normal and face, `clamps`, `is_rigid`, and a nominal step and what it does to both."""
        pushes = self.normal.push_m_s2, self.along.push_m_s2
        carried = carry(self.normal, self.nominal_s), carry(self.along, self.nominal_s)
        return *self.pulls, *pushes, self.clamps, self.is_rigid, self.nominal_s, *carried

    @cached_property
    def half_turn_s(self) -> float:
        """Half a period along the normal, s; infinity where nothing oscillates."""
        return pi / self.normal.root_per_s if self.normal.split_per_s2 < 0 else inf

    @cached_property
    def clamps(self) -> bool:
        """Whether the force ends before the hand has left; where there is no force at all, it ends at the face."""
        return self.law == "clamped" and any(self.pulls)

    @cached_property
    def is_rigid(self) -> bool:
        """Whether the block does not give way."""
        return self.mass_kg[0] == inf

    @cached_property
    def pulls(self) -> Pair:
        """K / M and C / M along the normal; K and C of a block that is held, where only their ratio counts."""
        if self.is_rigid:
            return self.stiffness_n_m[0], self.damping_n_s_m[0]
        return self.normal.stiffness_per_s2, 2 * self.normal.decay_per_s

    @cached_property
    def diagonals(self) -> tuple[float, float, float, float]:
        """K and C along the normal, then along the face, N/m and N s/m."""
        return self.stiffness_n_m[0], self.damping_n_s_m[0], self.stiffness_n_m[1], self.damping_n_s_m[1]

    def force_at(self, at: Motion) -> Pair:
        """Return -F (6), which pushes the hand out of the block and back along its face, N."""
        phase, deep, rate, along, aside, _, _ = at
        if not phase:
            return 0.0, 0.0
        k, c, k_along, c_along = self.diagonals
        out = k * deep + c * rate
        return (0.0 if out < 0 and self.clamps else out), k_along * along + c_along * aside

    def _axis(self, i: int) -> Oscillator:
        return oscillator(
            stiffness_n_m=self.stiffness_n_m[i],
            damping_n_s_m=self.damping_n_s_m[i],
            mass_kg=self.mass_kg[i],
            force_n=self.force_n[i],
        )


class Motion(NamedTuple):
    """The hand in a block's axes: `phase`, penetration and its rate, path along the face since the touch and its rate.

    `since_s` is the time since the last touch or release; `owed_s` its rounding error.
    """

    phase: int
    deep_m: float
    deep_m_s: float
    along_m: float = 0.0
    along_m_s: float = 0.0
    since_s: float = 0.0
    owed_s: float = 0.0


new = tuple.__new__
"""Makes a `Motion` of its values in half the time of its own name: what a step of a servo makes most."""

Kind = Literal["touch", "deepest", "release"]


class Switch(NamedTuple):
    """A touch, the deepest moment, or a release.

    `after_s` is from the step's beginning, `since_s` from the touch, or from the release before a touch.
    """

    kind: Kind
    after_s: float
    since_s: float
    deep_m: float
    deep_m_s: float


Advance = Callable[[Block, Motion, float], tuple[Motion, tuple[Switch, ...]]]
"""A stepper: block, motion and the length of a step, s -> the motion after it, and what happened on the way."""


def pull_m_s2(block: Block, x: float, u: float) -> float:
    """Return (K r + C dr/dt) / M along the normal, what the clamped law wants above zero; without M if it is held."""
    b, a2 = block.pulls
    return b * x + a2 * u
