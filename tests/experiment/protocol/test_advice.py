"""What is legal and odd is told with its field; what is as it should be is not; and nothing is refused for it."""

from __future__ import annotations

from collections import Counter
from fractions import Fraction
from itertools import permutations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.protocol.files import ProtocolFile
from palpate.experiment.protocol.models import PlannedTest, Protocol
from palpate.experiment.protocol.page import advice, page
from palpate.experiment.study.schedule import allocate
from tests.experiment.protocol.small import changed, document, okamoto2012, protocol


def told(path: tuple[str | int, ...], new: object) -> list[tuple[str, str, str]]:
    study = ProtocolFile.model_validate(changed(document(), path, new))
    return [(one.field, one.got, one.allowed) for one in advice(study)]


@pytest.mark.parametrize(
    "study", [protocol(), ProtocolFile.model_validate(okamoto2012())], ids=["small", "okamoto2012"]
)
def test_of_a_protocol_that_is_as_it_should_be_nothing_is_told(study: Protocol) -> None:
    assert advice(study) == ()
    assert "palpate found no" in page(study, "a.toml")


def test_a_chance_other_than_that_of_a_guess(approved: SnapshotAssertion) -> None:
    ((path, got, allowed),) = told(("analysis", 0, "chance"), 0.25)
    assert (path, got) == ("analysis[0].chance", "0.25")
    assert allowed == approved


@pytest.mark.parametrize(("count", "rounded"), [(3, 0.333), (3, 0.33), (6, 0.17), (7, 0.143), (9, 0.11), (4, 0.25)])
def test_a_chance_that_was_rounded_is_none(count: int, rounded: float) -> None:
    felt = document()["materials"][0]
    names = [f"{letter}elt" for letter in "abcdefghi"[:count]]
    materials = tuple({**felt, "id": name, "key": name[0], "spoken": (name,)} for name in names)
    study = changed(document(), ("materials",), materials)
    assert advice(ProtocolFile.model_validate(changed(study, ("analysis", 0, "chance"), rounded))) == ()
    (one,) = advice(ProtocolFile.model_validate(changed(study, ("analysis", 0, "chance"), rounded + 0.05)))
    assert one.field == "analysis[0].chance"


def test_a_planned_anova_that_names_no_materials() -> None:
    study = ProtocolFile.model_validate(okamoto2012())
    assert not any("analysis" in one.field for one in advice(study))
    place = next(i for i, test in enumerate(study.analysis) if test.test == "one-way ANOVA")
    tests = [test.model_copy(update={"materials": None}) for test in study.analysis]
    told = advice(study.model_copy(update={"analysis": tuple(tests)}))
    assert [(one.field, one.got) for one in told] == [(f"analysis[{place}].materials", "none")]


def test_frequencies_that_no_recording_holds(approved: SnapshotAssertion) -> None:
    # Of 4000 samples a second the highest frequency is 2000 Hz (Nyquist).
    assert told(("footstep", "tactile", "high_hz"), 2000) == []
    ((path, got, allowed),) = told(("footstep", "tactile", "high_hz"), 2000.5)
    assert got == "2000.5"
    assert path.endswith("tactile.high_hz")
    assert allowed == approved


def test_participants_whom_no_whole_number_of_orders_covers(approved: SnapshotAssertion) -> None:
    ((path, got, allowed),) = told(("tasks", 1, "participants"), 3)
    assert path == "tasks[1].participants"
    assert f"{got}; {allowed}" == approved
    fixed = changed(document(), ("task_order", "kind"), "fixed")
    assert advice(ProtocolFile.model_validate(changed(fixed, ("tasks", 1, "participants"), 3))) == ()


@given(st.lists(st.integers(1, 26), min_size=1, max_size=3), st.integers(0, 99))
def test_it_is_told_where_allocation_cannot_give_each_order_to_as_many(counts: list[int], seed: int) -> None:
    one = document()["tasks"][0]
    tasks = tuple({**one, "id": f"t{place}", "participants": count} for place, count in enumerate(counts))
    study = changed(changed(document(), ("tasks",), tasks), ("study", "participants"), max(counts))
    analysis = tuple({**test, "tasks": ("t0",)} for test in document()["analysis"])
    study = changed(changed(study, ("analysis",), analysis), ("duration",), None)
    made = ProtocolFile.model_validate(study)
    orders = Counter(allocation.tasks for allocation in allocate(made, seed))
    uneven = {frozenset(order) for order in orders if len({orders[other] for other in permutations(order)}) > 1}
    assert len(advice(made)) == len(uneven)


def test_a_visit_that_leaves_no_time_for_its_trials(approved: SnapshotAssertion) -> None:
    # 6 and 4 trials of 5 s, 5 and 6 s of familiarisation, and 61 s between the tasks: 122 s.
    short = changed(document(), ("duration", "shortest_min"), 1)
    assert advice(ProtocolFile.model_validate(changed(short, ("duration", "longest_min"), 2.04))) == ()
    (one,) = advice(ProtocolFile.model_validate(changed(short, ("duration", "longest_min"), 2.03)))
    assert (one.field, one.got) == ("duration.longest_min", "2.03")
    assert one.allowed == approved


def test_it_stands_on_the_page(approved: SnapshotAssertion) -> None:
    study = ProtocolFile.model_validate(changed(document(), ("analysis", 0, "chance"), 0.25))
    _, shown = page(study, "a.toml").split("13. Worth a second look\n")
    assert shown == approved


def test_a_study_without_consent_is_told() -> None:
    allowed = "usually true; otherwise, a session can start without consent on record"
    assert told(("consent", "required"), False) == [("consent.required", "false", allowed)]


@pytest.mark.parametrize(
    ("stated", "count", "exact"),
    [
        (1 / 3, 3, Fraction(1, 3)),
        (0.33333333, 3, Fraction(1, 3)),
        (1 / 7, 7, Fraction(1, 7)),
        (0.25, 4, Fraction(1, 4)),
        (0.333, 3, Fraction(333, 1000)),
        (0.5, 4, Fraction(1, 2)),
    ],
)
def test_a_chance_of_which_not_all_digits_are_written_is_that_of_a_guess(
    stated: float, count: int, exact: Fraction
) -> None:
    planned = PlannedTest(test="t against chance", tasks=("virtual",), question="Better than chance?", chance=stated)
    assert planned.exact_chance(count) == exact


@pytest.mark.parametrize(
    ("people", "test", "least"),
    [
        (5, {}, 6), (6, {}, None), (6, {"correction": "materials"}, 7), (7, {"correction": "materials"}, None),
        (5, {"alpha": 0.1}, None), (8, {"alpha": 0.01}, None), (7, {"alpha": 0.01}, 8),
    ],
)  # fmt: skip
def test_sign_flips_of_too_few_to_show_anything(people: int, test: dict[str, object], least: int | None) -> None:
    """Two-sided, the least P of n participants is 2 / 2^n; Holm multiplies it by the number of tests, here two."""
    study = document()
    assert len(study["materials"]) == 2
    study["tasks"] = tuple({**task, "participants": people} for task in study["tasks"])
    planned = {"question": "?", "test": "sign flips against chance", "tasks": ("one",), "chance": 0.5, **test}
    made = {**study, "format": 6, "study": {**study["study"], "participants": people}, "analysis": (planned,)}
    found = [one for one in advice(ProtocolFile.model_validate(made)) if one.field == "analysis[0].test"]
    assert [f"{least} or more participants" in one.allowed for one in found] == [True] * (least is not None)
