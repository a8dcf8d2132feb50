"""What participants told of themselves: each one's answers in a file of their own, which goes with a withdrawal.

The roster's chain has the hash of the file. That has a salt of 128 bits, so that nobody guesses the answers of a file
that is gone from its hash.
"""

import hashlib
import secrets
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from palpate.experiment import storage
from palpate.experiment.errors import DatasetError, Finding, Remedy, RosterError
from palpate.experiment.protocol import files
from palpate.experiment.protocol.asked import Asked, Fact, Value
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import journal
from palpate.experiment.settings.characters import quoted
from palpate.experiment.study.enrolment import study_begun
from palpate.experiment.study.roster import Roster

MISSING = "n/a"
"""How it stands in participants.tsv that somebody did not answer."""


def facts(protocol: Protocol) -> tuple[Fact, ...]:
    """Return what a protocol asks participants about themselves."""
    asked = protocol.find(Asked)
    return asked.people if asked is not None else ()


def columns(protocols: tuple[Protocol, ...]) -> dict[str, Fact]:
    """Return the facts that any version of a protocol asks, by id; the latest version's words."""
    return {one.id: one for protocol in protocols for one in facts(protocol)}


def read(protocol: Protocol, given: Mapping[str, str]) -> dict[str, Value | None]:
    """Return what was given as values. Raises `RosterError` for an unknown id, and for what is not allowed."""
    known = {one.id: one for one in facts(protocol)}
    if unknown := [name for name in given if name not in known]:
        allowed = ", ".join(known) or "none: this protocol asks nothing"
        raise RosterError("--fact", f"got {quoted(unknown[0])}", "ask what the board allows", allowed=allowed)
    values: dict[str, Value | None] = {}
    for name, typed in given.items():
        try:
            values[name] = known[name].read(typed)
        except ValueError as error:
            what = f"got {quoted(typed)} for {name}"
            raise RosterError("--fact", what, "correct it", allowed=known[name].allowed) from error
    return values


def answers(root: Path, participant: str) -> dict[str, Any]:
    """Return the answers of a participant, none where there is no file. Raises `DatasetError` if it cannot be read."""
    path = storage.facts_path(root, participant)
    return dict(_content(path)["answers"]) if path.exists() else {}


def _content(path: Path) -> dict[str, Any]:
    try:
        found = storage.json_of(storage.read_bytes(path))
        if isinstance(found, dict) and isinstance(found.get("answers"), dict):
            return found
        why = "it is not as palpate writes it"
    except (OSError, ValueError) as error:
        why = storage.why(error)
    raise DatasetError(path, f"cannot be read ({why})", "restore it from a backup")


def record(protocol_file: Path, participant: str, given: Mapping[str, str], *, root: Path | None) -> Path:
    """Put answers on record beside those that a participant gave before, and return their file.

    Raises `RosterError` as `read`, and if the participant is not enrolled or has withdrawn; `SessionLocked` during a
    session.
    """
    typed = read(files.load(protocol_file), given)
    root = study_begun(protocol_file, root)
    roster = Roster.continued(storage.roster_path(root))
    roster.check_enrolled(participant)
    if participant in roster.withdrawn:
        raise RosterError(f"participant {participant} has withdrawn", remedy="ask nothing more of them")
    path = storage.facts_path(root, participant)
    with journal.locked(storage.participant_folder(root, participant), participant):
        # What is not as the roster has it is not taken over: somebody may have edited it.
        before = answers(root, participant) if not any(_of_participant(root, roster, participant)) else {}
        kept = {**before, **typed}
        content = {"participant": participant, "salt": secrets.token_hex(16), "answers": dict(sorted(kept.items()))}
        storage.write_json(path, content)
        roster.keep_facts(participant, _sha256(content))
    return path


def _sha256(content: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a file's JSON, 64 hexadecimal digits, whatever ends its lines have."""
    return hashlib.sha256(storage.json_bytes(content)).hexdigest()


def findings(root: Path, roster: Roster) -> Iterator[Finding]:
    """Yield each file of answers that is not the one of the roster, and each that is left of who withdrew."""
    for participant in roster.consent_on:
        yield from _of_participant(root, roster, participant)


def _of_participant(root: Path, roster: Roster, participant: str) -> Iterator[Finding]:
    path, known = storage.facts_path(root, participant), roster.facts.get(participant)
    if participant in roster.withdrawn:
        if path.exists() and participant not in roster.erased:
            yield Finding(f"participant {participant} withdrew, and this is here", path, remedy="delete the file")
        return
    given = (str(storage.protocol_path(root)), "-p", participant, "--dataset", str(root))
    again = Remedy(
        "restore it from a backup, or have all answers given again: {}", ("palpate", "facts", *given), suffices=False
    )
    try:
        if path.exists() and _sha256(_content(path)) != known:
            yield Finding("is not the file whose hash the roster has", path, remedy=again)
        elif known is not None and not path.exists():
            yield Finding("is missing, and the roster has its hash", path, remedy=again)
    except DatasetError as error:
        yield error.finding


def shared_column(fact: Fact) -> str:
    """Return the column in which `palpate share` gives a fact: numbers stand in groups there."""
    return fact.id if fact.group is None else f"{fact.id}_group"


def shared_text(fact: Fact) -> dict[str, object]:
    """Return what the sidecar of a shared copy says of the column; a group of numbers is a text, without a unit."""
    if fact.group is None:
        return fact.column()
    return {"Description": f"{fact.question} In groups of {fact.group:g} {fact.unit or ''}".rstrip() + "."}


def shared_cell(fact: Fact, cell: str) -> str:
    """Return the cell of a fact there, of one in participants.tsv."""
    if fact.group is None or cell == MISSING:
        return cell
    least = float(cell) // fact.group * fact.group
    return f"{least:g} to below {least + fact.group:g}"
