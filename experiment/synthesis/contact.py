"""The virtual block of a tapping study: equations (4) to (6) of Wellman and Howe, exact between samples of the hand.

A block is a mass behind a plane face, with a spring and a damper along the normal of the face and along the face (K, C
and M are diagonal in these two axes). The hand's penetration r is counted from the face, along the normal. While the
hand touches,

    F = -K r - C dr/dt    (4)        M d2r/dt2 = F    (5)        -F pushes the hand out    (6)

(5) is an equation for r because the hand moves on a straight line, at constant speed, from one sample to the next: r''
is then minus the acceleration of the block. A constant force may be added to (5), which presses the block and the hand
together. The spring along the face begins where the hand touched.

Two laws say when the force acts:

- `clamped`, the default: it never pulls. It acts while r > 0 and K r + C dr/dt > 0. With damping it ends while the
  spring is still compressed.
- `printed`: it acts while r > 0, as the paper prints it, and pulls at the end.

`advance` is the exact stepper. It finds touch and release as roots in time and goes from one to the next by the matrix
exponential (`oscillator`), so its error does not depend on the length of a step. Other steppers have its signature
(`steppers`). Blocks that nothing touches take no steps: their state is where they were left, and at which speed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf, pi, sqrt
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from experiment.errors import SynthesisError
from experiment.synthesis.oscillator import (
    Carry,
    Oscillator,
    carry,
    falls_through_zero,
    first_zero,
    moved,
    oscillator,
    parabola_rises,
)

Law = Literal["clamped", "printed"]
Pair = tuple[float, float]

FREE, ENTERING, RETURNING = 0, 1, 2
"""Phases of a contact: none; before the hand was deepest; since then."""

MOST_SWITCHES = 100_000
"""Touches and releases in one step beyond which the step is refused."""


@dataclass(frozen=True)
class Block:
    """One block; pairs are (along the normal, along the face).

    `stiffness_n_m` is the diagonal of K in N/m, `damping_n_s_m` that of C in N s/m, and `mass_kg` that of M in kg; an
    infinite mass is a block that is held. `face_m` is a point of its face, (x, y), and `into` the unit vector from the
    face into the block. `force_n` presses block and hand together, N. The exponentials of steps of `nominal_s` are
    prepared; other steps cost more time and are as exact.
    """

    stiffness_n_m: Pair
    damping_n_s_m: Pair
    mass_kg: Pair
    law: Law = "clamped"
    face_m: Pair = (0.0, 0.0)
    into: Pair = (1.0, 0.0)
    force_n: Pair = (0.0, 0.0)
    nominal_s: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what no equation accepts. Raises `SynthesisError`."""
        if not all(map(_finite, (*self.face_m, *self.into))) or abs(self.into[0] ** 2 + self.into[1] ** 2 - 1) > 1e-9:
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
    def ready(self) -> tuple[float, float, float, float, bool, Carry, Carry]:
        """`pulls`, the pushes along normal and face, `clamps`, and what a nominal step does to both."""
        carried = carry(self.normal, self.nominal_s), carry(self.along, self.nominal_s)
        return *self.pulls, self.normal.push_m_s2, self.along.push_m_s2, self.clamps, *carried

    @cached_property
    def half_turn_s(self) -> float:
        """Half a period along the normal, s; infinity where nothing oscillates."""
        return pi / self.normal.root_per_s if self.normal.split_per_s2 < 0 else inf

    @cached_property
    def clamps(self) -> bool:
        """Whether the force ends before the hand has left; where there is no force at all, it ends at the face."""
        return self.law == "clamped" and any(self.pulls)

    @cached_property
    def held(self) -> bool:
        """Whether the block does not give way."""
        return self.mass_kg[0] == inf

    @cached_property
    def pulls(self) -> Pair:
        """K / M and C / M along the normal; K and C of a block that is held, where only their ratio counts."""
        if self.held:
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
    """The hand in the axes of one block: `phase`, penetration and its rate, path along the face and its rate.

    The path along the face begins at the touch. `since_s` is the time since the last touch or release; `owed_s` is what
    rounding has kept back of it.
    """

    phase: int
    deep_m: float
    deep_m_s: float
    along_m: float = 0.0
    along_m_s: float = 0.0
    since_s: float = 0.0
    owed_s: float = 0.0


Kind = Literal["touch", "deepest", "release"]


class Switch(NamedTuple):
    """A touch, the first moment at which the hand goes no deeper, or a release.

    `after_s` is counted from the beginning of the step, `since_s` from the touch, or from the release before a touch.
    """

    kind: Kind
    after_s: float
    since_s: float
    deep_m: float
    deep_m_s: float


Advance = Callable[[Block, Motion, float], tuple[Motion, tuple[Switch, ...]]]
"""A stepper: block, motion and the length of a step, s -> the motion after it, and what happened on the way."""


def advance(block: Block, at: Motion, dt_s: float) -> tuple[Motion, tuple[Switch, ...]]:
    """Return the motion after `dt_s`, the hand's speed being constant, and what happened on the way.

    Raises `SynthesisError` for more than `MOST_SWITCHES` touches and releases.
    """
    phase, x, u, y, v, since, owed = at
    if phase and dt_s < block.half_turn_s:
        b, a2, push, beside, clamps, normal, along = block.ready
        if dt_s != block.nominal_s:
            normal, along = carry(block.normal, dt_s), carry(block.along, dt_s)
        # `moved`, written out: a call costs as much as the arithmetic.
        kept, of_y, of_speed, s, w, pull = normal
        x1 = kept * x + (of_y * x + s * u + w * push)
        u1 = kept * u + (of_speed * u - pull * x + s * push)
        if phase == RETURNING or (u > 0 and u1 > 0):
            if clamps:
                end = b * x1 + a2 * u1
                before, after = b * u + a2 * (push - b * x - a2 * u), b * u1 + a2 * (push - end)
            else:
                end, before, after = x1, u, u1
            # Half a period ahead, what is above zero was below it only if it had a minimum; a held block has none.
            if end > 0 and (block.held or not before < 0 < after):
                kept, of_y, of_speed, s, w, pull = along
                wanted = dt_s - owed
                total = since + wanted
                return Motion(
                    phase,
                    x1,
                    u1,
                    kept * y + (of_y * y + s * v + w * beside),
                    kept * v + (of_speed * v - pull * y + s * beside),
                    total,
                    (total - since) - wanted,
                ), ()
    return _eventful(block, at, dt_s)


class Left(NamedTuple):
    """A block that nothing touches: where its face and a point on it are, m, how fast they go, m/s, and since when, s.

    All are along the block's own normal and face.
    """

    face_m: float
    beside_m: float
    face_m_s: float
    beside_m_s: float
    at_s: float


class State(NamedTuple):
    """The hand, (x, y), its velocity since the sample before, and each block, at a time that begins at zero."""

    time_s: float
    hand_m: Pair
    hand_m_s: Pair
    blocks: tuple[Motion | Left, ...]


class Stepped(NamedTuple):
    """The state after a step; the force on the hand, (x, y), N; and what happened, each with its block's place."""

    state: State
    force_n: Pair
    switches: tuple[tuple[int, Switch], ...]


@dataclass(frozen=True)
class Trajectory:
    """A whole path of the hand through n samples.

    `force_n` is the force on the hand at each sample, (x, y), N, shape (n, 2). `deep_m` is the penetration of each
    block, m, zero or less where it is not touched, and `touching` says where its force acts, both of shape (n, blocks).
    `switches` hold the time from the first sample, s, the block's place, and what happened there.
    """

    force_n: NDArray[np.float64]
    deep_m: NDArray[np.float64]
    touching: NDArray[np.bool_]
    switches: tuple[tuple[float, int, Switch], ...]


def init(blocks: Sequence[Block], *, hand_m: Pair) -> State:
    """Return the state in which all blocks and the hand rest, the hand at (x, y), m, outside of every block.

    Raises `SynthesisError` if the hand is not at a finite place, or inside a block.
    """
    _placed(hand_m)
    for i, block in enumerate(blocks):
        if (deep := _beside(block, hand_m)[0] - _beside(block, block.face_m)[0]) > 0:
            raise SynthesisError(
                f"hand: got {hand_m} m, which is {deep:g} m inside block {i + 1}; allowed: a place outside of every "
                "block; begin there"
            )
    return State(0.0, hand_m, (0.0, 0.0), tuple(Left(*_beside(one, one.face_m), 0.0, 0.0, 0.0) for one in blocks))


def step(blocks: Sequence[Block], state: State, *, hand_m: Pair, dt_s: float, advance: Advance = advance) -> Stepped:
    """Return what follows when the hand has gone straight to (x, y), m, in `dt_s`, s.

    `blocks` are those that `init` was given. A block that is not touched, and that the hand's path does not reach, is
    returned as it was. Raises `SynthesisError` unless the hand is at a finite place and the time above zero and finite.
    """
    if not 0 < dt_s < inf:
        raise SynthesisError(f"step: got {dt_s:g} s; allowed: a finite time above zero; give the time between samples")
    (before_x, before_y), (x, y) = state.hand_m, hand_m
    moving = (x - before_x) / dt_s, (y - before_y) / dt_s
    if not (moving[0] - moving[0] == 0.0 == moving[1] - moving[1]):
        _placed(hand_m)
        raise SynthesisError(f"hand: got a step to {hand_m} m in {dt_s:g} s; allowed: a finite speed; check the times")
    now_s, force_x, force_y = state.time_s + dt_s, 0.0, 0.0
    change_x, change_y = moving[0] - state.hand_m_s[0], moving[1] - state.hand_m_s[1]
    turned = bool(change_x or change_y)
    after: list[Motion | Left] = []
    switches: list[tuple[int, Switch]] = []
    for i, (block, was) in enumerate(zip(blocks, state.blocks, strict=True)):
        into_x, into_y = block.into
        if isinstance(was, Left):
            ahead = x * into_x + y * into_y - (was.face_m + was.face_m_s * (now_s - was.at_s))
            if ahead <= 0 and block.normal.push_m_s2 == 0 == block.along.push_m_s2:
                after.append(was)
                continue
            at = _joined(block, was, state)
        else:
            at = was
        began: tuple[Switch, ...] = ()
        if turned:
            phase, deep, rate, along, aside, since, owed = at
            rate += change_x * into_x + change_y * into_y
            aside += change_y * into_x - change_x * into_y
            at = Motion(phase, deep, rate, along, aside, since, owed)
            b, a2 = block.pulls
            if not (phase and deep > 0 and b * deep + a2 * rate > 0):
                at, began = _turned(block, at)
        at, seen = advance(block, at, dt_s)
        if began or seen:
            switches += [(i, one) for one in (*began, *seen)]
        if at.phase:
            out, back = block.force_at(at)
            force_x -= out * into_x - back * into_y
            force_y -= out * into_y + back * into_x
            after.append(at)
        else:
            after.append(_parted(block, at, hand_m, moving, now_s) if at.deep_m <= 0 else at)
    return Stepped(State(now_s, hand_m, moving, tuple(after)), (force_x, force_y), tuple(switches))


def trajectory(
    blocks: Sequence[Block], *, times_s: ArrayLike, hand_m: ArrayLike, advance: Advance = advance
) -> Trajectory:
    """Return the forces along a whole path of the hand: times rise, shape (n,); places are (x, y), m, shape (n, 2).

    Raises `SynthesisError` for other shapes, times that do not rise, or what `init` and `step` refuse.
    """
    times, places = np.asarray(times_s, dtype=np.float64), np.asarray(hand_m, dtype=np.float64)
    if times.ndim != 1 or not times.size or places.shape != (times.size, 2):
        raise SynthesisError(
            f"path: got times of shape {times.shape} and places of shape {places.shape}; allowed: (n,) and (n, 2), n "
            "being one or more; give a place for each time"
        )
    forces = np.zeros((times.size, 2))
    deep, touching = np.zeros((times.size, len(blocks))), np.zeros((times.size, len(blocks)), dtype=np.bool_)
    at, path = times.tolist(), [(x, y) for x, y in places.tolist()]
    state = init(blocks, hand_m=path[0])
    deep[0] = [penetration_m(block, one, state) for block, one in zip(blocks, state.blocks, strict=True)]
    switches: list[tuple[float, int, Switch]] = []
    for n in range(1, times.size):
        state, forces[n], seen = step(blocks, state, hand_m=path[n], dt_s=at[n] - at[n - 1], advance=advance)
        deep[n] = [penetration_m(block, one, state) for block, one in zip(blocks, state.blocks, strict=True)]
        touching[n] = [isinstance(one, Motion) and one.phase != FREE for one in state.blocks]
        switches += [(at[n - 1] - at[0] + one.after_s, i, one) for i, one in seen]
    return Trajectory(forces, deep, touching, tuple(switches))


def penetration_m(block: Block, at: Motion | Left, state: State) -> float:
    """Return how deep the hand is in a block, m, along its normal; negative outside."""
    return at.deep_m if isinstance(at, Motion) else _joined(block, at, state).deep_m


def _joined(block: Block, at: Motion | Left, state: State) -> Motion:
    """Return a block that was left, as seen from the hand."""
    if isinstance(at, Motion):
        return at
    deep, along = _beside(block, state.hand_m)
    deep_m_s, along_m_s = _beside(block, state.hand_m_s)
    flown = state.time_s - at.at_s
    return Motion(
        FREE,
        min(deep - (at.face_m + at.face_m_s * flown), 0.0),
        deep_m_s - at.face_m_s,
        along - (at.beside_m + at.beside_m_s * flown),
        along_m_s - at.beside_m_s,
    )


def _parted(block: Block, at: Motion, hand_m: Pair, hand_m_s: Pair, now_s: float) -> Motion | Left:
    """Return a block that the hand has left; one that a force presses on goes on being followed."""
    if block.normal.push_m_s2 or block.along.push_m_s2:
        return at
    deep, along = _beside(block, hand_m)
    deep_m_s, along_m_s = _beside(block, hand_m_s)
    return Left(deep - at.deep_m, along - at.along_m, deep_m_s - at.deep_m_s, along_m_s - at.along_m_s, now_s)


def _turned(block: Block, at: Motion) -> tuple[Motion, tuple[Switch, ...]]:
    """Return the motion after the hand's velocity has changed, which the force of the damper follows at once."""
    phase, x, u, _, v, since, _ = at
    touches = x > 0 and (not block.clamps or pull_m_s2(block, x, u) > 0)
    if phase and not touches and not (x == 0 and u > 0):
        return Motion(FREE, x, u, 0.0, v), (Switch("release", 0.0, since, x, u),)
    if touches and not phase:
        # The path along the face begins anew, and so does the time since the last switch.
        return Motion(ENTERING, x, u, 0.0, v), (Switch("touch", 0.0, since, x, u),)
    return at, ()


def _beside(block: Block, vector: Pair) -> Pair:
    """Return a vector in the axes of a block: along its normal, and along its face."""
    (x, y), (into_x, into_y) = vector, block.into
    return x * into_x + y * into_y, y * into_x - x * into_y


def _placed(hand_m: Pair) -> None:
    if not all(map(_finite, hand_m)):
        raise SynthesisError(f"hand: got {hand_m} m; allowed: finite numbers; check the tracker")


def _eventful(block: Block, at: Motion, dt_s: float) -> tuple[Motion, tuple[Switch, ...]]:
    """Return the same, from one switch to the next."""
    phase, x, u, y, v, since, owed = at
    of, beside = block.normal, block.along
    done, rest = 0.0, dt_s
    switches: list[Switch] = []
    while True:
        x_then = u_then = 0.0
        if phase == FREE:
            after, x_then, u_then = touch(block, x, u)
            taken = min(after, rest)
            x, u = x + taken * (u + of.push_m_s2 * taken / 2), u + of.push_m_s2 * taken
            v += beside.push_m_s2 * taken
        else:
            after = release_after(block, x, u, within_s=rest)
            taken = min(after, rest)
            if phase == ENTERING and (turned := deepest_after(of, x, u)) <= taken:
                phase = RETURNING
                deepest = moved(of, carry(of, turned), x, u)
                switches.append(Switch("deepest", done + turned, _added(since, owed, turned)[0], *deepest))
            x, u = moved(of, carry(of, taken), x, u)
            y, v = moved(beside, carry(beside, taken), y, v)
        since, owed = _added(since, owed, taken)
        if after > rest:
            return Motion(phase, x, u, y, v, since, owed), tuple(switches)
        if phase == FREE:
            phase, x, u, y = ENTERING, x_then, u_then, 0.0
        else:
            phase = FREE
            x, u = released(block, x, u)
        done += taken
        rest -= taken
        switches.append(Switch("touch" if phase else "release", done, since, x, u))
        since = owed = 0.0
        if len(switches) > MOST_SWITCHES:
            raise SynthesisError(
                f"step: got {dt_s:g} s with more than {MOST_SWITCHES} touches and releases; allowed: fewer; take "
                "shorter steps"
            )


def pull_m_s2(block: Block, x: float, u: float) -> float:
    """Return (K r + C dr/dt) / M along the normal, what the clamped law wants above zero; without M if it is held."""
    b, a2 = block.pulls
    return b * x + a2 * u


def deepest_after(of: Oscillator, x: float, u: float) -> float:
    """Return when a hand that touches goes deeper no longer, s: 0 where it does not now, infinity if never."""
    held = of.push_m_s2 - of.stiffness_per_s2 * x
    if u < 0 or (u == 0 and held <= 0):
        return 0.0
    return first_zero(of, value=u, drift=held - of.decay_per_s * u, slow_part=held - of.slow_per_s * u)


def release_after(block: Block, x: float, u: float, *, within_s: float = inf) -> float:
    """Return when a hand that touches, at penetration x, m, and rate u, m/s, is released, s; infinity if never.

    A release beyond `within_s` may be given as infinity. Without a force the root has a closed form. With one, the
    function that falls to zero has extremes with closed forms, of which the first minimum is the lowest: between it and
    what is before it Newton's method is held in a bracket.
    """
    of = block.normal
    a, b, push, slow = of.decay_per_s, of.stiffness_per_s2, of.push_m_s2, of.slow_per_s
    if block.held and block.clamps:
        stiffness, _ = block.pulls
        return pull_m_s2(block, x, u) / (-stiffness * u) if u < 0 < stiffness else inf
    held = push - b * x
    pull = held - 2 * a * u
    if push == 0:
        if block.clamps:
            return first_zero(of, value=pull, drift=-b * u - a * pull, slow_part=-slow * (held - slow * u))
        return first_zero(of, value=x, drift=u + a * x, slow_part=u + of.fast_per_s * x)
    if block.clamps:
        jerk = -b * u - 2 * a * pull
        slope = -jerk or b * pull
        turns = first_zero(of, value=jerk, drift=-b * pull - a * jerk, slow_part=slow * slow * (held - slow * u))
    else:
        slope = u or pull
        turns = first_zero(of, value=u, drift=held - a * u, slow_part=held - slow * u)

    def falling(t_s: float) -> tuple[float, float]:
        x1, u1 = moved(of, carry(of, t_s), x, u)
        if not block.clamps:
            return x1, u1
        return pull_m_s2(block, x1, u1), b * u1 + 2 * a * (push - b * x1 - 2 * a * u1)

    low, high = (turns, turns + block.half_turn_s) if slope > 0 else (0.0, turns)
    if low >= within_s:
        return inf
    if high == inf and within_s == inf:
        if push > 0:
            return inf
        high = max(2 * low, 1 / (a + sqrt(b)) if a or b else abs(u / push))
        while falling(high)[0] >= 0:
            high *= 2
    high = min(high, within_s)
    if falling(high)[0] >= 0:
        return inf
    return falls_through_zero(falling, low, high)


def released(block: Block, x: float, u: float) -> tuple[float, float]:
    """Return penetration and rate at a release, where one follows from the other: from the one that has more digits."""
    b, a2 = block.pulls
    if not block.clamps or a2 == 0:
        return 0.0, u
    return (x, -b * x / a2) if a2 * a2 > b and not block.held else (-a2 * u / b, u)


def touch(block: Block, x: float, u: float) -> tuple[float, float, float]:
    """Return when a hand that is free touches, s, and its penetration and rate then; infinity for the time if never."""
    push = block.normal.push_m_s2
    never = inf, x, u
    if push == 0:
        return (-x / u, 0.0, u) if x <= 0 < u else never
    speed2 = u * u - 2 * push * x
    if x > 0:
        if push < 0:
            return never
        # Released while the spring was compressed, and pressed back: perhaps before it has left the face.
        again = parabola_rises(
            min(pull_m_s2(block, x, u), 0.0),
            block.normal.stiffness_per_s2 * u + 2 * block.normal.decay_per_s * push,
            block.normal.stiffness_per_s2 * push / 2,
        )
        leaves = 2 * x / (sqrt(speed2) - u) if speed2 > 0 else inf
        if again < leaves:
            return again, x + again * (u + push * again / 2), u + push * again
    elif push < 0 and (u <= 0 or speed2 <= 0):
        return never
    speed = sqrt(speed2)
    after = -2 * x / (u + speed) if u > 0 else (speed - u) / push
    return after, 0.0, speed


def _added(total: float, owed: float, more: float) -> tuple[float, float]:
    """Return a sum, and what its rounding took (Kahan), so that a million short steps add up."""
    wanted = more - owed
    summed = total + wanted
    return summed, (summed - total) - wanted


def _finite(value: float) -> bool:
    return -inf < value < inf
