"""Who participants are: kept in a file of its owner's, in no dataset, and gone once they withdraw."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from palpate.experiment import storage
from palpate.experiment.errors import RosterError
from palpate.experiment.study import people
from palpate.experiment.study.people import Person, keeping
from tests.approved import Refuses
from tests.experiment.protocol.small import protocol

STUDY = protocol()
HERE = Path("small")
PILOT = Path("small-pilot")
ANN = Person(name="Ann Übermut", contact="room 7")


@pytest.fixture(autouse=True)
def _home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    monkeypatch.chdir(tmp_path)
    for number, dataset in enumerate((HERE, PILOT)):
        begin(dataset, number)


def begin(dataset: Path, seed: int) -> None:
    storage.write_json(
        storage.seed_path(dataset),
        {"format": storage.DATASET_FORMAT, "seed": seed, "purpose": "STUDY", "salt": "0" * 32},
    )


def stored(dataset: Path) -> Path:
    found = people.place(STUDY, dataset)
    assert found is not None
    return found


def test_people_are_kept_and_forgotten_one_by_one() -> None:
    assert people.known(STUDY, HERE) == {}
    keeping.keep(STUDY, HERE, "02", ANN)
    keeping.keep(STUDY, HERE, "01", Person(contact="room 8"))
    assert people.known(STUDY, HERE) == {"01": Person(contact="room 8"), "02": ANN}
    assert keeping.forget(STUDY, HERE, "02")
    assert not keeping.forget(STUDY, HERE, "02")
    assert people.known(STUDY, HERE) == {"01": Person(contact="room 8")}
    assert "Übermut" not in stored(HERE).read_text("utf-8")


def test_only_the_owner_may_read_the_file_and_its_folder() -> None:
    path = keeping.keep(STUDY, HERE, "01", ANN)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700


def test_a_pilot_and_its_study_keep_their_people_apart() -> None:
    keeping.keep(STUDY, PILOT, "01", ANN)
    assert people.known(STUDY, HERE) == {}
    assert not keeping.forget(STUDY, HERE, "01")
    assert people.known(STUDY, PILOT) == {"01": ANN}
    # However the folder is named, it is the same one.
    assert people.known(STUDY, PILOT.resolve()) == {"01": ANN}


def test_names_follow_a_dataset_that_is_moved(tmp_path: Path) -> None:
    path = keeping.keep(STUDY, HERE, "01", ANN)
    (tmp_path / "archive").mkdir()
    moved = HERE.rename(tmp_path / "archive" / "of 2026")
    assert people.known(STUDY, moved) == {"01": ANN}
    assert keeping.forget(STUDY, moved, "01")
    assert "Übermut" not in path.read_text("utf-8")


def test_where_a_dataset_lost_its_seed_the_studys_other_files_are_named(tmp_path: Path) -> None:
    path = keeping.keep(STUDY, HERE, "01", ANN)
    assert keeping.others(STUDY, HERE) == ()
    assert keeping.others(STUDY, PILOT) == (path,)
    storage.seed_path(HERE).unlink()
    assert (people.place(STUDY, HERE), people.known(STUDY, HERE)) == (None, {})
    assert not keeping.forget(STUDY, HERE, "01")
    assert keeping.others(STUDY, HERE) == (path,)
    with pytest.raises(RosterError, match="nobody is enrolled"):
        keeping.keep(STUDY, HERE, "01", ANN)
    storage.seed_path(HERE).write_text("[]", "utf-8")
    assert people.place(STUDY, HERE) is None


def test_the_names_file_shows_neither_seed_nor_salt() -> None:
    begin(HERE, 1234567)
    name = stored(HERE).name
    assert "1234567" not in name
    begin(HERE, 1234568)
    assert stored(HERE).name != name


def test_two_who_write_at_once_lose_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another process writes just before this one may: what it wrote is read, not what stood there before."""

    class Held:
        def __init__(self, path: Path) -> None:
            assert path == stored(HERE).with_suffix(".lock")

        def __enter__(self) -> None:
            monkeypatch.undo()
            monkeypatch.setenv("XDG_DATA_HOME", data)
            monkeypatch.chdir(here)
            keeping.keep(STUDY, HERE, "02", Person(name="Ben"))

        def __exit__(self, *_: object) -> None:
            pass

    data, here = os.environ["XDG_DATA_HOME"], Path.cwd()
    monkeypatch.setattr(storage, "locked", Held)
    keeping.keep(STUDY, HERE, "01", ANN)
    assert people.known(STUDY, HERE) == {"01": ANN, "02": Person(name="Ben")}


def test_without_a_home_the_file_has_no_place(monkeypatch: pytest.MonkeyPatch, refuses: Refuses) -> None:
    def nowhere() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_DATA_HOME")
    monkeypatch.setattr(Path, "home", nowhere)
    with refuses(RosterError):
        people.known(STUDY, HERE)


def test_no_dataset_takes_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refuses: Refuses) -> None:
    roster = storage.roster_path(tmp_path / "dataset")
    roster.parent.mkdir(parents=True)
    roster.touch()
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "dataset" / "sourcedata" / "mine"))
    with refuses(RosterError):
        keeping.keep(STUDY, HERE, "01", ANN)
    assert not stored(HERE).exists()


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b'{"study": "s", "people": {"01": {"age": 3}}}', b"\xff"])
def test_a_file_that_cannot_be_read_is_told(content: bytes) -> None:
    path = stored(HERE)
    path.parent.mkdir(parents=True)
    path.write_bytes(content)
    with pytest.raises(RosterError, match="cannot be read"):
        people.known(STUDY, HERE)
