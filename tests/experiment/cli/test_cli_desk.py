"""What a session's command does for its screens: their first view, and what it begins and ends beside them."""

from __future__ import annotations

from pathlib import Path
from typing import Any, BinaryIO

import pytest

from palpate.experiment import storage
from palpate.experiment.cli import desk, options, session
from palpate.experiment.cli.analysis import status_of
from palpate.experiment.errors import DatasetError, LinkError
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.models import Protocol
from tests.approved import Refuses
from tests.conftest import Palpate
from tests.experiment.protocol.small import SMALL


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
    with pytest.raises(KeyboardInterrupt), desk.screen_beside(tmp_path / "s", tmp_path / "p.toml", rig) as opened:
        assert opened
        raise KeyboardInterrupt
    assert begun[0].done == ["kill", "wait"]


def test_the_screen_of_a_session_that_ended_well_says_thanks_and_ends_by_itself(tmp_path: Path, rig: Path) -> None:
    with desk.screen_beside(tmp_path / "s", tmp_path / "p.toml", rig):
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


def test_why_a_session_did_not_begin_is_told_and_stays_nowhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refuses: Refuses
) -> None:
    class Refused(Process):
        def __init__(self, command: list[str], *, stdout: BinaryIO, **_: Any) -> None:
            super().__init__(command)
            stdout.write(b"palpate: participant 02 withdrew (was cold) and can no longer take part\n")
            stdout.flush()

        def poll(self) -> int:
            return 2

    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr("subprocess.Popen", Refused)
    with refuses(LinkError):
        session._attend(tmp_path / "study", "02", "console")
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_every_error_of_a_file_that_kept_a_session_from_beginning_has_its_line(
    palpate: Palpate, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = ["  line 31: actuator: got 1", "  line 40: audio: got 3"]

    def ended(*_: object) -> None:
        raise LinkError("\n".join(["rig.toml: 2 errors", *found]))

    monkeypatch.setattr(session, "_serve", ended)
    code, _, err = palpate("run", "okamoto2012", "--practice", "--serve", "127.0.0.1")
    assert (code, err.splitlines()[1:]) == (2, found)


def test_without_a_table_for_it_no_screen_is_opened(tmp_path: Path) -> None:
    with desk.screen_beside(tmp_path / "s", tmp_path / "p.toml", shipped("rigs/rehearsal.toml")) as opened:
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
        seed.write_text(f'{{"format": {storage.DATASET_FORMAT}, "seed": 1, "purpose": "{purpose}"}}', "utf-8")
    view = session._first_view(protocol, "03", tmp_path, practice=practice)
    assert (view.label, view.study, view.participant) == (label, protocol.study.id, "03")


def test_what_was_practiced_stands_for_a_study_that_nobody_is_enrolled_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Path] = []

    def status(given: Path, today: object) -> None:
        asked.append(given)
        raise DatasetError("read no further")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("palpate.experiment.dataset.status.status", status)
    file = Path("small.toml")
    file.write_text(SMALL, "utf-8")
    practiced = Path("participants/practice-small")
    for folder in (None, practiced, Path("participants/small")):
        if folder is not None:
            folder.mkdir(parents=True)
        with pytest.raises(DatasetError, match="read no further"):
            status_of(file)
    assert asked == [file, practiced, file]


@pytest.mark.parametrize("command", [("run", "okamoto2012", "--practice"), ("desk", "okamoto2012")])
def test_nothing_opens_where_the_screen_would_be_drawn_into_a_file(
    palpate: Palpate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: tuple[str, ...]
) -> None:
    """The screen is drawn on the standard error: with `2> FILE` it would be blank while the session stimulates."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("subprocess.Popen", lambda *_, **__: pytest.fail("a session was begun"))
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    monkeypatch.setattr("sys.stderr.isatty", lambda: False, raising=False)
    code, out, err = palpate(*command)
    assert (code, out) == (2, "")
    assert "2> FILE" in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("command", "told"),
    [
        (("new", "none.txt"), "A new protocol."),
        (("rehearse", "--participants", "16"), "REHEARSAL: setting up the simulated laboratory ..."),
        (("run", "okamoto2012", "--lines", "--practice", "--task", "x"), "Opening the PRACTICE session, with a "),
        (
            ("screen", "okamoto2012", "--rig", "none.toml"),
            "Opening the participant's screen; this takes a few seconds.",
        ),
        (("status", "none"), "Reading the study; this takes a few seconds."),
    ],
)
@pytest.mark.parametrize("terminal", [True, False])
def test_a_terminal_is_told_at_once_what_is_done(
    palpate: Palpate,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    command: tuple[str, ...],
    told: str,
    *,
    terminal: bool,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.stderr.isatty", lambda: terminal, raising=False)
    _, _, err = palpate(*command)
    assert err.startswith(told) is terminal


def test_a_line_with_an_indent_goes_on_further_in(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "44")
    options.say("Recordings:\n\n  8 m/s^2: 0.5 s, at most 8.1 m/s^2 at its peak")
    *_, whole, rest = capsys.readouterr().out.splitlines()
    assert (len(whole) <= 44, rest) == (True, "    peak")


def test_sentences_end_their_lines_between_words(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    said = (
        "The session is paused, with 1 answer on disk. To continue it, run the same command, today or tomorrow.\nHash: "
        + "0" * 90
    )
    for columns, lines in (("80", 4), ("2000", 2)):
        monkeypatch.setenv("COLUMNS", columns)
        options.say(said)
        printed = capsys.readouterr().out
        # No word is broken.
        assert printed.split() == said.split()
        assert len(printed.splitlines()) == lines
