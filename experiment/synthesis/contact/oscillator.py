"""The damped oscillator y'' + 2 a y' + b y = p, exact at any time, for any a and b that are zero or more.

Every function of time here is an entire function of d = a^2 - b, `Oscillator.split_per_s2`, rounded once from the exact
C^2 - 4 K M. Near critical damping, differences of exponentials lose digits, so each is written as a sine, a `expm1` or
a series of slow rates. Zeros of y' and of its derivatives have closed forms (`first_zero`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from math import atan2, cos, exp, expm1, inf, isfinite, log1p, pi, sin, sqrt
from typing import NamedTuple

from palpate.experiment.errors import SynthesisError

SLOW, SMALL = 0.02, 0.5
"""Below the first size of 2 a t + b t^2 the series needs at most 9 terms; below the second, changes are computed."""


class Carry(NamedTuple):
    """One step in time: y becomes `kept` y + (`of_y` y + `s_s` y' + `w_s2` p).

    y' becomes `kept` y' + (`of_speed` y' - `pull_per_s` y + `s_s` p); `kept` is 1 for small changes, else 0.
    """

    kept: float
    of_y: float
    of_speed: float
    s_s: float
    w_s2: float
    pull_per_s: float


@dataclass(frozen=True, slots=True)
class Oscillator:
    """The constants of y'' + 2 a y' + b y = p; `oscillator` makes it.

    `decay_per_s` is a, `stiffness_per_s2` b, `push_m_s2` p, `split_per_s2` d = a^2 - b, and `root_per_s` the root of
    |d|, an angular frequency for d < 0. `slow_per_s` and `fast_per_s` are the rates of decay for d >= 0, else zero.
    """

    decay_per_s: float
    stiffness_per_s2: float
    push_m_s2: float
    split_per_s2: float
    root_per_s: float
    slow_per_s: float
    fast_per_s: float


def oscillator(*, stiffness_n_m: float, damping_n_s_m: float, mass_kg: float, force_n: float = 0.0) -> Oscillator:
    """Return the oscillator M y'' + C y' + K y = F; an infinite mass moves on straight lines.

    Raises `SynthesisError` unless K and C are at least zero, M is above zero, and F, K and C and ratios are finite.
    """
    wrong = problems(stiffness_n_m=stiffness_n_m, damping_n_s_m=damping_n_s_m, force_n=force_n)
    if not mass_kg > 0:
        wrong.append(f"mass: got {mass_kg:g} kg; allowed: a number above zero; correct it")
    refuse(wrong)
    if mass_kg == inf:
        return Oscillator(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    m, c, k = Fraction(mass_kg), Fraction(damping_n_s_m), Fraction(stiffness_n_m)
    try:
        a, b, push = float(c / (2 * m)), float(k / m), float(Fraction(force_n) / m)
        split = float((c * c - 4 * k * m) / (4 * m * m))
    except OverflowError:
        split = inf
    if not split < 1e300:
        raise SynthesisError(
            f"block: got {stiffness_n_m:g} N/m and {damping_n_s_m:g} N s/m with {mass_kg:g} kg; allowed: a block "
            "that moves at a finite rate; use a larger mass"
        )
    root = sqrt(abs(split))
    if split < 0:
        return Oscillator(a, b, push, split, root, 0.0, 0.0)
    return Oscillator(a, b, push, split, root, b / (a + root) if b else 0.0, a + root)


def problems(*, stiffness_n_m: float, damping_n_s_m: float, force_n: float) -> list[str]:
    """Return everything for which `oscillator` refuses a spring, a damper and a force, a line each."""
    wrong = [
        f"{name}: got {value:g} {unit}; allowed: a finite number of zero or more; correct it"
        for name, value, unit in (("stiffness", stiffness_n_m, "N/m"), ("damping", damping_n_s_m, "N s/m"))
        if not 0 <= value < inf
    ]
    if not isfinite(force_n):
        wrong.append(f"force: got {force_n:g} N; allowed: a finite number; correct it")
    return wrong


def refuse(wrong: list[str]) -> None:
    """Raise `SynthesisError` for the first of what is wrong, with the others as its notes; nothing where nothing is."""
    if wrong:
        error = SynthesisError(wrong[0])
        for other in wrong[1:]:
            error.add_note(other)
        raise error


def carry(of: Oscillator, t_s: float) -> Carry:
    """Return what a time of zero or more, s, does to an oscillator; each of its numbers keeps its digits."""
    a, b, d, root = of.decay_per_s, of.stiffness_per_s2, of.split_per_s2, of.root_per_s
    if a == b == 0:
        return Carry(1.0, 0.0, 0.0, t_s, t_s * t_s / 2, 0.0)
    size = 2 * a * t_s + b * t_s * t_s
    if size < SLOW:
        return _series(a, b, t_s)
    if d < 0:
        left, angle = exp(-a * t_s), root * t_s
        half, odd = sin(angle / 2), left * sin(angle) / root
        # 1 - exp(-at) cos(wt) - a s, which may be small again after a whole turn.
        changed = -expm1(-a * t_s) + 2 * left * half * half - a * odd
        if size < SMALL:
            return Carry(1.0, -changed, -changed - 2 * a * odd, odd, changed / b, b * odd)
        even = left * cos(angle)
        return Carry(0.0, even + a * odd, even - a * odd, odd, changed / b, b * odd)
    apart, slow, fast = 2 * root * t_s, of.slow_per_s * t_s, of.fast_per_s * t_s
    if slow < 0.3 and apart < (0.05 if size < SMALL else 0.3):
        return _series(a, b, t_s)
    left = exp(-slow)
    odd = left * -expm1(-apart) / (2 * root) if root else left * t_s
    even = left * (1 + exp(-apart)) / 2
    of_y = even + a * odd
    of_speed = even - a * odd if apart < 1 else (of.fast_per_s * exp(-fast) - of.slow_per_s * left) / (2 * root)
    if slow > 0.3:
        w = (1 - of_y) / b
    else:
        w = ((-expm1(-slow) / of.slow_per_s if slow else t_s) + expm1(-fast) / of.fast_per_s) / (2 * root)
    if size < SMALL:
        return Carry(1.0, -b * w, -b * w - 2 * a * odd, odd, w, b * odd)
    return Carry(0.0, of_y, of_speed, odd, w, b * odd)


def moved(of: Oscillator, by: Carry, y_m: float, speed_m_s: float) -> tuple[float, float]:
    """Return y and y' after the time that `by` was made for, m and m/s."""
    kept, of_y, of_speed, s, w, pull = by
    push = of.push_m_s2
    return (
        kept * y_m + (of_y * y_m + s * speed_m_s + w * push),
        kept * speed_m_s + (of_speed * speed_m_s - pull * y_m + s * push),
    )


def first_zero(of: Oscillator, *, value: float, drift: float, slow_part: float) -> float:
    """Return the first time above zero, s, at which a solution of the equation without p is zero; infinity if never.

    `value` is y and `drift` y' + a y at the beginning. Where d >= 0, `slow_part` is y' + f y without cancellation, f
    being the fast rate of decay.
    """
    if of.split_per_s2 < 0:
        if value == 0:
            return pi / of.root_per_s if drift else inf
        turned = abs(value) * of.root_per_s
        return atan2(turned, -drift if value > 0 else drift) / of.root_per_s
    if slow_part == 0:
        return inf
    along = -value / slow_part
    if of.root_per_s == 0:
        return along if along > 0 else inf
    ratio = 2 * of.root_per_s * along
    return log1p(ratio) / (2 * of.root_per_s) if ratio > 0 else inf


def parabola_rises(value: float, slope: float, half_curve: float) -> float:
    """Return when a parabola from `value`, zero or less, with a curve of zero or more, rises through zero."""
    root = sqrt(slope * slope - 4 * half_curve * value)
    if slope > 0:
        return -2 * value / (slope + root)
    return (root - slope) / (2 * half_curve) if half_curve > 0 else inf


def falls_through_zero(of: Callable[[float], tuple[float, float]], low: float, high: float) -> float:
    """Return where a function that gives its value and slope falls through zero between `low` and `high`."""
    before = width = high - low
    t = (low + high) / 2 if low else high
    while True:
        value, slope = of(t)
        if value > 0:
            low = t
        else:
            high = t
        newton = t - value / slope if slope else inf
        if not low < newton < high or abs(newton - t) > before / 2:
            newton = (low + high) / 2
        before, width = width, abs(newton - t)
        if width <= 2e-16 * abs(newton) or not low < newton < high:
            return newton
        t = newton


def _series(a: float, b: float, t_s: float) -> Carry:
    decay, stiff = 2 * a * t_s, b * t_s * t_s
    before, term, s, w = 0.0, t_s, t_s, t_s / 2
    k, least = 1, t_s * 1e-18
    while abs(term) > least or abs(before) > least:
        before, term = term, -(decay * term + stiff * before / k) / (k + 1)
        k += 1
        s += term
        w += term / (k + 1)
    w *= t_s
    return Carry(1.0, -b * w, -b * w - 2 * a * s, s, w, b * s)
