"""d': how far apart two stimuli are for a participant, in standard deviations of what is felt, by a decision rule.

Macmillan and Creelman (2005), Detection Theory, 2nd edition: yes or no (equation 1.5), two intervals (7.2), same or
different by independent observations (9.6, 9.7) and by differences (9.8, 9.9). Shares are those of counts plus 1/2 in
trials plus 1, so that none is 0 or 1 (Hautus 1995, Behav. Res. Methods 27, 46-51). Errors of d' in yes or no and in two
intervals: Gourevitch and Galanter (1967, Psychometrika 32, 25-33).
"""

from dataclasses import dataclass
from math import exp, pi, sqrt
from typing import Literal

from scipy.optimize import brentq
from scipy.special import ndtr, ndtri

from palpate.analysis.statistics.exact import NotDefined

Rule = Literal["yes or no", "two intervals", "same or different, independent", "same or different, differences"]

MOST = 20.0
"""No d' is larger that differences are searched for; ours."""


@dataclass(frozen=True)
class Sensitivity:
    """d' by a rule and the criterion c, -(z(H) + z(F)) / 2; the standard error is None where none is computed."""

    rule: Rule
    d: float
    criterion: float
    se: float | None


def sensitivity(hits: int, signals: int, false_alarms: int, others: int, rule: Rule) -> Sensitivity:
    """Return d' from counts: hits among `signals`, false alarms among the `others`.

    With two intervals a hit is "first" where it was first, a false alarm "first" where it was second. With same or
    different a hit is "different" of two that differ, a false alarm "different" of two that are the same. Raises
    `NotDefined` without trials of both kinds.
    """
    if not signals or not others:
        raise NotDefined("d' needs trials with and without the signal")
    hit, alarm = (hits + 0.5) / (signals + 1), (false_alarms + 0.5) / (others + 1)
    z_hit, z_alarm = float(ndtri(hit)), float(ndtri(alarm))
    variance = hit * (1 - hit) / (signals * _density(z_hit) ** 2)
    variance += alarm * (1 - alarm) / (others * _density(z_alarm) ** 2)
    errors = {"yes or no": sqrt(variance), "two intervals": sqrt(variance / 2)}
    return Sensitivity(rule, d_prime(hit, alarm, rule), -(z_hit + z_alarm) / 2, errors.get(rule))


def d_prime(hit: float, alarm: float, rule: Rule) -> float:
    """Return d' from the shares of hits and of false alarms, each between 0 and 1."""
    apart = float(ndtri(hit) - ndtri(alarm))
    match rule:
        case "yes or no":
            return apart
        case "two intervals":
            return apart / sqrt(2)
        case "same or different, independent":
            # Of an unbiased observer; one who is right less often than wrong has a negative d'.
            best = float(ndtr(abs(apart) / 2))
            d = 2 * float(ndtri((1 + sqrt(max(2 * best - 1, 0.0))) / 2))
            return d if apart > 0 else -d
        case "same or different, differences":
            return _of_differences(hit, alarm)


def _of_differences(hit: float, alarm: float) -> float:
    """Return the d' at which a criterion k on the difference gives both shares; 0 where hits are no more frequent."""
    if hit <= alarm:
        return 0.0
    k = -sqrt(2) * float(ndtri(alarm / 2))

    def too_few(d: float) -> float:
        return float(ndtr((d - k) / sqrt(2)) + ndtr((-d - k) / sqrt(2))) - hit

    return float(brentq(too_few, 0.0, MOST, xtol=1e-12))


def _density(z: float) -> float:
    return exp(-z * z / 2) / sqrt(2 * pi)
