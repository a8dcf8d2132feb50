"""A plan for OSF's form: its parts in their order, the plan's own words, and what only a laboratory can say."""

from __future__ import annotations

import json
import re
from datetime import date
from itertools import pairwise
from pathlib import Path

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.errors import ProtocolError
from palpate.experiment.protocol.files import load, shipped
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.protocol.page.preregistration import text
from tests.approved import Refuses
from tests.experiment.protocol import leveled, rating

PARTS = ["Study Information", "Design Plan", "Sampling Plan", "Variables", "Analysis Plan", "Other"]
"""https://osf.io/prereg"""

POWER = {
    "study": "okamoto2012", "studies": 100, "seed": 1, "model": "two numbers", "target": 0.8, "recommended": 12,
    "needed_rows": [
        {"test": "t against chance", "tasks": "virtual", "of": "typing paper", "participants_planned": 15,
         "power_planned": 0.875},
    ],
}  # fmt: skip


@pytest.mark.parametrize("study", ["okamoto2012", "wellman1995"])
def test_the_plan_of_a_published_study(study: str, approved: SnapshotAssertion) -> None:
    file = shipped(f"{study}.toml")
    shown = text(load(file), file, date(2026, 4, 1))
    lines = shown.splitlines()
    assert [above for above, below in pairwise(lines) if set(below) == {"-"}] == PARTS
    assert max(map(len, lines)) <= 92
    assert shown == approved


@pytest.mark.parametrize("study", [rating.protocol(), leveled.protocol(leveled.footsteps())])
def test_a_study_whose_answers_are_no_shares_leaves_what_is_computed_of_them_open(
    study: Protocol, tmp_path: Path
) -> None:
    shown = text(study, tmp_path / "study.toml", date(2026, 4, 1))
    asked = shown.partition("\nIndices:\n")[2].split()[:3], shown.partition("\nTransformations:\n")[2].split()[:3]
    assert asked == (["TO", "BE", "FILLED"],) * 2


def test_simulated_power_is_the_reason_for_the_number_of_participants(tmp_path: Path, refuses: Refuses) -> None:
    file, power = shipped("okamoto2012.toml"), tmp_path / "power.json"
    power.write_text(json.dumps(POWER), "utf-8")
    shown = text(load(file), file, date(2026, 4, 1), power)
    assert re.findall(r"power (0\.\d+)", shown) == ["0.88"]
    others: tuple[object, ...] = ({**POWER, "study": "another"}, {"study": "okamoto2012"}, [])
    for wrong in others:
        power.write_text(json.dumps(wrong), "utf-8")
        with refuses(ProtocolError):
            text(load(file), file, date(2026, 4, 1), power)
