"""A vibration before contact in a protocol: what a task of them breaks, and what its board reads."""

from __future__ import annotations

from typing import Any

import pytest

from palpate.experiment.protocol.files import ProtocolFile, load, shipped
from palpate.experiment.protocol.page import page
from palpate.experiment.settings import load as settings
from tests.experiment.protocol.small import before_contact, changed, document

BROKEN: list[tuple[dict[str, Any], str, str]] = [
    (changed(before_contact(-20.0), ("tasks", 0, "stimulus"), "real"), "tasks[0].ahead", "virtual footsteps"),
    (changed(before_contact(-20.0), ("exclusion",), document()["exclusion"]), "tasks[0].ahead", "'speed-above'"),
    (before_contact(-25.1), "tasks[0].ahead.delay_ms", "at least -25, "),
    (before_contact(-100.0), "tasks[0].ahead.delay_ms", "gate_bottom_mm to 35, "),
    (before_contact(-100.0), "tasks[0].ahead.delay_ms", "'speed-above' to 85"),
    (before_contact(0.0), "tasks[0].ahead.delay_ms", "less than 0"),
    (before_contact(-20.0, error_max_ms=0.0), "tasks[0].ahead.error_max_ms", "greater than 0"),
    (before_contact(-20.0, broken_off="silence"), "tasks[0].ahead.broken_off", "nothing, vibration"),
]


@pytest.mark.parametrize(("broken", "path", "allowed"), BROKEN)
def test_what_is_refused_says_where_and_what_would_do(broken: dict[str, Any], path: str, allowed: str) -> None:
    (problem,) = settings.find(ProtocolFile, broken, {})
    assert problem.field == path
    assert allowed in problem.allowed


@pytest.mark.parametrize("remedy", [("footstep", "step", "gate_bottom_mm"), ("exclusion", 2, "limit")])
def test_either_remedy_is_enough(remedy: tuple[str | int, ...]) -> None:
    mended = changed(before_contact(-100.0), remedy, 35 if remedy[-1] == "gate_bottom_mm" else 85)
    assert settings.find(ProtocolFile, changed(mended, ("footstep", "step", "gate_top_mm"), 50), {}) == ()


def test_what_the_gate_just_leaves_is_accepted() -> None:
    assert settings.find(ProtocolFile, before_contact(-25.0), {}) == ()


def test_the_shipped_study_presents_the_same_at_contact_and_before() -> None:
    protocol = load(shipped("ahead.toml"))
    contact, before = protocol.tasks
    assert contact.ahead is None
    assert before.ahead is not None
    assert before.model_copy(update={"id": contact.id, "title": contact.title, "ahead": None}) == contact
    assert "Begins" in page(protocol, "ahead.toml")
