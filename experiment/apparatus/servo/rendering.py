"""From samples of the hand to the force on it, and to touches; pure, and silent at whatever it cannot believe.

Places are heights above the face of the block at rest, and places along it, mm. Between samples the hand moves
straight.

The force is zero until the hand comes from outside of the block, after a sample that is not a number, comes `GAP_S` or
more after the one before or no later than it, or is too far from it: a force that began inside would strike.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import copysign, hypot, inf, isfinite, sqrt
from typing import NamedTuple

from palpate.experiment.apparatus.tracker.clock_map import ClockMap
from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis.contact import lowpass, path
from palpate.experiment.synthesis.contact.block import Block, Pair, new
from palpate.experiment.synthesis.contact.observer import Observer, Seen
from palpate.experiment.synthesis.contact.path import Left, State, Stepped

GAP_S, MOST_MM_S = 0.01, 5000.0
"""Samples farther apart are no path, s, and no hand is faster, mm/s. Ours: ten slowest periods, and taps, ten times."""

AGAIN_MM = 1.0
"""Height above the face, mm, after which a touch counts again: damping releases a trembling hand inside. Ours."""

AWAY_MM = 5.0
"""So far above the face the hand has left a block, which then stands where it stood at first, mm. Ours."""

SPEED_US = 5000
"""The hand's speed is its mean over at least so long, microseconds: shorter, a sensor's noise would light the lamp."""

FALLS_NS = 50_000_000
"""A force that may be there no longer falls to zero over so long, ns: the hand leans on it. Ours."""

NO_FORCE: Pair = (0.0, 0.0)


class Touch(NamedTuple):
    """The hand touched a block at a device time, microseconds, at this speed into it, mm/s.

    `mean_mm_s` is the hand's mean speed then, in any direction, by which it is too fast or not.
    """

    device_us: float
    speed_mm_s: float
    mean_mm_s: float


@dataclass(frozen=True)
class Felt:
    """What the hand did since the read before: device times, microseconds, heights, mm, touches, and whether too fast.

    `clock` converts device time to session time.
    """

    device_us: tuple[int, ...]
    height_mm: tuple[float, ...]
    touches: tuple[Touch, ...]
    clock: ClockMap
    fast: bool


class Rendered(NamedTuple):
    """Where rendering stands; it never changes: `step` gives the next one.

    `us` is the newest sample's device time, None before the first; `state` None without a force. The force, N, is not
    bounded yet. `armed`: the next touch counts. `speed_mm_s` is the latest mean, since `since_us` and `since_mm`.
    `seen` is what an observer believes of the hand, `relaxing_n` the G of a block with a crossover, N.
    """

    us: int | None = None
    place_mm: Pair = (0.0, 0.0)
    state: State | None = None
    force_n: Pair = NO_FORCE
    armed: bool = False
    speed_mm_s: float = 0.0
    since_us: int = 0
    since_mm: Pair = (0.0, 0.0)
    seen: Seen | None = None
    relaxing_n: float = 0.0

    def silent(self) -> Rendered:
        """Return the same without a force, which begins again where the hand touches from outside."""
        return self._replace(state=None, force_n=NO_FORCE, relaxing_n=0.0)


def bounded(force_n: Pair, limit_n: float) -> Pair:
    """Return a force of at most the limit, N, also in single precision; zero if it is not finite.

    What pushes the hand out of the block comes first, and the force along the face gets what is left.
    """
    x, y = force_n
    size = hypot(x, y)
    if not isfinite(size) or not limit_n > 0:
        return NO_FORCE
    most = limit_n * (1 - 2**-22)
    if size <= most:
        return x, y
    x, left = _out_first(x, most)
    return x, min(max(y, -left), left)


def _out_first(out_n: float, most_n: float) -> Pair:
    """Return the force out of the block, up to the most, and what it leaves for the other, N."""
    out_n = min(max(out_n, -most_n), most_n)
    return out_n, sqrt(max(most_n * most_n - out_n * out_n, 0.0))


def share(now_ns: int, until_ns: int) -> float:
    """Return the part of a force to push: 1 until then, falling to 0 over `FALLS_NS`; so the block stays passive."""
    return min(max(1.0 - (now_ns - until_ns) / FALLS_NS, 0.0), 1.0)


def step(
    block: Block | None,
    at: Rendered,
    us: int,
    place_mm: Pair,
    observer: Observer | None = None,
    sent_n: Pair = NO_FORCE,
    limit_n: float = inf,
) -> tuple[Rendered, tuple[Touch, ...]]:
    """Return what follows from a sample at (height, along the face), mm, and device time; it never raises.

    `sent_n` is the force that was sent since the sample before, N, which an observer is told. The spring along the face
    is stretched no further than the device can hold it: its end slides with the hand. A block with a crossover is
    smooth: it pushes along its normal alone.
    """
    passed_us = 0 if at.us is None else us - at.us
    # False for what is no number, too.
    near = hypot(place_mm[0] - at.place_mm[0], place_mm[1] - at.place_mm[1]) <= MOST_MM_S * passed_us * 1e-6
    hand_m = place_mm[0] * 1e-3, place_mm[1] * 1e-3
    if not (near and 0 < passed_us < GAP_S * 1e6):
        if not isfinite(place_mm[0] + place_mm[1]):
            return Rendered(armed=at.armed), ()
        return Rendered(us, place_mm, armed=at.armed, since_us=us, since_mm=place_mm, seen=Seen(*hand_m)), ()
    speed_mm_s, since_us, since_mm = at.speed_mm_s, at.since_us, at.since_mm
    if us - since_us >= SPEED_US:
        speed_mm_s = hypot(place_mm[0] - since_mm[0], place_mm[1] - since_mm[1]) / (us - since_us) * 1e6
        since_us, since_mm = us, place_mm
    armed = at.armed or place_mm[0] > AGAIN_MM
    was_m = at.place_mm[0] * 1e-3, at.place_mm[1] * 1e-3
    dt_s, hand_m_s, seen = passed_us * 1e-6, None, at.seen
    if observer is not None and seen is not None:
        was_m = seen[:2]
        seen = observer.step(seen, hand_m, dt_s, sent_n)
        hand_m, hand_m_s = seen[:2], seen[2:4]
    state, force_n, relaxing_n = at.state, NO_FORCE, 0.0
    touches: tuple[Touch, ...] = ()
    if block is None:
        state = None
    elif state is not None and place_mm[0] > AWAY_MM and _has_moved(state):
        state = _outside(block, hand_m)
    elif (begun := state or _outside(block, was_m)) is not None:
        try:
            stepped = path.step((block,), begun, hand_m=hand_m, dt_s=dt_s, hand_m_s=hand_m_s)
        except SynthesisError:
            state = None
        else:
            relaxing_n, force_n = _passed(block, at.relaxing_n, stepped.state, stepped.force_n, dt_s, limit_n)
            state = _slid(block, stepped, limit_n)
            if armed and stepped.switches:
                touches = _touches(stepped, us - passed_us, speed_mm_s)
    armed = armed and not touches
    return new(
        Rendered, (us, place_mm, state, force_n, armed, speed_mm_s, since_us, since_mm, seen, relaxing_n)
    ), touches


def _touches(stepped: Stepped, begun_us: int, speed_mm_s: float) -> tuple[Touch, ...]:
    """Return the first touch of a step that began at a device time, microseconds, if there is one."""
    return tuple(
        Touch(begun_us + one.after_s * 1e6, one.deep_m_s * 1e3, speed_mm_s)
        for _, one in stepped.switches
        if one.kind == "touch"
    )[:1]


def _passed(
    block: Block, relaxing_n: float, state: State, force_n: Pair, dt_s: float, limit_n: float
) -> tuple[float, Pair]:
    """Return G of a block with a crossover, and which force is let through, N."""
    if block.crossover_hz == inf:
        return 0.0, force_n
    deep_m, deep_m_s = -state.hand_m[0], -state.hand_m_s[0]
    relaxing_n, out_n = lowpass.step(block, relaxing_n, deep_m=deep_m, deep_m_s=deep_m_s, dt_s=dt_s, limit_n=limit_n)
    return relaxing_n, (out_n, 0.0)


def _slid(block: Block, stepped: Stepped, limit_n: float) -> State:
    """Return the state with a spring along the face that the device can hold within its limit."""
    (at,), k = stepped.state.blocks, block.stiffness_n_m[1]
    if isinstance(at, Left) or not at.phase:
        return stepped.state
    _, left_n = _out_first(stepped.force_n[0], limit_n)
    if k * abs(at.along_m) <= left_n:
        return stepped.state
    return stepped.state._replace(blocks=(at._replace(along_m=copysign(left_n / k, at.along_m)),))


def _outside(block: Block, hand_m: Pair) -> State | None:
    try:
        return path.init((block,), hand_m=hand_m)
    except SynthesisError:
        # It is inside.
        return None


def _has_moved(state: State) -> bool:
    (block,) = state.blocks
    return isinstance(block, Left) and (block.face_m != 0.0 or block.face_m_s != 0.0)
