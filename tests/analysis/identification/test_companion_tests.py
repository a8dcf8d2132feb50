"""Ours beside the published tests: scipy and statsmodels on a dataset, stars by the protocol, a reconstruction."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from statsmodels.stats.anova import AnovaRM
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.identification.results import compute
from palpate.analysis.reading.dataset import read
from palpate.analysis.reading.study import Part, Study
from palpate.analysis.report import sections
from palpate.analysis.report.companion_tables import beside_section
from palpate.analysis.report.plan import TWO_WAY, Standing
from palpate.analysis.statistics.inference import holm
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.models import Protocol
from tests.analysis.datasets import MATERIALS, trials, write_dataset

LOGIT = "logit with participants who vary by material and task"


def _study(root: Path, people: int = 9, *, missing: tuple[str, ...] = ()) -> Study:
    """Six trials of each material in two tasks; those `missing` did the first alone."""
    rng = np.random.default_rng(6)
    sessions = {}
    for who in range(people):
        by_task = {}
        for task, skill in (("virtual", 0.2), ("real", 1.0)):
            level = rng.normal(skill, 0.7)
            answers = []
            for i, shown in enumerate(MATERIALS):
                odds = level + 0.5 * i + rng.normal(0, 0.5)
                right = rng.random(6) < 1 / (1 + np.exp(-odds))
                answers += [(shown, shown if hit else MATERIALS[(i + 1) % 3]) for hit in right]
            by_task[task] = trials(answers)
        sessions[str(who)] = {"virtual": by_task["virtual"]} if str(who) in missing else by_task
    return read(write_dataset(root, sessions))


def _ratios(study: Study) -> pd.DataFrame:
    frame = study.attempts.assign(right=(study.attempts["presented"] == study.attempts["answered"]).astype(float))
    found: pd.DataFrame = frame.groupby(["participant", "task", "presented"])["right"].mean().reset_index()
    return found


def test_repeated_measures_are_those_of_statsmodels(tmp_path: Path) -> None:
    study = _study(tmp_path)
    found = compute(study, {}).beside
    ratios = _ratios(study)
    table = AnovaRM(ratios, "right", "participant", within=["task", "presented"]).fit().anova_table
    for line, name in zip(found.both, ("task", "presented", "task:presented"), strict=True):
        assert (line.f, line.p_uncorrected) == pytest.approx((table.loc[name, "F Value"], table.loc[name, "Pr > F"]))
    for task, (line,) in found.materials.items():
        own = AnovaRM(ratios[ratios["task"] == task], "right", "participant", within=["presented"]).fit().anova_table
        assert line.f == pytest.approx(own.loc["presented", "F Value"])


def test_tasks_are_compared_over_those_who_did_both(tmp_path: Path) -> None:
    study = _study(tmp_path, missing=("2", "5"))
    (paired,) = compute(study, {}).beside.paired
    means = _ratios(study).pivot_table("right", "participant", "task").dropna()
    expected = stats.ttest_rel(means["virtual"], means["real"])
    assert (paired.test.n, paired.test.t, paired.test.p) == pytest.approx((7, expected.statistic, expected.pvalue))
    gaps = (means["virtual"] - means["real"]).to_numpy()
    signs = np.array(np.meshgrid(*[[1, -1]] * 7)).reshape(7, -1)
    assert paired.flip.p == pytest.approx(np.mean(abs(gaps @ signs) >= abs(gaps.sum()) - 1e-12))


def test_the_logit_counts_everybody_and_names_its_terms(tmp_path: Path) -> None:
    found = compute(_study(tmp_path, missing=("2",)), {}).beside.logit
    assert found is not None
    assert found.participants == 9
    assert list(found.coefficients) == [
        "intercept", "real (against virtual)", "sand (against glass)", "snow (against glass)",
    ]  # fmt: skip
    assert [(term.name, term.df1, term.df2) for term in found.terms] == [("task", 1, 8), ("material", 2, 16)]
    task = found.terms[0]
    estimate, error = found.coefficients["real (against virtual)"]
    assert (task.f, task.p) == pytest.approx(((estimate / error) ** 2, stats.f.sf((estimate / error) ** 2, 1, 8)))
    assert list(found.sds) == ["participant", "participant by task", "participant by material"]


def test_everything_of_ours_says_so(tmp_path: Path) -> None:
    results = compute(_study(tmp_path), {})
    nothing, planned = (
        Standing(frozenset(), frozenset(), frozenset()),
        Standing(frozenset({(TWO_WAY, "real")}), frozenset(), frozenset()),
    )
    shown = [beside_section(results.beside, stands) for stands in (planned, nothing)]
    assert [table.standing for section in shown for table in section.tables] == ["companion"] * 3 + [
        "companion, exploratory"
    ] * 3
    records = shown[0].records
    assert {str(one["analysis"]) for one in records if "(companion)" in str(one["analysis"])} == {
        "repeated measures (companion)", "paired tasks (companion)",
        "logit by participant, material and task (companion)",
    }  # fmt: skip


def test_what_few_or_perfect_participants_leave_open_is_said(tmp_path: Path, approved: SnapshotAssertion) -> None:
    few = compute(_study(tmp_path / "few", 4), {}).beside
    (why,) = few.statements.items()
    assert why == approved
    right = {str(k): {"virtual": trials([(one, one) for one in MATERIALS] * 3)} for k in range(6)}
    perfect = compute(read(write_dataset(tmp_path / "right", right, tasks=("virtual",))), {})
    assert perfect.beside.statements[LOGIT] == approved
    (line,) = perfect.beside.materials["virtual"]
    assert line.p is None
    flips = [test.flip for test in perfect.tasks[0].tests]
    assert [flip.p for flip in flips if flip] == [2 / 2**6] * 3
    assert {test.result.p for test in perfect.tasks[0].tests} == {None}


def _protocol(correction: str | None) -> Protocol:
    own = files.load(shipped("okamoto2012.toml"))
    tests = tuple(
        test.model_copy(update={"correction": correction}) if test.test == "t against chance" else test
        for test in own.analysis
    )
    return own.model_copy(update={"analysis": tests, "exclusion": ()})


@pytest.mark.parametrize(
    ("correction", "said"),
    [
        (None, "The stars follow the unadjusted P, because no protocol names a correction."),
        (
            "materials",
            "In virtual and real, the stars follow the Holm-adjusted P, as the protocol plans; the family is the ",
        ),
        ("materials and tasks", "the family is the materials and tasks."),
    ],
)
def test_stars_follow_the_p_that_the_protocol_names(correction: str | None, said: str, repository_root: Path) -> None:
    study = read(repository_root / "participants" / "okamoto2012")
    part = Part("one", study.participants, ("virtual", "real"), _protocol(correction))
    results = compute(replace(study, parts=(part,)), {})
    p = np.array([[test.result.p for test in task.tests] for task in results.tasks], dtype=float)
    adjusted = holm(p.T).T if correction != "materials and tasks" else holm(p.ravel()).reshape(2, 4)
    assert [[test.p_holm for test in task.tests] for task in results.tasks] == adjusted.tolist()
    followed = p if correction is None else adjusted
    marks = [[sum(one < level for level in (0.05, 0.01, 0.001)) * "*" for one in row] for row in followed]
    marks[0][3] = ""
    assert [[test.stars for test in task.tests] for task in results.tasks] == marks
    assert any(said in one for one in sections.tests_section(results).paragraphs)


@pytest.mark.parametrize(("people", "tests", "able"), [(5, 1, False), (6, 1, True), (6, 3, False), (7, 3, True)])
def test_the_least_p_of_sign_flips_is_that_of_holms_family(
    tmp_path: Path, people: int, tests: int, *, able: bool
) -> None:
    """2 / 2^6 is below 0.05, and three times as much is not; three times 2 / 2^7 is."""
    right = trials([(material, material) for material in MATERIALS[:tests] for _ in range(4)])
    sessions = {str(k): {"virtual": right} for k in range(people)}
    study = read(write_dataset(tmp_path, sessions, tasks=("virtual",), presented={"virtual": MATERIALS[:tests]}))
    part = Part("one", study.participants, ("virtual",), _protocol("materials"))
    (task,) = compute(replace(study, parts=(part,)), {}).tasks
    assert len(task.tests) == tests
    assert (min(test.flip_least or 0 for test in task.tests) < 0.05) == able
