"""Levels in a protocol: what is refused, what the board reads, and that no older file and no hash knows of them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from palpate.experiment.errors import ProtocolError
from palpate.experiment.protocol import files, page
from palpate.experiment.protocol.approval import canonical, sha256
from palpate.experiment.protocol.blocks import Facts
from palpate.experiment.protocol.files import ProtocolFile
from palpate.experiment.protocol.levels import facts
from tests.experiment.protocol import leveled
from tests.experiment.protocol.small import changed, document, with_tuples
from tests.experiment.protocol.small import protocol as small

TAPPING = with_tuples(leveled.tapping())
STEPS = with_tuples(leveled.footsteps())


def refused(tables: dict[str, Any], folder: Path) -> set[str]:
    """The fields that a file with these tables is refused for."""
    with pytest.raises(ProtocolError) as error:
        files.load(leveled.written(folder, tables))
    return {finding.field for finding in error.value.findings}


@pytest.mark.parametrize("tables", [TAPPING, STEPS])
def test_a_study_with_levels_is_read(tables: dict[str, Any], tmp_path: Path) -> None:
    read = files.load(leveled.written(tmp_path, tables))
    (task,) = read.tasks
    assert task.levels is not None
    assert list(task.levels.grid) == list(tables["tasks"][0]["levels"]["grid"])
    assert read.trials(task) == task.repetitions * len(read.presentations(task))


@pytest.mark.parametrize(
    ("path", "value", "field"),
    [
        (("levels", "grid"), (0.1, 0.3, 0.2), "tasks[0].levels.grid"),
        (("levels", "grid"), (0.1, 0.1), "tasks[0].levels.grid"),
        (("levels", "grid"), (0.0, 0.1), "tasks[0].levels.grid[0]"),
        (("levels", "grid"), (0.1, 1.5), "tasks[0].levels.grid[1]"),
        (("levels", "grid"), (0.1,), "tasks[0].levels.grid"),
        (("levels", "first"), 0.3, "tasks[0].levels.first"),
        (("levels", "down"), 0, "tasks[0].levels.down"),
        (("levels", "method"), "guess", "tasks[0].levels.method"),
        (("order",), {"kind": "full-random"}, "tasks[0].order.kind"),
        (("stimulus",), "real", "tasks[0].levels"),
    ],
)
def test_what_levels_cannot_be_is_refused_by_its_field(
    path: tuple[str, ...], value: object, field: str, tmp_path: Path
) -> None:
    assert field in refused(changed(TAPPING, ("tasks", 0, *path), value), tmp_path)


def test_progress_is_not_shown_where_answers_decide_how_much_is_left(tmp_path: Path) -> None:
    assert "answers.progress" in refused(changed(TAPPING, ("answers", "progress"), True), tmp_path)


def test_no_least_number_of_answers_is_asked_for(tmp_path: Path) -> None:
    rule = {"id": "few", "when": "answers-below", "limit": 3.0, "action": "exclude-participant", "reason": "few"}
    rules = (*TAPPING["exclusion"], rule)
    assert f"exclusion[{len(rules) - 1}].when" in refused({**TAPPING, "exclusion": rules}, tmp_path)


def test_an_older_file_has_no_levels_and_its_form_none(tmp_path: Path) -> None:
    assert "tasks[0].levels" in refused({**TAPPING, "format": 4}, tmp_path)
    older = small()
    assert all("levels" not in task for task in json.loads(canonical(older))["tasks"])
    newer = ProtocolFile.model_validate({**document(), "format": 5})
    assert [task["levels"] for task in json.loads(canonical(newer))["tasks"]] == [None, None]
    assert sha256(older) != sha256(newer)


def test_the_board_reads_every_level_and_how_they_follow() -> None:
    read = ProtocolFile.model_validate(STEPS)
    (task,) = read.tasks
    told = dict(facts(task))
    assert "0.125, 0.25, 0.5, 1." in told["Levels"]
    blocks = [block for name, section in page.sections(read) if name == "Tasks" for block in section]
    (of_task,) = [block for block in blocks if isinstance(block, Facts)]
    assert set(told.items()) <= set(of_task.known)
    text = page.page(read, "levels.toml")
    assert f"at most {read.trials(task)}" in text
    assert (
        "at most"
        not in page.page(small(), "small.toml").partition("4. What a participant does")[2].partition("6. M")[0]
    )


def test_planned_tests_of_answers_that_levels_settle_are_odd() -> None:
    odd = {finding.field for finding in page.advice(ProtocolFile.model_validate(STEPS))}
    assert {f"analysis[{place}].tasks" for place in range(len(STEPS["analysis"]))} <= odd
    assert not [field for field in {finding.field for finding in page.advice(small())} if field.endswith("tasks")]
