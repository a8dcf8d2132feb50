"""The rules of each version of an amended protocol are applied to its own sessions, and to every session once."""

from __future__ import annotations

import shutil
from pathlib import Path

import pandas as pd
import pytest

from palpate.analysis.reading.study import ALL_TASKS, Version
from palpate.analysis.reading.versions import apply_rules, read_versions
from palpate.experiment.errors import DatasetError
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.models import ExclusionRule
from tests.analysis.reading.test_exclusions import NOBODY, attempts_of_two, rule

TASKS = ("virtual", "real")


def version(name: str, who: str, *rules: ExclusionRule) -> Version:
    """A version with these rules, under which a participant did both tasks."""
    protocol = files.load(shipped("okamoto2012.toml")).model_copy(update={"exclusion": rules})
    return Version(name, protocol, frozenset((who, task) for task in TASKS))


def left_out(attempts: pd.DataFrame) -> set[tuple[str, int]]:
    return {(str(row["participant"]), int(row["trial"])) for _, row in attempts[~attempts["included"]].iterrows()}


def test_each_session_is_judged_by_the_rules_of_its_own_version() -> None:
    slow, fast = rule("speed-below", 150), rule("speed-above", 250)
    versions = version("protocol.toml", "1", slow), version("protocol-2.toml", "2", fast)
    pooled, exclusions, unasked = apply_rules(attempts_of_two(), NOBODY, versions[-1].protocol, versions)
    assert left_out(pooled) == {("1", 1), ("2", 3), ("2", 4)}
    assert {(one.participant, one.trial, one.rule) for one in exclusions} == {
        ("1", 1, "speed-below"),
        ("2", 3, "speed-above"),
        ("2", 4, "speed-above"),
    }
    assert (list(pooled.index), unasked) == (list(range(16)), ())


def test_who_is_left_out_whole_under_one_version_is_left_out_under_every_one() -> None:
    first = (
        version("protocol.toml", "1"),
        version("protocol-2.toml", "2", rule("answers-below", 3, "exclude-participant")),
    )
    old = Version("protocol.toml", first[0].protocol, first[0].sessions | {("2", "virtual")})
    new = Version("protocol-2.toml", first[1].protocol, frozenset({("2", "real")}))
    pooled, exclusions, _ = apply_rules(attempts_of_two(), NOBODY, new.protocol, (old, new))
    assert left_out(pooled) == {("2", trial) for trial in range(1, 5)}
    assert [(one.participant, one.task, one.rule) for one in exclusions] == [("2", ALL_TASKS, "answers-below")]


def test_a_session_in_no_version_is_named() -> None:
    versions = (version("protocol.toml", "1"), Version("protocol-2.toml", version("", "2").protocol, frozenset()))
    with pytest.raises(DatasetError) as error:
        apply_rules(attempts_of_two(), NOBODY, versions[-1].protocol, versions)
    assert "sub-2_task-real" in error.value.finding.what


def test_a_session_in_two_versions_is_named_and_one_in_one_is_read(tmp_path: Path) -> None:
    (tmp_path / "sourcedata").mkdir()
    for name in ("protocol.toml", "protocol-2.toml"):
        shutil.copy(shipped("okamoto2012.toml"), tmp_path / "sourcedata" / name)
    stated = [
        {"Protocol": "protocol.toml", "Sessions": ["sub-1_task-real", "sub-2_task-real"]},
        {"Protocol": "protocol-2.toml", "Sessions": ["sub-2_task-virtual"]},
    ]
    assert [one.sessions for one in read_versions(tmp_path, {"Versions": stated})] == [
        {("1", "real"), ("2", "real")},
        {("2", "virtual")},
    ]
    stated[1]["Sessions"] = ["sub-2_task-virtual", "sub-2_task-real"]
    with pytest.raises(DatasetError) as error:
        read_versions(tmp_path, {"Versions": stated})
    assert "sub-2_task-real" in error.value.finding.what
