"""Designs with looks: bounds in R, Bayes factor thresholds, how participants go together, and the type I error."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import spearmanr
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.documents.tables import text
from palpate.analysis.power import planned_tests
from palpate.analysis.power.choice_models import Answers, ChoiceModel
from palpate.analysis.power.sequential import EVIDENCE, Rule, bounds, draw, run, section, spent, thresholds
from palpate.analysis.power.simulate import find
from palpate.analysis.statistics.inference import log_bayes_factor
from palpate.experiment.errors import PowerError
from palpate.experiment.protocol.files import load, shipped
from tests.analysis.reference import printed

OKAMOTO = load(shipped("okamoto2012.toml"))
DESIGN = planned_tests.design(OKAMOTO, {})
KINDS: tuple[tuple[str, Rule], ...] = (("obrien_fleming", "obrien-fleming"), ("pocock", "pocock"))


def model(share: float, spread: float) -> ChoiceModel:
    shares = np.full((4, 5), (1 - share) / 3)
    shares[:, -1] = 0.0
    np.fill_diagonal(shares, share)
    return ChoiceModel("test", tuple(Answers(task, shares, np.full(4, spread)) for task in ("virtual", "real")))


@pytest.mark.parametrize(("name", "rule"), KINDS)
def test_bounds_are_those_of_r(name: str, rule: Rule) -> None:
    reference = printed("alpha_spending")
    for case in reference["in_r"]:
        assert bounds(rule, case["fractions"], 0.05) == pytest.approx(case[name], abs=1e-8)


@pytest.mark.parametrize("rule", [rule for _, rule in KINDS])
def test_all_of_alpha_is_spent_at_the_end_and_more_at_every_look(rule: Rule) -> None:
    used = [spent(rule, fraction, 0.05) for fraction in (0.2, 0.5, 0.8, 1.0)]
    assert used[-1] == pytest.approx(0.05)
    assert all(a < b for a, b in pairwise(used))


def test_thresholds_of_t_give_the_evidence() -> None:
    for people in (5, 12, 100):
        some, none = thresholds(people, EVIDENCE)
        assert log_bayes_factor(some, people) == pytest.approx(np.log(EVIDENCE))
        assert none == -1 or log_bayes_factor(none, people) == pytest.approx(-np.log(EVIDENCE))
    assert thresholds(5, EVIDENCE)[1] == -1  # so few participants cannot speak for none
    assert thresholds(100, EVIDENCE)[1] > 0


def test_participants_go_together_by_the_share_that_is_asked() -> None:
    """The ranks of two materials' shares correlate as 6 / pi asin(r / 2) of a normal r (Pearson 1907), less chance."""
    many = model(0.5, 0.6)
    long = planned_tests.design(OKAMOTO, {})
    tasks = tuple(task.model_copy(update={"repetitions": 4000}) for task in long.tasks)
    planned = planned_tests.Design(long.materials, tasks, long.participants, long.tests, {})
    for alike in (0.0, 0.5, 1.0):
        right = draw(planned, many, 4000, 1, alike, False, np.random.default_rng(1))
        for one, other in ((right[0][0, 0], right[0][1, 0]), (right[0][0, 0], right[1][2, 0])):
            found = spearmanr(one, other).statistic
            assert found == pytest.approx(6 / np.pi * np.arcsin(alike / 2), abs=0.05)


def test_each_material_keeps_its_own_mean_and_spread() -> None:
    right = draw(DESIGN, model(0.6, 0.3), 2000, 5, 0.7, False, np.random.default_rng(2))
    ratios = right[0] / 10
    assert ratios.mean() == pytest.approx(0.6, abs=0.02)
    # p (1 - p) (rho + (1 - rho) / m), as a beta-binomial has it
    assert ratios.var(axis=-1).mean() == pytest.approx(0.24 * (0.3 + 0.7 / 10), rel=0.05)


@pytest.mark.parametrize("rule", [rule for _, rule in KINDS])
def test_looks_do_not_raise_the_type_i_error_of_sign_flips(rule: Rule) -> None:
    """Of 1,000 studies at the participants' own spread; the limit is 5 % and four standard errors."""
    found = run(DESIGN, model(0.5, 0.2), study="s", rule=rule, looks=(10, 15, 20), alike=0.5, studies=1000, seed=1)
    flips = [one for one in found.outcomes if "sign flips" in one.subject]
    assert len(flips) == 8
    assert all(sum(one.control) < 0.05 + 4 * 0.0069 for one in flips)
    assert all(sum(one.found) > 0.9 for one in flips)
    assert all(10 <= one.mean < 18 for one in flips)


def test_a_bayes_factor_design_stops_for_none_too(approved: SnapshotAssertion) -> None:
    found = run(DESIGN, model(0.25, 0.0), study="s", rule="bayes", looks=(20, 60, 120), alike=0.0, studies=200, seed=1)
    assert all(sum(one.none) > 0.5 for one in found.outcomes)
    assert "SIMULATED" in text(section(found))
    assert [note for table in section(found).tables for note in table.notes] == approved
    # R's integrate() of Rouder et al. (2009), equation 1, with r = sqrt(2) / 2, at t = 0: 5.9955 of 42, 6.0610 of 43.
    (paired,) = [one for one in found.outcomes if "paired" in one.subject]
    assert paired.mean < 120


def test_everybody_right_defines_no_t_but_sign_flips() -> None:
    found = run(DESIGN, model(1.0, 0.0), study="s", rule="pocock", looks=(6, 12), alike=0.5, studies=50, seed=1)
    power = {one.subject: sum(one.found) for one in found.outcomes}
    assert power["copy paper, virtual"] == 0.0
    assert power["copy paper, virtual, sign flips (companion)"] == 1.0


def test_the_same_seed_gives_the_same_and_looks_are_checked() -> None:
    own = find("okamoto2012", OKAMOTO)
    one, other = (
        run(DESIGN, own, study="s", rule="pocock", looks=(5, 9), alike=0.3, studies=60, seed=3) for _ in range(2)
    )
    assert one == other
    for looks in ((5,), (9, 5), (2, 5), (5, 5), (5, 2000)):
        with pytest.raises(PowerError, match=r"--looks: got .*; allowed: two or more increasing numbers"):
            run(DESIGN, own, study="s", rule="pocock", looks=looks, alike=0.3, studies=60, seed=3)


def test_tasks_are_looked_at_over_the_materials_that_both_present() -> None:
    """Everybody is right in 0.9 of trials: were copy paper compared with a material of no trial, tasks would differ."""

    def asked(*real: str) -> dict[str, float]:
        only = {"virtual": ("copy paper", "aluminum foil"), "real": real}
        tasks = tuple(task.model_copy(update={"materials": only[task.id]}) for task in OKAMOTO.tasks)
        planned = planned_tests.design(OKAMOTO.model_copy(update={"tasks": tasks}), {})
        right = draw(planned, model(0.9, 0.1), 10, 20, 0.5, False, np.random.default_rng(1))
        assert [[bool(own.any()) for own in of] for of in right] == [
            [name in only[task.id] for name in planned.materials] for task in tasks
        ]
        found = run(
            planned, model(0.9, 0.1), study="s", rule="pocock", looks=(5, 10), alike=0.5, studies=200, seed=1,
            tick=lambda: None,
        )  # fmt: skip
        return {one.subject: sum(one.found) for one in found.outcomes}

    both = asked("aluminum foil", "typing paper")
    assert {name for name in both if "flips" not in name} == {
        "copy paper, virtual", "aluminum foil, virtual", "aluminum foil, real", "typing paper, real",
        "virtual - real, paired (companion)",
    }  # fmt: skip
    assert both["virtual - real, paired (companion)"] < 0.12
    assert both["typing paper, real"] > 0.99
    assert "virtual - real, paired (companion)" not in asked("typing paper")
