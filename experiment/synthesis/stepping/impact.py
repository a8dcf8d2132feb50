"""One impact: a mass meets a block's spring and damper at a speed, and is thrown back; in closed form, or in steps.

The mass starts at r = 0; a constant force may press or pull. The closed form goes from touch to release in one step
(`contact`). Without a force, with a damping ratio z = C / (2 sqrt(K M)) below 1 and phi = acos z, release for the
clamped law is after 2 phi / (w sin phi) at v exp(-2 z phi / sin phi), where w = sqrt(K / M). Units are powers of two
that bring the numbers near 1 (`Collision.scaled`), so that squares stay in range and digits are kept.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import cached_property
from math import ceil, inf, isfinite, ldexp, log, log2, sqrt

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis.contact import exact
from palpate.experiment.synthesis.contact.block import FREE, Block, Law, Motion, Switch
from palpate.experiment.synthesis.contact.oscillator import Oscillator, carry, moved, problems, refuse
from palpate.experiment.synthesis.stepping import stability
from palpate.experiment.synthesis.stepping.steppers import EXACT, stepper

LEAST = 2.0**-1022
"""The smallest number that has all its digits."""

MOST_STEPS = 200_000
"""Steps of one impact beyond which it is refused, or taken in fewer by the exact stepper, whose error they leave."""

LONGEST = 1e12
"""A step beyond which only the exact stepper goes, in units of an impact: a switch is located to 1e-13 of a step."""

NEARLY_CRITICAL = 1e-3
"""How near to 1 a damping ratio is called nearly critical under the printed law."""

LONG_STEP = 0.1
"""A step, as a part of the contact, beyond which a method other than the exact one is said to see little. Ours."""

GAUSS_48 = np.polynomial.legendre.leggauss(48)
"""Nodes and weights of Gauss's 48 points on [-1, 1]."""

QUANTITIES = ("release_s", "rebound_m_s", "penetration_m", "peak_s", "dissipated_j", "left_in_spring_j")


@dataclass(frozen=True)
class Collision:
    """What meets what: N/m, N s/m, kg, m/s, N (positive presses the mass into the block), and the law.

    Raises `SynthesisError` unless K and C are at least zero, M and the speed above zero, and all finite.
    """

    stiffness_n_m: float
    damping_n_s_m: float
    mass_kg: float
    speed_m_s: float
    force_n: float = 0.0
    law: Law = "clamped"

    def __post_init__(self) -> None:
        """Refuse what is no impact."""
        given = {"stiffness_n_m": self.stiffness_n_m, "damping_n_s_m": self.damping_n_s_m, "force_n": self.force_n}
        wrong = problems(**given)
        if not 0 < self.mass_kg < inf:
            wrong.append(f"mass: got {self.mass_kg:g} kg; allowed: a finite number above zero; correct it")
        if not 0 < self.speed_m_s < inf:
            wrong.append(f"speed: got {self.speed_m_s:g} m/s; allowed: a finite number above zero; correct it")
        elif not max(1.0, self.mass_kg) * self.speed_m_s * self.speed_m_s < inf:
            wrong.append(
                f"mass and speed: got {self.mass_kg:g} kg at {self.speed_m_s:g} m/s; allowed: a finite "
                "energy; reduce one of them"
            )
        refuse(wrong)
        _ = self.scaled

    @cached_property
    def units(self) -> tuple[int, int, int]:
        """Powers of two of a kilogram, a second and a metre: in these units M and V are near 1, K, C and F at most."""
        m, v = round(log2(self.mass_kg)), round(log2(self.speed_m_s))
        k, c, f = (log2(abs(x)) if x else -inf for x in (self.stiffness_n_m, self.damping_n_s_m, self.force_n))
        fastest = max((k - m) / 2, c - m, f - m - v)
        second = -round(fastest) if fastest > -inf else 0
        return m, second, v + second

    @cached_property
    def scaled(self) -> Collision:
        """The same impact in `units`. Raises `SynthesisError` where spring, damper and force are too far apart."""
        kg, s, m = self.units
        if (kg, s, m) == (0, 0, 0):
            return self
        k, c = ldexp(self.stiffness_n_m, 2 * s - kg), ldexp(self.damping_n_s_m, s - kg)
        force = ldexp(self.force_n, 2 * s - kg - m)
        # So small a damping does nothing; a spring or a force may still be what brings the mass back.
        if (self.stiffness_n_m and k < LEAST) or (self.force_n and abs(force) < LEAST):
            raise SynthesisError(
                f"impact: got {self.stiffness_n_m:g} N/m, {self.damping_n_s_m:g} N s/m and {self.force_n:g} N for "
                f"{self.mass_kg:g} kg at {self.speed_m_s:g} m/s, and one acts about 1e150 times as fast as "
                "another; allowed: closer values, or zero; leave out the one without effect"
            )
        return Collision(k, c, ldexp(self.mass_kg, -kg), ldexp(self.speed_m_s, s - m), force, self.law)

    @cached_property
    def block(self) -> Block:
        """The block, whose other axis has neither spring nor damper."""
        return self.stepped_block(0.0)

    def stepped_block(self, nominal_s: float) -> Block:
        """Return the block, prepared for steps of this length, s."""
        return Block(
            (self.stiffness_n_m, 0.0),
            (self.damping_n_s_m, 0.0),
            (self.mass_kg, self.mass_kg),
            law=self.law,
            force_n=(self.force_n, 0.0),
            nominal_s=nominal_s,
        )

    @property
    def frequency_rad_s(self) -> float:
        """w = sqrt(K / M); infinity beyond the largest number."""
        return _shifted(sqrt(self.scaled.block.normal.stiffness_per_s2), -self.units[1])

    @property
    def damping_ratio(self) -> float | None:
        """z = C / (2 sqrt(K M)); None without a spring."""
        of = self.scaled.block.normal
        return of.decay_per_s / sqrt(of.stiffness_per_s2) if of.stiffness_per_s2 else None

    @property
    def nearly_critical(self) -> bool:
        """Whether the release hangs on the last digits of the damping: see `NEARLY_CRITICAL`."""
        of = self.scaled.block.normal
        if self.law != "printed" or of.split_per_s2 >= 0:
            return False
        return -of.split_per_s2 < 2 * NEARLY_CRITICAL * of.stiffness_per_s2


@dataclass(frozen=True)
class Impact:
    """What came of it; `why` explains each None.

    `release_s` and `peak_s` are from the touch, `rebound_m_s` is a magnitude, `penetration_m` the largest, which
    without a release may only be approached (`peak_s` None). Energies are up to the release.
    """

    release_s: float | None
    rebound_m_s: float | None
    penetration_m: float | None
    peak_s: float | None
    dissipated_j: float | None
    left_in_spring_j: float | None
    why: tuple[str, ...] = ()


@dataclass(frozen=True)
class Course:
    """An impact in steps: its outcome, and at each step the time, s, r, m, dr/dt, m/s, and the force, N, all (n,)."""

    impact: Impact
    times_s: NDArray[np.float64]
    deep_m: NDArray[np.float64]
    deep_m_s: NDArray[np.float64]
    force_n: NDArray[np.float64]


def closed_form(of: Collision) -> Impact:
    """Return the exact outcome."""
    return _in_si(_closed_form(of.scaled), of)


def _in_si(made: Impact, of: Collision) -> Impact:
    """Return an outcome that was found in the units of an impact, without what no number holds."""
    kg, s, m = of.units
    powers = dict(zip(QUANTITIES, (s, m - s, m, s, kg + 2 * (m - s), kg + 2 * (m - s)), strict=True))
    found = {name: getattr(made, name) for name in QUANTITIES}
    si = {name: None if value is None else _shifted(value, powers[name]) for name, value in found.items()}
    lost = [name for name, value in si.items() if value is not None and found[name] and not LEAST <= abs(value) < inf]
    beyond = (f"{', '.join(lost)}: outside the range from {LEAST:.2g} to 1.8e308.",) if lost else ()
    return Impact(**{**si, **dict.fromkeys(lost)}, why=made.why + beyond)


def _shifted(value: float, power: int) -> float:
    """Return a number, zero or more, times a power of two; infinity beyond the largest number."""
    try:
        return ldexp(value, power)
    except OverflowError:
        return inf


def _closed_form(of: Collision) -> Impact:
    axis, block, v = of.block.normal, of.block, of.speed_m_s
    release, peak = exact.release_after(block, 0.0, v), exact.deepest_after(axis, 0.0, v)
    if release == inf:
        penetration = moved(axis, carry(axis, peak), 0.0, v)[0] if peak < inf else _approached(of)
        return Impact(None, None, penetration, peak if peak < inf else None, None, None, _never(of, penetration, peak))
    x, u = exact.released(block, *moved(axis, carry(axis, release), 0.0, v))
    peak = min(peak, release)
    deepest, _ = moved(axis, carry(axis, peak), 0.0, v)
    lost = dissipated_j(of, release)
    if 4 * axis.decay_per_s**2 < axis.stiffness_per_s2 and abs(axis.push_m_s2) > of.frequency_rad_s * v:
        x, u = _by_balance(of, lost)
    why: tuple[str, ...] = (_NEARLY_CRITICAL,) if of.nearly_critical else ()
    rebound: float | None = abs(u)
    if of.nearly_critical and abs(u) < 1e-290:
        rebound, why = None, (*why, "rebound_m_s: it is below 1e-290 of the touch speed, which is too small.")
    return Impact(release, rebound, deepest, peak, lost, of.stiffness_n_m * x * x / 2, why)


_NEARLY_CRITICAL = (
    f"The damping is within {NEARLY_CRITICAL:g} of critical, where release under the printed law is ill-conditioned: "
    "it depends on the last digits of K, C and M, and is late."
)


def condition(of: Collision) -> float:
    """Return the largest condition number of release time, rebound and penetration; infinity at an edge.

    It sums, over K, C, M, speed and force, the relative change of a result by that of the input.
    """
    least = 1e-5
    while True:
        worst = _condition(of.scaled, least)
        if worst < inf or least < 1e-9:
            return worst
        least /= 100


def _condition(of: Collision, by: float) -> float:
    sums = dict.fromkeys(QUANTITIES[:3], 0.0)
    here = _closed_form(of)
    for name in ("stiffness_n_m", "damping_n_s_m", "mass_kg", "speed_m_s", "force_n"):
        value = getattr(of, name)
        if value == 0:
            continue
        above, below = (_closed_form(replace(of, **{name: value * factor})) for factor in (1 + by, 1 - by))
        for quantity in sums:
            is_, up, down = (getattr(one, quantity) for one in (here, above, below))
            if (up is None) != (is_ is None) or (down is None) != (is_ is None):
                return inf
            if up and down:
                sums[quantity] += abs(log(up / down)) / (2 * by)
    return max(sums.values())


def _by_balance(of: Collision, lost_j: float) -> tuple[float, float]:
    """Return penetration and rate at a release from energy and law: a strong force costs speeds their digits."""
    axis = of.block.normal
    lag = 2 * axis.decay_per_s / axis.stiffness_per_s2 if of.block.clamps else 0.0
    energy = of.speed_m_s**2 - 2 * lost_j / of.mass_kg
    of_square, half = 1 + axis.stiffness_per_s2 * lag * lag, axis.push_m_s2 * lag
    root = sqrt(max(half * half + of_square * energy, 0.0))
    speed = (half + root) / of_square if half > 0 else energy / (root - half) if root > half else 0.0
    return lag * speed, -speed


def dissipated_j(of: Collision, until_s: float) -> float:
    """Return the energy that the damper takes from the touch until `until_s`, J, with its digits.

    Within 10 rates of decay and one turn it is C times the integral of (dr/dt)^2 at Gauss's 48 points, later a balance.
    """
    axis, v = of.block.normal, of.speed_m_s
    if of.damping_n_s_m == 0:
        return 0.0
    rate = axis.fast_per_s or axis.decay_per_s
    if rate * until_s < 10 and axis.root_per_s * until_s < 10:
        nodes, weights = GAUSS_48
        times = (until_s * (nodes + 1) / 2).tolist()
        squares = [moved(axis, carry(axis, t), 0.0, v)[1] ** 2 for t in times]
        return float(of.damping_n_s_m * until_s / 2 * np.dot(weights, squares))
    x, u = moved(axis, carry(axis, until_s), 0.0, v)
    return balance_j(of, x, u)


def balance_j(of: Collision, x: float, u: float) -> float:
    """Return what is lost of the energy that a mass brought, at penetration x, m, and rate u, m/s, J."""
    kept = of.mass_kg * u * u + of.stiffness_n_m * x * x
    return (of.mass_kg * of.speed_m_s**2 - kept) / 2 + of.force_n * x


def in_steps(of: Collision, *, method: str = EXACT, rate_hz: float, phase: float = 0.0) -> Course:
    """Return the impact by one of `steppers.STEPPERS`, in steps of 1 / `rate_hz`, to the release.

    `phase` is the part of the first step before the touch. Without a release it lasts four times as long as the way to
    the deepest place. Raises `SynthesisError` for a bad rate, an unknown method, or more than `MOST_STEPS` inexact
    steps.
    """
    if not 0 < rate_hz < inf:
        raise SynthesisError(f"rate: got {rate_hz:g} Hz; allowed: a finite number above zero; correct it")
    if not 0 <= phase < 1:
        raise SynthesisError(f"phase: got {phase:g}; allowed: 0 to below 1; correct it")
    kg, s, m = of.units
    given, of = of, of.scaled
    once, dt = stepper(method), _shifted(1 / rate_hz, -s)
    if method != EXACT and not dt < LONGEST:
        raise SynthesisError(
            f"rate: got {rate_hz:g} Hz; allowed: steps shorter than {LONGEST:g} times the time scale of this "
            "impact; choose a higher rate"
        )
    exact = _closed_form(of)
    longest = 4 * (exact.release_s or exact.peak_s or _settles_s(of.block.normal))
    if longest > (MOST_STEPS - 4) * dt:
        if method != EXACT:
            raise SynthesisError(
                f"rate: got {rate_hz:g} Hz for a contact of {_shifted(longest / 4, s):.3g} s; allowed: up to "
                f"{_shifted(MOST_STEPS / longest, -s):.3g} Hz there; choose a lower rate"
            )
        dt = longest / MOST_STEPS
    block, steps = of.stepped_block(dt), ceil(longest / dt) + 4
    # A free mass flies on a parabola: begun a part of a step earlier, so that it is at the face at the speed asked for.
    push, early = block.normal.push_m_s2, phase * dt
    at = Motion(FREE, -early * (of.speed_m_s - push * early / 2), of.speed_m_s - push * early)
    rows, seen = [(at, 0.0)], list[Switch]()
    for _ in range(steps):
        at, switches = once(block, at, dt)
        seen += switches
        rows.append((at, block.force_at(at)[0]))
        if (switches and switches[-1].kind == "release") or not (isfinite(at.deep_m) and isfinite(at.deep_m_s)):
            break
    deep, speed, force = np.array([(one.deep_m, one.deep_m_s, force) for one, force in rows], dtype=np.float64).T
    times = np.arange(len(rows), dtype=np.float64) * dt - early
    made = _in_si(_outcome(of, exact, method, seen, _shifted(steps * dt, s)), given)
    powers = s, m, m - s, kg + m - 2 * s
    return Course(made, *(np.ldexp(one, by) for one, by in zip((times, deep, speed, force), powers, strict=True)))


def _outcome(of: Collision, exact: Impact, method: str, seen: list[Switch], lasted_s: float) -> Impact:
    released = next((one for one in seen if one.kind == "release"), None)
    deepest = next((one for one in seen if one.kind == "deepest"), None)
    penetration, peak = (deepest.deep_m, deepest.since_s) if deepest else (None, None)
    if deepest is None and exact.peak_s is None:
        penetration = exact.penetration_m
    unseen: tuple[str, ...] = ()
    if penetration is None and exact.penetration_m is not None:
        unseen = (f"penetration_m and peak_s: no step of '{method}' ends with the mass in the block and moving out.",)
    if released is None:
        why = exact.why
        if exact.release_s is not None:
            why = (f"'{method}' does not release the mass within {lasted_s:.3g} s at this rate.", *unseen)
        return Impact(None, None, penetration, peak, None, None, why)
    x, u = released.deep_m, released.deep_m_s
    lost = dissipated_j(of, released.since_s) if method == EXACT else balance_j(of, x, u)
    why = exact.why if exact.release_s is not None else ("The method releases the mass only because of its error.",)
    rebound = None if exact.release_s is not None and exact.rebound_m_s is None else abs(u)
    left = of.stiffness_n_m * x * x / 2
    return Impact(released.since_s, rebound, penetration, peak, lost, left, (*why, *unseen))


def _settles_s(axis: Oscillator) -> float:
    """Return a time in which what has no deepest place shows where it goes."""
    rate = axis.decay_per_s or sqrt(axis.stiffness_per_s2)
    return 5 / rate if rate else 1.0


def _approached(of: Collision) -> float | None:
    """Return the penetration that a mass approaches and never reaches; None where it goes on without an end."""
    if of.stiffness_n_m:
        return of.force_n / of.stiffness_n_m
    return of.mass_kg * of.speed_m_s / of.damping_n_s_m if of.damping_n_s_m and of.force_n == 0 else None


def _never(of: Collision, penetration: float | None, peak: float) -> tuple[str, ...]:
    """Return why there is no release, and what else is not defined for that reason."""
    nothing = "release_s, rebound_m_s, dissipated_j and left_in_spring_j: "
    if of.force_n > 0 and of.stiffness_n_m:
        why = "the force keeps the mass in the block, where it comes to rest at F / K."
        if of.damping_n_s_m == 0:
            why = "the force keeps the mass in the block, where it oscillates around F / K."
    elif of.force_n > 0:
        why = "there is no spring, so the force pushes the mass deeper into the block."
    elif of.stiffness_n_m == 0:
        why = "there is no spring, so nothing pushes the mass back."
    else:
        why = "the damping is critical or higher, so the printed law never returns the mass to r = 0 in finite time."
    deep: tuple[str, ...] = ()
    if penetration is None:
        deep = ("penetration_m and peak_s: the mass goes deeper without limit.",)
    elif peak == inf:
        deep = ("peak_s: the mass approaches the largest penetration but never reaches it.",)
    return (nothing + why, *deep)


@dataclass(frozen=True)
class Answer:
    """What `palpate tap contact` says of an impact: by which method, at which rate, stable or not.

    `h_w` is the step times w = sqrt(K / M), `limit_h_w` the largest stable one, None for no limit; `step_in_contacts`
    the step over the contact, None without a release; `condition` is None at a change of kind within a rounding.
    """

    of: Collision
    method: str
    rate_hz: float
    impact: Impact
    stable: bool
    h_w: float
    limit_h_w: float | None
    step_in_contacts: float | None
    condition: float | None

    def as_dict(self) -> dict[str, object]:
        """Return the same for JSON; a quantity that is not defined is null, and `why` says why."""
        of, made = self.of, self.impact
        return {
            **asdict(of),
            "method": self.method,
            "rate_hz": self.rate_hz,
            "damping_ratio": of.damping_ratio,
            **{name: getattr(made, name) for name in QUANTITIES},
            "why": " ".join(made.why) or None,
            **{name: getattr(self, name) for name in ("condition", "stable", "h_w", "limit_h_w", "step_in_contacts")},
        }

    def text(self) -> str:
        """Return the same for a reader, in a few lines."""
        of, made = self.of, self.impact
        ratio = "no spring" if of.damping_ratio is None else f"damping ratio {of.damping_ratio:.4g}"
        lines = [
            f"{of.mass_kg:g} kg meets {of.stiffness_n_m:g} N/m and {of.damping_n_s_m:g} N s/m at {of.speed_m_s:g} m/s "
            f"under {of.force_n:g} N: {ratio}, law '{of.law}', method '{self.method}' at {self.rate_hz:g} Hz"
        ]
        bound = "every step is" if self.limit_h_w is None else f"up to {self.limit_h_w:.4g} is"
        verdict = "stable" if self.stable else "NOT STABLE, so the numbers below are meaningless"
        lines.append(f"  the method is {verdict} in this contact (h w = {self.h_w:.4g}; {bound} stable)")
        if self.method != EXACT and (long := self.step_in_contacts or 0.0) > LONG_STEP:
            sees = "nothing" if long > 1 else "little"
            lines.append(
                f"  a step is {long:.3g} times as long as the contact, so the method captures {sees} of it: stable or "
                "not, its numbers do not describe this impact"
            )
        for name, shown, unit in (
            ("release_s", "release", "s after the touch"),
            ("rebound_m_s", "rebound", "m/s"),
            ("penetration_m", "penetration", "m at most"),
            ("peak_s", "peak", "s after the touch"),
            ("dissipated_j", "dissipated", "J in the damper"),
            ("left_in_spring_j", "left in spring", "J at the release"),
        ):
            value = getattr(made, name)
            lines.append(f"  {shown:15} {'not defined' if value is None else f'{value:.12g} {unit}'}")
        lines += [f"  {sentence}" for sentence in made.why]
        known = "not finite" if self.condition is None else f"{self.condition:.3g}"
        if self.condition == 0:
            lines.append("  no condition number: no defined result depends on errors in the input")
        else:
            lines.append(f"  condition number {known}: the factor by which relative errors in the input grow")
        return "\n".join(lines)


def answer(of: Collision, *, method: str = EXACT, rate_hz: float) -> Answer:
    """Return an impact by a method, and its stability at this rate; exact ones take one step. Raises as `in_steps`."""
    stepper(method)
    step = 1 / rate_hz if rate_hz else inf
    h_w = of.frequency_rad_s * step
    if not (0 < step < inf and h_w < inf):
        raise SynthesisError(
            f"rate: got {rate_hz:g} Hz; allowed: a finite number above zero, with a finite step times sqrt(K / M); "
            "correct it"
        )
    exact = closed_form(of)
    made = exact if method == EXACT else in_steps(of, method=method, rate_hz=rate_hz).impact
    near = of.scaled
    case = {"stiffness_n_m": near.stiffness_n_m, "damping_n_s_m": near.damping_n_s_m, "mass_kg": near.mass_kg}
    most = inf
    if of.damping_ratio is not None:
        most = stability.limit(method, damping_ratio=of.damping_ratio)
    number, contacts = condition(of), step / exact.release_s if exact.release_s else inf
    return Answer(
        of,
        method,
        rate_hz,
        made,
        stability.stable(method, **case, step_s=_shifted(step, -of.units[1])),
        h_w,
        most if most < inf else None,
        contacts if contacts < inf else None,
        number if number < inf else None,
    )
