"""Training in a protocol: what cannot be trained is refused, and the board reads what is told and what ends it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import tomlkit
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.errors import ProtocolError
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import ProtocolFile
from palpate.experiment.protocol.page import advice, page
from palpate.experiment.settings import load
from tests.experiment.protocol import rating, tapping
from tests.experiment.protocol.presented import presenting
from tests.experiment.protocol.small import changed, document, with_tuples

WHERE = ("tasks", 0, "training")
CRITERION = {"right": 4, "of": 5, "unmet": "end"}
TABLE: dict[str, Any] = {"trials": 12, "feedback": True, "criterion": CRITERION}


def fields(tables: Any) -> set[str]:
    return {one.field for one in load.find(ProtocolFile, tables, {})}


@pytest.mark.parametrize(
    ("key", "value", "field"),
    [
        (("criterion", "of"), 13, "criterion.of"),
        (("criterion", "right"), 6, "criterion.right"),
        (("criterion", "unmet"), "repeat", "criterion.unmet"),
        (("trials",), 4, "criterion.of"),
    ],
)
def test_a_criterion_that_cannot_be_reached_is_refused(key: tuple[str, ...], value: object, field: str) -> None:
    assert fields(changed(presenting(), WHERE, TABLE)) == set()
    assert fields(changed(presenting(), WHERE, changed(TABLE, key, value))) == {f"tasks[0].training.{field}"}


def test_what_has_no_right_answer_another_kind_and_an_older_format_have_no_training(tmp_path: Path) -> None:
    whole = {"tasks[0].training"}
    assert fields(changed(with_tuples(rating.study()), WHERE, TABLE)) == whole
    assert fields({**changed(tapping.comparing(), WHERE, TABLE), "format": 7}) == whole
    older = tmp_path / "study.toml"
    older.write_text(tomlkit.dumps(changed(document(), WHERE, TABLE)), "utf-8")
    with pytest.raises(ProtocolError) as refused:
        files.load(older)
    assert {one.field for one in refused.value.findings} == whole


def test_the_board_reads_how_many_what_is_told_and_what_ends_it(approved: SnapshotAssertion) -> None:
    lines = []
    for table in (
        TABLE,
        changed(TABLE, ("criterion", "unmet"), "go on"),
        {"trials": 3, "feedback": False},
    ):
        text = page(ProtocolFile.model_validate(changed(presenting(), WHERE, table)), "study.toml").splitlines()
        bare = page(ProtocolFile.model_validate(presenting()), "study.toml").splitlines()
        lines += [*(line for line in text if line not in bare), "--"]
    assert "\n".join(lines) == approved


def test_its_trials_are_in_the_time_of_a_visit() -> None:
    study = presenting(repetitions=100)
    least = []
    for table in (study, changed(study, WHERE, {"trials": 1000, "feedback": False})):
        told = advice(ProtocolFile.model_validate(table))
        least.append([one.allowed for one in told if one.field == "duration.longest_min"])
    assert least[0] != least[1]
