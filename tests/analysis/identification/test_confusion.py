"""Confusion matrices: against pandas, and what must hold for any answers."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.analysis.identification.confusion import Confusion, confusion
from palpate.experiment.records.events import NO_ANSWER

MATERIALS = ("glass", "sand", "snow")
rows = st.lists(
    st.tuples(st.sampled_from(["1", "2", "3"]), st.sampled_from(MATERIALS), st.sampled_from([*MATERIALS, NO_ANSWER])),
    min_size=1,
    max_size=80,
)


def _confusion(answers: list[tuple[str, str, str]]) -> Confusion:
    participants, presented, answered = zip(*answers, strict=True)
    return confusion(participants, presented, answered, MATERIALS)


@settings(deadline=None)
@given(rows)
def test_means_and_deviations_are_those_of_pandas(answers: list[tuple[str, str, str]]) -> None:
    matrix = _confusion(answers)
    frame = pd.DataFrame(answers, columns=["participant", "presented", "answered"])
    for i, presented in enumerate(MATERIALS):
        shown = frame[frame["presented"] == presented]
        for j, answered in enumerate((*MATERIALS, NO_ANSWER)):
            ratios = (shown["answered"] == answered).groupby(shown["participant"]).mean()
            assert matrix.n(i) == len(ratios)
            if len(ratios):
                assert matrix.mean(i, j) == pytest.approx(ratios.mean())
            else:
                assert matrix.mean(i, j) is None
            if len(ratios) > 1:
                assert matrix.sd(i, j) == pytest.approx(ratios.std(ddof=1), abs=1e-12)
            else:
                assert matrix.sd(i, j) is None


@settings(deadline=None)
@given(rows)
def test_every_row_adds_up_to_one(answers: list[tuple[str, str, str]]) -> None:
    sums = _confusion(answers).means().sum(axis=1)
    assert np.all(np.isnan(sums) | np.isclose(sums, 1))


@settings(deadline=None)
@given(rows, st.randoms())
def test_the_order_of_trials_does_not_matter(answers: list[tuple[str, str, str]], random: object) -> None:
    shuffled = list(answers)
    random.shuffle(shuffled)  # type: ignore[attr-defined]
    one, other = (_confusion(order) for order in (answers, shuffled))
    np.testing.assert_array_equal(one.means(), other.means())
    assert one.most_confused() == other.most_confused()


def test_a_trial_without_an_answer_stays_in_the_denominator() -> None:
    matrix = confusion(["1"] * 4, ["sand"] * 4, ["sand", "sand", NO_ANSWER, "snow"], MATERIALS)
    assert matrix.mean(1, 1) == 0.5
    assert matrix.unanswered == 1


def test_constant_ratios_have_exactly_no_deviation() -> None:
    people = [label for label in "abcdefghijklmno" for _ in range(10)]
    matrix = confusion(people, ["sand"] * 150, (["sand"] + ["snow"] * 9) * 15, MATERIALS)
    assert matrix.sd(1, 1) == 0.0


def test_the_most_confused_pair_counts_both_directions() -> None:
    answers = [("glass", "sand")] * 3 + [("glass", "glass")] + [("snow", "glass")] * 2 + [("glass", "snow")] * 2
    answers += [("sand", "sand")] * 4 + [("snow", "snow")] * 2
    shown, said = zip(*answers, strict=True)
    assert confusion(["1"] * len(answers), shown, said, MATERIALS).most_confused() == (("glass", "snow"),)


def test_without_any_confusion_no_pair_is_the_most_confused() -> None:
    assert confusion(["1"] * 3, MATERIALS, MATERIALS, MATERIALS).most_confused() == ()


def test_pairs_that_are_confused_as_often_are_all_returned() -> None:
    """Each material is taken once for each other one, by three participants with different trials."""
    shown, said = zip(*((a, b) for a in MATERIALS for b in MATERIALS), strict=True)
    found = confusion(["1"] * 9 + ["2"] * 18, shown * 3, said * 3, MATERIALS)
    assert found.most_confused() == tuple(combinations(MATERIALS, 2))


def test_an_unknown_material_is_refused() -> None:
    with pytest.raises(ValueError, match="ice"):
        confusion(["1"], ["ice"], ["glass"], MATERIALS)
