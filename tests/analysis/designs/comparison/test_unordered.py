"""Comparisons of materials that stand in no order, and their factors as columns."""

from __future__ import annotations

import csv
import io
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import expit

from palpate.analysis.designs.comparison import NEIGHBORS, PEOPLE, VALUES, results, sections
from palpate.analysis.designs.comparison.unordered import times_named
from palpate.analysis.export import DICTIONARY, files
from palpate.analysis.power.comparisons import Observers, ranked
from palpate.analysis.reading.dataset import read
from palpate.analysis.reading.study import Study
from palpate.experiment.protocol.designs.factors import crossed
from palpate.experiment.protocol.files import load, shipped
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.study.schedule import schedule
from tests.analysis.datasets import compared, write_dataset

SLOPES = {"frequency": 0.2, "amplitude": 0.8}


@pytest.fixture(scope="module")
def protocol() -> Protocol:
    return load(shipped("harder.toml"))


@pytest.fixture(scope="module")
def study(protocol: Protocol, tmp_path_factory: pytest.TempPathFactory) -> Study:
    """Answers of three SIMULATED participants to the shipped study, by its draws and a Bradley-Terry scale."""
    rng, sessions = np.random.default_rng(3), {}
    worth = {name: sum(SLOPES[of] * np.log2(x) for of, x in own.items()) for name, own in crossed(protocol).items()}
    for who in ("1", "2", "3"):
        order = schedule(protocol=protocol, participant=who, task_id="harder", seed=1)
        said = [
            (*one.presented, "first" if rng.random() < expit(worth[one.presented[0]] - worth[one.presented[1]]) else
             "second")
            for one in order
        ]  # fmt: skip
        sessions[who] = {"harder": compared([(one, other, answered) for one, other, answered in said])}
    folder = write_dataset(
        tmp_path_factory.mktemp("unordered") / "study",
        sessions,
        materials=tuple(one.id for one in protocol.materials),
        tasks=("harder",),
        answers=("first", "second"),
        origin="REHEARSAL",
        kind="presented",
        design="comparison",
    )
    known = read(folder)
    (part,) = known.parts
    return replace(known, parts=(replace(part, protocol=protocol),))


def test_no_table_says_that_a_choice_was_right(study: Study) -> None:
    found = results.compute(study)
    assert not found.ordered
    tables = [table for section in sections(study, found, None) for table in section.tables]
    headings = {heading for table in tables for heading in table.header}
    assert headings.isdisjoint(one.heading for one in (NEIGHBORS[1], PEOPLE[1], VALUES[3]))
    assert not any("right" in table.title for table in tables)
    keys = {key for table in tables for record in table.records for key in record}
    assert keys.isdisjoint({"right", "share_right", "trials_of_two"})
    assert "named" in keys


def test_a_tie_is_right_for_nobody_only_where_materials_are_ordered(study: Study) -> None:
    found = results.compute(study)
    (task,) = found.tasks
    tied = replace(task, pairs=tuple(replace(pair, ties=1) for pair in task.pairs))
    for ordered in (True, False):
        shown = sections(study, replace(found, tasks=(tied,), ordered=ordered), None)
        (pairs,) = (one for one in shown if one.slug == "pairs")
        assert any("right" in note for note in pairs.tables[0].notes) == ordered


def test_each_material_is_named_as_often_as_answers_say(study: Study) -> None:
    (task,) = results.compute(study).tasks
    trials = study.trials("harder")
    of_two = trials[trials["first"] != trials["second"]]
    counted = Counter(np.where(of_two["answered"] == "first", of_two["first"], of_two["second"]).tolist())
    named = {name: times_named(task, place) for place, name in enumerate(study.materials)}
    assert {name: count for name, (count, _) in named.items()} == dict(counted)
    # 8 others, 4 trials each, of 3 participants.
    assert {trials for _, trials in named.values()} == {96}


def test_the_planned_test_reads_the_factors_of_the_protocol(study: Study) -> None:
    (task,) = results.compute(study).tasks
    assert task.factors is not None
    assert [(one.name, one.levels) for one in task.factors.factors] == [
        ("amplitude", (2.0, 4.0, 8.0)),
        ("frequency", (60.0, 120.0, 240.0)),
    ]
    for one in task.factors.factors:
        assert one.doubling is not None
        assert one.doubling.value == pytest.approx(SLOPES[one.name], abs=0.3)


def test_trials_have_a_column_of_each_factor(study: Study, protocol: Protocol) -> None:
    made = files(study)
    rows = list(csv.DictReader(io.StringIO(made["trials.csv"].decode())))
    values = crossed(protocol)
    for row in rows:
        for place in ("first", "second"):
            for name, value in values[row[place]].items():
                assert float(row[f"{place}_{name}"]) == value
    assert {row["right"] for row in rows} == {"NA"}
    described = {row["column"] for row in csv.DictReader(io.StringIO(made[DICTIONARY].decode()))}
    assert set(rows[0]) <= described


def test_power_takes_the_order_of_its_model(protocol: Protocol) -> None:
    values = np.array([0.0, 1.0, 2.0, -1.0, 0.5, 3.0, -2.0, 0.2, 4.0])
    assert ranked(protocol, values) == (6, 3, 0, 7, 4, 1, 2, 5, 8)
    assert ranked(load(shipped("wellman1995.toml")), values) == Observers("live", values, 0.0, 0.0, 0.0).ranks == ()


def test_a_dataset_without_a_protocol_is_ordered(study: Study) -> None:
    parts = tuple(replace(part, protocol=None) for part in study.parts)
    found = results.compute(replace(study, parts=parts))
    assert found.ordered
    assert found.tasks[0].factors is None
