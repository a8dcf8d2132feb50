"""A small valid protocol of comparisons, so that tests do not change when a published one does."""

from __future__ import annotations

from typing import Any

from experiment.protocol.models import Protocol
from tests.experiment.protocol.small import document


def comparing(*, repetitions: int = 2, order: str = "full-random", tie_key: str | None = None) -> dict[str, Any]:
    """Three materials, whose 6 pairs are each presented so often, as tables with arrays as tuples."""
    study = document()
    del study["footstep"]
    task = study["tasks"][0]
    study["materials"] = tuple({"id": name, "description": f"Piece of {name}."} for name in ("felt", "cork", "tin"))
    study["comparison"] = {"quality": "hardness", "first_key": "1", "second_key": "2"}
    if tie_key is not None:
        study["comparison"]["tie_key"] = tie_key
    kept = {key: task[key] for key in ("participants", "familiarisation", "instruction", "title")}
    live = {
        "id": "live",
        "kind": "comparison",
        "stimulus": "real",
        "repetitions": repetitions,
        "order": {"kind": order},
    }
    study["tasks"] = ({**kept, **live},)
    study["exclusion"] = tuple(rule for rule in study["exclusion"] if rule["when"] == "withdrawn")
    tests = ("Davidson",) if tie_key is not None else ("Bradley-Terry", "Thurstone")
    study["analysis"] = tuple({"test": test, "tasks": ("live",), "question": "How far apart?"} for test in tests)
    return study


def protocol(**how: Any) -> Protocol:
    """The protocol of `comparing`."""
    return Protocol.model_validate(comparing(**how))
