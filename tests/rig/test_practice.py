"""A session practiced at a real terminal: the keys are an experimenter's, all that is beyond the ports is simulated."""

from __future__ import annotations

import os
import pty
import re
import select
import subprocess
import sys
from pathlib import Path

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment import storage
from palpate.experiment.dataset import checks
from palpate.experiment.dataset.verify import verify
from palpate.experiment.protocol.files import shipped
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Answer, Ignored
from tests.approved import on_any_machine
from tests.conftest import Palpate
from tests.experiment.protocol.small import SMALL
from tests.rig.laboratory import write_rig
from tests.rig.rehearsed import assert_all_say

COMMAND = """\
from palpate.experiment.__main__ import main
from palpate.experiment.rehearsal.kinds.footstep import participant
from tests.rig.laboratory import HURRIED
vars(participant).update(HURRIED)
main()
"""
"""The command, for which no participant only thinks."""

QUESTION = re.compile(
    r"Armed: the participant may step\.\n|says: (?P<said>[^\n]*)\.\n|(?P<key>participant say\?\n[^\n]*WHAT WAS DONE: )"
    r"|type (?P<again>\S) again[^\n]*again: |\[Enter\] [^\n]*: |blank, and press Enter: "
    r"|(?P<agree>\[y\] [^\n]*: )"
)
KEYS = {"felt": "f", "cork": "k", "kraft paper": "p", "foil": "o", "film": "i"}
TRIALS = 4
PAUSED = (
    "The session is paused, with 1 answer on disk: it was interrupted at the keyboard. "
    "To continue it, run the same command."
)


@pytest.fixture
def study(tmp_path: Path) -> Path:
    file = tmp_path / "small.toml"
    file.write_text(SMALL.replace("repetitions = 3", "repetitions = 2"), "utf-8")
    return file


def practice(folder: Path, *arguments: str, stop_after: int = TRIALS, stop: int = 2) -> tuple[int, str]:
    """Give the command at a terminal, and key what the participant says; `stop` it once so many are answered.

    By default it is stopped as by Ctrl-C.
    """
    ours, theirs = pty.openpty()
    command = [sys.executable, "-P", "-c", COMMAND, "run", *arguments, "--practice", "--lines"]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    process = subprocess.Popen(
        command, cwd=folder, env=environment, stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True
    )
    os.close(theirs)
    screen, at, said, answered, waits = "", 0, "", 0, False
    try:
        while True:
            if (asked := QUESTION.search(screen, at)) is None:
                assert select.select([ours], [], [], 30)[0], screen
                try:
                    screen += os.read(ours, 65536).decode().replace("\r", "")
                except OSError:
                    return process.wait(10), screen
                continue
            at = asked.end()
            if "Armed" in asked[0]:
                os.write(ours, b"f")
            elif asked["said"] is not None:
                said = asked["said"]
                if waits:
                    os.write(ours, f"{KEYS[said]}\n".encode())
                waits = False
            elif asked["key"] is not None and answered == stop_after:
                process.send_signal(stop)
            elif asked["key"] is not None:
                answered += 1
                # Who hesitates speaks after the question.
                waits = not said
                if said:
                    os.write(ours, f"{KEYS[said]}\n".encode())
                said = ""
            else:
                os.write(ours, f"{'y' if asked['agree'] else asked['again'] or ''}\n".encode())
    finally:
        os.close(ours)
        process.kill()


def test_a_session_is_practiced_paused_and_continued_at_a_terminal(
    tmp_path: Path, study: Path, palpate: Palpate, monkeypatch: pytest.MonkeyPatch, approved: SnapshotAssertion
) -> None:
    code, screen = practice(tmp_path, "small.toml", "--task", "one", stop_after=1)
    assert (code, PAUSED in " ".join(screen.split())) == (0, True), screen
    at_once = "Opening the PRACTICE session, with a simulated laboratory ...\n"
    assert screen.startswith(f"{at_once}PRACTICE - simulated participants")
    assert "'felt' and 'cork'" in screen
    assert "Familiarization, up to 55 s." in screen
    code, rest = practice(tmp_path, "small.toml", "--task", "one")
    assert (code, "complete: 4 answers" in rest) == (0, True), rest
    root = tmp_path / "participants" / "practice-small"
    entries = journal.read(storage.journal_path(root, "01", "one")).entries
    assert "--task two" in rest
    told = re.findall(r"says: (.*)\.\n", screen)[:1] + re.findall(r"says: (.*)\.\n", rest)
    answers = [entry for entry in entries if isinstance(entry, Answer)]
    assert [(one.answered, one.key) for one in answers] == [(name, KEYS[name]) for name in told]
    # What was typed before the participant had spoken answered nothing.
    assert sum(isinstance(entry, Ignored) for entry in entries) >= TRIALS
    assert_all_say(root, "PRACTICE")
    assert checks.load_sound(root).purpose == "PRACTICE"
    assert verify(root).refused == 0
    code, _, err = palpate("withdraw", study, "-p", "01", "--reason", "moved away", "--dataset", root)
    assert code == 2
    assert on_any_machine(err, tmp_path) == approved
    monkeypatch.chdir(tmp_path)
    code, tables, _ = palpate("analyse", root, "--no-figures")
    assert (code, tables.count("PRACTICE") > 0) == (0, True)
    made = [path for path in (root / "derivatives").rglob("*") if path.is_file()]
    assert made
    assert [path for path in made if "PRACTICE" not in path.read_text("utf-8")] == []


def test_a_task_that_was_practiced_has_its_tables_whatever_ends_the_next(
    tmp_path: Path, study: Path, palpate: Palpate
) -> None:
    code, screen = practice(tmp_path, "small.toml", stop_after=TRIALS + 1, stop=9)
    assert code == -9, screen
    root = tmp_path / "participants" / "practice-small"
    assert verify(root).refused == 0
    code, out, err = palpate("analyse", root, "--no-figures", "--full", "--out", tmp_path / "tables")
    assert (code, "no footer" in err, "PRACTICE" in out) == (0, True, True), err


@pytest.mark.usefixtures("working_folder")
def test_a_new_study_of_five_materials_is_practiced_and_has_its_tables(
    tmp_path: Path, palpate: Palpate, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    materials = [word for name, key in KEYS.items() for word in ("--material", f"{name}, {key}")]
    assert palpate("new", "mystudy.toml", *materials, "--tasks", "virtual", "--repetitions", 1, "--yes")[0] == 0
    code, screen = practice(tmp_path, "mystudy.toml", "--task", "virtual", stop_after=5)
    assert (code, "complete: 5 answers" in screen) == (0, True), screen
    code, tables, err = palpate("analyse", "participants/practice-mystudy", "--no-figures")
    assert (code, err) == (0, "")
    assert [name for name in KEYS if name not in tables] == []


def test_fewer_trials_are_practiced_in_a_folder_of_their_own(tmp_path: Path, study: Path) -> None:
    code, screen = practice(tmp_path, "small.toml", "--task", "one", "--repetitions", "1", stop_after=2)
    assert (code, "complete: 2 answers" in screen) == (0, True), screen
    root = tmp_path / "participants" / "practice-small-1-of-each"
    (onward,) = re.findall(r"palpate run (\S+) (.*--task two)", screen)
    assert onward[0] == "small.toml"
    assert "--repetitions 1 " in onward[1]
    assert len(journal.read(storage.journal_path(root, "01", "one")).header.order) == 2
    assert verify(root).refused == 0
    assert not (root.parent / "practice-small").exists()


@pytest.mark.parametrize(
    ("options", "refused"),
    [
        (["--practice", "-p", "99"], "no participant '99': this study has '01' to '06'"),
        (["--practice", "--task", "three"], "does not do task 'three'; allowed: one, two; choose one of these"),
        (["--practice", "--recordings", "there"], "got --recordings with --practice"),
        (["--practice", "--rig", "rig.toml"], "rig.toml: is a real rig"),
        (
            ["--practice", "--dataset", "."],
            "is not the dataset of practice, and practice writes only to its own datasets",
        ),
        ([], "--participant or --rig is missing"),
        (["-p", "01", "--rig", "rig.toml", "--repetitions", "1"], "got --repetitions"),
    ],
)
def test_what_cannot_be_practiced_is_refused_and_leaves_nothing(
    tmp_path: Path,
    study: Path,
    options: list[str],
    refused: str,
    palpate: Palpate,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    write_rig(tmp_path, "rehearsal", port='"/dev/none"', address='"127.0.0.1:1"')
    before = sorted(tmp_path.rglob("*"))
    code, _, err = palpate("run", study, *options)
    assert (code, refused in err) == (2, True), err
    assert sorted(tmp_path.rglob("*")) == before


def test_practice_and_a_rehearsal_stand_apart(
    tmp_path: Path, one: Path, palpate: Palpate, approved: SnapshotAssertion
) -> None:
    code, _, err = palpate("run", shipped("okamoto2012.toml"), "--practice", "--dataset", one)
    assert code == 2
    assert on_any_machine(err, tmp_path) == approved


def test_a_task_that_presents_one_material_is_practiced_and_analysed(tmp_path: Path, palpate: Palpate) -> None:
    (tmp_path / "small.toml").write_text(
        SMALL.replace('stimulus = "real"', 'stimulus = "real"\nmaterials = ["cork"]'), "utf-8"
    )
    code, screen = practice(tmp_path, "small.toml", "--task", "two", stop_after=TRIALS)
    assert (code, "complete: 2 answers" in screen) == (0, True), screen
    root = tmp_path / "participants" / "practice-small"
    order = journal.read(storage.journal_path(root, "01", "two")).header.order
    assert [trial.presented for trial in order] == [("cork",)] * 2
    assert verify(root).refused == 0
    code, out, err = palpate("analyse", root, "--no-figures", "--full", "--out", tmp_path / "tables")
    assert (code, "felt is not" in out) == (0, True), err
