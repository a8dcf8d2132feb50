"""A part of the forged datasets, of which `python -m tests.faults forged` makes all: verify reports what it did."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from tests.faults.forged import baseline
from tests.faults.forged.baseline import BASELINE, compact, differences, name, read_json, read_text, whole
from tests.faults.forged.records import FORGERIES, Record, run
from tests.faults.forged.studies import CLEAN

PART = range(20, len(FORGERIES) + 1, 20)


@pytest.fixture(scope="module")
def records() -> list[Record]:
    return run(PART)


def test_every_twentieth_forged_dataset_is_reported_as_in_the_baseline(records: list[Record]) -> None:
    now = compact(records)
    assert [one.number for one in records if one.number] == list(PART)
    before = {known_by: lines for known_by, lines in read_text(BASELINE).items() if known_by in now}
    assert not list(differences(before, now))


def test_the_baseline_has_every_forgery_and_every_clean_dataset() -> None:
    numbers = [int(known_by[:3]) for known_by in read_text(BASELINE)]
    assert len(FORGERIES) == len({one.name for one in FORGERIES}) == 200
    assert numbers == [0] * len(CLEAN) + list(range(1, 201))


def test_a_finding_with_another_text_is_a_difference(records: list[Record]) -> None:
    one = next(one for one in records if one.number and one.findings)
    first, *rest = one.findings
    changed = replace(one, findings=(replace(first, text="another text"), *rest))
    others = [other for other in records if other is not one]
    for lines in (whole, compact):
        assert next(differences(lines(records), lines([*others, changed]))) == name(one)
        assert next(differences(lines(records), lines(others))) == name(one)


def test_records_are_read_as_they_were_written(records: list[Record], tmp_path: Path) -> None:
    baseline.write_json(tmp_path / "records.jsonl", records)
    assert read_json(tmp_path / "records.jsonl") == records
    baseline.write_text(tmp_path / "records.txt", compact(records))
    assert read_text(tmp_path / "records.txt") == compact(records)


def test_no_record_has_what_differs_from_run_to_run(records: list[Record]) -> None:
    text = "\n".join(line for lines in whole(records).values() for line in lines)
    assert "<study>" in text
    assert not re.search(r"[0-9a-f]{8}|(?<!<study>)(?<!<outside>)/(dev|tmp|home)/|20[2-8]\d-", text)
