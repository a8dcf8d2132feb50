"""A study's dataset before its first session: begun once with one protocol and one seed; enrolment and withdrawal."""

from __future__ import annotations

import json
import secrets
from collections.abc import Callable
from datetime import date
from pathlib import Path

from filelock import FileLock

from experiment import storage
from experiment.errors import DatasetError
from experiment.protocol import approval, files
from experiment.protocol.models import Protocol
from experiment.records import journal
from experiment.study import roster

LOCK = ".study.lock"

SEED = "seed.json"
"""Beside the journals: the one seed that names every draw of a study."""


def default_root(protocol: Protocol) -> Path:
    """Where the dataset of a study stands unless another folder is named."""
    return Path("participants") / protocol.study.id


def enrol(
    protocol_file: Path, participant: str, consent_on: date | None, *, root: Path | None, seed: int | None
) -> Path:
    """Enrol the next participant; the first one begins the study's dataset and settles its seed.

    Args:
        protocol_file: the study's protocol.
        participant: the next label.
        consent_on: day of consent; None while there is none.
        root: folder of the dataset; None for `participants/STUDY`.
        seed: of the study's draws; None for the settled one, or a new one.

    Returns:
        The roster's file.

    Raises:
        RosterError: not the next label, or one that the study does not have.
        DatasetError: the folder is that of something else.
    """
    protocol = files.load(protocol_file)
    root = root or default_root(protocol)
    roster.find(roster.allocate(protocol, 0), participant)
    path = storage.roster_path(root)
    roster.Roster.load(path).check_next(participant)
    settle(root, protocol_file, protocol, seed)
    roster.Roster.load(path).enrol(participant, consent_on)
    return path


def seed_of(root: Path) -> int:
    """The seed that names every draw of the study with this dataset.

    Raises:
        DatasetError: the study has none, or its file is broken.
    """
    file = root / "sourcedata" / SEED
    try:
        return int(json.loads(file.read_text("utf-8"))["seed"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DatasetError(f"{file}: holds no seed; restore it from a backup or from a journal's header") from error


def consent(protocol_file: Path, participant: str, consent_on: date, *, root: Path | None) -> Path:
    """Record the consent of a participant who enrolled without it.

    Raises:
        RosterError: the participant is not enrolled, has consented already, or has withdrawn.
    """
    path = storage.roster_path(root or default_root(files.load(protocol_file)))
    roster.Roster.load(path).consent(participant, consent_on)
    return path


def withdraw(
    protocol_file: Path, participant: str, reason: str, *, root: Path | None, rebuild: Callable[[Path], None]
) -> Path:
    """Record that a participant withdrew; the dataset says so, and analysis leaves them out.

    Args:
        protocol_file: the study's protocol.
        participant: who withdrew.
        reason: why, one line.
        root: folder of the dataset; None for `participants/STUDY`.
        rebuild: makes the dataset's tables anew, from its folder.

    Raises:
        RosterError: the participant is not enrolled, or the reason is no line of text.
        SessionLocked: a session of theirs is running.
    """
    root = root or default_root(files.load(protocol_file))
    path = storage.roster_path(root)
    known = roster.Roster.load(path)
    known.check_enrolled(participant)
    with journal.locked(storage.participant_folder(root, participant), participant):
        known.withdraw(participant, reason)
        if storage.journals(root):
            rebuild(root)
    return path


def settle(root: Path, protocol_file: Path, protocol: Protocol, seed: int | None) -> int:
    """Keep protocol and seed beside the journals at the first call, and hold every later one to them.

    The protocol's copy is written last: without it the study has not begun.
    """
    source = root / "sourcedata"
    kept, file = source / "protocol.toml", source / SEED
    begun = {"sourcedata", f"sourcedata/{SEED}", f"sourcedata/{LOCK}"}
    if not kept.exists() and root.exists() and {p.relative_to(root).as_posix() for p in root.rglob("*")} - begun:
        raise DatasetError(f"{root}: is no dataset that palpate run began; choose another folder with --dataset")
    if (source / "rehearsal.json").exists():
        raise DatasetError(f"{root}: is a rehearsal's; choose another folder with --dataset")
    source.mkdir(parents=True, exist_ok=True)
    with FileLock(source / LOCK):
        if not kept.exists():
            drawn = secrets.randbelow(2**31) if seed is None else seed
            storage.write_json(file, {"seed": drawn})
            storage.write_bytes(kept, protocol_file.read_bytes())
        elif approval.sha256(files.load(kept)) != approval.sha256(protocol):
            raise DatasetError(
                f"{root}: was begun with another form of the protocol; run {kept}, or choose another --dataset"
            )
    settled = seed_of(root)
    if seed not in (None, settled):
        raise DatasetError(f"{root}: its draws are named by seed {settled}, not {seed}; leave out --seed")
    return settled
