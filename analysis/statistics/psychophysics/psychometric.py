"""Psychometric functions: how the share of right answers rises with the strength of a stimulus.

psi(x) = guess + (1 - guess - lapse) Phi((x - threshold) / spread), in whatever unit x has, such as dB. At `threshold`
half of what is not guessed and not missed is right, and one `spread` above it 84 %. `fit` gives the posterior on a
grid: threshold and the logarithm of spread are equally probable at first within bounds of the levels, and a lapse as by
Beta(1, 10) (Schuett, Harmeling, Macke and Wichmann 2016, Vision Res. 122, 105-123, section 2.3, of lapses).
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

from palpate.analysis.statistics.exact import Floats, NotDefined
from palpate.analysis.statistics.inference import CONFIDENCE

COARSE = 41, 25, 11
FINE = 61, 41, 11
"""Thresholds, spreads and lapses of the first grid, which finds where the posterior is, and of the second; ours."""

MOST_LAPSES = 0.2
OF_LAPSES = 10.0
"""Lapses are at most as many; the second parameter of their Beta prior."""

OPEN = 0.005
"""With more of the posterior in the last of the first grid's thresholds, the answers leave it open; ours."""

TAIL = 1e-6
"""The second grid leaves out less of the posterior on each side; ours."""


@dataclass(frozen=True)
class Known:
    """A number with its interval: the median of the posterior and the limits of its central 95 %."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Fit:
    """A fitted function; `at_bound` says that the answers leave the threshold open on one side."""

    threshold: Known
    spread: Known
    lapse: Known
    guess: float
    trials: int
    at_bound: bool

    @property
    def jnd(self) -> Known:
        """How far above threshold 75 % of what is not guessed is right: z(0.75) spreads."""
        z = float(ndtri(0.75))
        return Known(z * self.spread.value, z * self.spread.low, z * self.spread.high)

    def share(self, x: Floats) -> Floats:
        """Return the share of right answers at these levels, by the medians."""
        return psychometric(x, self.threshold.value, self.spread.value, self.guess, self.lapse.value)


def psychometric(x: Floats, threshold: float, spread: float, guess: float, lapse: float) -> Floats:
    """Return the share of right answers at levels x."""
    shares: Floats = guess + (1 - guess - lapse) * ndtr((np.asarray(x) - threshold) / spread)
    return shares


def fit(x: Floats, right: Floats, trials: Floats, *, guess: float, lapse: float | None = None) -> Fit:
    """Return the psychometric function of right answers in trials at levels x, each of shape (levels,).

    `lapse` fixes the share of lapses; None leaves it free. Raises `NotDefined` below two levels with trials.
    """
    x, right, trials = (np.asarray(one, dtype=np.float64) for one in (x, right, trials))
    x, right, trials = x[trials > 0], right[trials > 0], trials[trials > 0]
    if len(x) < 2:
        raise NotDefined(f"a psychometric function needs trials at two levels, got {len(x)}")
    span, step = float(np.ptp(x)), float(np.diff(np.sort(x)).min())
    bounds = (float(x.min()) - span / 2, float(x.max()) + span / 2), (np.log(step / 4), np.log(2 * span))
    lapses = np.linspace(0, MOST_LAPSES, COARSE[2]) if lapse is None else np.array([lapse])
    data = _Data(x, right, trials, guess)
    axes, ends = (np.linspace(*bounds[0], COARSE[0]), np.linspace(*bounds[1], COARSE[1])), 0.0
    for size in (COARSE, FINE):
        weight = data.posterior(*axes, lapses)
        marginal = weight.sum(axis=(1, 2)), weight.sum(axis=(0, 2))
        if size is COARSE:
            ends = marginal[0][[0, -1]].max() / marginal[0].sum()
            held = [_holding(axis, of) for axis, of in zip(axes, marginal, strict=True)]
            axes = np.linspace(*held[0], FINE[0]), np.linspace(*held[1], FINE[1])
    threshold = _quantiles(axes[0], marginal[0])
    log_spread, missed = _quantiles(axes[1], marginal[1]), _quantiles(lapses, weight.sum(axis=(0, 1)))
    spread = Known(*(float(np.exp(one)) for one in (log_spread.value, log_spread.low, log_spread.high)))
    return Fit(threshold, spread, missed, guess, int(trials.sum()), bool(ends > OPEN))


@dataclass(frozen=True)
class _Data:
    x: Floats
    right: Floats
    trials: Floats
    guess: float

    def posterior(self, thresholds: Floats, log_spreads: Floats, lapses: Floats) -> Floats:
        """Return the probability of each, shape (thresholds, spreads, lapses)."""
        log = np.zeros((len(thresholds), len(log_spreads), len(lapses)))
        for at, right, wrong in zip(self.x, self.right, self.trials - self.right, strict=True):
            felt = ndtr((at - thresholds[:, None]) / np.exp(log_spreads))[..., None]
            share = self.guess + (1 - self.guess - lapses) * felt
            # No answer of a kind has no part in it, and a logarithm costs most of the time.
            if right:
                log += right * np.log(np.maximum(share, 1e-300))
            if wrong:
                log += wrong * np.log(np.maximum(1 - share, 1e-300))
        if len(lapses) > 1:
            log += (OF_LAPSES - 1) * np.log1p(-lapses)
        weight: Floats = np.exp(log - log.max())
        weight /= weight.sum()
        return weight


def _holding(axis: Floats, weight: Floats) -> tuple[float, float]:
    """Return the part of an axis outside of which there is nearly no weight, with a step on each side."""
    below = np.cumsum(weight)
    first, last = int(np.searchsorted(below, TAIL)), int(np.searchsorted(below, 1 - TAIL))
    return float(axis[max(first - 1, 0)]), float(axis[min(last + 1, len(axis) - 1)])


def _quantiles(axis: Floats, weight: Floats) -> Known:
    """Return median and limits of the weight at evenly spaced places, each spread over its cell."""
    if len(axis) == 1:
        return Known(*(float(axis[0]),) * 3)
    half = (axis[1] - axis[0]) / 2
    edges, below = np.append(axis - half, axis[-1] + half), np.append(0.0, np.cumsum(weight))
    tail = (1 - CONFIDENCE) / 2
    value, low, high = (float(one) for one in np.interp([0.5, tail, 1 - tail], below, edges))
    return Known(value, max(low, float(axis[0])), min(high, float(axis[-1])))
