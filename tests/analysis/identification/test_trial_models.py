"""Models of single trials: statsmodels' formula interface, known odds, and trials that cannot be modelled."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import statsmodels.api as sm
import statsmodels.formula.api as smf
from scipy import stats
from scipy.linalg import sqrtm
from scipy.optimize import approx_fprime, minimize
from scipy.special import logsumexp
from statsmodels.genmod.generalized_estimating_equations import GEE
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.identification.results import compute
from palpate.analysis.identification.trial_models import (
    FASTER,
    HARDER,
    LATER,
    TRIAL,
    Design,
    TrialLevel,
    design,
    gee,
    log_likelihood,
    mixed,
    trial_level,
)
from palpate.analysis.reading.dataset import read
from palpate.analysis.reading.study import Study
from palpate.analysis.report.identification_sections import trials_section
from palpate.analysis.statistics.exact import NotDefined
from tests.analysis.datasets import MATERIALS, trial, write_dataset
from tests.analysis.reference import printed
from tests.approved import Refuses


def _session(
    rng: np.random.Generator, skill: float, *, slope: float = 0.0, speeds: bool = True
) -> list[dict[str, object]]:
    rows = []
    for number in range(1, 31):
        shown = MATERIALS[int(rng.integers(3))]
        speed = round(float(rng.uniform(60, 300)), 1)
        odds = skill + slope * (speed - 180) / 100
        said = shown if rng.random() < 1 / (1 + math.exp(-odds)) else MATERIALS[(MATERIALS.index(shown) + 1) % 3]
        known: dict[str, object] = {"foot_speed": speed, "response_time": round(float(rng.uniform(1, 4)), 3)}
        rows.append(trial(number, shown, said, **(known if speeds else {})))
    return rows


def _study(root: Path, people: int = 12, *, slope: float = 0.0, spread: float = 0.5, speeds: bool = True) -> Study:
    rng = np.random.default_rng(11)
    sessions = {}
    for who in range(people):
        skill = rng.normal(0.4, spread)
        tasks = {task: _session(rng, skill, slope=slope, speeds=speeds) for task in ("virtual", "real")}
        sessions[str(who)] = tasks
    return read(write_dataset(root, sessions))


def _with_order(study: Study) -> Study:
    return replace(study, first_tasks={who: ("virtual", "real")[int(who) % 2] for who in study.participants})


def test_gee_is_that_of_the_formula_interface(tmp_path: Path) -> None:
    study = _with_order(_study(tmp_path))
    found = gee(design(study))
    frame = study.attempts.copy()
    frame["right"] = (frame["presented"] == frame["answered"]).astype(int)
    frame["later"] = [
        int(study.first_tasks[who] != task) for who, task in zip(frame["participant"], frame["task"], strict=True)
    ]
    formula = (
        "right ~ C(task, Treatment('virtual')) + C(presented, Treatment('glass')) + trial + foot_speed_mm_s + later"
    )
    expected = smf.gee(
        formula, "participant", frame, family=sm.families.Binomial(), cov_struct=sm.cov_struct.Exchangeable()
    ).fit(maxiter=200)
    names = [one.name for one in found.coefficients]
    levels = ["real (against virtual)", "sand (against glass)", "snow (against glass)"]
    assert names == ["intercept", *levels, TRIAL, FASTER, LATER]
    steps = np.array([1, 1, 1, 1, 10, 100, 1])
    assert [one.estimate for one in found.coefficients[1:]] == pytest.approx(
        (expected.params * steps)[1:].tolist(), rel=1e-4
    )
    assert [term.df for term in found.terms] == [1, 2, 1, 1, 1]
    assert found.participants == 12
    assert (found.terms[1].df, found.terms[1].df2) == (2, 10)
    assert found.terms[1].p == pytest.approx(stats.f.sf(found.terms[1].statistic, 2, 10), rel=1e-9)
    one = found.coefficients[1]
    assert one.p == pytest.approx(2 * stats.t.sf(abs(one.estimate / one.error), 11), rel=1e-9)
    assert one.high == pytest.approx(one.estimate + stats.t.ppf(0.975, 11) * one.error, rel=1e-9)


def _cbpp() -> Design:
    counts = np.array(printed("cbpp")["counts"])
    right = np.concatenate([np.arange(animals) < cases for _, cases, animals, _ in counts]).astype(np.float64)
    herds, periods = np.repeat(counts[:, 0] - 1, counts[:, 2]), np.repeat(counts[:, 3], counts[:, 2])
    matrix = np.column_stack([np.ones(len(right)), *(periods == period for period in (2, 3, 4))]).astype(np.float64)
    return Design(right, herds, ("intercept", "2", "3", "4"), matrix, {"period": (1, 2, 3)}, {}, {}, ())


def test_the_force_of_the_foot_is_a_covariate_where_any_was_recorded(tmp_path: Path) -> None:
    """Log odds that fall by 0.6 for each 10 N come back within the interval, beside those of the formula interface."""
    assert HARDER not in design(_study(tmp_path / "none")).names
    rng = np.random.default_rng(5)
    rows: dict[str, dict[str, list[dict[str, object]]]] = {}
    for who in range(12):
        skill, own_n = rng.normal(0.6, 0.4), rng.uniform(30, 50)
        session = []
        for number in range(1, 81):
            shown, force_n = MATERIALS[int(rng.integers(3))], round(own_n + rng.normal(0, 8), 2)
            right = rng.random() < 1 / (1 + math.exp(0.06 * (force_n - own_n) - skill))
            said = shown if right else MATERIALS[(MATERIALS.index(shown) + 1) % 3]
            session.append(trial(number, shown, said, foot_speed=100.0 + number, foot_force=force_n))
        rows[str(who)] = {"virtual": session}
    found = trial_level(read(write_dataset(tmp_path / "some", rows)))
    for model in (found.gee, found.mixed):
        assert model is not None
        (one,) = [each for each in model.coefficients if each.name == HARDER]
        assert one.low < -0.6 < one.high < 0


def test_gee_is_that_of_its_equations() -> None:
    """Liang and Zeger (1986), equation 7, solved from 0, and Kauermann and Carroll (2001), by matrices of trials.

    The correlation is the moment estimate that was found, whose equation statsmodels alone is trusted with.
    """
    data, found = _cbpp(), gee(_cbpp())
    beta = np.zeros(4)
    for _ in range(50):
        bread, score, parts = np.zeros((4, 4)), np.zeros(4), []
        for herd in range(15):
            own = data.participants == herd
            x, y = data.matrix[own], data.correct[own]
            mu = 1 / (1 + np.exp(-x @ beta))
            root = np.sqrt(mu * (1 - mu))
            alike = np.full((len(y), len(y)), found.spread) + (1 - found.spread) * np.eye(len(y))
            slope, inverse = x * (mu * (1 - mu))[:, None], np.linalg.inv(root[:, None] * alike * root)
            parts.append((slope, inverse, y - mu))
            bread += slope.T @ inverse @ slope
            score += slope.T @ inverse @ (y - mu)
        beta += np.linalg.solve(bread, score)
    outer = np.linalg.inv(bread)
    meat = np.zeros((4, 4))
    for slope, inverse, left in parts:
        spared = np.linalg.solve(sqrtm(np.eye(len(left)) - slope @ outer @ slope.T @ inverse), left)
        one = slope.T @ inverse @ spared
        meat += np.outer(one, one)
    covariance = outer @ meat @ outer
    assert [one.estimate for one in found.coefficients] == pytest.approx(beta.tolist(), rel=1e-6)
    assert [one.error for one in found.coefficients] == pytest.approx(np.sqrt(np.diag(covariance)).tolist(), rel=1e-6)
    # Hotelling (1931): (n - q) / (q (n - 1)) of Wald's statistic is F on q and n - q df; n = 15 herds, q = 3 periods.
    wald = beta[1:] @ np.linalg.solve(covariance[1:, 1:], beta[1:])
    assert found.terms[0].p == pytest.approx(stats.f.sf(wald * 12 / 42, 3, 12), rel=1e-6)


def test_the_mixed_logit_is_at_maximum_likelihood() -> None:
    """The likelihood by its definition: each herd's integral over a normal intercept, at 60 Hermite nodes."""
    data = _cbpp()
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)

    def minus_log_likelihood(parameters: np.ndarray) -> float:
        odds = (data.matrix @ parameters[:4])[:, None] + np.exp(parameters[4]) * nodes
        by_herd = np.zeros((15, nodes.size))
        np.add.at(by_herd, data.participants, data.correct[:, None] * odds - np.logaddexp(0, odds))
        return -float(logsumexp(by_herd + np.log(weights / weights.sum()), axis=1).sum())

    best = minimize(minus_log_likelihood, np.zeros(5), options={"gtol": 1e-6})
    found = mixed(data)
    assert [one.estimate for one in found.coefficients] == pytest.approx(best.x[:4].tolist(), abs=2e-4)
    assert found.spread == pytest.approx(np.exp(best.x[4]), abs=2e-4)


def test_the_mixed_logit_is_the_same_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    data = _cbpp()
    order = np.random.default_rng(1).permutation(data.correct.size)
    mingled = replace(
        data, correct=data.correct[order], matrix=data.matrix[order], participants=data.participants[order]
    )
    whole = mixed(data)
    monkeypatch.setattr("palpate.analysis.identification.trial_models.HELD", 100)
    parts = mixed(mingled)
    assert [one.estimate for one in parts.coefficients] == pytest.approx(
        [one.estimate for one in whole.coefficients], abs=1e-5
    )
    assert [one.error for one in parts.coefficients] == pytest.approx([one.error for one in whole.coefficients], 1e-4)
    assert parts.spread == pytest.approx(whole.spread, abs=1e-5)


@pytest.mark.parametrize("sd", [0.0, 0.3, 1.0, 3.0])
def test_the_likelihood_is_that_of_a_fine_trapezoid(sd: float) -> None:
    """The integral over the intercept by its definition, in 4,000 steps from -10 to 10 SD."""
    data = _cbpp()
    nodes = np.linspace(-10, 10, 4001)
    weights = np.exp(-(nodes**2) / 2) / np.sqrt(2 * np.pi) * (nodes[1] - nodes[0])
    coefficients = np.array([-1.2, -0.8, 0.3, -1.5])

    def direct(parameters: np.ndarray) -> float:
        odds = (data.matrix @ parameters[:4])[:, None] + parameters[4] * nodes
        by_herd = np.zeros((15, nodes.size))
        np.add.at(by_herd, data.participants, data.correct[:, None] * odds - np.logaddexp(0, odds))
        return float(logsumexp(by_herd, axis=1, b=weights).sum())

    value, slopes = log_likelihood(
        correct=data.correct, matrix=data.matrix, participants=data.participants, coefficients=coefficients, sd=sd
    )
    at = np.append(coefficients, sd)
    assert value == pytest.approx(direct(at), abs=1e-4)
    assert slopes.tolist() == pytest.approx(approx_fprime(at, direct, 1e-6).tolist(), abs=2e-3)


def test_without_differences_among_participants_it_is_the_plain_logit(tmp_path: Path) -> None:
    """Against statsmodels' Logit, from the same trials."""
    trials = design(_study(tmp_path, 12))
    plain = sm.Logit(trials.correct, trials.matrix)
    coefficients = np.linspace(-0.5, 0.5, trials.matrix.shape[1])
    value, slopes = log_likelihood(
        correct=trials.correct,
        matrix=trials.matrix,
        participants=trials.participants,
        coefficients=coefficients,
        sd=0.0,
    )
    assert value == pytest.approx(plain.loglike(coefficients), abs=1e-9)
    assert slopes.tolist() == pytest.approx([*plain.score(coefficients).tolist(), 0.0], abs=1e-9)


def test_known_odds_come_back(tmp_path: Path) -> None:
    """The foot's speed changes the log odds by 1 per 100 mm/s; everyone differs by an SD of 0.5."""
    trials = design(_study(tmp_path, 30, slope=1.0))
    for model in (gee(trials), mixed(trials)):
        speed = next(one for one in model.coefficients if one.name == FASTER)
        assert speed.estimate == pytest.approx(1.0, abs=0.25)
    assert mixed(trials).spread == pytest.approx(0.5, abs=0.25)


def test_the_same_trials_give_the_same_numbers(tmp_path: Path) -> None:
    trials = design(_study(tmp_path, 8))
    assert mixed(trials) == mixed(trials)


def test_what_is_not_in_the_dataset_is_said(tmp_path: Path, approved: SnapshotAssertion) -> None:
    trials = design(_study(tmp_path, speeds=False))
    assert trials.absent.keys() == {FASTER, LATER}
    assert [trials.absent[FASTER], trials.absent[LATER]] == approved
    assert trials.names[-1] == TRIAL


def test_trials_without_a_value_are_left_out_and_counted(tmp_path: Path) -> None:
    study = _study(tmp_path)
    study.attempts.loc[study.attempts.index[:7], "foot_speed_mm_s"] = float("nan")
    trials = design(study)
    assert (trials.left_out, trials.gone, len(trials.correct)) == ({"virtual": 7}, (), 713)


def _known(study: Study, column: str, trials: np.ndarray) -> None:
    study.attempts.loc[~trials, column] = float("nan")


def test_a_covariate_of_one_task_alone_is_dropped_and_not_the_other_task(
    tmp_path: Path, approved: SnapshotAssertion
) -> None:
    study = _study(tmp_path)
    _known(study, "foot_speed_mm_s", (study.attempts["task"] == "virtual").to_numpy())
    trials = design(study)
    assert trials.absent[FASTER] == approved
    assert "task" in trials.terms
    assert (trials.left_out, len(trials.correct)) == ({}, 720)


def test_the_response_time_is_no_covariate(tmp_path: Path) -> None:
    """It follows the stimulus: what it explains would be taken from material and task."""
    study = _study(tmp_path)
    assert study.attempts["response_time_s"].notna().all()
    assert not any("response" in name for name in (*design(study).names, *design(study).absent))


def test_a_covariate_that_one_material_lacks_is_dropped_and_not_the_material(
    tmp_path: Path, approved: SnapshotAssertion
) -> None:
    study = _study(tmp_path)
    _known(study, "foot_speed_mm_s", (study.attempts["presented"] != "snow").to_numpy())
    trials = design(study)
    assert trials.absent[FASTER] == approved
    assert len(trials.correct) == 720


def test_participants_without_a_trial_left_are_named(tmp_path: Path, approved: SnapshotAssertion) -> None:
    study = _study(tmp_path)
    _known(study, "foot_speed_mm_s", (study.attempts["participant"] != "3").to_numpy())
    assert design(study).gone == ("3",)
    said = trials_section(compute(study, {})).paragraphs
    assert said == approved


def test_one_order_of_tasks_for_all_cannot_be_told_from_the_task(tmp_path: Path, approved: SnapshotAssertion) -> None:
    study = _study(tmp_path)
    trials = design(replace(study, first_tasks=dict.fromkeys(study.participants, "virtual")))
    assert trials.absent[LATER] == approved
    assert np.linalg.matrix_rank(trials.matrix) == len(trials.names)


def test_every_task_after_the_first_is_a_later_one(tmp_path: Path) -> None:
    """By hand: participant 0 began with the first of three tasks, participant 1 with the third."""
    rng = np.random.default_rng(2)
    tasks = ("one", "two", "three")
    sessions = {str(who): {task: _session(rng, 0.4) for task in tasks} for who in range(8)}
    study = read(write_dataset(tmp_path, sessions, tasks=tasks))
    trials = design(replace(study, first_tasks={who: tasks[int(who) % 3] for who in study.participants}))
    later = trials.matrix[:, trials.names.index("a task after the first")]
    first = {
        task: bool(later[trials.participants == 0][k] == later.min())
        for k, task in zip((0, 30, 60), tasks, strict=True)
    }
    assert first == {"one": True, "two": False, "three": False}
    assert "second task" not in trials.names


def test_without_a_trial_there_is_no_model(tmp_path: Path, refuses: Refuses) -> None:
    study = _study(tmp_path, 2)
    study.attempts["included"] = False
    with refuses(NotDefined):
        design(study)


def test_a_reconstruction_has_no_single_trials(repository_root: Path, approved: SnapshotAssertion) -> None:
    found = trial_level(read(repository_root / "participants" / "okamoto2012"))
    assert (found.gee, found.mixed) == (None, None)
    assert found.statements.items() == approved


def test_a_material_that_is_always_recognised(tmp_path: Path, refuses: Refuses) -> None:
    study = _study(tmp_path)
    always = study.attempts["presented"] == "snow"
    study.attempts.loc[always, "answered"] = "snow"
    with refuses(NotDefined):
        design(study)


def test_participants_who_answer_alike_have_no_standard_errors_of_the_gee(tmp_path: Path, refuses: Refuses) -> None:
    """All do the same: their scores, which add up to zero, are zero each, and so is the covariance between them."""
    rows = _session(np.random.default_rng(5), 0.4)
    study = read(write_dataset(tmp_path, {str(who): {"virtual": rows} for who in range(9)}))
    with refuses(NotDefined):
        gee(design(study))


def test_terms_that_cannot_be_told_apart_have_no_standard_errors_of_the_gee(refuses: Refuses) -> None:
    data = _cbpp()
    matrix = np.column_stack([data.matrix, data.matrix[:, 1:].sum(axis=1) + data.matrix[:, 0]])
    twice = replace(data, matrix=matrix, names=(*data.names, "again"), terms={"again": (4,)})
    with refuses(NotDefined):
        gee(twice)


def test_odds_without_limit_are_named(refuses: Refuses) -> None:
    """In the fourth period no animal fell ill: its odds are those of never."""
    data = _cbpp()
    never = replace(data, correct=np.where(data.matrix[:, 3] > 0, 0.0, data.correct))
    with refuses(NotDefined):
        mixed(never)


def test_what_statsmodels_says_of_a_fit_that_converges_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    fit = GEE.fit

    def warn(self: GEE, **options: object) -> object:
        warnings.warn("the scale is odd", RuntimeWarning, stacklevel=2)
        return fit(self, **options)

    monkeypatch.setattr(GEE, "fit", warn)
    found = gee(_cbpp())
    assert len(found.warned) == 1
    results = SimpleNamespace(trials=TrialLevel(found, None, {}, {}, (), {}))
    (table,) = trials_section(results).tables  # type: ignore[arg-type]
    assert table.notes[-1].endswith(f": {found.warned[0]}.")


def test_too_few_participants(tmp_path: Path) -> None:
    found = trial_level(_study(tmp_path, 4))
    assert set(found.statements) == {"GEE logit", "mixed logit"}
    assert "participants, got 4" in found.statements["GEE logit"]
