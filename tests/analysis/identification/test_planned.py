"""Planned tests over participants: numbers of R, families, materials that a plan names, and what is not defined."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import permutation_test, ttest_ind

from palpate.analysis.identification.companion_tests import LINKED, slopes_logit
from palpate.analysis.identification.confusion import Confusion
from palpate.analysis.identification.planned import TESTS, Planned, planned_tests
from palpate.analysis.reading.dataset import read
from palpate.analysis.reading.study import Part, Study
from palpate.analysis.statistics.exact import Floats
from palpate.experiment.protocol import files
from palpate.experiment.protocol.asked import Asked, Fact
from palpate.experiment.protocol.designs.identification import DESIGN
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.models import PlannedTest
from tests.analysis.datasets import balanced, write_dataset
from tests.analysis.reference import printed

BOTH = ("one", "two")


def _tasks() -> dict[str, Confusion]:
    """Right answers of the reference's 12 participants in two tasks with three materials; no wrong one names any."""
    counts = np.array(printed("mixed_logit")["counts"])[:, 3:].T.reshape(2, 12, 2, 3)
    found = {}
    for k, task in enumerate(BOTH):
        right, total = counts[:, :, k]
        answers = np.zeros((len(right), 3, 4), dtype=np.int64)
        answers[:, range(3), range(3)] = right
        answers[:, :, 3] = total - right
        found[task] = Confusion(("a", "b", "c"), tuple(map(str, range(len(right)))), answers)
    return found


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    people = {str(k): {"virtual": balanced(k)} for k in range(1, 4)}
    # Those with an even number began with task one.
    first = {str(k): BOTH[k % 2] for k in range(12)}
    return replace(read(write_dataset(tmp_path_factory.mktemp("study"), people)), first_tasks=first)


def _planned(
    study: Study, given: Mapping[str, Confusion] | None = None, /, asked: Asked | None = None, **plan: Any
) -> Planned:
    own = files.load(shipped("okamoto2012.toml"))
    test = PlannedTest(**{"question": "?", "tasks": BOTH, **plan})
    part = Part("p", (), BOTH, own.model_copy(update={"analysis": (test, test), "asked": asked}))
    (found,) = planned_tests(replace(study, parts=(part,)), given or _tasks(), np.random.default_rng(1))
    return found


# What follows is of R 4.2.2 with car 3.1.1: sign flips over expand.grid, orders over combn, p.adjust, t.test, Anova.


def test_sign_flips_against_chance_are_of_the_materials_that_the_plan_names(study: Study) -> None:
    found = _planned(study, test="sign flips against chance", tasks=("one",), chance=0.5, materials=("a", "b"))
    assert [(line.subject, line.p_holm, line.shown) for line in found.lines] == [("a", None, False), ("b", None, False)]
    assert [line.p for line in found.lines] == pytest.approx([0.33984375, 0.03125], abs=1e-12)
    above = _planned(study, test="sign flips against chance", tasks=("two",), chance=0.25, correction="materials")
    assert [line.shown for line in above.lines] == [True, False, True]


def test_tasks_and_materials_are_compared_by_sign_flips_in_their_family(study: Study) -> None:
    (tasks,) = _planned(study, test="sign flips between tasks", correction="tasks").lines
    assert (tasks.value, tasks.p, tasks.p_holm) == pytest.approx((-0.173148148148, 0.0107421875, 0.0107421875))
    assert tasks.shown
    found = _planned(study, test="sign flips between materials", correction="materials").lines
    assert [line.subject for line in found[:3]] == ["a less b", "a less c", "b less c"]
    assert [line.p for line in found[:3]] == pytest.approx([0.05029296875, 0.0537109375, 0.0009765625], abs=1e-12)
    assert [line.p_holm for line in found[:3]] == pytest.approx([0.1005859375, 0.1005859375, 0.0029296875], abs=1e-12)
    assert [line.shown for line in found[:3]] == [False, False, True]
    every = _planned(study, test="sign flips between materials", correction="materials and tasks").lines
    assert every[2].p_holm == pytest.approx(6 * 0.0009765625)


def test_repeated_measures_have_the_correction_of_huynh_and_feldt(study: Study) -> None:
    (one,) = _planned(study, test="repeated measures", tasks=("one",)).lines
    assert (one.df, one.n) == ((2, 22), 12)
    assert one.f == pytest.approx(10.0391488838, abs=1e-6)
    assert one.p == pytest.approx(0.000798012511872, abs=1e-9)
    found = _planned(study, test="repeated measures", alpha=0.001).lines
    assert [line.subject for line in found] == ["task", "material", "task x material"]
    assert [line.f for line in found] == pytest.approx([10.066708539426, 14.277409314906, 0.484915312038], abs=1e-6)
    assert [line.p for line in found] == pytest.approx([0.0088741208144, 0.000105989139403, 0.617231458167], abs=1e-9)
    assert [line.shown for line in found] == [False, True, False]


def test_equivalence_is_tested_at_the_level_of_the_plan(study: Study) -> None:
    (found,) = _planned(study, test="equivalence", margin=0.2, alpha=0.01).lines
    assert found.interval is not None
    assert (found.interval.low, found.interval.high) == pytest.approx((-0.3214806112150, -0.0248156850813), abs=1e-9)
    assert found.p == pytest.approx(0.316181686005, abs=1e-9)
    assert not found.shown
    assert found.interval.confidence == pytest.approx(0.98)
    pairs = _planned(study, test="equivalence", tasks=("one",), margin=0.2, materials=("a", "c")).lines
    assert [line.subject for line in pairs] == ["a and c"]


def test_the_order_of_tasks_is_that_of_who_began_with_which(study: Study) -> None:
    (found,) = _planned(study, test="order of tasks").lines
    assert found.interval is not None
    assert found.value == pytest.approx(0.0070987654321, abs=1e-9)
    assert (found.interval.low, found.interval.high) == pytest.approx((-0.1203332099944, 0.1345307408586), abs=1e-9)
    assert (found.p, found.least) == pytest.approx((0.909090909091, 2 / 924), abs=1e-9)
    nobody = _planned(replace(study, first_tasks=dict.fromkeys("0123456789", "one")), test="order of tasks")
    assert nobody.lines == ()
    assert "got 10 and 0" in nobody.statements["one and two"]


def _groups(study: Study, patients: tuple[int, ...]) -> Planned:
    """Return the differences of five patients and seven controls; the third choice is nobody's."""
    chosen = {str(k): "patient" if k in patients else "control" for k in range(12)}
    fact = {"id": "diagnosis", "question": "?", "answer": "choice", "reason": "-"}
    asked = Asked(people=(Fact.model_validate({**fact, "values": ("patient", "control", "sibling")}),))
    told = replace(study, facts={(who, "diagnosis"): group for who, group in chosen.items()})
    return _planned(told, asked=asked, test="difference of groups", groups="diagnosis", correction="tasks")


def _ways(patients: tuple[int, ...]) -> list[float]:
    """Return P of Welch's t in all ways to choose so many patients, by SciPy's `permutation_test`, of each task."""

    def welch(one: Floats, other: Floats, axis: int) -> Floats:
        return np.asarray(abs(ttest_ind(one, other, axis=axis, equal_var=False).statistic))

    found = []
    for matrix in _tasks().values():
        shares = (matrix.counts[:, range(3), range(3)] / matrix.trials).mean(axis=1)
        pair = shares[list(patients)], np.delete(shares, patients)
        found.append(float(permutation_test(pair, welch, n_resamples=np.inf, alternative="greater").pvalue))
    return found


def test_groups_are_those_of_a_fact_about_people(study: Study) -> None:
    """The five vary less than the seven, so that P counts all ways, for which SciPy's has R's numbers (combn)."""
    assert _ways((0, 2, 4, 6, 8)) == pytest.approx([0.529040404040404, 0.914141414141414], abs=1e-12)
    found = _groups(study, (1, 3, 5, 7, 9))
    assert [(line.tasks, line.subject) for line in found.lines] == [((task,), "patient less control") for task in BOTH]
    assert not any(line.loose for line in found.lines)
    assert [line.p for line in found.lines] == pytest.approx(_ways((1, 3, 5, 7, 9)), abs=1e-12)
    assert [line.p_holm for line in found.lines] == [1.0] * 2


def test_a_smaller_group_that_varies_more_has_p_of_its_own_df(study: Study) -> None:
    """Groups of 5 and 7; on 4 df the two-sided P of t is 1 - 1.5 s + 0.5 s^3 with s = t / sqrt(t^2 + 4)."""
    found = _groups(study, (0, 2, 4, 6, 8))
    assert [(line.tasks, line.subject) for line in found.lines] == [((task,), "patient less control") for task in BOTH]
    assert [line.value for line in found.lines] == pytest.approx([0.104021164021164, -0.00994708994708993], abs=1e-12)
    assert all(line.loose for line in found.lines)
    wanted = []
    for matrix in _tasks().values():
        shares = (matrix.counts[:, range(3), range(3)] / matrix.trials).mean(axis=1)
        one, other = shares[:10:2], np.delete(shares, range(0, 10, 2))
        t = abs(one.mean() - other.mean()) / (one.var(ddof=1) / 5 + other.var(ddof=1) / 7) ** 0.5
        s = t / (t * t + 4) ** 0.5
        wanted.append(1 - 1.5 * s + 0.5 * s**3)
    assert [line.p for line in found.lines] == pytest.approx(wanted, abs=1e-12)
    assert [line.p_holm for line in found.lines] == [1.0] * 2
    assert len(found.statements) == 4


def test_a_logit_is_that_of_the_planned_tasks(study: Study) -> None:
    (found,) = _planned(study, test="logit with participants", tasks=("one",)).lines
    (term,) = slopes_logit({"one": _tasks()["one"]}).terms
    assert (found.subject, found.f, found.p) == ("material", term.f, term.p)


def test_what_is_not_there_or_arbitrary_says_why(study: Study) -> None:
    lone = {"one": _tasks()["one"]}
    found = _planned(study, lone, test="sign flips between tasks")
    assert (found.lines, dict(found.statements)) == ((), {"two": "no trial"})
    again = _planned(replace(study, origin="RECONSTRUCTION"), test="repeated measures")
    assert (again.lines, dict(again.statements)) == ((), {"one and two": LINKED})


def test_every_test_that_the_design_offers_is_computed_here_or_published() -> None:
    assert set(DESIGN.tests) - set(TESTS) == {"t against chance", "one-way ANOVA", "two-way ANOVA", "ICC"}
