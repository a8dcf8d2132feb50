"""Where the files of a session stand in a dataset."""

from __future__ import annotations

from pathlib import Path


def participant_folder(dataset: Path, participant: str) -> Path:
    """Where everything of a participant's sessions stands inside a dataset."""
    return dataset / "sourcedata" / f"sub-{participant}"


def journal_path(dataset: Path, participant: str, task: str) -> Path:
    """Where the journal of a session stands inside a dataset."""
    return participant_folder(dataset, participant) / f"sub-{participant}_task-{task}_journal.jsonl"


def rig_path(journal_file: Path) -> Path:
    """Where the rig file of a session stands, beside its journal."""
    return journal_file.with_name(journal_file.name.replace("_journal.jsonl", "_rig.toml"))


def foot_path(journal_file: Path) -> Path:
    """Where the raw tracker frames of a session stand, beside its journal."""
    return journal_file.with_name(journal_file.name.replace("_journal.jsonl", "_foot.cobs"))
