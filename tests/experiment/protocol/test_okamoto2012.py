"""The published study, against what the paper prints (sections and tables of Okamoto et al. named beside each)."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.protocol import files
from palpate.experiment.protocol.kinds.footstep import Footstep
from palpate.experiment.protocol.models import Protocol
from tests.experiment.protocol.small import OKAMOTO2012


@pytest.fixture(scope="module")
def study() -> Protocol:
    return files.load(OKAMOTO2012)


def rows(reference: Path, name: str) -> list[dict[str, str]]:
    with (reference / f"okamoto2012_{name}.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_materials_are_those_of_the_tables_in_their_order(study: Protocol, reference: Path) -> None:
    printed = list(dict.fromkeys(row["presented"] for row in rows(reference, "table1")))
    assert [material.id for material in study.materials] == printed


def test_participants_give_the_printed_degrees_of_freedom(study: Protocol, reference: Path) -> None:
    for row in rows(reference, "statistics"):
        if row["test"] == "t against 0.25":
            assert study.task(row["task"]).participants == int(row["df"]) + 1
        if row["test"] == "one-way ANOVA":
            # Four ratios of 15 participants: 3 and 4 * 15 - 4.
            assert row["df"] == f"3,{4 * study.task('virtual').participants - 4}"
        if row["test"] == "two-way ANOVA":
            # (15 + 10) participants by 4 materials, less 4 * 2 cells: the interaction is in the model.
            values = sum(task.participants for task in study.tasks) * len(study.materials)
            assert row["df"] == f"1,{values - len(study.materials) * len(study.tasks)}"


def test_every_printed_test_is_planned(study: Protocol, reference: Path) -> None:
    planned = {(planned.test, planned.chance) for planned in study.analysis}
    printed = {row["test"] for row in rows(reference, "statistics")}
    assert printed == {f"t against {chance}" if chance else test for test, chance in planned}


def test_numbers_of_sections_3_to_5(study: Protocol, approved: SnapshotAssertion) -> None:
    synthesis, step = study.table(Footstep).synthesis, study.table(Footstep).step
    assert (synthesis.rate_hz, synthesis.samples, synthesis.takes) == (5000, 2500, 3)
    assert synthesis.speeds_mm_s == (50, 100, 200, 300)
    assert (step.gate_top_mm, step.gate_bottom_mm, step.contact_mm) == (20, 10, 0)
    assert study.study.participants == 15
    assert [(task.id, task.stimulus, task.participants) for task in study.tasks] == [
        ("virtual", "virtual", 15),
        ("real", "real", 10),
    ]
    for task in study.tasks:
        assert task.repetitions * len(study.materials) == 40
        assert task.order.kind == "full-random"
        assert (task.familiarisation.min_s, task.familiarisation.max_s) == (180, 300)
    assert study.task_order.kind == "counterbalanced"
    assert study.duration is not None
    assert (study.duration.shortest_min, study.duration.longest_min) == (60, 80)
    assert (study.masker.noise, study.masker.level_set_by) == ("pink", "participant")
    assert study.answers.mode == "oral"
    assert study.ethics.board == approved


def test_fields_of_a_laboratory_are_left_empty(study: Protocol) -> None:
    ethics = study.ethics
    assert (ethics.approval_number, ethics.contact, ethics.approved_on, ethics.expires_on) == ("", "", None, None)


def test_published_participants_pass_the_exclusion_rules(study: Protocol, reference: Path) -> None:
    # The paper excludes nobody; the reconstruction has a few trials without an answer.
    (fewest,) = (rule.limit for rule in study.exclusion if rule.when == "answers-below")
    assert fewest is not None
    for task in ("virtual", "real"):
        answered: dict[str, int] = {}
        for row in rows(reference, f"counts_{task}"):
            if row["answered"] != "(none)":
                answered[row["participant"]] = answered.get(row["participant"], 0) + int(row["count"])
        assert min(answered.values()) >= fewest
