"""Power of comparisons: the scale of `statistics.scaling`, type I error where participants differ, models, limits."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.analysis import published
from palpate.analysis.power import planned_tests, report, simulate
from palpate.analysis.power.comparisons import Observers, PairModel, answers, draw, finite, planned_trials, scale
from palpate.analysis.power.simulate import find
from palpate.analysis.statistics.exact import Integers
from palpate.analysis.statistics.scaling import FIRST, SECOND, Comparisons, fit
from palpate.experiment.errors import PowerError
from palpate.experiment.protocol.files import load, shipped
from palpate.experiment.protocol.models import Protocol
from tests.analysis.datasets import compared, write_dataset
from tests.approved import Refuses

RANDOM = partial(np.random.default_rng, 4)


def wellman() -> Protocol:
    return load(shipped("wellman1995.toml"))


def model(values: tuple[float, ...], spread: float = 0.4, order: float = 0.3) -> PairModel:
    own = Observers("live", np.array(values), order, spread, 0.2)
    return PairModel("test", (own, replace(own, task="virtual")))


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
    wins = draw(model((-1.0, 0.0, 0.4, 0.6)).tasks[0], trials, 6, 5, RANDOM())
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
    wins = draw(model((-0.5, -0.4, 0.0, 0.4, 0.5)).tasks[0], trials, 7, 3, RANDOM())
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
    found = answers(planned, model((-1.0, -0.5, 0.0, 0.5, 1.0), spread=0.8).control(wellman()), 15, 1500, RANDOM())
    for question, answer in found.items():
        if question.subject != "every step, in order":
            assert answer.p is not None
            assert 0.025 < np.mean(answer.p < 0.05) < 0.075


def test_a_scale_without_limit_is_the_bias_reduced_one_of_a_study() -> None:
    """Three items, of which the last always wins, or the last but one too; other studies stay as they are."""
    trials = planned_trials(3, 4)
    wins = draw(model((-30.0, 0.0, 0.3)).tasks[0], trials, 5, 4, RANDOM())
    wins[0] = draw(model((-0.3, 0.0, 0.3)).tasks[0], trials, 5, 1, RANDOM())[0]
    found, plain = finite(wins, trials.astype(float)), scale(wins, trials.astype(float))
    assert np.isnan(plain.order).tolist() == [False, True, True, True]
    for study in range(4):
        own = fit(one_by_one(wins[study], trials), "bradley-terry")
        assert own.reduced == bool(study)
        assert found.values[study] == pytest.approx(own.values, abs=1e-8)
        assert found.covariance[study] == pytest.approx(own.covariance, abs=1e-8)


def test_an_order_that_is_always_told_is_found(approved: SnapshotAssertion) -> None:
    study = wellman()
    far = model((-40.0, -20.0, 0.0, 20.0, 40.0), spread=0.0, order=0.0)
    result = simulate.run(
        study, planned_tests.design(study, {}), far, participants=(7,), studies=20, seed=1, target=0.8,
        runner=partial(simulate.on_cores, jobs=1),
    )  # fmt: skip
    assert {row.tally.undefined for row in result.rows if row.kind == "model"} == {0}
    steps = {row.tally.significant for row in result.rows if row.kind == "model" and " to " in row.question.subject}
    assert steps == {20}
    shown = report.text(result)
    assert "SIMULATED" in shown
    assert "Model of comparisons" in shown
    assert [line for one in report.sections(result) for line in one.paragraphs] == approved


def test_each_task_has_the_scale_of_its_own_printed_table_and_a_spread_that_is_ours(
    approved: SnapshotAssertion,
) -> None:
    """A scale of greatest likelihood expects as many choices of a surface as Tables 2 and 3 of the paper print."""
    found = find("published", wellman())
    printed = published.load("wellman1995")
    assert printed is not None
    assert [one.task for one in found.tasks] == ["live", "virtual"] == [block.task for block in printed.choices]
    for one, block in zip(found.tasks, printed.choices, strict=True):
        surplus = np.zeros(5)
        for cell in block.cells:
            high, low = (int(name) - 1 for name in cell.pair)
            if high != low:
                beyond = float(cell.correct.value) - 1 / (1 + np.exp(one.values[low] - one.values[high]))
                surplus += beyond * (np.eye(5)[high] - np.eye(5)[low])
        assert surplus == pytest.approx(np.zeros(5), abs=1e-8)
        assert (one.values.sum(), one.order, one.spread) == (pytest.approx(0.0, abs=1e-9), 0.0, 0.5)
    assert "Table 2 and Table 3" in found.source
    assert list(found.notes) == approved


def test_a_study_is_drawn_from_the_scale_of_each_task() -> None:
    """Where observers guess in one task and never err in the other, no step is shown in the first."""
    study = wellman()
    guess, far = Observers("live", np.zeros(5), 0.0, 0.0, 0.0), Observers("virtual", np.arange(5.0), 0.0, 0.0, 0.0)
    seen = answers(planned_tests.design(study, {}), PairModel("test", (guess, far)), 15, 50, RANDOM())
    shown = {
        question.tasks: answer.p for question, answer in seen.items() if question.subject == "every step, in order"
    }
    live, virtual = shown["live",], shown["virtual",]
    assert live is not None
    assert virtual is not None
    assert [float(np.mean(p < 0.05)) for p in (live, virtual)] == [0.0, 1.0]


def test_a_file_states_a_model_for_all_tasks_or_for_each(tmp_path: Path, refuses: Refuses) -> None:
    file = tmp_path / "pilot.toml"
    names = [material.id for material in wellman().materials]
    head = 'format = 1\nsource = "a guess"\norder = 0.1\nspread = 0.5\n'
    of_all = [f'{{ material = "{name}", value = {k} }}' for k, name in enumerate(names)]
    file.write_text(f"{head}values = [{', '.join(of_all)}]\n", "utf-8")
    for one in find(str(file), wellman()).tasks:
        assert one.values == pytest.approx([-2, -1, 0, 1, 2])
        assert (one.order, one.spread, one.order_spread) == (0.1, 0.5, 0.0)
    of_each = [f'{{ task = "{task}", material = "{name}", value = {k * step} }}'
               for task, step in (("live", 1), ("virtual", 3)) for k, name in enumerate(names)]  # fmt: skip
    file.write_text(f"{head}values = [{', '.join(of_each)}]\n", "utf-8")
    assert [one.values[-1] for one in find(str(file), wellman()).tasks] == [2.0, 6.0]
    file.write_text(file.read_text("utf-8").replace('"virtual"', '"glove"'), "utf-8")
    with refuses(PowerError):
        find(str(file), wellman())
    file.write_text(f"{head}values = [{', '.join(of_each[:5])}]\n", "utf-8")
    with refuses(PowerError):
        find(str(file), wellman())
    file.write_text(f"{head}values = [{', '.join(of_all)}]\n".replace(names[0], "cheese"), "utf-8")
    with refuses(PowerError):
        find(str(file), wellman())
    with refuses(PowerError):
        find("nobody", wellman())


def test_two_numbers_give_how_often_the_next_material_is_chosen_and_how_unlike_observers_are() -> None:
    found = find("0.75,0.5", wellman())
    for one in found.tasks:
        assert np.diff(one.values) == pytest.approx([np.log(3)] * 4)
        assert (one.order, one.spread, one.order_spread) == (0.0, 0.5, 0.5)
    with pytest.raises(PowerError):
        find("1.2,0.5", wellman())


def test_a_dataset_gives_each_task_its_scale_and_its_participants_spread(tmp_path: Path, refuses: Refuses) -> None:
    study = wellman()
    names = [material.id for material in study.materials]
    rising = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
    own = [Observers("live", rising, 0.3, 0.9, 0.0), Observers("virtual", -rising, 0.0, 0.0, 0.0)]
    trials, random = planned_trials(5, 8), RANDOM()
    wins = {one.task: draw(one, trials, 40, 1, random)[0] for one in own}
    people = {
        str(p): {task: compared([
            (names[i], names[j], "first" if k < found[p, i, j] else "second")
            for i in range(5) for j in range(5) for k in range(trials[i, j])
        ]) for task, found in wins.items()}
        for p in range(40)
    }  # fmt: skip
    root = write_dataset(tmp_path / "pilot", people, materials=tuple(names), tasks=("live", "virtual"),
                         origin="REHEARSAL", answers=("first", "second"))  # fmt: skip
    found = find(str(root), study)
    live, virtual = found.tasks
    assert live.values == pytest.approx(rising, abs=0.45)
    assert virtual.values == pytest.approx(-rising, abs=0.2)
    assert live.order == pytest.approx(0.3, abs=0.15)
    assert live.spread == pytest.approx(0.8, abs=0.3)
    assert max(live.order_spread, virtual.spread, virtual.order_spread) < 0.3
    assert "REHEARSAL" in found.label
    one = {label: {"live": tasks["live"]} for label, tasks in people.items()}
    other = write_dataset(tmp_path / "half", one, materials=tuple(names), tasks=("live",), answers=("first", "second"))
    with refuses(PowerError):
        find(str(other), study)


def test_comparisons_without_a_planned_scale_cannot_be_planned(refuses: Refuses) -> None:
    study = wellman()
    tests = tuple(test for test in study.analysis if test.test == "Thurstone")
    with refuses(PowerError):
        find("published", study.model_copy(update={"analysis": tests}))
