"""Files that are whole and on disk: the order of what the operating system is asked, and nothing left behind."""

from __future__ import annotations

import os
import socket
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


def test_what_is_no_file_is_neither_waited_for_nor_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Opening a pipe waits until somebody writes, and a device has no end."""
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe")
    with socket.socket(socket.AF_UNIX) as made:
        made.bind("socket")
    for path in (Path("pipe"), Path("socket"), Path("/dev/zero")):
        with pytest.raises(OSError, match="a device, a pipe or a socket, not a file"):
            storage.read_bytes(path)
    with pytest.raises(IsADirectoryError):
        storage.read_bytes(tmp_path)
    with pytest.raises(OSError, match="null byte in its name"):
        storage.read_bytes(tmp_path / "a\0b")


def test_what_is_too_large_is_not_read(tmp_path: Path) -> None:
    with (tmp_path / "file").open("wb") as file:
        file.truncate(10 * 2**30)
    with pytest.raises(OSError, match="10,737,418,240 bytes, more than 268,435,456"):
        storage.read_bytes(tmp_path / "file")
    (tmp_path / "file").write_bytes(b"ab\r\n")
    assert storage.read_bytes(tmp_path / "file", 4) == b"ab\r\n"
    assert storage.read_text(tmp_path / "file") == "ab\n"
    with pytest.raises(OSError, match="4 bytes, more than 3"):
        storage.read_bytes(tmp_path / "file", 3)


@pytest.mark.parametrize(
    "text",
    ["[" * 40 + "]" * 40, '{"a":' * 100_000, "9" * 400, "9" * 5000, "NaN", "-Infinity", "1e400", '"\\ud800"', "{"],
)
def test_json_that_no_file_needs_is_refused(text: str) -> None:
    for one in (text, text.encode()):
        with pytest.raises(ValueError, match=r"\w"):
            storage.json_of(one)


def test_json_is_read_as_it_stands() -> None:
    assert storage.json_of('{"a": [1, -0.5, null, "\\u00e4\\ud83d\\ude00"]}') == {
        "a": [1, -0.5, None, "\u00e4\U0001f600"]
    }
