"""Who participants are: kept in a file of its owner's, in no dataset, and gone once they withdraw."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest

from experiment import storage
from experiment.errors import RosterError
from experiment.study import people
from experiment.study.people import Person
from tests.experiment.protocol.small import protocol

STUDY = protocol()
ANN = Person(name="Ann Übermut", contact="room 7")


@pytest.fixture(autouse=True)
def _home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))


def test_people_are_kept_and_forgotten_one_by_one() -> None:
    assert people.known(STUDY) == {}
    people.keep(STUDY, "02", ANN)
    people.keep(STUDY, "01", Person(contact="room 8"))
    assert people.known(STUDY) == {"01": Person(contact="room 8"), "02": ANN}
    assert people.forget(STUDY, "02")
    assert not people.forget(STUDY, "02")
    assert people.known(STUDY) == {"01": Person(contact="room 8")}
    assert "Übermut" not in people.place(STUDY).read_text("utf-8")


def test_only_the_owner_may_read_the_file_and_its_folder() -> None:
    path = people.keep(STUDY, "01", ANN)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700


def test_no_dataset_takes_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    roster = storage.roster_path(tmp_path / "dataset")
    roster.parent.mkdir(parents=True)
    roster.touch()
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "dataset" / "sourcedata" / "mine"))
    with pytest.raises(RosterError, match="names stand in no dataset"):
        people.keep(STUDY, "01", ANN)
    assert not people.place(STUDY).exists()


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b'{"study": "s", "people": {"01": {"age": 3}}}', b"\xff"])
def test_a_file_that_cannot_be_read_is_told(content: bytes) -> None:
    path = people.place(STUDY)
    path.parent.mkdir(parents=True)
    path.write_bytes(content)
    with pytest.raises(RosterError, match="cannot be read"):
        people.known(STUDY)
