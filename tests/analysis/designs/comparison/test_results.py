"""Numbers of comparisons: by hand, in closed form, and by the laws that made the answers."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import pearsonr
from syrupy.assertion import SnapshotAssertion

from palpate.analysis import published
from palpate.analysis.designs.comparison.results import Compared, compute, scaled
from palpate.analysis.reading.dataset import read
from palpate.analysis.statistics.scaling import FIRST, SECOND, Comparisons
from tests.analysis.datasets import compared, write_dataset

MATERIALS = ("felt", "cork", "tin")
"""From the softest to the hardest."""

REFERENCE = Path(__file__).parents[3] / "reference"


def results(
    tmp_path: Path,
    sessions: dict[str, list[tuple[str, str, str]]],
    answers: tuple[str, ...] = ("first", "second"),
    materials: tuple[str, ...] = MATERIALS,
    study: str = "lab",
) -> Compared:
    root = write_dataset(
        tmp_path / "study",
        {who: {"live": compared(pairs)} for who, pairs in sessions.items()},
        study=study,
        materials=materials,
        tasks=("live",),
        answers=answers,
    )
    return compute(read(root), published.load(study))


def test_right_choices_are_counted_by_pair_whichever_was_presented_first(tmp_path: Path) -> None:
    said = [
        ("felt", "tin", "second"),
        ("tin", "felt", "first"),
        ("tin", "felt", "second"),
        ("felt", "cork", "first"),
        ("cork", "cork", "first"),
        ("cork", "cork", "second"),
        ("cork", "cork", "first"),
        ("felt", "tin", "(none)"),
    ]
    (task,) = results(tmp_path, {"1": said}).tasks
    assert (task.trials, task.unanswered) == (8, 1)
    found = {(pair.low, pair.high): (pair.right.count, pair.right.trials) for pair in task.pairs}
    assert found == {(0, 0): (0, 0), (0, 1): (0, 1), (0, 2): (2, 3), (1, 1): (2, 3), (1, 2): (0, 0), (2, 2): (0, 0)}
    assert (task.first_of_same.count, task.first_of_same.trials) == (2, 3)
    assert task.pair(2, 0) == task.pair(0, 2)
    assert (task.pair(1, 2).right.value, task.pair(1, 2).right.interval) == (None, None)


def test_the_interval_of_a_share_is_exact(tmp_path: Path) -> None:
    """Of n right choices of n, Clopper and Pearson's lower limit is 0.025^(1/n)."""
    (task,) = results(tmp_path, {"1": [("felt", "tin", "second")] * 5}).tasks
    interval = task.pair(0, 2).right.interval
    assert interval is not None
    assert interval.low == pytest.approx(0.025 ** (1 / 5))
    assert interval.high == 1.0


def test_a_tie_is_a_trial_and_right_for_nobody(tmp_path: Path) -> None:
    said = [("felt", "tin", "second"), ("felt", "tin", "tie"), ("tin", "felt", "second"), ("cork", "cork", "tie")]
    (task,) = results(tmp_path, {"1": said}, ("first", "second", "tie")).tasks
    assert (task.pair(0, 2).right.count, task.pair(0, 2).right.trials, task.pair(0, 2).ties) == (1, 3, 1)
    assert [one.law for one in task.scales] == ["davidson"]


def test_each_participant_has_their_own_shares(tmp_path: Path) -> None:
    (task,) = results(
        tmp_path,
        {"1": [("felt", "tin", "second"), ("cork", "cork", "first")], "2": [("felt", "tin", "first")] * 2},
    ).tasks
    shares = [(one.participant, one.right.value, one.first_of_same.value) for one in task.people]
    assert shares == [("1", 1.0, 1.0), ("2", 0.0, None)]


def test_where_one_was_always_chosen_the_scale_is_bias_reduced(tmp_path: Path) -> None:
    both = [("felt", "tin", "second"), ("tin", "felt", "first"), ("tin", "cork", "first"), ("cork", "tin", "second")]
    (task,) = results(tmp_path, {"1": both * 2, "2": both * 2}).tasks
    for one in task.scales:
        assert one.scale is not None
        assert (one.scale.reduced, one.p) == (True, None)
        assert all(step.low is not None and step.low < step.value for step in one.steps)


def test_materials_that_were_never_compared_are_named(tmp_path: Path) -> None:
    (task,) = results(tmp_path, {"1": [("felt", "tin", "second"), ("tin", "felt", "second")]}).tasks
    assert [one.scale for one in task.scales] == [None, None]
    assert [one.part for one in task.scales] == [(0, 2), (0, 2)]


def test_a_task_without_an_answer_has_no_scale(tmp_path: Path, approved: SnapshotAssertion) -> None:
    (task,) = results(tmp_path, {"1": [("felt", "tin", "(none)")]}).tasks
    assert task.scales[0].statement == approved


def drawn(seed: int, people: int, repetitions: int, values: Iterable[float], order: float) -> Comparisons:
    """Answers by the logistic law, all independent and all participants alike."""
    at, rng = np.array(list(values)), np.random.default_rng(seed)
    pairs = [(i, j) for i in range(at.size) for j in range(at.size)] * repetitions * people
    first, second = np.array(pairs, dtype=np.int64).T
    share = 1 / (1 + np.exp(-(at[first] - at[second] + order)))
    chosen = np.where(rng.random(first.size) < share, FIRST, SECOND)
    return Comparisons(first, second, chosen, np.arange(first.size) % people, at.size)


def test_a_scale_of_two_is_the_logarithm_of_their_odds() -> None:
    """30 of 40 for the second of two, in both orders alike: ln 3 apart, and no order."""
    first = np.array([0] * 40 + [1] * 40)
    chosen = np.array([FIRST] * 10 + [SECOND] * 30 + [FIRST] * 30 + [SECOND] * 10)
    one = scaled(Comparisons(first, 1 - first, chosen, np.arange(80) % 4, 2), "bradley-terry")
    assert one.order is not None
    assert one.steps[0].value == pytest.approx(math.log(3), abs=1e-9)
    assert one.order.value == pytest.approx(0, abs=1e-9)
    # The deviance is nothing, for both ordered pairs are fitted exactly, with two terms.
    assert one.scale is not None
    assert one.scale.deviance == pytest.approx(0, abs=1e-9)
    assert (one.scale.df, one.p) == (0, None)


def test_an_interval_is_students_with_participants_as_units() -> None:
    one = scaled(drawn(1, 7, 4, (-1, 0, 1), 0.3), "bradley-terry")
    step = one.steps[0]
    assert step.se is not None
    # t of 6 degrees of freedom at 97.5 %, as tables print it: 2.447.
    assert step.low == pytest.approx(step.value - 2.447 * step.se, abs=1e-3)
    assert step.high == pytest.approx(step.value + 2.447 * step.se, abs=1e-3)


def test_of_a_single_participant_no_interval_is_given() -> None:
    one = scaled(drawn(2, 1, 20, (-1, 0, 1), 0.0), "thurstone")
    assert all(value.se is value.low is value.high is None for value in (*one.values, *one.steps))


def test_the_goodness_of_fit_rejects_as_often_as_it_says_where_its_assumptions_hold() -> None:
    """SIMULATED: 300 studies of 7 alike participants, P below 0.05 in 5 % with a standard error of 1.3 %."""
    low = [scaled(drawn(seed, 7, 8, (-0.8, 0.1, 0.7), 0.2), "bradley-terry").p for seed in range(300)]
    rejected = np.mean([p is not None and p < 0.05 for p in low])
    assert 0.02 < rejected < 0.09


PAPER = ("polystyrene", "silicone", "basswood", "plastic", "aluminum")


def test_the_papers_percentages_stand_beside_by_their_places(tmp_path: Path) -> None:
    said = [("polystyrene", "aluminum", "second")] * 3 + [("plastic", "aluminum", "first")] * 3
    said += [("aluminum", "plastic", "first"), ("silicone", "silicone", "first"), ("silicone", "basswood", "second")]
    (task,) = results(tmp_path, {"1": said}, materials=PAPER, study="wellman1995").tasks
    assert task.in_print is not None
    assert task.in_print.where == "Table 2"
    found = {(cell.low, cell.high): (cell.printed, cell.percent, cell.here) for cell in task.in_print.cells}
    with (REFERENCE / "wellman1995_table2_live.csv").open() as file:
        printed = {
            (int(row["material_b"]) - 1, int(row["material_a"]) - 1): float(row["percent_correct"])
            for row in csv.DictReader(file)
        }
    assert {pair: percent for pair, (_, percent, _) in found.items()} == pytest.approx(printed)
    assert found[3, 4][0::2] == ("33%", 25.0)
    assert found[0, 4][2] == 100.0
    assert found[0, 1][2] is None
    known = [(percent, here) for _, percent, here in found.values() if here is not None]
    assert task.in_print.r == pytest.approx(pearsonr(*zip(*known, strict=True)).statistic)


def test_other_materials_have_no_print_beside_them(tmp_path: Path) -> None:
    (task,) = results(tmp_path, {"1": [("felt", "tin", "second")]}, study="wellman1995").tasks
    assert task.in_print is None
