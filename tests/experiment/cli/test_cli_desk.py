"""What a session's command does for its screens: their first view, and what it begins and ends beside them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from experiment import storage
from experiment.cli import desk, session
from experiment.protocol.files import shipped
from experiment.protocol.models import Protocol


class Process:
    """Stands for the process of a session or of a participant's screen, and keeps what was done to it."""

    def __init__(self, command: list[str], **_: Any) -> None:
        assert {"screen", "--session-at"} & set(command)
        self.done: list[str] = []
        begun.append(self)

    def kill(self) -> None:
        self.done.append("kill")

    def wait(self) -> int:
        self.done.append("wait")
        return -9

    def send_signal(self, number: int) -> None:
        self.done.append(f"signal {number}")

    def poll(self) -> int | None:
        self.done.append("poll")
        return None


begun: list[Process] = []


@pytest.fixture(autouse=True)
def _no_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    begun.clear()
    monkeypatch.setattr("subprocess.Popen", Process)


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    made = tmp_path / "rig.toml"
    made.write_text(shipped("rigs/rehearsal.toml").read_text("utf-8") + "\n[screen]\n", "utf-8")
    return made


def test_the_screen_of_a_session_that_failed_covers_the_display_no_longer(tmp_path: Path, rig: Path) -> None:
    with pytest.raises(KeyboardInterrupt), desk.beside(tmp_path / "s", tmp_path / "p.toml", rig) as opened:
        assert opened
        raise KeyboardInterrupt
    assert begun[0].done == ["kill", "wait"]


def test_the_screen_of_a_session_that_ended_well_says_thanks_and_ends_by_itself(tmp_path: Path, rig: Path) -> None:
    with desk.beside(tmp_path / "s", tmp_path / "p.toml", rig):
        pass
    assert begun[0].done == ["poll"]


def test_an_interrupt_while_a_console_is_opened_ends_the_session_that_was_begun_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr(session, "_wait_for", interrupted)
    with pytest.raises(KeyboardInterrupt):
        session._attend(tmp_path, "01", "console")
    assert begun[0].done == ["signal 2"]


def test_without_a_table_for_it_no_screen_is_opened(tmp_path: Path) -> None:
    with desk.beside(tmp_path / "s", tmp_path / "p.toml", shipped("rigs/rehearsal.toml")) as opened:
        assert not opened
    assert not begun


@pytest.mark.parametrize(
    ("purpose", "practice", "label"),
    [("PILOT", False, "PILOT"), ("STUDY", False, ""), (None, False, ""), (None, True, "PRACTICE")],
)
def test_a_pilot_is_told_from_a_study_before_its_first_session(
    tmp_path: Path, protocol: Protocol, purpose: str | None, practice: bool, label: str
) -> None:
    if purpose is not None:
        seed = storage.seed_path(tmp_path)
        seed.parent.mkdir(parents=True, exist_ok=True)
        seed.write_text(f'{{"seed": 1, "purpose": "{purpose}"}}', "utf-8")
    view = session._first_view(protocol, "03", tmp_path, practice=practice)
    assert (view.label, view.study, view.participant) == (label, protocol.study.id, "03")
