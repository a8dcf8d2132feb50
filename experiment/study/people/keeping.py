"""Keep names of participants, and forget them."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.errors import Remedy, RosterError
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.study.people import ENDING, File, Person, folder, known, place


def others(protocol: Protocol, dataset: Path) -> tuple[Path, ...]:
    """Return this user's other files of names of the study, as of its pilot. Raises `RosterError` as `folder`."""
    here = place(protocol, dataset)
    return tuple(one for one in sorted(folder().glob(f"{protocol.study.id}-*{ENDING}")) if one != here)


def keep(protocol: Protocol, dataset: Path, participant: str, person: Person) -> Path:
    """Save who a participant is, and return the file. Raises `RosterError` for an unreadable file, or no enrolment."""
    with _locked_file(protocol, dataset) as path:
        _write(path, protocol, dataset, {**known(protocol, dataset), participant: person})
    return path


def forget(protocol: Protocol, dataset: Path, participant: str) -> bool:
    """Delete what is known of a participant; return False if there was nothing."""
    if participant not in known(protocol, dataset):
        return False
    with _locked_file(protocol, dataset) as path:
        people = known(protocol, dataset)
        people.pop(participant, None)
        _write(path, protocol, dataset, people)
    return True


@contextmanager
def _locked_file(protocol: Protocol, dataset: Path) -> Iterator[Path]:
    """Yield the file, in a folder that only its owner may open, while nobody else changes it. Raises `RosterError`."""
    path = place(protocol, dataset)
    if path is None:
        remedy = Remedy("enrol the participant first", ("palpate", "enrol", "PROTOCOL"))
        raise RosterError(dataset, "nobody is enrolled here", remedy)
    inside = [one for one in path.resolve().parents if storage.roster_path(one).exists()]
    if inside:
        raise RosterError(
            f"{path} is inside the dataset {inside[0]}; datasets must not contain names",
            remedy="set XDG_DATA_HOME to another folder",
        )
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    with storage.locked(path.with_suffix(".lock")):
        yield path


def _write(path: Path, protocol: Protocol, dataset: Path, people: dict[str, Person]) -> None:
    kept = File(study=protocol.study.id, dataset=str(dataset.resolve()), people=dict(sorted(people.items())))
    before = os.umask(0o077)
    try:
        storage.write_json(path, kept.model_dump())
    finally:
        os.umask(before)
