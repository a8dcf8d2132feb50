"""Other ways to step through a contact, for comparison with the exact one: same signature, equations (4) and (5).

All but the last two notice touch and release only at the end of a step, so they are of first order through a switch.

- `euler`: position and speed both from the beginning of the step.
- `semi-implicit euler`: the speed first, then the position with the new speed.
- `rk4`: the classical Runge-Kutta method of fourth order.
- `implicit midpoint`: the force at the middle of the step, solved for.
- `exponential`: the exact motion of the phase in which the step begins, to its end.
- `rk4 with events`: `rk4`, with touch and release located by shorter steps.
- `exact`: `exact.advance`, the default.
"""

from collections.abc import Callable

from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis.contact import block as blocks
from palpate.experiment.synthesis.contact import exact
from palpate.experiment.synthesis.contact.oscillator import Oscillator, carry, moved

Point = tuple[float, float, float, float]
"""Penetration, its rate, the path along the face, its rate: m and m/s."""

NEAR = 1e-13
"""How closely `rk4 with events` locates a switch, as a part of the step."""

EXACT = "exact"


def stepper(name: str) -> blocks.Advance:
    """Return the stepper of this name. Raises `SynthesisError` for a name that is none."""
    if name not in STEPPERS:
        raise SynthesisError(f"method: got {name!r}; allowed: {', '.join(STEPPERS)}; choose one of them")
    return STEPPERS[name]


def _acting(block: blocks.Block, x: float, u: float) -> bool:
    return (x > 0 or x == 0 < u) and (not block.clamps or blocks.pull_m_s2(block, x, u) > 0)


def _rates(block: blocks.Block, at: Point) -> Point:
    """Return the time derivative of a point by the law, without memory of touches."""
    x, u, y, v = at
    push, beside = block.normal.push_m_s2, block.along.push_m_s2
    if not _acting(block, x, u):
        return u, push, v, beside
    of = block.along
    along = beside - of.stiffness_per_s2 * y - 2 * of.decay_per_s * v
    return u, push - blocks.pull_m_s2(block, x, u), v, along


def _ahead(at: Point, rates: Point, by_s: float) -> Point:
    x, u, y, v = at
    dx, du, dy, dv = rates
    return x + by_s * dx, u + by_s * du, y + by_s * dy, v + by_s * dv


def _semi_implicit(block: blocks.Block, at: Point, dt_s: float) -> Point:
    x, u, y, v = at
    _, du, _, dv = _rates(block, at)
    u, v = u + dt_s * du, v + dt_s * dv
    return x + dt_s * u, u, y + dt_s * v, v


def _rk4(block: blocks.Block, at: Point, dt_s: float) -> Point:
    half = dt_s / 2
    first = _rates(block, at)
    second = _rates(block, _ahead(at, first, half))
    third = _rates(block, _ahead(at, second, half))
    fourth = _rates(block, _ahead(at, third, dt_s))
    sixth = dt_s / 6
    x, u, y, v = (
        one + sixth * (a + 2 * b + 2 * c + d) for one, a, b, c, d in zip(at, first, second, third, fourth, strict=True)
    )
    return x, u, y, v


def _midpoint(block: blocks.Block, at: Point, dt_s: float) -> Point:
    x, u, y, v = at
    half = dt_s / 2

    def solved(of: Oscillator, place: float, speed: float) -> tuple[float, float]:
        """Return the place and the speed in the middle, where the force acts there."""
        a2, b = 2 * of.decay_per_s, of.stiffness_per_s2
        middle = (speed + half * (of.push_m_s2 - b * place)) / (1 + half * (a2 + b * half))
        return place + half * middle, middle

    middle_x, middle_u = solved(block.normal, x, u)
    if _acting(block, middle_x, middle_u):
        _, middle_v = solved(block.along, y, v)
    else:
        middle_u, middle_v = u + half * block.normal.push_m_s2, v + half * block.along.push_m_s2
    return x + dt_s * middle_u, 2 * middle_u - u, y + dt_s * middle_v, 2 * middle_v - v


def _exponential(block: blocks.Block, at: Point, dt_s: float) -> Point:
    x, u, y, v = at
    if not (_acting(block, x, u) or (x == 0 < u)):
        push, beside = block.normal.push_m_s2, block.along.push_m_s2
        return x + dt_s * (u + push * dt_s / 2), u + push * dt_s, y + dt_s * (v + beside * dt_s / 2), v + beside * dt_s
    normal, along = block.ready[-2:]
    if dt_s != block.nominal_s:
        normal, along = carry(block.normal, dt_s), carry(block.along, dt_s)
    return *moved(block.normal, normal, x, u), *moved(block.along, along, y, v)


Blind = Callable[[blocks.Block, Point, float], Point]


def _blind(once: Blind) -> blocks.Advance:
    """Return the stepper that notices a switch at the end of its step."""

    def advance(block: blocks.Block, at: blocks.Motion, dt_s: float) -> tuple[blocks.Motion, tuple[blocks.Switch, ...]]:
        phase, x, u, y, v, since, _ = at
        seen: list[blocks.Switch] = []
        if phase == blocks.FREE and x == 0 < u:
            # The hand stands at the face and goes in: this is the touch.
            phase, y, since = blocks.ENTERING, 0.0, 0.0
            seen.append(blocks.Switch("touch", 0.0, at.since_s, x, u))
        x, u, y, v = once(block, (x, u, y, v), dt_s)
        since += dt_s
        acting = _acting(block, x, u)
        if phase == blocks.FREE and acting:
            seen.append(blocks.Switch("touch", dt_s, since, x, u))
            phase, y, since = blocks.ENTERING, 0.0, 0.0
        if phase == blocks.ENTERING and u <= 0:
            seen.append(blocks.Switch("deepest", dt_s, since, x, u))
            phase = blocks.RETURNING
        if phase and not acting and not (phase == blocks.ENTERING and x == 0):
            seen.append(blocks.Switch("release", dt_s, since, x, u))
            phase, since = blocks.FREE, 0.0
        return blocks.Motion(phase, x, u, y, v, since), tuple(seen)

    return advance


def _located(block: blocks.Block, at: blocks.Motion, dt_s: float) -> tuple[blocks.Motion, tuple[blocks.Switch, ...]]:
    """Step with `rk4` from switch to switch; each is located by the secant method, held in a bracket (Illinois)."""
    phase, x, u, y, v, since, _ = at
    rest = dt_s
    seen: list[blocks.Switch] = []
    smooth = _smooth(block)

    def ahead_of(kind: blocks.Kind, point: Point) -> float:
        """Return what rises through zero at a switch."""
        if kind == "touch":
            return point[0]
        if kind == "deepest":
            return -point[1]
        return -(blocks.pull_m_s2(block, point[0], point[1]) if block.clamps else point[0])

    while True:
        point = (x, u, y, v)
        kinds: tuple[blocks.Kind, ...]
        kinds = (
            ("touch",)
            if phase == blocks.FREE
            else ("release",)
            if phase == blocks.RETURNING
            else ("deepest", "release")
        )
        end, taken, found = smooth(phase, point, rest), rest, None
        for kind in kinds:
            low, high = ahead_of(kind, point), ahead_of(kind, end)
            if high <= 0 or (kind == "touch" and u <= 0):
                continue
            before, after = 0.0, taken
            while after - before > NEAR * dt_s and high:
                middle = after - high * (after - before) / (high - low) if low < 0 else before
                if not before < middle < after:
                    middle = (before + after) / 2
                there = smooth(phase, point, middle)
                value = ahead_of(kind, there)
                if value > 0:
                    after, high, end, low = middle, value, there, low / 2
                else:
                    before, low, high = middle, value, high / 2
            end, taken, found = smooth(phase, point, after), after, kind
        (x, u, y, v), since, rest = end, since + taken, rest - taken
        if found is None:
            return blocks.Motion(phase, x, u, y, v, since), tuple(seen)
        seen.append(blocks.Switch(found, dt_s - rest, since, x, u))
        if found == "deepest":
            phase = blocks.RETURNING
            continue
        phase, since = (blocks.ENTERING, 0.0) if found == "touch" else (blocks.FREE, 0.0)
        if found == "touch":
            x, y = 0.0, 0.0


def _smooth(block: blocks.Block) -> Callable[[int, Point, float], Point]:
    """Return `rk4` for the motion of one phase, which does not ask the law where it stands."""
    normal, along = block.normal, block.along
    a2, b, push = 2 * normal.decay_per_s, normal.stiffness_per_s2, normal.push_m_s2
    d2, e, beside = 2 * along.decay_per_s, along.stiffness_per_s2, along.push_m_s2

    def once(phase: int, point: Point, dt_s: float) -> Point:
        x, u, y, v = point
        if phase == blocks.FREE:
            return (
                x + dt_s * (u + push * dt_s / 2),
                u + push * dt_s,
                y + dt_s * (v + beside * dt_s / 2),
                v + beside * dt_s,
            )
        half = dt_s / 2
        u1, v1 = push - b * x - a2 * u, beside - e * y - d2 * v
        x2, y2 = u + half * u1, v + half * v1
        u2, v2 = push - b * (x + half * u) - a2 * x2, beside - e * (y + half * v) - d2 * y2
        x3, y3 = u + half * u2, v + half * v2
        u3, v3 = push - b * (x + half * x2) - a2 * x3, beside - e * (y + half * y2) - d2 * y3
        x4, y4 = u + dt_s * u3, v + dt_s * v3
        u4, v4 = push - b * (x + dt_s * x3) - a2 * x4, beside - e * (y + dt_s * y3) - d2 * y4
        sixth = dt_s / 6
        return (
            x + sixth * (u + 2 * x2 + 2 * x3 + x4),
            u + sixth * (u1 + 2 * u2 + 2 * u3 + u4),
            y + sixth * (v + 2 * y2 + 2 * y3 + y4),
            v + sixth * (v1 + 2 * v2 + 2 * v3 + v4),
        )

    return once


STEPPERS: dict[str, blocks.Advance] = {
    "euler": _blind(lambda block, at, dt_s: _ahead(at, _rates(block, at), dt_s)),
    "semi-implicit euler": _blind(_semi_implicit),
    "rk4": _blind(_rk4),
    "implicit midpoint": _blind(_midpoint),
    "exponential": _blind(_exponential),
    "rk4 with events": _located,
    EXACT: exact.advance,
}
"""Every stepper by its name."""
