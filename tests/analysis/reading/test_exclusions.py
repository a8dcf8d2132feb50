"""Exclusions: every one is listed with its reason, and nothing else is left out."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import pandas as pd
import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.reading.dataset import read
from palpate.analysis.reading.study import ALL_TASKS, Exclusion, Unasked, exclude, nothing_left
from palpate.analysis.report.plan import exclusions_section
from palpate.experiment.protocol.models import ExclusionRule
from tests.analysis.datasets import balanced, trial, write_dataset


def attempts_of_two() -> pd.DataFrame:
    return pd.DataFrame(
        [
            {
                "participant": participant,
                "task": task,
                "trial": number,
                "attempt": 1,
                "counted": True,
                "presented": "sand",
                "answered": "(none)" if participant == "2" and number > 2 and task == "real" else "sand",
                "foot_speed_mm_s": 100.0 * number,
                "frames_lost": float("nan") if task == "real" else float(number),
                "delivered": {1: 1.0, 2: 0.0}.get(number, float("nan")),
                "redo_reason": "n/a",
                "included": True,
            }
            for participant, task, number in product("12", ("virtual", "real"), range(1, 5))
        ]
    )


def rule(when: str, limit: float | None, action: str = "exclude-trial") -> ExclusionRule:
    return ExclusionRule.model_validate(
        {"id": when, "when": when, "limit": limit, "action": action, "reason": f"the reason of {when}"}
    )


NOBODY = {"1": False, "2": False}


def test_without_rules_nothing_is_left_out() -> None:
    attempts = attempts_of_two()
    assert exclude(attempts, NOBODY, ()) == ((), ())
    assert attempts["included"].all()


@pytest.mark.parametrize(
    ("when", "limit", "trials"),
    [("frames-lost", 3, {4}), ("speed-below", 150, {1}), ("speed-above", 300, {4}), ("frames-lost", 4, set())],
)
def test_a_rule_on_trials_leaves_out_what_lies_beyond_its_limit(when: str, limit: float, trials: set[int]) -> None:
    attempts = attempts_of_two()
    found, _ = exclude(attempts, NOBODY, [rule(when, limit)])
    assert {exclusion.trial for exclusion in found} == trials
    assert set(attempts[~attempts["included"]]["trial"]) == trials
    assert len(found) == (~attempts["included"]).sum()
    assert all(
        f"the reason of {when}" in exclusion.reason and f"limit {limit}" in exclusion.reason for exclusion in found
    )


def test_a_missing_value_is_beyond_no_limit_and_is_counted() -> None:
    attempts = attempts_of_two()
    _, unasked = exclude(attempts, NOBODY, [rule("frames-lost", 0)])
    assert set(attempts[attempts["included"]]["task"]) == {"real"}
    assert unasked == tuple(Unasked(who, "real", "frames-lost", "frames lost", 4, 4) for who in "12")


def test_a_rule_is_asked_of_what_is_left() -> None:
    """Of trials 3 and 4 of everyone it is not known whether they were delivered; one rule before takes the fourth."""
    rules = [rule("speed-above", 300), rule("undelivered", None), rule("undelivered", None, "repeat-trial")]
    _, unasked = exclude(attempts_of_two(), {"1": True, "2": False}, rules)
    assert [(one.participant, one.task, one.trials, one.of) for one in unasked] == [
        ("2", "virtual", 1, 3),
        ("2", "real", 1, 3),
    ]


def test_nobody_asks_whether_a_real_object_was_delivered() -> None:
    _, unasked = exclude(attempts_of_two(), NOBODY, [rule("undelivered", None)], with_objects=["real"])
    assert [(one.participant, one.task) for one in unasked] == [("1", "virtual"), ("2", "virtual")]


def test_a_dataset_asks_by_the_tasks_of_its_own_protocol(tmp_path: Path, repository_root: Path) -> None:
    root = write_dataset(tmp_path / "data", {"1": {"virtual": balanced(1), "real": balanced(2)}})
    written = (repository_root / "protocols" / "okamoto2012.toml").read_text("utf-8")
    before = 'when = "undelivered"\naction = "repeat-trial"'
    assert written.count(before) == 1
    (root / "sourcedata").mkdir()
    (root / "sourcedata" / "protocol.toml").write_text(
        written.replace(before, before.replace("repeat", "exclude")), "utf-8"
    )
    assert {(one.task, one.rule) for one in read(root).unasked} == {("virtual", "undelivered")}


def test_the_report_counts_trials_of_which_a_rule_could_not_be_asked(
    tmp_path: Path, approved: SnapshotAssertion
) -> None:
    rows = balanced(1)
    rows[0]["foot_speed"], rows[1]["foot_speed"] = 900.0, 150.0
    study = read(write_dataset(tmp_path, {"1": {"real": rows}}))
    exclusions, unasked = exclude(study.attempts, {"1": False}, [rule("speed-above", 300)])
    said = exclusions_section(replace(study, exclusions=exclusions, unasked=unasked)).paragraphs
    assert said == approved
    assert exclusions_section(replace(study, exclusions=(), unasked=unasked)).paragraphs[1] == said[1]


def test_undelivered_trials_are_left_out_where_the_protocol_says_so() -> None:
    attempts = attempts_of_two()
    found, _ = exclude(attempts, NOBODY, [rule("undelivered", None)])
    assert {(exclusion.trial, exclusion.reason) for exclusion in found} == {(2, "the reason of undelivered")}
    assert set(attempts[~attempts["included"]]["trial"]) == {2}
    assert exclude(attempts_of_two(), NOBODY, [rule("undelivered", None, "repeat-trial")]) == ((), ())


def test_repeated_trials_were_dealt_with_in_the_session() -> None:
    attempts = attempts_of_two()
    assert exclude(attempts, NOBODY, [rule("speed-above", 1, "repeat-trial")]) == ((), ())


def test_few_answers_leave_out_the_participant_everywhere() -> None:
    attempts = attempts_of_two()
    found, _ = exclude(attempts, NOBODY, [rule("answers-below", 3, "exclude-participant")])
    reason = "the reason of answers-below (2 answered trials in real, limit 3)"
    assert found == (Exclusion("2", ALL_TASKS, None, None, "answers-below", reason),)
    assert set(attempts[attempts["included"]]["participant"]) == {"1"}


def test_answers_are_counted_after_trials_were_left_out() -> None:
    rules = [rule("answers-below", 3, "exclude-participant"), rule("speed-above", 200)]
    found, _ = exclude(attempts_of_two(), NOBODY, rules)
    assert [(e.participant, e.trial) for e in found if e.rule == "answers-below"] == [("1", None), ("2", None)]


def test_a_withdrawal_leaves_out_everything_even_without_a_rule() -> None:
    attempts = attempts_of_two()
    left_out = Exclusion("1", ALL_TASKS, None, None, "withdrawn", "withdrew")
    assert exclude(attempts, {"1": True, "2": False}, ()) == ((left_out,), ())
    assert set(attempts[attempts["included"]]["participant"]) == {"2"}


def test_a_withdrawal_carries_the_reason_of_the_protocol() -> None:
    (found,), _ = exclude(attempts_of_two(), {"1": True, "2": False}, [rule("withdrawn", None, "exclude-participant")])
    assert found.reason == "the reason of withdrawn"


def test_attempts_done_again_and_absent_participants_are_listed(tmp_path: Path) -> None:
    rows = [trial(1, "sand", "n/a", counted=False, redo_reason="foot slipped"), trial(1, "sand", "sand", attempt=2)]
    sessions = {"1": {"real": rows}, "2": {"real": balanced(1)}, "3": {}, "4": {"real": balanced(2)}}
    study = read(write_dataset(tmp_path, sessions, withdrawn=["4"]))
    assert study.exclusions == (
        Exclusion("1", "real", 1, 1, "done again", "attempt 1 was repeated: foot slipped"),
        Exclusion("3", ALL_TASKS, None, None, "no data", "no events in the dataset"),
        Exclusion("4", ALL_TASKS, None, None, "withdrawn", "withdrew"),
    )
    assert len(study.trials("real")) == 13


def test_when_nothing_is_left_each_rule_stands_once(approved: SnapshotAssertion) -> None:
    attempts = attempts_of_two()
    attempts["answered"] = "(none)"
    attempts.loc[attempts["trial"] == 1, "answered"] = attempts["participant"].map({"1": "sand", "2": "(none)"})
    found, _ = exclude(attempts, NOBODY, [rule("answers-below", 3, "exclude-participant")])
    assert not attempts["included"].any()
    again = Exclusion("1", "real", 2, 1, "done again", "attempt 1 was repeated: slipped")
    gone = Exclusion("3", ALL_TASKS, None, None, "withdrawn", "withdrew")
    # What nobody can act on stands last.
    assert str(nothing_left("lab", (again, *found, gone))) == approved


def test_the_rules_come_from_the_protocol_in_the_dataset(tmp_path: Path, repository_root: Path) -> None:
    okamoto = ("copy paper", "aluminum foil", "polypropylene", "typing paper")
    root = write_dataset(
        tmp_path, {"1": {"real": balanced(1, 10, okamoto)}, "2": {"real": balanced(2, 2, okamoto)}}, materials=okamoto
    )
    copy = root / "sourcedata" / "protocol.toml"
    copy.parent.mkdir()
    copy.write_bytes((repository_root / "protocols" / "okamoto2012.toml").read_bytes())
    study = read(root)
    (part,) = study.parts
    assert part.protocol is not None
    limits = [rule.limit for rule in part.protocol.exclusion if rule.when == "answers-below"]
    assert [e.participant for e in study.exclusions] == (["2"] if limits and (limits[0] or 0) > 8 else [])
