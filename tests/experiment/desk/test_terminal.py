"""The experimenter's screen in a pipe."""

from __future__ import annotations

import io
import os
import select
from collections import deque
from collections.abc import Callable

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.desk.messages import ENTER, Correct, TakeNote, TellIncident
from palpate.experiment.desk.questions import (
    Answered,
    Arm,
    Confirm,
    Debrief,
    Familiarise,
    Instructed,
    Level,
    Notice,
    Place,
    Rest,
    TrialAnswer,
)
from palpate.experiment.desk.terminal import REMARKS, TerminalConsole, typed_ahead
from palpate.experiment.errors import ScreenGone
from tests.approved import Refuses

ANSWERS = {"c": "copy paper"}
OTHERS: dict[str, str] = {}


def console(*typed: str) -> tuple[TerminalConsole, io.StringIO, list[str]]:
    lines, screen, prompts = deque(typed), io.StringIO(), list[str]()

    def ask(prompt: str) -> str:
        prompts.append(prompt)
        return lines.popleft()

    return TerminalConsole(write=screen, ask=ask, heading="Participant 01"), screen, prompts


def test_an_answer_is_keyed_shown_and_confirmed_by_the_same_key(approved: SnapshotAssertion) -> None:
    one, _, prompts = console("C ", "c")
    assert one.ask(TrialAnswer(3, ANSWERS, "n", OTHERS)).key == "c"
    assert one.ask(Confirm("c", "copy paper")).key == ENTER
    assert prompts == approved


def test_pictures_of_an_instruction_are_named_to_whoever_shows_them() -> None:
    one, screen, _ = console()
    one.tell(Instructed("Step.", pictures=("foot.png",)))
    assert "foot.png." in screen.getvalue().split()


@pytest.mark.parametrize("typed", ["", "n", "no", "cc", "enter"])
def test_no_other_key_confirms_and_enter_that_repeats_does_not(typed: str) -> None:
    one, _, _ = console(typed)
    assert one.ask(Confirm("c", "copy paper")).key != ENTER


def test_a_remark_in_place_of_a_confirmation_is_refused_by_name_and_not_lost_without_a_word() -> None:
    one, screen, _ = console("note door slammed", "x")
    for lines in (1, 0):
        before = screen.tell()
        assert one.ask(Confirm("c", "copy paper")).key != ENTER
        assert ("note door slammed" in screen.getvalue()[before:]) is bool(lines)


def test_an_event_is_what_happened_and_what_was_done() -> None:
    one, _, _ = console("adverse Fell.", "adverse Fell.; Sat down.", "deviation The door; closed", "n")
    asked = TrialAnswer(3, ANSWERS, "n", OTHERS)
    fell, door = one.ask(asked).remark, one.ask(asked).remark
    assert fell == TellIncident(sort="adverse event", text="Fell.", done="Sat down.", trial=3)
    assert door == TellIncident(sort="deviation", text="The door", done="closed", trial=3)


def test_a_wrong_key_is_named_and_asked_again() -> None:
    one, screen, _ = console("x", "", "n")
    assert one.ask(TrialAnswer(3, ANSWERS, "n", OTHERS)).key == "n"
    told = "is not a valid key; type one of c n, or " + REMARKS
    assert screen.getvalue().splitlines() == [f"'x' {told}", f"'' {told}"]


def test_a_note_and_a_correction_take_the_place_of_a_key() -> None:
    one, screen, _ = console(
        "note Coughs. ",
        "correct 12 N misheard, a door slammed",
        "note",
        "correct x c why",
        f"correct {'1' * 4301} c why",
        "c",
    )
    assert one.ask(TrialAnswer(3, ANSWERS, "n", OTHERS)).remark == TakeNote(text="Coughs.", trial=3)
    assert one.ask(TrialAnswer(3, ANSWERS, "n", OTHERS)).remark == Correct(
        trial=12, key="n", reason="misheard, a door slammed"
    )
    assert one.ask(TrialAnswer(3, ANSWERS, "n", OTHERS)).key == "c"
    assert screen.getvalue().count("not a valid key") == 3


def test_a_correction_without_a_reason_is_asked_for_one(approved: SnapshotAssertion) -> None:
    one, screen, _ = console("correct 2 n", "c")
    assert one.ask(TrialAnswer(3, ANSWERS, "n", OTHERS)).key == "c"
    assert screen.getvalue() == approved


def test_a_remark_that_could_deceive_does_not_go_on_record(approved: SnapshotAssertion) -> None:
    one, screen, _ = console("note all\x1b[2Jwell", "c")
    assert one.ask(TrialAnswer(3, ANSWERS, "n", OTHERS)).key == "c"
    assert screen.getvalue() == approved


def test_a_session_ends_with_enter_and_takes_remarks_until_then(approved: SnapshotAssertion) -> None:
    one, screen, prompts = console("bye", "note Felt all.", "")
    assert one.ask(Debrief()).remark == TakeNote(text="Felt all.")
    assert one.ask(Debrief()).remark is None
    assert [screen.getvalue(), *prompts] == approved


QUESTIONS: tuple[Callable[[TerminalConsole], object], ...] = (
    lambda one: one.ask(TrialAnswer(1, ANSWERS, "n", OTHERS)).key,
    lambda one: one.ask(Confirm("c", "copy paper")).key == ENTER,
    lambda one: one.ask(Debrief()),
    lambda one: one.ask(Place(1, ("foil",))),
    lambda one: one.ask(Rest("")),
    lambda one: one.ask(Level(50.0, 80.0, "", probe=False, by="experimenter")).key,
    lambda one: one.ask(Familiarise("", 0, 1, {})).key,
)


@pytest.mark.parametrize("question", QUESTIONS)
def test_what_was_typed_before_a_question_does_not_answer_it(question: Callable[[TerminalConsole], object]) -> None:
    """On a pseudo-terminal: a line that was ended, and one that was begun, are both dropped, told, and kept."""
    far, near = os.openpty()
    screen = io.StringIO()

    def ask(prompt: str) -> str:
        os.write(far, b"\n" if "Enter" in prompt else b"c\n")
        line = b""
        while not line.endswith(b"\n"):
            line += os.read(near, 1)
        return line.decode().strip()

    with os.fdopen(near, closefd=False) as terminal:
        one = TerminalConsole(write=screen, ask=ask, heading="", early=lambda: typed_ahead(terminal))
        os.write(far, b"n\nn")
        # Until the terminal has it.
        assert select.select([near], [], [], 5)[0]
        question(one)
    assert ": n, Enter, n.\n" in screen.getvalue()
    assert (one.ignored(), one.ignored()) == ("n\nn", "")
    assert typed_ahead(io.StringIO("n\n")) == ""


@pytest.mark.parametrize("when", ["isatty", "read"])
def test_a_terminal_that_is_lost_while_its_input_is_dropped_is_a_screen_that_is_gone(
    monkeypatch: pytest.MonkeyPatch, when: str, refuses: Refuses
) -> None:
    """It hangs up before its settings are read, or before they are restored."""
    far, near = os.openpty()
    before = getattr(os, when)

    def lost(descriptor: int, *size: int) -> object:
        found = before(descriptor, *size)
        os.close(far)
        return found

    with os.fdopen(near) as terminal:
        one = TerminalConsole(write=io.StringIO(), ask=input, heading="", early=lambda: typed_ahead(terminal))
        monkeypatch.setattr(os, when, lost)
        with refuses(ScreenGone):
            one.ask(Rest(""))


def test_the_real_object_is_laid_out_before_the_participant_may_step(approved: SnapshotAssertion) -> None:
    one, screen, prompts = console("")
    one.ask(Place(2, ("copy paper",)))
    one.ask(Arm(2, 3, 40, may="step"))
    assert [*prompts, screen.getvalue()] == approved


def test_of_a_pair_both_are_laid_out_each_at_its_place(approved: SnapshotAssertion) -> None:
    one, _, prompts = console("")
    one.ask(Place(2, ("tin", "cork")))
    assert prompts == approved


def test_a_foot_that_did_not_rest_is_told_so_and_asked_again(approved: SnapshotAssertion) -> None:
    one, screen, prompts = console("", "")
    one.ask(Rest(""))
    one.ask(Rest("zeroing: got 9 mm; rest the foot"))
    assert len(prompts) == 2
    assert [*prompts, screen.getvalue()] == approved


def test_a_step_that_broke_off_is_named(approved: SnapshotAssertion) -> None:
    one, screen, _ = console()
    one.ask(Arm(2, 2, 4, "the foot turned back above the panel"))
    assert screen.getvalue() == approved


def test_the_maskers_level_is_shown_changed_and_kept(approved: SnapshotAssertion) -> None:
    one, screen, prompts = console("+", "x", "-", "")
    asked = [one.ask(Level(50.4, 80.0, "Nothing is heard.", probe=False, by="experimenter")).key for _ in range(3)]
    assert asked == ["+", "-", ENTER]
    assert [prompts[0], screen.getvalue()] == approved


def test_the_end_of_the_input_is_named(refuses: Refuses) -> None:
    def ended(_: str) -> str:
        raise EOFError

    one = TerminalConsole(write=io.StringIO(), ask=ended, heading="")
    with refuses(ScreenGone):
        one.ask(TrialAnswer(1, ANSWERS, "n", OTHERS))


def test_what_is_on_disk_is_said(approved: SnapshotAssertion) -> None:
    one, screen, _ = console("")
    one.ask(Familiarise("Crinkle them.", 180, 300, {}))
    one.tell(Answered(1, None))
    assert screen.getvalue() == approved


def test_a_key_counts_what_was_handled_and_enter_ends_a_familiarisation(approved: SnapshotAssertion) -> None:
    one, screen, prompts = console("x", "c", "")
    said = [one.ask(Familiarise("", 0, 60, {"c": "cork (2)"})).key for _ in range(2)]
    assert said == ["c", ENTER]
    assert [prompts[0], screen.getvalue()] == approved


def test_a_screen_that_is_closed_is_named(refuses: Refuses) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    with open(writing, "w", encoding="utf-8", closefd=False) as pipe:
        one = TerminalConsole(write=pipe, ask=lambda _: "", heading="")
        with refuses(ScreenGone):
            one.tell(Answered(1, "foil"))
        os.dup2(os.open(os.devnull, os.O_WRONLY), writing)
    os.close(writing)
    one, screen, _ = console("")
    screen.close()
    with pytest.raises(ScreenGone, match="closed file"):
        one.tell(Notice(""))


def test_a_prompt_that_nobody_can_see_is_a_screen_that_is_gone() -> None:
    def ask(_: str) -> str:
        raise OSError(5, "Input/output error")

    with pytest.raises(ScreenGone, match="Input/output error"):
        TerminalConsole(write=io.StringIO(), ask=ask, heading="").ask(Place(1, ("foil",)))
