"""What participants told of themselves: each one's answers in a file of their own, which goes with a withdrawal.

The roster's chain has the hash of the file. That has a salt of 128 bits, so that nobody guesses the answers of a file
that is gone from its hash.
"""

import hashlib
import secrets
from collections.abc import Container, Iterator, Mapping
from contextlib import suppress
from decimal import ROUND_FLOOR, Decimal
from pathlib import Path
from typing import Any

from palpate.experiment import storage
from palpate.experiment.errors import DatasetError, Finding, Remedy, RosterError
from palpate.experiment.protocol import files
from palpate.experiment.protocol.asked import Asked, Fact, Value
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import journal
from palpate.experiment.settings.characters import quoted
from palpate.experiment.study.enrolment import check_on_record, study_begun
from palpate.experiment.study.lines import Facts
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
        allowed = ", ".join(known) or "none: this protocol has no questions about participants"
        raise RosterError("--fact", f"got {quoted(unknown[0])}", "ask only what the protocol asks", allowed=allowed)
    values: dict[str, Value | None] = {}
    for name, typed in given.items():
        try:
            values[name] = known[name].read(typed)
        except ValueError as error:
            what = f"got {quoted(typed)} for {name}"
            raise RosterError("--fact", what, "correct it", allowed=known[name].allowed) from error
    return values


def simulated(protocol: Protocol, participant: str) -> dict[str, Value]:
    """Return what a SIMULATED participant chooses of facts: the values in turn, whatever they answer in trials."""
    place = int(participant) - 1
    return {one.id: one.values[place % len(one.values)] for one in facts(protocol) if one.values}


def answers(root: Path, roster: Roster, participant: str) -> dict[str, Any]:
    """Return the answers of a participant whose hash the roster has; none where it has none, or they withdrew."""
    withdrew = participant in roster.withdrawn
    return {} if withdrew else dict((_on_record(root, roster, participant) or {"answers": {}})["answers"])


def _on_record(root: Path, roster: Roster, participant: str) -> dict[str, Any] | None:
    """Return what the file holds that the roster has the hash of, under either name; None without such a file."""
    path, known = storage.facts_path(root, participant), roster.facts.get(participant)
    for one in (path, _new(path)):
        with suppress(DatasetError):
            if known is not None and one.exists() and _sha256(content := _content(one)) == known:
                return content
    return None


def _new(path: Path) -> Path:
    """Return where the next answers stand until the roster has their hash."""
    return path.with_suffix(".new.json")


def _content(path: Path) -> dict[str, Any]:
    try:
        found = storage.json_of(storage.read_bytes(path))
        if isinstance(found, dict) and isinstance(found.get("answers"), dict):
            return found
        why = "it was not written by palpate"
    except (OSError, ValueError) as error:
        why = storage.why(error)
    raise DatasetError(path, f"cannot be read ({why})", "restore it from a backup")


def record(protocol_file: Path, participant: str, given: Mapping[str, str], *, root: Path | None) -> Path:
    """Put answers on record beside those that a participant gave before, and return their file.

    Raises `RosterError` as `read`, and if the participant is not enrolled or has withdrawn; `DatasetError` for a
    version of the protocol that is not on record, and if an edited or lost file is not replaced as a whole;
    `SessionLocked` during a session.
    """
    protocol = files.load(protocol_file)
    typed = read(protocol, given)
    root = study_begun(protocol_file, root)
    check_on_record(root, protocol_file, protocol)
    Roster.load(storage.roster_path(root)).check_enrolled(participant)
    path = storage.facts_path(root, participant)
    with journal.locked(storage.participant_folder(root, participant), participant):
        roster = Roster.continued(storage.roster_path(root))
        if participant in roster.withdrawn:
            raise RosterError(f"participant {participant} has withdrawn", remedy="ask no more questions")
        # What is not as the roster has it is not taken over: somebody may have edited it.
        if not {one.id for one in facts(protocol)} <= {*typed}:
            for finding in _of_participant(root, roster, participant):
                raise DatasetError.at(finding)
        if not roster.facts:
            storage.owners_alone(root)
        kept = {**answers(root, roster, participant), **typed}
        content = {"participant": participant, "salt": secrets.token_hex(16), "answers": dict(sorted(kept.items()))}
        # Until the roster has its hash, the file before counts; after that this one, whatever it is called.
        storage.write_json(new := _new(path), content)
        try:
            roster.append(Facts, participant=participant, file_sha256=_sha256(content))
        except RosterError:
            new.unlink()
            raise
        new.replace(path)
        storage.sync_folder(path.parent)
    return path


def _sha256(content: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a file's JSON, 64 hexadecimal digits, whatever ends its lines have."""
    return hashlib.sha256(storage.json_bytes(content)).hexdigest()


def findings(root: Path, roster: Roster, known: Container[str]) -> Iterator[Finding]:
    """Yield what is wrong with files of answers: edited, lost, left of who withdrew, or to what is not `known`."""
    for participant in roster.consent_on:
        wrong = [*_of_participant(root, roster, participant)]
        yield from wrong
        if unknown := [] if wrong else [name for name in answers(root, roster, participant) if name not in known]:
            what, path = (
                f"has answers to {', '.join(unknown)}, which are not asked in any version of the protocol",
                storage.facts_path(root, participant),
            )
            yield Finding(what, path, remedy="participants.tsv leaves them out", verdict="warns")


def _of_participant(root: Path, roster: Roster, participant: str) -> Iterator[Finding]:
    path, known = storage.facts_path(root, participant), roster.facts.get(participant)
    if participant in roster.withdrawn:
        for left in storage.answers_of(root, participant) if participant not in roster.erased else ():
            yield Finding(
                f"participant {participant} withdrew, but this file still exists", left, remedy="delete the file"
            )
        return
    if _on_record(root, roster, participant) is not None:
        return
    latest = storage.protocol_path(root, roster.approved[-1].number if roster.approved else 1)
    given = (str(latest), "-p", participant, "--dataset", str(root))
    again = Remedy(
        "restore it from a backup, or record all answers again: {}", ("palpate", "facts", *given), suffices=False
    )
    try:
        if path.exists() and _content(path):
            yield Finding("does not match its hash in the roster", path, remedy=again)
        elif known is not None:
            yield Finding("is missing, although the roster has its hash", path, remedy=again)
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
    """Return the cell of a fact there, of one in participants.tsv; `n/a` for what is no answer to it today."""
    if cell == MISSING or not fact.has(cell):
        return MISSING
    if fact.group is None:
        return cell
    group = Decimal(str(fact.group))
    least = (Decimal(cell) / group).to_integral_value(ROUND_FLOOR) * group
    return f"{float(least):g} to below {float(least + group):g}"
