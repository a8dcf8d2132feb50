"""Scales from paired comparisons: against R's printed examples, and likelihoods that are written anew and maximised."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.optimize
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.analysis.statistics.exact import NotDefined
from palpate.analysis.statistics.scaling import FIRST, SECOND, TIE, Comparisons, Law, NeverCompared, Scale, fit

CITED = np.array([[714, 730, 498, 221], [33, 425, 68, 17], [320, 813, 1072, 142], [284, 276, 325, 188]])
"""Citations among Biometrika, Commun. Statist., JASA and JRSS-B, 1987-89 (Stigler 1994, Table 4; data `citations` of
the R package BradleyTerry2): the row was cited by the column."""

IN_R = [0.0, -2.9490709, -0.4795715, 0.2689541]
"""`BTabilities(BTm(cbind(win1, win2), player1, player2, data = countsToBinomial(citations)))`, as its manual prints; R
stops where the deviance changes by less than 1e-8 of itself, some 2e-6 of the last digits away from the maximum."""


def made(counts: dict[tuple[int, int], tuple[int, int, int]], items: int, persons: int = 1) -> Comparisons:
    """Comparisons from counts of second, tie and first by ordered pair, dealt out to persons in turn."""
    rows = [
        (first, second, choice)
        for (first, second), choices in counts.items()
        for choice, count in zip((SECOND, TIE, FIRST), choices, strict=True)
        for _ in range(count)
    ]
    first, second, chosen = np.array(rows, dtype=np.int64).T
    return Comparisons(first, second, chosen, np.arange(len(rows)) % persons, items)


def journals() -> Comparisons:
    """Each pair in both orders alike, so that the order can have no effect."""
    counts = {
        (one, other): (int(CITED[other, one]), 0, int(CITED[one, other]))
        for one in range(4)
        for other in range(4)
        if one != other
    }
    return made(counts, 4)


def test_bradley_terry_is_that_of_r() -> None:
    scale = fit(journals(), "bradley-terry")
    assert scale.values - scale.values[0] == pytest.approx(IN_R, abs=2e-6)
    assert scale.order == pytest.approx(0, abs=1e-9)
    assert scale.values.sum() == pytest.approx(0, abs=1e-12)


def log_likelihood(data: Comparisons, law: Law, values: np.ndarray, order: float, tie: float) -> float:
    """The law as it stands in print, one term a comparison."""
    d = values[data.first] - values[data.second] + order
    towards = np.where(data.chosen == FIRST, d, -d)
    if law == "thurstone":
        terms = scipy.stats.norm.logcdf(towards)
    elif law == "bradley-terry":
        terms = -np.log1p(np.exp(-towards))
    else:
        odds = np.exp([-d / 2, np.full_like(d, tie), d / 2])  # SECOND, TIE and FIRST
        terms = np.log(np.choose(data.chosen, odds) / odds.sum(axis=0))
    return float(np.sum(terms))


def simulated(law: Law, seed: int, items: int = 4, persons: int = 6, each: int = 4) -> Comparisons:
    random = np.random.default_rng(seed)
    values = random.normal(0, 0.7, items)
    rows = []
    for person in range(persons):
        for first in range(items):
            for second in range(items):
                d = values[first] - values[second] + 0.3
                odds = np.exp([-d / 2, -0.5 if law == "davidson" else -np.inf, d / 2])
                rows += [(first, second, c, person) for c in random.choice(3, size=each, p=odds / odds.sum())]
    first, second, chosen, person = np.array(rows, dtype=np.int64).T
    return Comparisons(first, second, chosen, person, items)


@pytest.mark.parametrize("law", ["bradley-terry", "thurstone", "davidson"])
@pytest.mark.parametrize("seed", range(3))
def test_no_other_scale_is_likelier(law: Law, seed: int) -> None:
    data = simulated(law, seed)
    scale = fit(data, law)
    tie = scale.tie or 0.0
    assert scale.log_likelihood == pytest.approx(log_likelihood(data, law, scale.values, scale.order, tie), rel=1e-12)

    def worse(moved: np.ndarray) -> float:
        values = np.append(moved[:3], -moved[:3].sum())
        return -log_likelihood(data, law, values, moved[3], moved[4] if law == "davidson" else 0.0)

    best = scipy.optimize.minimize(worse, np.zeros(5), method="BFGS", options={"gtol": 1e-7})
    assert scale.values[:3] == pytest.approx(best.x[:3], abs=1e-6)
    assert scale.order == pytest.approx(best.x[3], abs=1e-6)
    if law == "davidson":
        assert scale.tie == pytest.approx(best.x[4], abs=1e-6)


@pytest.mark.parametrize("law", ["bradley-terry", "thurstone", "davidson"])
def test_shares_add_up_and_meet_their_margins(law: Law) -> None:
    data = simulated(law, 5)
    scale = fit(data, law)
    d = scale.values[data.first] - scale.values[data.second] + scale.order
    if law == "thurstone":
        shares = np.column_stack([scipy.stats.norm.cdf(d), np.zeros_like(d), scipy.stats.norm.cdf(-d)])
    else:
        tie = -np.inf if scale.tie is None else scale.tie
        shares = scipy.special.softmax(np.column_stack([d / 2, np.full_like(d, tie), -d / 2]), axis=1)
    assert shares.sum(axis=1) == pytest.approx(1, abs=1e-12)
    if law != "thurstone":
        # Of a logistic law, what was chosen in the first place in all is what is fitted, and so are ties.
        assert shares.sum(axis=0)[0] - shares.sum(axis=0)[2] == pytest.approx(
            (data.chosen == FIRST).sum() - (data.chosen == SECOND).sum(), abs=1e-6
        )
        assert shares.sum(axis=0)[1] == pytest.approx((data.chosen == TIE).sum(), abs=1e-6)


@pytest.mark.parametrize("law", ["bradley-terry", "thurstone", "davidson"])
def test_persons_who_answer_alike_widen_nothing_and_a_repeated_person_does(law: Law) -> None:
    """The covariance is the sandwich of one score a person: dealing each out anew keeps the scale, and changes it."""
    data = simulated(law, 7)
    scale = fit(data, law)
    first, second, chosen, person = (np.tile(one, 2) for one in (data.first, data.second, data.chosen, data.person))
    doubled = Comparisons(first, second, chosen, person, 4)
    twice = fit(doubled, law)
    assert twice.values == pytest.approx(scale.values, abs=1e-9)
    assert twice.covariance == pytest.approx(scale.covariance, rel=1e-6, abs=1e-12)
    assert twice.deviance == pytest.approx(2 * scale.deviance, rel=1e-9)
    alone = Comparisons(data.first, data.second, data.chosen, np.zeros_like(data.person), 4)
    assert np.isnan(fit(alone, law).covariance).all()


def test_two_items_are_in_closed_form() -> None:
    """70 of 100 chose the first in one order, 40 of 100 in the other: half the difference and sum of both quantiles."""
    data = made({(0, 1): (30, 0, 70), (1, 0): (60, 0, 40)}, 2, persons=10)
    for law, quantile in (("bradley-terry", scipy.special.logit), ("thurstone", scipy.stats.norm.ppf)):
        scale = fit(data, law)  # type: ignore[arg-type]
        one, other = quantile(0.7), quantile(0.4)
        assert scale.difference(0, 1)[0] == pytest.approx((one - other) / 2, abs=1e-9)
        assert scale.order == pytest.approx((one + other) / 2, abs=1e-9)
        assert scale.deviance == pytest.approx(0, abs=1e-9)
        assert scale.df == 0


def test_clustered_errors_are_those_of_statsmodels() -> None:
    """Its generalised estimating equations with independence, which share no line with the sandwich here."""
    import statsmodels.api as sm

    data = simulated("bradley-terry", 11, persons=9)
    design = np.zeros((len(data.first), 4))
    for row, (first, second) in enumerate(zip(data.first, data.second, strict=True)):
        design[row, first] += 1
        design[row, second] -= 1
    contrasts = np.column_stack([design[:, :3] - design[:, [3]], np.ones(len(design))])
    chosen = (data.chosen == FIRST).astype(float)
    found = sm.GEE(chosen, contrasts, groups=data.person, family=sm.families.Binomial()).fit()
    scale = fit(data, "bradley-terry")
    expected = np.asarray(found.cov_robust) * 9 / 8
    assert scale.values[:3] == pytest.approx(np.asarray(found.params)[:3], abs=1e-6)
    assert scale.covariance[:3, :3] == pytest.approx(expected[:3, :3], rel=1e-5)
    error = np.sqrt(expected[0, 0] + expected[1, 1] - 2 * expected[0, 1])
    assert scale.difference(0, 1)[1] == pytest.approx(error, rel=1e-5)


@pytest.mark.parametrize(
    ("counts", "law", "why"),
    [
        ({(0, 0): (4, 0, 5), (1, 1): (3, 0, 3)}, "thurstone", "never compared"),
        ({(0, 1): (3, 0, 9)}, "bradley-terry", "too few orders"),
        ({(0, 1): (3, 2, 9), (1, 0): (5, 0, 9)}, "thurstone", "ended in a tie"),
        ({(0, 1): (3, 0, 9), (1, 0): (5, 0, 9)}, "davidson", "no comparison ended in a tie"),
    ],
)
def test_what_has_no_best_scale_is_told(
    counts: dict[tuple[int, int], tuple[int, int, int]], law: Law, why: str
) -> None:
    with pytest.raises(NotDefined, match=why):
        fit(made(counts, 2), law)


def test_items_in_two_parts_are_named_by_their_places() -> None:
    """Each part has choices of both, so that only the missing comparisons are the cause."""
    counts = {(0, 2): (3, 0, 4), (2, 0): (1, 0, 4), (1, 3): (3, 0, 4), (3, 1): (2, 0, 2)}
    with pytest.raises(NeverCompared) as raised:
        fit(made(counts, 4), "bradley-terry")
    assert raised.value.part == (0, 2)


def always_won(law: Law) -> Comparisons:
    """Item 2 was always chosen; the others, which came first more often when second, were not."""
    tie = 2 if law == "davidson" else 0
    counts = {
        (0, 1): (3, tie, 5), (1, 0): (4, tie, 2), (0, 2): (6, 0, 0), (2, 0): (0, 0, 5), (1, 2): (4, 0, 0),
        (2, 1): (0, 0, 6),
    }  # fmt: skip
    return made(counts, 3, persons=5)


IN_BRGLM2 = {
    "bradley-terry": [-0.9552821218226, -1.4787353962284, -0.0666708205889],
    "thurstone": [-0.4959846189320, -0.8240489844414, -0.0391184997454],
}
"""R 4.2.2, brglm2 0.9: `glm(cbind(first, second) ~ a + b, binomial(link), method = "brglmFit", type = "AS_mean")` of
the counts of `always_won`, a and b being 1 where item 0 or 1 is first, -1 where second, each less the same of item 2;
then the intercept."""


@pytest.mark.parametrize("law", ["bradley-terry", "thurstone"])
def test_where_one_always_won_the_scale_is_that_of_brglm2(law: Law) -> None:
    scale = fit(always_won(law), law)
    assert scale.reduced
    assert [*scale.values[:2], scale.order] == pytest.approx(IN_BRGLM2[law], abs=1e-8)


def shares(data: Comparisons, law: Law, beta: np.ndarray) -> np.ndarray:
    """The shares of second, tie and first, shape (comparisons, 3), of two values, the order and the tie."""
    values = np.append(beta[:2], -beta[:2].sum())
    d = values[data.first] - values[data.second] + beta[2]
    if law == "thurstone":
        return np.column_stack([scipy.stats.norm.cdf(-d), np.zeros_like(d), scipy.stats.norm.cdf(d)])
    tie = beta[3] if law == "davidson" else -np.inf
    return np.asarray(scipy.special.softmax(np.column_stack([-d / 2, np.full_like(d, tie), d / 2]), axis=1))


def slopes(data: Comparisons, law: Law, beta: np.ndarray) -> np.ndarray:
    """The derivatives of the shares by each coefficient, shape (comparisons, 3, coefficients), by differences."""
    steps = 1e-5 * np.eye(len(beta))
    return np.stack(
        [(shares(data, law, beta + step) - shares(data, law, beta - step)) / 2e-5 for step in steps], axis=-1
    )


@pytest.mark.parametrize("law", ["bradley-terry", "davidson"])
def test_where_one_always_won_the_scale_has_the_greatest_penalized_likelihood(law: Law) -> None:
    """Firth's penalty for logits, half the logarithm of the determinant of the information, maximized directly."""
    data = always_won(law)

    def worse(beta: np.ndarray) -> float:
        of = shares(data, law, beta)
        held = np.where(of > 0, of, 1.0)
        information = np.einsum("nck,ncl,nc->kl", *[slopes(data, law, beta)] * 2, np.where(of > 0, 1 / held, 0.0))
        likelihood = np.log(of[np.arange(len(of)), data.chosen]).sum()
        return float(-likelihood - np.linalg.slogdet(information)[1] / 2)

    start = np.zeros(4 if law == "davidson" else 3)
    best = scipy.optimize.minimize(worse, start, method="Nelder-Mead", options={"xatol": 1e-8, "fatol": 1e-12})
    scale = fit(data, law)
    assert scale.reduced
    own = np.append(scale.values[:2], [scale.order, *([scale.tie] if scale.tie is not None else [])])
    # Close to a maximum values differ by 1e-6 where it rises by 1e-11, which rounding hides.
    assert own == pytest.approx(best.x, abs=1e-5)
    assert worse(own) <= best.fun + 1e-10


def test_the_scores_of_a_normal_law_are_reduced_by_firths_general_formula() -> None:
    """Half the trace of the inverse information times E(U U' U) - E(J U), J observed, all outcomes enumerated."""
    data = always_won("thurstone")
    scale = fit(data, "thurstone")
    beta = np.append(scale.values[:2], scale.order)
    design = slopes(data, "thurstone", beta)[:, FIRST] / scipy.stats.norm.pdf(
        scale.values[data.first] - scale.values[data.second] + scale.order
    )[:, None]  # fmt: skip

    def score(d: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        towards = np.where(chosen == FIRST, 1.0, -1.0)
        return np.asarray(towards * np.exp(scipy.stats.norm.logpdf(d) - scipy.stats.norm.logcdf(towards * d)))

    d = design @ beta
    both = {choice: np.full(len(d), choice) for choice in (SECOND, FIRST)}
    p = {SECOND: scipy.stats.norm.cdf(-d), FIRST: scipy.stats.norm.cdf(d)}
    u = {choice: score(d, of) for choice, of in both.items()}
    j = {choice: -(score(d + 1e-5, of) - score(d - 1e-5, of)) / 2e-5 for choice, of in both.items()}
    information = np.einsum("nk,nl,n->kl", design, design, sum(p[c] * u[c] ** 2 for c in p))
    third = sum(p[c] * (u[c] ** 3 - j[c] * u[c]) for c in p)
    penalty = np.einsum("kl,nk,nl,nm,n->m", np.linalg.inv(information), design, design, design, third) / 2
    assert design.T @ score(d, data.chosen) + penalty == pytest.approx(np.zeros(3), abs=1e-6)
    assert scale.reduced


def test_two_items_of_which_one_always_won_are_in_closed_form() -> None:
    """Both orders alike, 0 of n: half a choice is added to each of both coefficients' shares, logit of (n + 1/2)."""
    scale = fit(made({(0, 1): (9, 0, 0), (1, 0): (0, 0, 9)}, 2, persons=3), "bradley-terry")
    assert scale.difference(1, 0)[0] == pytest.approx(np.log(9.5 / 0.5), abs=1e-9)
    assert scale.order == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("law", ["bradley-terry", "thurstone", "davidson"])
def test_where_all_answer_alike_errors_are_no_smaller_than_of_independent_answers(law: Law) -> None:
    """Scores of persons who answer alike have one value, whose variance would be next to nothing."""
    one = always_won(law)
    first, second, chosen = (np.tile(of, 5) for of in (one.first, one.second, one.chosen))
    alike = Comparisons(first, second, chosen, np.repeat(np.arange(5), len(one.first)), 3)
    apart = Comparisons(first, second, chosen, np.arange(5 * len(one.first)), 3)
    scale, independent = fit(alike, law), fit(apart, law)
    assert scale.difference(2, 0)[1] >= 0.7 * independent.difference(2, 0)[1]


@settings(max_examples=40, deadline=None)
@given(
    counts=st.lists(st.integers(0, 12), min_size=12, max_size=12),
    law=st.sampled_from(["bradley-terry", "thurstone", "davidson"]),
)
def test_any_counts_have_a_finite_scale_or_a_reason(counts: list[int], law: Law) -> None:
    pairs = [(0, 1), (1, 2), (2, 0), (1, 0)]
    table = {
        pair: (counts[3 * k], counts[3 * k + 1] if law == "davidson" else 0, counts[3 * k + 2])
        for k, pair in enumerate(pairs)
    }
    if not sum(map(sum, table.values())):
        return
    try:
        scale: Scale = fit(made(table, 3), law)
    except NotDefined:
        return
    assert np.isfinite([*scale.values, scale.order, scale.deviance]).all()
    assert scale.deviance > -1e-6
