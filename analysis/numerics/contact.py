"""Error against run time of ways to step through a contact, and invariants of each.

Errors are against `oracle.impact`, the largest over the phase of the touch within a step.
"""

from collections.abc import Sequence
from functools import partial
from itertools import product
from math import inf, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from palpate.analysis.numerics import oracle
from palpate.analysis.numerics.cases import Case, Seen
from palpate.analysis.numerics.played import Condition
from palpate.experiment.synthesis.contact.block import ENTERING, FREE, RETURNING, Advance, Block, Motion, Switch
from palpate.experiment.synthesis.contact.exact import advance
from palpate.experiment.synthesis.contact.path import Trajectory, trajectory
from palpate.experiment.synthesis.stepping import stability
from palpate.experiment.synthesis.stepping.impact import Collision, closed_form, condition
from palpate.experiment.synthesis.stepping.steppers import STEPPERS

SERVO_S = 400e-6
"""The period of the paper's servo."""

DIAGRAMS = ((4.5e3, 0.1), (1.9e4, 0.1), (1.6e5, 0.1), (1.6e6, 5e-3), (1e9, 1e-6))
"""Stiffness, N/m, and mass, kg, of each diagram: Table 1 of the paper, ten times its hardest, and beyond."""

DAMPING_RATIO, SPEED_M_S = 0.2, 0.2
"""Of the diagrams. Errors are relative, and all of one damping ratio alike but for the length of a step."""

PHASES = (0.0, 0.13, 0.37, 0.59, 0.83)
"""How far into its first step the mass touches, as parts of a step."""

CLAIMED, CLAIMED_ENERGY = 1e-11, 1e-13
"""Relative errors that the exact stepper claims, and the energy that it may create, as a part of what there is."""

MOST = 5_000
"""Steps after which a mass that is not released counts as stuck."""


def block_of(*, stiffness: float, damping_ratio: float, mass: float, step_s: float = 0.0) -> Block:
    """Return a block, N/m and kg, with steps of `step_s` prepared, s."""
    damping = 2 * damping_ratio * sqrt(stiffness * mass)
    return Block((stiffness, 0.0), (damping, 0.0), (mass, mass), nominal_s=step_s)


def impact(block: Block, once: Advance, *, speed: float, step_s: float, phase: float) -> list[Switch]:
    """Return what happens from the approach to the release, or until `MOST` steps, or until nothing is a number."""
    at, seen = Motion(FREE, -phase * step_s * speed, speed), list[Switch]()
    for _ in range(MOST):
        at, switches = once(block, at, step_s)
        if switches:
            seen += switches
            if switches[-1].kind == "release":
                break
        elif not -1e3 < at.deep_m < 1e3:
            break
    return seen


def errors(
    seen: Sequence[Switch], *, stiffness: float, damping_ratio: float, mass: float, speed: float
) -> dict[str, float]:
    """Return the relative errors of release time, rebound, penetration and energy; 1 for what was not found."""
    wanted = oracle.impact(stiffness=stiffness, damping_ratio=damping_ratio, mass=mass, speed=speed)
    last = seen[-1] if seen and seen[-1].kind == "release" else None
    deepest = next((one.deep_m for one in seen if one.kind == "deepest"), None)
    if last is None or deepest is None or not abs(last.deep_m_s) < inf:
        return dict.fromkeys(("release", "rebound", "penetration", "energy"), 1.0)
    kept = (mass * last.deep_m_s**2 + stiffness * last.deep_m**2) / (mass * speed**2)
    found = {
        "release": abs(last.since_s / wanted.release_s - 1),
        "rebound": abs(-last.deep_m_s / wanted.rebound_m_s - 1),
        "penetration": abs(deepest / wanted.penetration_m - 1),
        "energy": abs(kept - wanted.kept),
    }
    return {name: min(float(error), 1.0) for name, error in found.items()}


def worst(method: str, *, stiffness: float, mass: float, step_s: float) -> dict[str, float]:
    """Return each error of a diagram's impact by a method, the largest over `PHASES`."""
    run = run_of(method, stiffness=stiffness, mass=mass, step_s=step_s)
    given = {"stiffness": stiffness, "damping_ratio": DAMPING_RATIO, "mass": mass, "speed": SPEED_M_S}
    all_ = [errors(run(phase=phase), **given) for phase in PHASES]
    return {name: max(one[name] for one in all_) for name in all_[0]}


def run_of(method: str, *, stiffness: float, mass: float, step_s: float) -> partial[list[Switch]]:
    """Return one impact of a diagram, to be called with a `phase` or, as it is timed, at the third of `PHASES`."""
    block = block_of(stiffness=stiffness, damping_ratio=DAMPING_RATIO, mass=mass, step_s=step_s)
    return partial(impact, block, STEPPERS[method], speed=SPEED_M_S, step_s=step_s, phase=PHASES[2])


def contact_s(*, stiffness: float, mass: float) -> float:
    """Return how long the mass of a diagram touches, s."""
    given = {"damping_ratio": DAMPING_RATIO, "mass": mass, "speed": SPEED_M_S}
    return float(oracle.impact(stiffness=stiffness, **given).release_s)


def conditions() -> tuple[Condition, ...]:
    """Return the condition number of an impact, the largest of the diagrams."""
    found = []
    for stiffness, mass in DIAGRAMS:
        damping = 2 * DAMPING_RATIO * sqrt(stiffness * mass)
        found.append((condition(Collision(stiffness, damping, mass, SPEED_M_S)), f"{stiffness:g} N/m, {mass:g} kg"))
    number, where = max(found)
    of, on = "release, rebound, penetration of an impact", "stiffness, damping, mass, speed"
    return (Condition(of, on, number, where),)


RATIOS = (0.0, 0.02, 0.3, 0.9, 1.0, 2.0, 5.0)
SWINGS = 20_000
"""Steps in which a method shows whether it is stable: 1 % outside of its limit Euler's may grow by 1e-5 a step."""

LIMIT_RATIOS = (0.02, 0.1, 0.5, 0.9, 1.5, 3.0)


def cases() -> list[Case]:
    """Return every case of a contact."""
    to_claim = f"release, rebound and penetration within {CLAIMED:g} of the closed form, at any step and phase"
    group, stable = "contact", "stable 1 % inside, unstable 1 % outside, by simulation"
    grid = [Case(group, f"{k:g} N/m", to_claim, partial(_grid, k)) for k in (4.5e3, 1.9e4, 1.6e5, 1.6e6, 1e9)]
    return [
        *grid,
        Case(group, "printed law", f"release and rebound within {CLAIMED:g}; none if critically damped", _printed),
        Case(group, "no damper", f"half a period, and the approach speed, within {CLAIMED:g}", _undamped),
        Case(group, "no spring", "never released; settles at M V / C", _springless),
        Case(group, "resting under a force", f"settles at F / K within {CLAIMED:g}; never released", _resting),
        Case(group, "grazing", f"touches at the parabola's speed within {CLAIMED:g}, down to 1e-6 m/s", _grazing),
        Case(group, "chain of bounces", f"1000 bounces conserve energy within {CLAIMED_ENERGY:g} each", _bouncing),
        Case(group, "energy", f"no step creates more than {CLAIMED_ENERGY:g}", _energy),
        Case(group, "samples dropped and jittered", f"the same forces within {CLAIMED:g} on a straight path", _dropped),
        Case(
            group,
            "samples quantized to 10 µm",
            "finite forces that never pull on the hand or add energy to it",
            _quantised,
        ),
        *(Case("stability limit", method, stable, partial(_limit, method)) for method in STEPPERS),
    ]


def _grid(stiffness: float) -> Seen:
    most, most_created = 0.0, -inf
    for mass, ratio, speed in product((1.0, 5e-3, 1e-6), RATIOS, (1e-3, 3.0)):
        given = {"stiffness": stiffness, "damping_ratio": ratio, "mass": mass}
        lasts = float(oracle.impact(**given, speed=speed).release_s)
        for part, phase in product((0.013, 0.41, 30.0), (0.0, 0.37)):
            step_s = part * lasts
            seen = impact(block_of(**given), advance, speed=speed, step_s=step_s, phase=phase)
            found = errors(seen, **given, speed=speed)
            most = max(most, found["release"], found["rebound"], found["penetration"])
            last = seen[-1]
            kept = mass * last.deep_m_s**2 + stiffness * last.deep_m**2
            most_created = max(most_created, kept / (mass * speed**2) - 1)
    return most <= CLAIMED and most_created <= CLAIMED_ENERGY, f"off by up to {most:.1e}"


def _printed() -> Seen:
    most = 0.0
    for stiffness, mass, ratio in product((4.5e3, 1e9), (1.0, 1e-6), (0.0, 0.1, 0.7, 0.99)):
        w = sqrt(stiffness / mass)
        found = closed_form(Collision(stiffness, 2 * ratio * sqrt(stiffness * mass), mass, 0.2, law="printed"))
        apart = np.sqrt(np.longdouble(1) - np.longdouble(ratio) ** 2)
        if found.release_s is None or found.rebound_m_s is None:
            return False, f"no release at a damping ratio of {ratio:g}"
        rebound = 0.2 * np.exp(-np.longdouble(pi) * ratio / apart)
        most = max(most, float(abs(found.release_s * w * apart / np.longdouble(pi) - 1)))
        most = max(most, float(abs(found.rebound_m_s / rebound - 1)))
    for ratio in (1.0, 1.5, 5.0):
        if closed_form(Collision(2500.0, ratio * 100.0, 1.0, 0.2, law="printed")).release_s is not None:
            return False, f"a release at a damping ratio of {ratio:g}"
    return most <= CLAIMED, f"off by up to {most:.1e}"


def _undamped() -> Seen:
    most = 0.0
    for stiffness, mass in product((1.0, 4.5e3, 1e9), (1.0, 1e-6)):
        found = closed_form(Collision(stiffness, 0.0, mass, 0.2))
        half = np.longdouble(pi) / np.sqrt(np.longdouble(stiffness) / np.longdouble(mass))
        if found.release_s is None or found.rebound_m_s is None:
            return False, f"no release at {stiffness:g} N/m"
        most = max(most, float(abs(found.release_s / half - 1)), abs(found.rebound_m_s / 0.2 - 1))
    return most <= CLAIMED, f"off by up to {most:.1e}"


def _springless() -> Seen:
    found = closed_form(Collision(0.0, 3.0, 0.1, 0.2))
    block, at = Block((0.0, 0.0), (3.0, 0.0), (0.1, 0.1)), Motion(ENTERING, 0.0, 0.2)
    for _ in range(40):
        at, _seen = advance(block, at, 0.05)
    off = abs(at.deep_m / (0.1 * 0.2 / 3.0) - 1)
    never = found.release_s is None and at.phase != FREE
    return never and off <= CLAIMED, f"off by {off:.1e}" if never else "released"


def _resting() -> Seen:
    most = 0.0
    for stiffness, mass, ratio in product((4.5e3, 1e9), (1.0, 1e-6), (0.05, 1.0, 5.0)):
        damping, w = 2 * ratio * sqrt(stiffness * mass), sqrt(stiffness / mass)
        force = 10 * mass * w * 1e-3
        block = Block((stiffness, 0.0), (damping, 0.0), (mass, mass), force_n=(force, 0.0))
        at, step_s = Motion(ENTERING, 0.0, 1e-3), 0.7 / w
        for _ in range(4000):
            at, seen = advance(block, at, step_s)
            if any(one.kind == "release" for one in seen):
                return False, f"released at {stiffness:g} N/m"
        most = max(most, abs(at.deep_m * stiffness / force - 1))
    return most <= CLAIMED, f"off by up to {most:.1e}"


def _grazing() -> Seen:
    most = 0.0
    for slow, step_s in product((1e-1, 1e-3, 1e-6), (1e-5, 1e-2)):
        # A mass that a pull slows down to `slow` just where the face is; all numbers are powers of two but `slow`.
        mass, pull, far = 1.0, 0.5, 2.0**-10
        speed = float(np.sqrt(np.longdouble(slow) ** 2 + 2 * np.longdouble(pull) * np.longdouble(far)))
        wanted = np.sqrt(np.longdouble(speed) ** 2 - 2 * np.longdouble(pull) * np.longdouble(far))
        block = Block((4.5e3, 0.0), (1.0, 0.0), (mass, mass), force_n=(-pull, 0.0))
        at, seen = Motion(FREE, -far, speed), list[Switch]()
        while not seen and at.deep_m_s > 0:
            at, switches = advance(block, at, step_s)
            seen += switches
        if not seen:
            return False, f"no touch at {slow:g} m/s"
        # The speed of touch hangs on a difference: an error of one rounding in it is its condition number of roundings.
        hangs = speed**2 / slow**2
        most = max(most, float(abs(seen[0].deep_m_s / wanted - 1)) / hangs)
    return most <= CLAIMED, f"off by up to {most:.1e} times the condition number of the difference"


def _bouncing() -> Seen:
    block = Block((4.5e3, 0.0), (0.0, 0.0), (0.1, 0.1), force_n=(1.0, 0.0))
    at, bounces, most = Motion(FREE, 0.0, 0.2), 0, 0.0
    while bounces < 1000:
        at, seen = advance(block, at, 0.0137)
        for one in seen:
            bounces += one.kind == "release"
            if one.kind != "deepest":
                most = max(most, abs(abs(one.deep_m_s) / 0.2 - 1) / max(bounces, 1))
    return most <= CLAIMED_ENERGY, f"{bounces} bounces, off by up to {most:.1e} each"


def _energy() -> Seen:
    rng, most = np.random.default_rng(17), -inf
    for _ in range(300):
        stiffness, mass = float(10 ** rng.uniform(0, 9)), float(10 ** rng.uniform(-6, 0))
        ratio, w = float(rng.choice([0.0, rng.uniform(0, 5), 1.0])), sqrt(stiffness / mass)
        block = block_of(stiffness=stiffness, damping_ratio=ratio, mass=mass)
        at, step_s = Motion(FREE, 0.0, 1.0), float(10 ** rng.uniform(-2, 1)) / w
        before = 1.0
        for _ in range(40):
            at, _seen = advance(block, at, step_s)
            now = at.deep_m_s**2 + (w * at.deep_m) ** 2 if at.phase else at.deep_m_s**2
            most, before = max(most, now - before), now
    return most <= CLAIMED_ENERGY, f"at most {max(most, 0.0):.1e} of the initial energy"


def _hand(times: NDArray[np.float64], places: NDArray[np.float64], block: Block) -> Trajectory:
    return trajectory([block], times_s=times, hand_m=np.stack([places, np.zeros_like(places)], axis=1))


def _dropped() -> Seen:
    block = Block((2500.0, 0.0), (10.0, 0.0), (0.5, 0.5))
    even = np.arange(0.0, 0.07, SERVO_S)
    rng = np.random.default_rng(5)
    kept = np.sort(rng.choice(np.arange(1, even.size - 1), even.size // 3, replace=False))
    jittered = even + SERVO_S * np.where((even == even[0]) | (even == even[-1]), 0.0, rng.uniform(-0.4, 0.4, even.size))
    wanted = _hand(even, -0.005 + 0.1 * even, block).force_n[-1, 0]
    most = 0.0
    for times in (even[[0, *kept, even.size - 1]], jittered):
        got = _hand(times, -0.005 + 0.1 * times, block).force_n[-1, 0]
        most = max(most, float(abs(got - wanted)) / 10.0)
    return most <= CLAIMED, f"off by up to {most:.1e} of the largest force"


def _quantised() -> Seen:
    times = np.arange(0.0, 1.0, SERVO_S)
    places = np.round(0.004 * np.sin(2 * pi * 3 * times) / 1e-5) * 1e-5 - 1e-3
    for stiffness, damping, mass in ((2500.0, 10.0, inf), (1.6e6, 100.0, 0.1), (1e9, 1.0, 5e-3)):
        made = _hand(times, places, Block((stiffness, 0.0), (damping, 0.0), (mass, mass)))
        if not np.all(np.isfinite(made.force_n)) or made.force_n[:, 0].max() > 0:
            return False, f"a force of {made.force_n[:, 0].max():g} N at {stiffness:g} N/m"
        if mass < inf and len(made.switches) > 2 * times.size:
            return False, f"{len(made.switches)} switches"
    return True, "finite, and at most 0 N of pull"


def _limit(method: str) -> Seen:
    found = []
    for ratio in LIMIT_RATIOS:
        most = stability.limit(method, damping_ratio=ratio)
        found.append(f"{most:.3g}")
        inside, outside = (0.99 * most, 1.01 * most) if most < inf else (1e3, None)
        if _grows(method, ratio, inside):
            return False, f"unstable inside {most:.4g} at a damping ratio of {ratio:g}"
        if outside is not None and not _grows(method, ratio, outside):
            return False, f"stable outside {most:.4g} at a damping ratio of {ratio:g}"
    ratios = ", ".join(f"{ratio:g}" for ratio in LIMIT_RATIOS)
    if set(found) == {"inf"}:
        return True, f"every step is stable; damping ratios {ratios}"
    return True, f"h w up to {', '.join(found)} at damping ratios of {ratios}"


def _grows(method: str, ratio: float, h_w: float) -> bool:
    """Return whether a mass that is held in a block by a force swings further and further, by simulation."""
    mass, step_s, far = 1.0, 1e-3, 1.0
    stiffness = (h_w / step_s) ** 2
    damping = 2 * ratio * sqrt(stiffness)
    block = Block(
        (stiffness, 0.0), (damping, 0.0), (mass, mass), law="printed", force_n=(stiffness * far, 0.0), nominal_s=step_s
    )
    once, swing = STEPPERS[method], 1e-9 * far
    at, early, late = Motion(RETURNING, far + swing, 0.0), 0.0, 0.0
    for n in range(SWINGS):
        at, _ = once(block, at, step_s)
        now = abs(at.deep_m - far) + abs(at.deep_m_s) / sqrt(stiffness)
        if not now < 1e4 * swing:
            return True
        if n > 50 and now < 1e-4 * swing:
            return False
        if n < SWINGS // 10:
            early = max(early, now)
        elif n >= SWINGS - SWINGS // 10:
            late = max(late, now)
    return late > early
