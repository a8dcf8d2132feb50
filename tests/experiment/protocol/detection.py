"""Small protocols of detection: yes or no with catch trials, and which of two intervals; both have every key."""

from __future__ import annotations

from typing import Any

from palpate.experiment.protocol.files import ProtocolFile
from palpate.experiment.protocol.models import Protocol
from tests.experiment.protocol.presented import WAVES, presenting

SILENCE: tuple[dict[str, Any], ...] = ({"silence": {"lasts_s": 0.25}},)

UP_DOWN: dict[str, Any] = {
    "method": "up-down",
    "grid": (0.03125, 0.0625, 0.125, 0.25, 0.5, 1.0),
    "first": 1.0,
    "down": 2,
    "reversals": 8,
}
CONSTANT: dict[str, Any] = {"method": "constant", "grid": (0.03125, 0.0625, 0.125, 0.25)}

ASKED: dict[int, dict[str, Any]] = {
    1: {"signal_trials": 2, "catch_trials": 1, "yes_key": "1", "no_key": "2"},
    2: {"signal_trials": 2, "first_key": "1", "second_key": "2"},
}


def detecting(
    intervals: int = 1, levels: dict[str, Any] | None = None, repetitions: int = 4, **own: Any
) -> dict[str, Any]:
    """Tables as in a file: the last material is nothing, the others are the same sinusoid; arrays are tuples."""
    study = presenting(repetitions=repetitions, first=WAVES[:1])
    names = [one["id"] for one in study["materials"]]
    stimuli = tuple({"material": name, "parts": SILENCE if name == names[-1] else WAVES[:1]} for name in names)
    (task,) = study["tasks"]
    task = task | {"design": "detection"} | ({"levels": levels} if levels else {})
    planned = tuple(
        {"test": test, "tasks": (task["id"],), "question": "How much is felt?"}
        for test in ("threshold", "sensitivity")
        if levels or test == "sensitivity"
    )
    return study | {
        "materials": tuple({"id": one["id"], "description": one["description"]} for one in study["materials"]),
        "presented": study["presented"] | {"stimuli": stimuli},
        "detection": {"intervals": intervals, "blank": names[-1]} | ASKED[intervals] | own,
        "tasks": (task,),
        "analysis": planned,
    }


def protocol(intervals: int = 1, levels: dict[str, Any] | None = None, **how: Any) -> Protocol:
    """The protocol of `detecting`."""
    return ProtocolFile.model_validate(detecting(intervals, levels, **how))


STUDIES: tuple[Protocol, ...] = (protocol(1), protocol(2))
