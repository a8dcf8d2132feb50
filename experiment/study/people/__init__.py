"""Names of participants, in a file outside of each dataset that only its owner can read.

Nothing of palpate copies them: no journal, table, export, anchor or log contains any, and no reason on record.
"""

import hashlib
import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError

from palpate.experiment import storage
from palpate.experiment.errors import RosterError
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.settings.characters import one_line, quoted

Line = Annotated[str, AfterValidator(one_line)]

HEALTH = re.compile(
    r"\b(?:ill|illness|sick\w*|disease\w*|disorder\w*|disab\w*|injur\w*|wound\w*|hurt|hurts|hurting|pains?|painful"
    r"|(?:\w*(?:head|tooth|stomach|back|ear) ?)?aches?|migraine\w*|nause\w*|vomit\w*|dizz\w*|faint\w*|fever\w*|flu"
    r"|influenza|covid\w*|infect\w*|cancer\w*|tumou?r\w*|diabet\w*|asthma\w*|allerg\w*|epilep\w*|seizure\w*|stroke"
    r"|pregnan\w*|depress\w*|anxi\w*|panic|psychi\w*|psycho(?:sis|ses|tic\w*|log\w*)|autis\w*|adhd|dementia"
    r"|neuropath\w*|arthrit\w*|diagnos\w*|symptom\w*|medic\w*|drug\w*|surger\w*|hospitals?|hospitali[sz]\w*|doctors?"
    r"|therap\w*|health\w*|unwell|handicap\w*|amput\w*|paraly\w*)\b",
    re.IGNORECASE,
)
"""Words that tell of somebody's health."""

ENDING = "-people.json"
"""Ends the name of each file of names."""

SHORTEST = 3
"""Letters of a part of a name that is looked for: a shorter one is a word of many sentences."""


class Person(BaseModel):
    """What is kept of one participant: a name, and how they are reached; either may be empty."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: Line = ""
    contact: Line = ""


class File(BaseModel):
    """What a file of names holds, by label."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    study: str
    dataset: str
    people: dict[str, Person]


def folder() -> Path:
    """Return the folder of the files of names, in the user's data. Raises `RosterError` where that is unknown."""
    try:
        return Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share") / "palpate"
    except RuntimeError as error:
        raise RosterError(
            "there is no home folder for the file of names",
            remedy="set one of these variables",
            allowed="a folder in HOME or XDG_DATA_HOME",
        ) from error


def place(protocol: Protocol, dataset: Path) -> Path | None:
    """Return the file of names of a dataset, named by seed and salt; None before enrolment. Raises `RosterError`."""
    try:
        settled = storage.json_of(storage.read_bytes(storage.seed_path(dataset)))
        drawn = f"people of {settled['seed']} {settled.get('salt')}"
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None
    return folder() / f"{protocol.study.id}-{hashlib.sha256(drawn.encode()).hexdigest()[:16]}{ENDING}"


def known(protocol: Protocol, dataset: Path) -> dict[str, Person]:
    """Return who is known, by label. Raises `RosterError` if the file cannot be read."""
    path = place(protocol, dataset)
    if path is None or not path.exists():
        return {}
    try:
        return dict(File.model_validate(storage.json_of(storage.read_bytes(path))).people)
    except (OSError, ValueError) as error:
        told = "it was not written by palpate" if isinstance(error, ValidationError) else str(error)
        raise RosterError(path, f"the file of names cannot be read: {told}", "restore it from a backup") from error


def has_name(text: str, names: Iterable[str]) -> bool:
    """Return whether a text has a part of one of these `names` that is no word of many sentences."""
    words = {word.casefold() for word in re.findall(r"\w+", text)}
    parts = {part.casefold() for name in names for part in re.findall(r"\w+", name) if len(part) >= SHORTEST}
    return bool(words & parts)


def check_reason(reason: str, names: Iterable[str]) -> None:
    """Raise `RosterError`, without the reason, if it has one of these `names` or an English word for health."""
    found = HEALTH.search(reason)
    told = f"a word about health, {quoted(found[0])}" if found else "the name of a participant"
    if found or has_name(reason, names):
        raise RosterError(
            "--reason",
            f"got {told}",
            "the record is permanent, so use different words",
            allowed="one line without names or words about health, such as 'asked to stop'",
        )
