"""Psychometric functions against R's glm and optim, and their intervals on simulated answers."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.analysis.statistics.exact import NotDefined
from palpate.analysis.statistics.psychophysics.psychometric import _Data, fit, psychometric

X = np.array([-24.0, -20, -16, -12, -8, -4])
TRIALS = np.full(6, 30.0)
R_FITS = pytest.mark.parametrize(
    ("right", "guess", "printed"),
    [
        # R 4.2.2: glm(cbind(k, 30 - k) ~ x, family = binomial(probit)): -b0/b1 and 1/b1.
        ([2, 6, 13, 22, 28, 30], 0.0, (-15.55291176, 5.15132268)),
        # The same with psyphy 0.2.3's link mafc.probit(2), whose guesses are half of the answers.
        ([16, 18, 22, 26, 29, 30], 0.5, (-15.49315538, 4.90120209)),
    ],
)


@R_FITS
def test_without_lapses_the_posterior_of_many_trials_is_at_what_r_fits(
    right: list[int], guess: float, printed: tuple[float, float]
) -> None:
    """Of the same shares in a thousand times as many trials R's estimates are the same."""
    found = fit(X, 1000 * np.array(right, dtype=float), 1000 * TRIALS, guess=guess, lapse=0.0)
    assert (found.threshold.value, found.spread.value) == pytest.approx(printed, rel=1e-3)
    assert found.lapse.value == 0.0
    few = fit(X, np.array(right, dtype=float), TRIALS, guess=guess, lapse=0.0)
    assert few.threshold.low < printed[0] < few.threshold.high


@R_FITS
def test_without_lapses_the_most_probable_function_is_what_r_fits(
    right: list[int], guess: float, printed: tuple[float, float]
) -> None:
    """Every prior is flat then, so that R's greatest likelihood is the top of the posterior: of a paraboloid there."""
    data = _Data(X, np.array(right, dtype=float), TRIALS, guess)
    near = np.linspace(-0.003, 0.003, 7)
    weight = data.posterior(printed[0] + near, np.log(printed[1]) + near, np.zeros(1))[..., 0]
    one, other = (of.ravel() for of in np.meshgrid(near, near, indexing="ij"))
    terms = np.stack([np.ones_like(one), one, other, one**2, one * other, other**2], axis=1)
    _, b, c, d, e, f = np.linalg.lstsq(terms, np.log(weight).ravel(), rcond=None)[0]
    off = np.linalg.solve([[2 * d, e], [e, 2 * f]], [-b, -c])
    assert (printed[0] + off[0], printed[1] * np.exp(off[1])) == pytest.approx(printed, abs=2e-5)


def test_of_many_trials_the_posterior_is_what_r_says_of_its_estimates() -> None:
    """R 4.2.2: the first of the data above a hundred times over; the error of -b0/b1 from vcov, by the delta method."""
    found = fit(X, np.array([200.0, 600, 1300, 2200, 2800, 3000]), TRIALS * 100, guess=0.0, lapse=0.0)
    assert found.threshold.value == pytest.approx(-15.5529, abs=0.01)
    assert (found.threshold.high - found.threshold.low) / 2 == pytest.approx(1.96 * 0.0629049556614, rel=0.02)


def test_lapses_and_a_steep_function_are_told_apart() -> None:
    x = np.arange(-30.0, 1.0, 3)
    right = np.round(psychometric(x, -16.0, 3.0, 0.5, 0.05) * 400)
    found = fit(x, right, np.full(len(x), 400.0), guess=0.5)
    assert found.threshold.value == pytest.approx(-16.0, abs=0.2)
    assert found.spread.value == pytest.approx(3.0, abs=0.3)
    assert found.lapse.value == pytest.approx(0.05, abs=0.01)
    assert found.jnd.value == pytest.approx(0.67449 * found.spread.value, rel=1e-5)
    assert not found.at_bound


def test_what_the_levels_do_not_reach_is_said() -> None:
    assert fit(X, TRIALS, TRIALS, guess=0.5).at_bound
    with pytest.raises(NotDefined):
        fit(X[:1], TRIALS[:1], TRIALS[:1], guess=0.5)
