"""The hand's path through blocks: places of the hand in, forces on it and touches out, sample by sample.

Between samples the hand moves straight at constant speed. Untouched blocks take no steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, isfinite
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis.contact.block import ENTERING, FREE, Block, Motion, Pair, Switch, new, pull_m_s2
from palpate.experiment.synthesis.contact.exact import advance

if TYPE_CHECKING:
    import pandas as pd


class Left(NamedTuple):
    """An untouched block: its face and a point on it, m, their speeds, m/s, along normal and face, since a time, s."""

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
    """A path of the hand through n samples, with the force on it, (x, y), N, shape (n, 2).

    `times_s` and `hand_m` are the path, shapes (n,) and (n, 2). `switches` are the time from the first sample, s, the
    block's place, and what happened.
    """

    times_s: NDArray[np.float64]
    hand_m: NDArray[np.float64]
    force_n: NDArray[np.float64]
    switches: tuple[tuple[float, int, Switch], ...]

    def __repr__(self) -> str:
        strongest = float(np.hypot(*self.force_n.T).max())
        return f"<Trajectory: {self.times_s.size} samples, switches: {len(self.switches)}, at most {strongest:.4g} N>"

    def to_frame(self) -> pd.DataFrame:
        """Return a row for each sample: time_s, the hand's x_m and y_m, and the force on it, x_n and y_n."""
        import pandas as pd

        columns = np.column_stack([self.times_s, self.hand_m, self.force_n])
        return pd.DataFrame(columns, columns=["time_s", "x_m", "y_m", "x_n", "y_n"])


def init(blocks: Sequence[Block], *, hand_m: Pair) -> State:
    """Return the state at rest, the hand at (x, y), m. Raises `SynthesisError` if that is not finite and outside."""
    _placed(hand_m)
    for i, block in enumerate(blocks):
        if (deep := _in_axes(block, hand_m)[0] - _in_axes(block, block.face_m)[0]) > 0:
            raise SynthesisError(
                f"hand: got {hand_m} m, which is {deep:g} m inside block {i + 1}; allowed: a position outside every "
                "block; start there"
            )
    return State(0.0, hand_m, (0.0, 0.0), tuple(Left(*_in_axes(one, one.face_m), 0.0, 0.0, 0.0) for one in blocks))


def step(blocks: Sequence[Block], state: State, *, hand_m: Pair, dt_s: float, hand_m_s: Pair | None = None) -> Stepped:
    """Return what follows when the hand has gone straight to (x, y), m, in `dt_s`, s.

    `hand_m_s` is its speed, m/s, where an observer tells it: the hand then came from where that speed has it before,
    and not from the place told then. `blocks` are those of `init`. Raises `SynthesisError` unless the place is finite
    and the time above zero and finite.
    """
    if not 0 < dt_s < inf:
        raise SynthesisError(f"step: got {dt_s:g} s; allowed: a finite time above zero; give the time between samples")
    (before_x, before_y), (x, y) = state.hand_m, hand_m
    if hand_m_s is None:
        moving, gone_x, gone_y = ((x - before_x) / dt_s, (y - before_y) / dt_s), 0.0, 0.0
    else:
        moving = hand_m_s
        gone_x, gone_y = x - moving[0] * dt_s - before_x, y - moving[1] * dt_s - before_y
    if not (moving[0] - moving[0] == 0.0 == moving[1] - moving[1]):
        _placed(hand_m)
        raise SynthesisError(f"hand: got a step to {hand_m} m in {dt_s:g} s; allowed: a finite speed; check the times")
    now_s, force_x, force_y = state.time_s + dt_s, 0.0, 0.0
    change_x, change_y = moving[0] - state.hand_m_s[0], moving[1] - state.hand_m_s[1]
    turned = bool(change_x or change_y or gone_x or gone_y)
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
            deep += gone_x * into_x + gone_y * into_y
            along += gone_y * into_x - gone_x * into_y
            rate += change_x * into_x + change_y * into_y
            aside += change_y * into_x - change_x * into_y
            at = new(Motion, (phase, deep, rate, along, aside, since, owed))
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
    state = new(State, (now_s, hand_m, moving, tuple(after)))
    return new(Stepped, (state, (force_x, force_y), tuple(switches)))


def trajectory(blocks: Sequence[Block], *, times_s: ArrayLike, hand_m: ArrayLike) -> Trajectory:
    """Return the forces along a path of the hand: times, s, shape (n,), and places (x, y), m, shape (n, 2).

    Raises `SynthesisError` for other shapes, times that do not rise, and as `init` and `step`.
    """
    times, places = np.asarray(times_s, dtype=np.float64), np.asarray(hand_m, dtype=np.float64)
    if times.ndim != 1 or not times.size or places.shape != (times.size, 2):
        raise SynthesisError(
            f"path: got times of shape {times.shape} and positions of shape {places.shape}; allowed: (n,) and (n, 2), "
            "with n at least 1; give a position for each time"
        )
    forces = np.zeros((times.size, 2))
    at, path = times.tolist(), [(x, y) for x, y in places.tolist()]
    state = init(blocks, hand_m=path[0])
    switches: list[tuple[float, int, Switch]] = []
    for n in range(1, times.size):
        state, forces[n], seen = step(blocks, state, hand_m=path[n], dt_s=at[n] - at[n - 1])
        switches += [(at[n - 1] - at[0] + one.after_s, i, one) for i, one in seen]
    return Trajectory(times, places, forces, tuple(switches))


def _joined(block: Block, at: Left, state: State) -> Motion:
    """Return a block that was left, as seen from the hand."""
    deep, along = _in_axes(block, state.hand_m)
    deep_m_s, along_m_s = _in_axes(block, state.hand_m_s)
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
    deep, along = _in_axes(block, hand_m)
    deep_m_s, along_m_s = _in_axes(block, hand_m_s)
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


def _in_axes(block: Block, vector: Pair) -> Pair:
    """Return a vector in the axes of a block: along its normal, and along its face."""
    (x, y), (into_x, into_y) = vector, block.into
    return x * into_x + y * into_y, y * into_x - x * into_y


def _placed(hand_m: Pair) -> None:
    if not all(map(isfinite, hand_m)):
        raise SynthesisError(f"hand: got {hand_m} m; allowed: finite numbers; check the tracker")
