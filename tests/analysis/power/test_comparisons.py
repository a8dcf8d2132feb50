"""Power of comparisons: the scale of `statistics.scaling`, type I error where participants differ, models, limits."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest

from analysis.power import planned_tests, report, simulate
from analysis.power.comparisons import PairModel, alike, answers, draw, find, planned_trials, scale
from analysis.statistics.exact import Integers
from analysis.statistics.scaling import FIRST, SECOND, Comparisons, fit
from experiment.errors import PowerError
from experiment.protocol.files import load, shipped
from experiment.protocol.models import Protocol
from tests.analysis.datasets import compared, write_dataset

RANDOM = partial(np.random.default_rng, 4)


def wellman() -> Protocol:
    return load(shipped("wellman1995.toml"))


def model(values: tuple[float, ...], spread: float = 0.4, order: float = 0.3) -> PairModel:
    return PairModel("test", np.array(values), order, spread, 0.2)


def one_by_one(wins: Integers, trials: Integers) -> Comparisons:
    rows = [
        (i, j, FIRST if k < wins[p, i, j] else SECOND, p)
        for p in range(len(wins))
        for i in range(len(trials))
        for j in range(len(trials))
        for k in range(trials[i, j])
    ]
    first, second, chosen, person = np.array(rows, dtype=np.int64).T
    return Comparisons(first, second, chosen, person, len(trials))


def test_many_scales_are_those_of_one_study_each() -> None:
    """`scaling.fit` is statsmodels' GLM, which stands against R's BradleyTerry2."""
    trials = planned_trials(4, 4)
    wins = draw(model((-1.0, 0.0, 0.4, 0.6)), trials, 6, 5, RANDOM())
    found = scale(wins, trials.astype(float))
    for study in range(5):
        own = fit(one_by_one(wins[study], trials), "bradley-terry")
        assert found.values[study] == pytest.approx(own.values, abs=1e-8)
        assert found.order[study] == pytest.approx(own.order, abs=1e-8)
        assert found.covariance[study] == pytest.approx(own.covariance, abs=1e-8)


def test_a_step_is_tested_as_its_interval_is_made() -> None:
    from scipy.stats import t

    planned = planned_tests.design(wellman(), {})
    seen = answers(planned, model((-0.5, -0.4, 0.0, 0.4, 0.5)), 7, 3, RANDOM())
    trials = planned_trials(5, 8)
    wins = draw(model((-0.5, -0.4, 0.0, 0.4, 0.5)), trials, 7, 3, RANDOM())
    subjects = [question.subject for question in seen]
    assert subjects[-2:] == ["every step, in order", "being first"]
    for study in range(3):
        own = fit(one_by_one(wins[study], trials), "bradley-terry")
        for above in range(1, 5):
            value, error = own.difference(above, above - 1)
            p = list(seen.values())[above - 1].p
            assert p is not None
            assert p[study] == pytest.approx(2 * t.sf(abs(value / error), 6), abs=1e-8)


def test_participants_who_differ_do_not_raise_the_type_i_error() -> None:
    """Of 1,500 studies in which nothing differs on average; binomial limits at 0.001 are 3.3 and 7.0 %."""
    planned = planned_tests.design(wellman(), {})
    found = answers(planned, alike(model((-1.0, -0.5, 0.0, 0.5, 1.0), spread=0.8)), 15, 1500, RANDOM())
    for question, answer in found.items():
        if question.subject != "every step, in order":
            assert answer.p is not None
            assert 0.025 < np.mean(answer.p < 0.05) < 0.075


def test_an_order_that_is_always_told_has_no_scale_and_is_counted() -> None:
    study = wellman()
    far = model((-40.0, -20.0, 0.0, 20.0, 40.0), spread=0.0, order=0.0)
    result = simulate.run(
        study, planned_tests.design(study, {}), far, participants=(7,), studies=20, seed=1, target=0.8,
        runner=partial(simulate.on_cores, jobs=1),
    )  # fmt: skip
    assert {row.tally.undefined for row in result.rows if row.kind == "model"} == {20}
    shown = report.text(result)
    assert "no finite scale" in shown
    assert "SIMULATED" in shown
    assert "Model of comparisons" in shown
    assert "The planned Thurstone of live and virtual is not simulated" in " ".join(shown.split())


def test_printed_percentages_give_a_model_whose_spread_is_ours() -> None:
    found = find("published", wellman())
    assert found.values.sum() == pytest.approx(0.0, abs=1e-9)
    assert found.values[4] > found.values[2] > found.values[0]
    assert "the spread is ours, 0.5 logits" in found.notes[0]


def test_a_file_states_a_model(tmp_path: Path) -> None:
    file = tmp_path / "pilot.toml"
    names = [material.id for material in wellman().materials]
    values = ", ".join(f'{{ material = "{name}", value = {k} }}' for k, name in enumerate(names))
    file.write_text(f'format = 1\nsource = "a guess"\norder = 0.1\nspread = 0.5\nvalues = [{values}]\n', "utf-8")
    found = find(str(file), wellman())
    assert found.values == pytest.approx([-2, -1, 0, 1, 2])
    assert (found.order, found.spread, found.order_spread) == (0.1, 0.5, 0.0)
    file.write_text(file.read_text("utf-8").replace(names[0], "cheese"), "utf-8")
    with pytest.raises(PowerError, match=r"got values of cheese, .*; allowed: each material"):
        find(str(file), wellman())
    with pytest.raises(PowerError, match="got no model of that name"):
        find("nobody", wellman())


def test_a_dataset_gives_its_scale_and_its_participants_spread(tmp_path: Path) -> None:
    study = wellman()
    names = [material.id for material in study.materials]
    own = PairModel("test", np.array([-1.0, -0.5, 0.0, 0.5, 1.0]), 0.3, 0.9, 0.0)
    trials = planned_trials(5, 8)
    wins = draw(own, trials, 40, 1, RANDOM())[0]
    people = {
        str(p): {"live": compared([
            (names[i], names[j], "first" if k < wins[p, i, j] else "second")
            for i in range(5) for j in range(5) for k in range(trials[i, j])
        ])}
        for p in range(40)
    }  # fmt: skip
    root = write_dataset(tmp_path / "pilot", people, materials=tuple(names), tasks=("live",), origin="REHEARSAL",
                         answers=("first", "second"))  # fmt: skip
    found = find(str(root), study)
    assert found.values == pytest.approx(own.values, abs=0.45)
    assert found.order == pytest.approx(0.3, abs=0.15)
    assert found.spread == pytest.approx(0.8, abs=0.3)
    assert found.order_spread < 0.3
    assert "REHEARSAL" in found.label


def test_comparisons_without_a_planned_scale_cannot_be_planned() -> None:
    study = wellman()
    tests = tuple(test for test in study.analysis if test.test == "Thurstone")
    with pytest.raises(PowerError, match="got no planned Bradley-Terry"):
        find("published", study.model_copy(update={"analysis": tests}))
