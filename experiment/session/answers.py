"""The keys with which the experimenter logs what the participant said."""

from __future__ import annotations

from experiment.protocol.models import Protocol


def keys(protocol: Protocol) -> dict[str, str]:
    """What each key stands for, as the experimenter reads it: answers first, then what the session understands."""
    spoken = {m.key: m.id + (f" ('{m.spoken[0]}')" if m.spoken[0] != m.id else "") for m in protocol.materials}
    return spoken | {
        protocol.answers.no_answer_key: "no answer",
        protocol.answers.redo_key: "do this trial again",
        protocol.answers.pause_key: "pause",
    }


def material_of(protocol: Protocol, key: str) -> str | None:
    """The material that `key` names; None for the key of no answer.

    Raises:
        KeyError: the key names no answer.
    """
    if key == protocol.answers.no_answer_key:
        return None
    return {m.key: m.id for m in protocol.materials}[key]
