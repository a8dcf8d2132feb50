"""The exact stepper of a block: from one touch or release to the next by the matrix exponential (`oscillator`).

Touch and release are found as roots in time, so the error does not depend on the step.
"""

from math import inf, sqrt

from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis.contact import oscillator
from palpate.experiment.synthesis.contact.block import ENTERING, FREE, RETURNING, Block, Motion, Switch, new, pull_m_s2

MOST_SWITCHES = 100_000
"""Touches and releases in one step beyond which the step is refused."""


def advance(block: Block, at: Motion, dt_s: float) -> tuple[Motion, tuple[Switch, ...]]:
    """Return the motion after `dt_s` at constant speed of the hand, and the switches on the way.

    Raises `SynthesisError` for more than `MOST_SWITCHES` touches and releases.
    """
    phase, x, u, y, v, since, owed = at
    if phase and dt_s < block.half_turn_s:
        b, a2, push, beside, clamps, held, nominal_s, normal, along = block.ready
        if held:
            x1, u1, y1, v1 = x + dt_s * u, u, y + dt_s * v, v
        else:
            if dt_s != nominal_s:
                normal, along = oscillator.carry(block.normal, dt_s), oscillator.carry(block.along, dt_s)
            # `moved`, written out: a call costs as much as the arithmetic.
            kept, of_y, of_speed, s, w, pull = normal
            x1 = kept * x + (of_y * x + s * u + w * push)
            u1 = kept * u + (of_speed * u - pull * x + s * push)
            kept, of_y, of_speed, s, w, pull = along
            y1 = kept * y + (of_y * y + s * v + w * beside)
            v1 = kept * v + (of_speed * v - pull * y + s * beside)
        end = b * x1 + a2 * u1 if clamps else x1
        # Half a period ahead, what is above zero was below it only if it had a minimum; a held block has none.
        if (
            end > 0
            and (phase == RETURNING or (u > 0 and u1 > 0))
            and (
                held
                or not (b * u + a2 * (push - b * x - a2 * u) < 0 < b * u1 + a2 * (push - end) if clamps else u < 0 < u1)
            )
        ):
            wanted = dt_s - owed
            total = since + wanted
            return new(Motion, (phase, x1, u1, y1, v1, total, (total - since) - wanted)), ()
    return _eventful(block, at, dt_s)


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
                deepest = oscillator.moved(of, oscillator.carry(of, turned), x, u)
                switches.append(Switch("deepest", done + turned, _added(since, owed, turned)[0], *deepest))
            x, u = oscillator.moved(of, oscillator.carry(of, taken), x, u)
            y, v = oscillator.moved(beside, oscillator.carry(beside, taken), y, v)
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
                f"step: got {dt_s:g} s with more than {MOST_SWITCHES} touches and releases; allowed: fewer; use "
                "shorter steps"
            )


def deepest_after(of: oscillator.Oscillator, x: float, u: float) -> float:
    """Return when a hand that touches goes deeper no longer, s: 0 where it does not now, infinity if never."""
    held = of.push_m_s2 - of.stiffness_per_s2 * x
    if u < 0 or (u == 0 and held <= 0):
        return 0.0
    return oscillator.first_zero(of, value=u, drift=held - of.decay_per_s * u, slow_part=held - of.slow_per_s * u)


def release_after(block: Block, x: float, u: float, *, within_s: float = inf) -> float:
    """Return when a touching hand, at penetration x, m, and rate u, m/s, is released, s; infinity if never.

    A release beyond `within_s` may be infinity. Without a force the root has a closed form. With one, the extremes have
    closed forms, and Newton's method is bracketed before the first minimum, which is the lowest.
    """
    of = block.normal
    a, b, push, slow = of.decay_per_s, of.stiffness_per_s2, of.push_m_s2, of.slow_per_s
    if block.is_rigid and block.clamps:
        stiffness, _ = block.pulls
        return pull_m_s2(block, x, u) / (-stiffness * u) if u < 0 < stiffness else inf
    held = push - b * x
    pull = held - 2 * a * u
    if push == 0:
        if block.clamps:
            return oscillator.first_zero(of, value=pull, drift=-b * u - a * pull, slow_part=-slow * (held - slow * u))
        return oscillator.first_zero(of, value=x, drift=u + a * x, slow_part=u + of.fast_per_s * x)
    if block.clamps:
        jerk = -b * u - 2 * a * pull
        slope = -jerk or b * pull
        turns = oscillator.first_zero(
            of, value=jerk, drift=-b * pull - a * jerk, slow_part=slow * slow * (held - slow * u)
        )
    else:
        slope = u or pull
        turns = oscillator.first_zero(of, value=u, drift=held - a * u, slow_part=held - slow * u)

    def falling(t_s: float) -> tuple[float, float]:
        x1, u1 = oscillator.moved(of, oscillator.carry(of, t_s), x, u)
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
    return oscillator.falls_through_zero(falling, low, high)


def released(block: Block, x: float, u: float) -> tuple[float, float]:
    """Return penetration and rate at a release, where one follows from the other: from the one that has more digits."""
    b, a2 = block.pulls
    if not block.clamps or a2 == 0:
        return 0.0, u
    return (x, -b * x / a2) if a2 * a2 > b and not block.is_rigid else (-a2 * u / b, u)


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
        again = oscillator.parabola_rises(
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
