"""Files that are whole and on disk: the order of what the operating system is asked, and nothing left behind."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from experiment import storage

pytestmark = pytest.mark.fsync


def test_a_file_is_on_disk_before_it_has_its_name_and_its_folder_after(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A power cut between any two steps leaves the old file or the new one."""
    path = tmp_path / "new" / "file"
    steps: list[tuple[str, int | bool]] = []
    fsync, replace = os.fsync, Path.replace

    def synced(descriptor: int) -> None:
        steps.append(("sync", path.exists()))
        fsync(descriptor)

    def replaced(self: Path, target: Path) -> Path:
        steps.append(("replace", self.stat().st_size))
        return replace(self, target)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(Path, "replace", replaced)
    storage.write(path, b"whole")
    assert steps[:3] == [("sync", False), ("replace", 5), ("sync", True)]
    assert path.read_bytes() == b"whole"


def test_a_write_that_fails_leaves_the_old_file_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_bytes(b"old")

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        storage.write(tmp_path / "file", b"new")
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("file", b"old")]


def test_anyone_may_read_what_was_written(tmp_path: Path) -> None:
    storage.write(tmp_path / "file", b"")
    assert (tmp_path / "file").stat().st_mode & 0o777 == 0o644
