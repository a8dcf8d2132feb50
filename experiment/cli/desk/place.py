"""Where a desk stands: which files and folders it works with."""

from dataclasses import dataclass
from pathlib import Path

from palpate.experiment.cli import files_with

RECORDINGS = Path("recordings")
"""The folder of a laboratory's recordings, unless another is chosen with the rig."""


@dataclass(frozen=True)
class Place:
    """Where a desk stands: files of protocol and rig, folders of dataset and recordings, and how sessions are begun."""

    protocol: Path | None = None
    rig: Path | None = None
    dataset: Path | None = None
    session: tuple[str, ...] = ()
    recordings: Path | None = None

    @classmethod
    def here(cls) -> "Place":
        """Return the study, the rig and the recordings of this folder: of several files the one changed last."""
        study, rig = (max(map(Path, files_with(table)), key=_changed_ns, default=None) for table in ("study", "rig"))
        return cls(study, rig, recordings=RECORDINGS if RECORDINGS.is_dir() else None)


def _changed_ns(path: Path) -> int:
    return path.stat().st_mtime_ns
