"""Files that are whole and on disk: the order of what the operating system is asked, and nothing left behind."""

from __future__ import annotations

import errno
import fcntl
import os
import socket
from pathlib import Path

import pytest

from palpate.experiment import storage
from tests.approved import Refuses

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


@pytest.mark.parametrize("umask", [0o022, 0o077, 0o002])
def test_modes_follow_the_umask_and_what_people_gave_is_their_owners(tmp_path: Path, umask: int) -> None:
    """The group may enter only where the umask lets it write, which says that a laboratory shares its files."""
    before = os.umask(umask)
    try:
        storage.write(tmp_path / "file", b"")
        mode = (tmp_path / "file").stat().st_mode & 0o777
        with storage.new_folder(tmp_path / "folder"):
            pass
        people = storage.people_folder(tmp_path)
        storage.owners_alone(tmp_path / "file")
    finally:
        os.umask(before)
    assert mode == 0o666 & ~umask
    assert (tmp_path / "file").stat().st_mode & 0o777 == (0o660 if umask == 0o002 else 0o600)
    assert (tmp_path / "folder").stat().st_mode & 0o777 == 0o777 & ~umask
    assert people.stat().st_mode & 0o777 == (0o770 if umask == 0o002 else 0o700)


LEFT, LINK = f".palpate-{'0' * 16}", f".palpate-{'1' * 16}"


def test_a_write_sweeps_what_a_killed_one_left_and_nothing_else(tmp_path: Path) -> None:
    """A link of such a name leads elsewhere; somebody else's file has another; and one is being written just now."""
    folder = tmp_path / "folder"
    (folder / LEFT).mkdir(parents=True)
    (folder / LEFT / "deep").write_bytes(b"torn")
    (folder / LEFT.replace("0", "3")).write_bytes(b"torn")
    (folder / ".palpate-mine").write_bytes(b"mine")
    (tmp_path / "precious").mkdir()
    (tmp_path / "precious" / "file").write_bytes(b"mine")
    (folder / LINK).symlink_to(tmp_path / "precious")
    with storage.temporary(folder) as held:
        storage.write(folder / "file", b"new")
        assert {path.name for path in folder.iterdir()} == {"file", ".palpate-mine", LINK, held.name}
    assert {path.name for path in folder.iterdir()} == {"file", ".palpate-mine", LINK}
    assert (tmp_path / "precious" / "file").read_bytes() == b"mine"


def test_a_file_that_another_sweep_takes_before_it_is_held_is_made_again(tmp_path: Path) -> None:
    made: list[Path] = []

    def swept_once(path: Path) -> None:
        path.write_bytes(b"new")
        made.append(path)
        if len(made) == 1:
            path.unlink()

    with storage.temporary(tmp_path, swept_once) as path:
        assert (path, path.read_bytes()) == (made[1], b"new")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_takes_its_place_whole_or_not_at_all(tmp_path: Path) -> None:
    out = tmp_path / "deep" / "out"
    with pytest.raises(KeyboardInterrupt), storage.new_folder(out) as partial:
        storage.create(partial / "a" / "file", b"whole")
        raise KeyboardInterrupt
    assert list(out.parent.iterdir()) == []
    with storage.new_folder(out) as partial:
        storage.create(partial / "a" / "file", b"whole")
        assert not out.exists()
    assert [path.name for path in out.parent.iterdir()] == ["out"]
    with pytest.raises(OSError, match="not empty"), storage.new_folder(out):
        pass
    assert (out / "a" / "file").read_bytes() == b"whole"


def test_what_is_no_file_is_neither_waited_for_nor_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refuses: Refuses
) -> None:
    """Opening a pipe waits until somebody writes, and a device has no end."""
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe")
    with socket.socket(socket.AF_UNIX) as made:
        made.bind("socket")
    for path in (Path("pipe"), Path("socket"), Path("/dev/zero")):
        with pytest.raises(OSError, match="it is a device, a pipe or a socket, not a file"):
            storage.read_bytes(path)
    with pytest.raises(IsADirectoryError):
        storage.read_bytes(tmp_path)
    with refuses(OSError):
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
        with pytest.raises(ValueError, match=r"\w") as refused:
            storage.json_of(one)
        assert "sys." not in str(refused.value)


def test_json_is_read_as_it_stands() -> None:
    assert storage.json_of('{"a": [1, -0.5, null, "\\u00e4\\ud83d\\ude00"]}') == {
        "a": [1, -0.5, None, "\u00e4\U0001f600"]
    }


def test_a_file_that_holds_what_is_to_be_written_is_left_as_it_is(tmp_path: Path) -> None:
    """A session's end writes the tables of all sessions; on a slow disk those that stay the same took a minute."""
    path, other = tmp_path / "file", tmp_path / "other"
    storage.write_bytes(path, b"content")
    before = path.stat()
    storage.write_bytes(path, b"content")
    assert (path.stat().st_ino, path.stat().st_mtime_ns) == (before.st_ino, before.st_mtime_ns)
    storage.write_bytes(path, b"Content")
    assert path.read_bytes() == b"Content"
    # A link is replaced by the file, whatever it leads to.
    other.symlink_to(path)
    storage.write_bytes(other, b"Content")
    assert not other.is_symlink()


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.ENOSYS])
def test_a_file_system_without_locks_names_the_file(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuses(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(fcntl, "flock", refuses)
    monkeypatch.setattr(fcntl, "lockf", refuses)
    with pytest.raises(OSError, match="Errno") as caught, storage.locked(tmp_path / "new" / "lock"):
        pytest.fail("nothing is held")
    assert (caught.value.filename, caught.value.errno) == (str(tmp_path / "new" / "lock"), number)
    assert storage.remedy(caught.value) == storage.REMEDIES[number]


def test_a_disk_that_is_full_names_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="Errno") as caught:
        storage.create(tmp_path / "file", b"new")
    assert caught.value.filename == str(tmp_path / "file")
    assert storage.remedy(caught.value) == storage.REMEDIES[errno.ENOSPC]
    with pytest.raises(OSError, match="Errno") as caught:
        storage.write(tmp_path / "other", b"new")
    assert caught.value.filename == str(tmp_path / "other")
    with pytest.raises(OSError, match="Errno") as caught, storage.new_folder(tmp_path / "folder") as partial:
        storage.create(partial / "a" / "file", b"new")
    assert caught.value.filename == str(tmp_path / "a" / "file")
