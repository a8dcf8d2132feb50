"""Who the participants are, where a laboratory wants to know: one file that only its owner may read, in no dataset.

A study needs labels alone. Names stand here so that the right person sits at the panel and can be called back, and
nothing of palpate copies them: no journal, table, export, anchor or log holds any.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError

from experiment import storage
from experiment.errors import RosterError
from experiment.protocol.models import Protocol
from experiment.settings.characters import one_line

Line = Annotated[str, AfterValidator(one_line)]


class Person(BaseModel):
    """What is kept of one participant: a name, and how they are reached; either may be empty."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: Line = ""
    contact: Line = ""


class _File(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    study: str
    people: dict[str, Person]


def place(protocol: Protocol) -> Path:
    """Return where the people of a study stand: among the files of the person who uses this machine."""
    data = os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share"
    return Path(data) / "palpate" / f"{protocol.study.id}-people.json"


def known(protocol: Protocol) -> dict[str, Person]:
    """Return who is known, by label. Raises `RosterError` if the file cannot be read."""
    path = place(protocol)
    if not path.exists():
        return {}
    try:
        return dict(_File.model_validate(storage.json_of(storage.read_bytes(path))).people)
    except (OSError, ValueError) as error:
        told = "it is not as palpate writes it" if isinstance(error, ValidationError) else str(error)
        raise RosterError(
            f"{path}: the people of this study cannot be read: {told}; put a backup in its place"
        ) from error


def keep(protocol: Protocol, participant: str, person: Person) -> Path:
    """Write down who a participant is, in place of what was known, and return the file."""
    return _write(protocol, {**known(protocol), participant: person})


def forget(protocol: Protocol, participant: str) -> bool:
    """Delete what is known of a participant; return False if there was nothing."""
    people = known(protocol)
    if people.pop(participant, None) is None:
        return False
    _write(protocol, people)
    return True


def _write(protocol: Protocol, people: dict[str, Person]) -> Path:
    path = place(protocol)
    folder = path.parent.resolve()
    inside = [one for one in (folder, *folder.parents) if storage.roster_path(one).exists()]
    if inside:
        raise RosterError(
            f"{path} lies in the dataset {inside[0]}; names stand in no dataset; have XDG_DATA_HOME name another folder"
        )
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    document = _File(study=protocol.study.id, people=dict(sorted(people.items()))).model_dump()
    before = os.umask(0o077)
    try:
        storage.write_json(path, document)
    finally:
        os.umask(before)
    return path
