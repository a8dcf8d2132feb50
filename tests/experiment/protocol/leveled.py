"""Protocols with levels, made of the shipped ones with two materials and one task."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import tomlkit

from palpate.experiment.protocol.files import ProtocolFile, shipped
from palpate.experiment.protocol.models import Protocol
from tests.experiment.protocol.small import with_tuples

GRID = tuple(round(10 ** (place / 10 - 3), 6) for place in range(21))
"""Levels 2 dB apart, from 0.001 to 0.1."""

LEVELS: dict[str, Any] = {"method": "up-down", "grid": list(GRID), "first": GRID[12], "down": 2, "reversals": 12}
STEPS: dict[str, Any] = {"method": "up-down", "grid": [0.125, 0.25, 0.5, 1.0], "first": 1.0, "down": 2, "reversals": 4}

WEIGHTED: dict[str, Any] = STEPS | {"down": 1, "up": 3, "steps": [2, 1]}
EXPECTED: dict[str, Any] = {
    "method": "quest-plus",
    "grid": [0.125, 0.25, 0.5, 1.0],
    "thresholds": [0.25, 0.375],
    "spreads_db": [2.5, 6.5],
    "lapses": [0.0, 0.0625],
    "guess": 0.5,
    "precision_db": 1.5,
}


def tapping() -> dict[str, Any]:
    """The virtual task of Wellman and Howe with basswood and aluminum, so that one pair is the one track."""
    study = _of("wellman1995.toml", ("basswood", "aluminum"), LEVELS, repetitions=120)
    study["tapping"]["surfaces"] = [one for one in study["tapping"]["surfaces"] if one["material"] in _names(study)]
    return study


def footsteps(levels: dict[str, Any] = STEPS) -> dict[str, Any]:
    """The virtual task of Okamoto et al. with two materials, each a track of its own."""
    study = _of("okamoto2012.toml", ("copy paper", "aluminum foil"), levels, repetitions=12)
    return study | {"format": 5 if levels is STEPS else 7}


def _of(file: str, materials: tuple[str, ...], levels: dict[str, Any], repetitions: int) -> dict[str, Any]:
    study = tomllib.loads(shipped(file).read_text("utf-8"))
    (task,) = (one for one in study["tasks"] if one["stimulus"] == "virtual")
    changed = {"order": {"kind": "blocked-random"}, "repetitions": repetitions, "levels": levels}
    ours = [one for one in study["materials"] if one["id"] in materials]
    assert len(ours) == len(materials), [one["id"] for one in study["materials"]]
    planned = [test for test in study["analysis"] if task["id"] in test["tasks"] and "materials" not in test]
    return study | {
        "format": 5,
        "study": study["study"] | {"participants": task["participants"]},
        "tasks": [task | changed],
        "materials": ours,
        "exclusion": [rule for rule in study["exclusion"] if rule["when"] != "answers-below"],
        "analysis": [test | {"tasks": [task["id"]]} for test in planned if test["test"] in SINGLE],
    }


SINGLE = ("t against chance", "Bradley-Terry", "Thurstone", "Davidson")
"""Planned tests of one task."""


def _names(study: dict[str, Any]) -> set[str]:
    return {one["id"] for one in study["materials"]}


def written(folder: Path, study: dict[str, Any]) -> Path:
    file = folder / "levels.toml"
    file.write_text(tomlkit.dumps(study), "utf-8")
    return file


def protocol(study: dict[str, Any]) -> Protocol:
    return ProtocolFile.model_validate(with_tuples(study))
