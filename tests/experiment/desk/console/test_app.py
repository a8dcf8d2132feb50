"""The console at a real link: what is pressed, and what then reaches the session."""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
from rich.segment import Segment
from syrupy.assertion import SnapshotAssertion
from textual import events
from textual.widget import Widget
from textual.widgets import Input

from palpate.experiment.desk import link
from palpate.experiment.desk.console import app, panes, picture, presses
from palpate.experiment.desk.console.app import Left, attend
from palpate.experiment.desk.console.panes import Pane
from palpate.experiment.desk.link.wire import (
    CLOSED,
    Choose,
    Ended,
    Hello,
    Pause,
    Standing,
    Stop,
    Told,
    Typed,
    View,
    Write,
)
from palpate.experiment.desk.messages import Choice, Correct, Gauges, Repeat, Reveal, TakeNote
from palpate.experiment.errors import LinkError
from tests.approved import Refuses
from tests.experiment.desk.console.scripted import Desk, desk, question

KINDS = ("agree", "familiarise", "level", "say", "rest", "place", "answer", "confirm", "debrief", "continue")
"""Every kind of question that is answered by a key; those without are `write` and `break`."""

RECENT = (Told(trial=1, words="copy paper"), Told(trial=2, words="typing paper"))
ARMED = View(study="small", state="armed", trial=3, standing=Standing(trials=8, answered=2, remaining=6, recent=RECENT))
"""Nothing is asked."""


def asking(kind: str, number: int = 5) -> View:
    return ARMED.model_copy(update={"state": "answering", "question": question(kind, number=number)})


def key_of(kind: str) -> str:
    return question(kind).choices[0].key


def drawn(there: Desk, part: Widget) -> list[Segment]:
    """Return what is on the screen where a part of it stands."""
    place = part.region
    rows = there.app.screen._compositor.render_strips()[place.y : place.bottom]
    return [segment for row in rows for segment in row.crop(place.x, place.right)]


def rows_of_key(there: Desk, key: str) -> int:
    """Return on how many rows of the screen a click presses a key, to the left of its words."""
    offered = there.app.screen.query_one("#offered")
    strips = there.app.screen._compositor.render_strips()[offered.region.y : offered.region.bottom]
    pressed = [
        [one.style for one in strip if one.style and one.style.meta.get(picture.PRESSES) == key] for strip in strips
    ]
    return sum(any(style.bgcolor and style.bgcolor.name == picture.PLAIN for style in row) for row in pressed)


def at_a_desk(
    folder: Path, view: View, then: Callable[[Desk], Awaitable[None]], size: tuple[int, int] = (80, 24)
) -> Left | None:
    """Do something at a console that shows a view; return why it was left, if it was."""

    async def run() -> Left | None:
        async with desk(folder, view, size) as there:
            await then(there)
            return there.app.return_value

    return asyncio.run(run())


def test_a_key_answers_the_question_on_the_screen(tmp_path: Path) -> None:
    async def then(there: Desk) -> None:
        for number, kind in enumerate(KINDS):
            await there.show(asking(kind, number))
            await there.press(key_of(kind))
            assert (await there.deeds(number + 1))[number:] == [Choose(question=number, key=key_of(kind), t_ns=0)]

    at_a_desk(tmp_path, ARMED, then)


def test_a_key_from_before_the_question_answers_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, approved: SnapshotAssertion
) -> None:
    monkeypatch.setattr(presses, "HELD_S", float("-inf"))
    notices: list[str] = []

    async def then(there: Desk) -> None:
        for number, kind in enumerate(KINDS):
            key, pressed_s = key_of(kind), time.monotonic()
            await there.show(asking(kind, number))
            await there.press(key, at_s=pressed_s)
            notices.append(there.notice)
            await there.press(key)
            found = (await there.deeds(2 * number + 2))[2 * number :]
            assert found == [Typed(keys="\n" if key == "enter" else key), Choose(question=number, key=key, t_ns=0)]

    at_a_desk(tmp_path, ARMED, then)
    assert notices == approved


def test_a_key_that_is_held_answers_neither_this_question_twice_nor_the_next(
    tmp_path: Path, approved: SnapshotAssertion
) -> None:
    notices: list[str] = []

    async def then(there: Desk) -> None:
        for number, kind in enumerate(KINDS):
            key, first = key_of(kind), 2 * number
            await there.show(asking(kind, first))
            await there.press(key)
            await there.press(*[key] * 9, after_s=0.4)
            await there.deeds(first + 1)
            await there.show(asking(kind, first + 1))
            await there.press(*[key] * 40, after_s=0.03)
            notices.append(there.notice)
            await there.press("z")
            found = (await there.deeds(first + 2))[first:]
            assert found == [Choose(question=first, key=key, t_ns=0), Choose(question=first + 1, key="z", t_ns=0)]

    at_a_desk(tmp_path, ARMED, then)
    assert notices == approved


def confirming(number: int, confirms: int) -> View:
    asked = question("confirm", number=number).model_copy(update={"confirms": confirms})
    return ARMED.model_copy(update={"state": "answering", "question": asked})


@pytest.mark.parametrize("drawn_first", [False, True])
def test_enter_right_after_a_key_confirms_that_key_however_late_its_question_is_drawn(
    tmp_path: Path, drawn_first: bool
) -> None:
    async def then(there: Desk) -> None:
        for number in (10, 20):
            count = len(there.end.deeds)
            await there.show(asking("answer", number))
            await there.press("c")
            await there.deeds(count + 1)
            if drawn_first:
                await there.show(confirming(number + 1, number))
                await there.press("enter", at_s=time.monotonic())
            else:
                await there.press("enter")
                await there.show(ARMED)
                assert len(there.end.deeds) == count + 1
                await there.show(confirming(number + 1, number))
            chosen = [Choose(question=number, key="c", t_ns=0), Choose(question=number + 1, key="enter", t_ns=0)]
            assert (await there.deeds(count + 2))[count:] == chosen

    at_a_desk(tmp_path, ARMED, then)


@pytest.mark.parametrize("between", ["a", "escape", "f2", "refused", "another question", "another's confirmation"])
def test_enter_belongs_to_no_key_that_was_not_taken_or_was_not_the_last(tmp_path: Path, between: str) -> None:
    async def then(there: Desk) -> None:
        there.end.refusals = {"refused": {"c": "no"}, "a": {"a": CLOSED}, "escape": {"escape": CLOSED}}.get(between, {})
        await there.show(asking("answer", 10))
        await there.press("c")
        if len(between) == 1 or between == "escape":
            await there.press(between)
            await there.press("enter")
        elif between == "f2":
            await there.press("f2", "enter", "escape")
        else:
            await there.press("enter")
        view = asking("answer", 11) if between == "another question" else confirming(11, 10)
        await there.show(confirming(11, 7) if between.startswith("another's") else view)
        await there.press("z", "escape")
        assert Choose(question=11, key="enter", t_ns=0) not in await there.deeds(3)

    at_a_desk(tmp_path, ARMED, then)


def test_a_session_that_stands_still_is_told_of_and_so_is_its_going_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, approved: SnapshotAssertion
) -> None:
    notices: list[str] = []

    async def then(there: Desk) -> None:
        monkeypatch.setattr(link, "BEAT_S", float("inf"))
        monkeypatch.setattr(app, "STANDS_S", 0.3)
        await there.until(lambda: bool(there.notice))
        notices.append(re.sub(r"for \d+ s", "for N s", there.notice))
        monkeypatch.setattr(link, "BEAT_S", 0.05)
        await there.until(lambda: "is responding" in there.notice)
        notices.append(there.notice)

    at_a_desk(tmp_path, asking("answer"), then)
    assert notices == approved


def test_a_session_of_which_nothing_changes_is_heard_all_the_same(tmp_path: Path) -> None:
    async def then(there: Desk) -> None:
        heard_s = there.app._heard_s
        await there.until(lambda: there.app._heard_s > heard_s + 2 * link.BEAT_S)
        assert there.notice == ""

    at_a_desk(tmp_path, asking("answer"), then)


def test_a_key_between_two_presses_shows_that_none_was_held(tmp_path: Path) -> None:
    async def then(there: Desk) -> None:
        await there.press("f3")
        await there.press("shift+tab", "enter", "a", "enter", *"slip", "enter", after_s=0.08)
        assert await there.deeds(1) == [Correct(trial=2, key="a", reason="slip")]

    at_a_desk(tmp_path, ARMED, then)


def test_a_form_shows_where_typing_goes_and_takes_what_comes_at_once_in_order(tmp_path: Path) -> None:
    """Trial 2 is selected in its field; Backspace and a digit come in one burst, as from a terminal, and a letter."""

    async def then(there: Desk) -> None:
        await there.press("f3")
        marks = there.app.query(".at")
        assert [str(one.render()) for one in marks][:3] == ["", ">", ""]
        await there.press("shift+tab")
        await there.until(lambda: [str(one.render()) for one in marks][:3] == [">", "", ""])
        for key, character in (("backspace", "\x7f"), ("1", "1"), ("x", "x")):
            there.app.post_message(events.Key(key, character))
        await there.pilot.pause()
        await there.press("enter", "a", "enter", *"slip", "enter")
        assert await there.deeds(1) == [Correct(trial=1, key="a", reason="slip")]

    at_a_desk(tmp_path, ARMED, then)


@pytest.mark.parametrize("after_s", [0.03, 0.35, 0.6])
def test_every_press_of_softer_counts_held_or_not(tmp_path: Path, after_s: float) -> None:
    """Also one that comes right as the next level is asked for."""

    async def then(there: Desk) -> None:
        now_s = time.monotonic()
        for number in range(6):
            await there.show(asking("level", number))
            await there.press("-", at_s=now_s + number * after_s)
            assert there.notice == ""
        assert await there.deeds(6) == [Choose(question=number, key="-", t_ns=0) for number in range(6)]
        await there.press("+", at_s=now_s + 10)
        await there.press("+", at_s=now_s + 10.4)
        assert there.notice.startswith("+ was held")
        assert (await there.deeds(7))[6:] == [Choose(question=5, key="+", t_ns=0)]

    at_a_desk(tmp_path, ARMED, then)


def test_a_key_from_before_its_question_that_comes_again_at_once_has_not_counted(tmp_path: Path) -> None:
    async def then(there: Desk) -> None:
        pressed_s = time.monotonic()
        await there.show(asking("answer"))
        await there.press("c", at_s=pressed_s)
        await there.press("c", at_s=pressed_s + 0.4)
        assert there.notice.startswith("c was held")
        assert await there.deeds(1) == [Typed(keys="c")]

    at_a_desk(tmp_path, ARMED, then)


def test_an_answer_and_its_confirmation_held_down_do_not_end_the_session(tmp_path: Path) -> None:
    async def then(there: Desk) -> None:
        await there.press("c")
        await there.show(asking("confirm", 6))
        await there.press("enter")
        await there.deeds(2)
        await there.show(asking("debrief", 7))
        await there.press(*["enter"] * 60, after_s=0.05)
        await there.press("z")
        assert await there.deeds(3) == [
            Choose(question=5, key="c", t_ns=0),
            Choose(question=6, key="enter", t_ns=0),
            Choose(question=7, key="z", t_ns=0),
        ]

    at_a_desk(tmp_path, asking("answer"), then)


def test_the_words_of_a_refusal_stand_above_the_question(tmp_path: Path) -> None:
    async def then(there: Desk) -> None:
        for number, kind in enumerate(KINDS):
            words = f"'z' is not a key here, the {number}th time."
            there.end.refusals = {"z": words}
            await there.show(asking(kind, number))
            await there.press("z")
            await there.until(lambda words=words: words in there.text)  # type: ignore[misc]
            assert there.text.index(words) < there.text.index("What is it?")
            assert there.app.query_one("#notice").has_class("refused")

    at_a_desk(tmp_path, ARMED, then)


def test_the_mouse_needs_a_second_press_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, approved: SnapshotAssertion
) -> None:
    monkeypatch.setattr(presses, "SEEN_S", 0.0)
    notices: set[str] = set()

    async def then(there: Desk) -> None:
        for number, kind in enumerate(KINDS):
            first = 2 * number
            await there.show(asking(kind, first))
            await there.pilot.click("#offered", offset=(9, 0))
            await there.deeds(first + 1)
            monkeypatch.setattr(presses, "HELD_S", 1000.0)
            await there.show(asking("confirm", first + 1))
            await there.pilot.click("#offered", offset=(9, 0))
            notices.add(there.notice)
            monkeypatch.setattr(presses, "HELD_S", 0.0)
            await there.pilot.click("#offered", offset=(9, 0))
            chosen, confirmed = (
                Choose(question=first, key=key_of(kind), t_ns=0),
                Choose(question=first + 1, key="enter", t_ns=0),
            )
            assert (await there.deeds(first + 2))[first:] == [chosen, confirmed]

    at_a_desk(tmp_path, ARMED, then)
    assert notices == approved


def test_a_question_that_wants_a_line_is_answered_with_one_or_with_nothing(tmp_path: Path) -> None:
    async def then(there: Desk) -> None:
        await there.press("c", "enter", *"warm", "enter")
        assert await there.deeds(2) == [Choose(question=5, key="c", t_ns=0), Write(question=5, text="warm")]
        await there.show(asking("write", 6))
        await there.press("enter")
        await there.press(*["enter"] * 20, after_s=0.05)
        await there.press("enter")
        assert (await there.deeds(3))[2:] == [Write(question=6, text="")]

    at_a_desk(tmp_path, asking("write"), then)


def test_what_is_typed_when_nothing_is_asked_is_told_and_shown(tmp_path: Path) -> None:
    async def then(there: Desk) -> None:
        await there.press("c", "enter", "left", "f12")
        assert await there.deeds(2) == [Typed(keys="c"), Typed(keys="\n")]
        told = "Enter was pressed when there was no question, and was ignored."
        assert told in there.said
        await there.show(asking("place"))
        # What was told before the question holds beside it.
        assert told in there.said
        await there.show(asking("answer", 6))
        assert told not in there.said

    at_a_desk(tmp_path, ARMED, then)


def test_what_was_told_of_a_question_that_is_over_stands_above_no_other(
    tmp_path: Path, approved: SnapshotAssertion
) -> None:
    async def then(there: Desk) -> None:
        there.end.refusals = {"z": "'z' is not a key here.", "y": CLOSED}
        await there.press("z")
        await there.until(lambda: "is not a key here" in there.text)
        await there.show(asking("place", 6))
        assert there.notice == ""
        await there.press("y")
        await there.until(lambda: "key was ignored" in there.text)
        await there.show(ARMED)
        assert there.notice == ""
        await there.show(ARMED.model_copy(update={"state": "waiting"}))
        await there.press("enter")
        assert there.notice == approved
        await there.show(ARMED)
        assert there.notice == ""

    at_a_desk(tmp_path, asking("break"), then)


def test_what_is_pasted_answers_nothing(tmp_path: Path) -> None:
    from textual.events import Paste

    async def then(there: Desk) -> None:
        there.app.post_message(Paste("c"))
        assert await there.deeds(1) == [Typed(keys="c")]

    at_a_desk(tmp_path, asking("answer"), then)


def test_capital_letters_stand_for_small_ones(tmp_path: Path) -> None:
    async def then(there: Desk) -> None:
        await there.press("C")
        assert await there.deeds(1) == [Choose(question=5, key="c", t_ns=0)]

    at_a_desk(tmp_path, asking("answer"), then)


@pytest.mark.parametrize(
    ("keys", "deed"),
    [
        (("ctrl+c",), Pause()),
        (("f7",), Pause()),
        (("f2", *"q c", "enter"), TakeNote(text="q c", trial=3)),
        (("f3", "a", "enter", *"slip", "enter"), Correct(trial=2, key="a", reason="slip")),
        (("f3", "shift+tab", "1", "enter", "a", "enter", *"slip", "enter"), Correct(trial=1, key="a", reason="slip")),
        (("f3", "a", "tab", *"slip", "tab", "1", "enter"), Correct(trial=1, key="a", reason="slip")),
        (("f4", *"cough", "enter"), Repeat(trial=3, reason="cough")),
        (("f4", "shift+tab", "1", "enter", *"cough", "enter"), Repeat(trial=1, reason="cough")),
        (("f6", *"2,5", "enter"), Pause(minutes=2.5)),
        (("f8", "enter"), Stop()),
    ],
    ids=lambda value: getattr(value, "do", None),
)
def test_every_command_can_be_given_at_any_moment(tmp_path: Path, keys: tuple[str, ...], deed: object) -> None:
    async def then(there: Desk) -> None:
        for number, view in enumerate((ARMED, asking("answer"), asking("confirm"))):
            there.end.words = f"Done as asked, the {number}th time."
            await there.show(view)
            await there.press(*keys)
            assert (await there.deeds(number + 1))[number:] == [deed]
            await there.until(lambda: there.end.words in there.text and not there.app.query_one("Blanks").display)

    at_a_desk(tmp_path, ARMED, then)


@pytest.mark.parametrize("reveals", [True, False])
def test_results_are_asked_for_where_the_protocol_allows_it(tmp_path: Path, reveals: bool) -> None:
    async def then(there: Desk) -> None:
        await there.press("f1", "f7")
        assert await there.deeds(1 + reveals) == [Reveal(), Pause()][not reveals :]

    at_a_desk(tmp_path, ARMED.model_copy(update={"reveals": reveals}), then)


def test_the_note_keeps_the_trial_in_which_it_was_begun(tmp_path: Path) -> None:
    async def then(there: Desk) -> None:
        await there.press("f2", "x")
        await there.show(ARMED.model_copy(update={"trial": 4}))
        assert "Note on trial 3." in there.text
        await there.press("enter")
        assert await there.deeds(1) == [TakeNote(text="x", trial=3)]

    at_a_desk(tmp_path, ARMED, then)


def test_an_open_form_takes_every_key_and_the_question_is_seen_anew_after_it(tmp_path: Path) -> None:
    async def then(there: Desk) -> None:
        await there.press("f2", "c", "a")
        await there.show(asking("answer", 6))
        await there.press("n", "f3", "escape")
        assert "What is it?" in there.text
        await there.press("z", at_s=time.monotonic() - 1)
        await there.press("a")
        assert await there.deeds(2) == [Typed(keys="z"), Choose(question=6, key="a", t_ns=0)]

    at_a_desk(tmp_path, asking("answer"), then)


def test_enter_that_ends_a_form_and_is_held_confirms_nothing(tmp_path: Path) -> None:
    async def then(there: Desk) -> None:
        await there.press("f2", "x", "enter")
        await there.deeds(1)
        await there.until(lambda: "go on" in there.text or "confirm" in there.text)
        await there.press(*["enter"] * 30, after_s=0.05)
        await there.press("z")
        assert (await there.deeds(2))[1:] == [Choose(question=5, key="z", t_ns=0)]

    at_a_desk(tmp_path, asking("confirm"), then)


def test_what_a_refused_form_held_is_kept(tmp_path: Path) -> None:
    async def then(there: Desk) -> None:
        there.end.refusals = {"x": "'x' is not the key of an answer."}
        await there.press("f3", "x", "enter", *"slip", "enter")
        await there.until(lambda: "is not the key of an answer" in there.text)
        assert [field.value for field in there.app.query(Input)][:3] == ["2", "x", "slip"]

    at_a_desk(tmp_path, ARMED, then)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        (("f3", "a", "enter", "enter"), "Reason is blank."),
        (("f3", "enter"), "Key is blank."),
        (("f4", "enter"), "Reason is blank."),
        (("f6", "0", "enter"), "is not a valid break."),
        (("f2", "enter"), "Note is blank."),
    ],
)
def test_a_form_that_is_not_filled_in_says_what_is_missing(tmp_path: Path, keys: tuple[str, ...], words: str) -> None:
    async def then(there: Desk) -> None:
        await there.press(*keys)
        assert words in there.said
        assert there.end.deeds == []

    at_a_desk(tmp_path, ARMED, then)


def test_every_command_is_there_for_the_mouse(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def then(there: Desk) -> None:
        monkeypatch.setattr(presses, "HELD_S", 0.0)
        row = there.text.split("\n")[-1]
        for word, shown in (
            ("note", "Note on trial 3"),
            ("correct", "Correct an answer"),
            ("leave", "Leave the console"),
        ):
            await there.pilot.click("#commands", offset=(row.index(word), 0))
            assert shown in there.text
            hint = next(line for line in there.text.split("\n") if "closes this" in line)
            at = (hint.index("closes this"), there.text.split("\n").index(hint))
            await there.pilot.click(offset=at)
            assert shown not in there.text
        await there.pilot.click("#commands", offset=(row.index("pause"), 0))
        assert await there.deeds(1) == [Pause()]

    at_a_desk(tmp_path, ARMED, then)


def test_leaving_says_what_becomes_of_the_session(tmp_path: Path, approved: SnapshotAssertion) -> None:
    async def then(there: Desk) -> None:
        await there.press("f9")
        assert there.text == approved
        await there.press("enter")

    assert at_a_desk(tmp_path, ARMED, then) == Left("left")


@pytest.mark.parametrize("key", ["f9", "ctrl+c", "ctrl+q"])
def test_a_session_that_has_ended_is_left_by_the_keys_that_leave(tmp_path: Path, key: str) -> None:
    ended = Ended(words="The session is complete: 8 answers.", exit_code=0)

    async def then(there: Desk) -> None:
        await there.show(ARMED.model_copy(update={"state": "ended", "ended": ended}))
        await there.press(key)

    assert at_a_desk(tmp_path, ARMED, then) == Left("ended", ended=ended)


@pytest.mark.parametrize(("key", "again"), [("enter", True), ("f9", False), ("ctrl+c", False)])
def test_a_session_that_is_gone_can_be_started_again(tmp_path: Path, key: str, again: bool) -> None:
    async def then(there: Desk) -> None:
        await there.press("f2", "x")
        there.end_session()
        await there.until(lambda: "The session's process has ended." in there.text)
        assert "GONE" in there.text
        await there.press("c")
        await there.press(key)

    assert at_a_desk(tmp_path, asking("answer"), then) == Left("gone", again=again)


def test_enter_that_was_held_when_the_session_died_does_not_start_it_again(tmp_path: Path) -> None:
    async def then(there: Desk) -> None:
        await there.press("enter")
        there.end_session()
        await there.until(lambda: "The session's process has ended." in there.text)
        await there.press(*["enter"] * 30, after_s=0.05)
        assert there.app.is_running

    assert at_a_desk(tmp_path, asking("confirm"), then) is None


def test_how_a_session_ended_stays_on_the_screen_until_enter(tmp_path: Path) -> None:
    ended = Ended(words="The session is complete: 8 answers.", exit_code=0)

    async def then(there: Desk) -> None:
        await there.show(ARMED.model_copy(update={"state": "ended", "ended": ended}))
        there.end_session()
        await there.until(lambda: ended.words in there.text)
        await there.press("c", "f2")
        assert ended.words in there.text
        await there.press("enter")

    assert at_a_desk(tmp_path, ARMED, then) == Left("ended", ended=ended)


def test_another_version_is_told(tmp_path: Path, approved: SnapshotAssertion) -> None:
    async def then(there: Desk) -> None:
        there.end.view = Hello(role="console", by="x")  # type: ignore[assignment]
        there.link.wake()
        await there.until(lambda: there.app.misunderstood is not None)
        assert str(there.app.misunderstood) == approved

    at_a_desk(tmp_path, ARMED, then)


def test_no_session_no_console(tmp_path: Path, refuses: Refuses) -> None:
    with refuses(LinkError):
        attend(tmp_path / "none", Hello(role="console", by="x"))


def test_what_has_not_changed_is_not_drawn_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[str | None] = []
    update = Pane.update

    def counted(self: Pane, *args: object, **kwargs: object) -> None:
        drawn.append(self.id)
        update(self, *args, **kwargs)  # type: ignore[arg-type]

    async def then(there: Desk) -> None:
        monkeypatch.setattr(Pane, "update", counted)
        for left_s in (1999.9, 1999.8):
            gauges = Gauges(left_s=left_s, trace=(left_s, 0.0), trace_unit="mm")
            await there.show(ARMED.model_copy(update={"gauges": gauges}))
        assert drawn.count("gauges") == drawn.count("left") == 1
        assert set(drawn) == {"gauges", "left", "trace"}

    at_a_desk(tmp_path, ARMED, then)


def test_the_next_trial_moves_nothing_on_the_screen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A layout takes longer than all else, and whoever keys an answer waits for it."""
    laid_out: list[str | None] = []
    refresh = Widget.refresh

    def counted(self: Widget, *regions: Any, layout: bool = False, **more: Any) -> Widget:
        if layout:
            laid_out.append(self.id)
        return refresh(self, *regions, layout=layout, **more)

    async def then(there: Desk) -> None:
        monkeypatch.setattr(Widget, "refresh", counted)
        for trial in (4, 5):
            standing = ARMED.standing.model_copy(update={"answered": trial - 1, "remaining": 9 - trial})
            await there.show(asking("answer", trial).model_copy(update={"trial": trial, "standing": standing}))
        assert laid_out == []

    at_a_desk(tmp_path, asking("answer", 3), then)


def test_a_break_is_counted_down(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now_ns = [0]
    monkeypatch.setattr(panes, "wall_ns", lambda: now_ns[0])

    async def then(there: Desk) -> None:
        assert "the break" in there.text
        now_ns[0] = 61 * 10**9
        await there.show(ARMED.model_copy(update={"state": "paused", "pause_until_ns": 60 * 10**9, "trial": None}))
        assert "is over." in there.text

    at_a_desk(tmp_path, ARMED.model_copy(update={"state": "paused", "pause_until_ns": 90 * 10**9}), then)


def test_a_long_text_scrolls_and_its_keys_stay(tmp_path: Path) -> None:
    text = " ".join(f"word{number}" for number in range(200))
    view = ARMED.model_copy(update={"question": question("familiarise", text=text)})

    async def then(there: Desk) -> None:
        told = there.app.query_one("#text")
        await there.until(lambda: told.max_scroll_y > 0)
        tops, pages = [told.scroll_y], [there.part("#text")]
        while told.scroll_y < told.max_scroll_y:
            assert "go on" in there.text
            await there.press("pagedown")
            await there.until(lambda: told.scroll_y > tops[-1] and there.part("#text") != pages[-1])
            await there.pilot.pause()
            tops.append(told.scroll_y)
            pages.append(there.part("#text"))
        assert set(text.split()) == set(re.findall(r"word\d+", " ".join(pages)))

    at_a_desk(tmp_path, view, then)


def test_the_newest_line_stays_on_the_screen_whatever_is_asked(tmp_path: Path) -> None:
    lines = tuple(f"line {number}" for number in range(40))

    async def then(there: Desk) -> None:
        for number, kind in enumerate(("place", "answer", "confirm", "continue")):
            await there.show(asking(kind, number).model_copy(update={"lines": (*lines, f"newest {number}")}))
            await there.until(lambda number=number: f"newest {number}" in there.text)  # type: ignore[misc]
            await there.press("f3")
            await there.until(lambda number=number: f"newest {number}" in there.text)  # type: ignore[misc]
            await there.press("escape")
        assert "PageUp shows" in there.text
        await there.press("pageup", "pageup", after_s=0.05)
        assert there.notice == ""
        await there.until(lambda: "newest" not in there.text)

    at_a_desk(tmp_path, ARMED, then)


def test_what_a_pause_was_told_is_gone_once_it_came(tmp_path: Path) -> None:
    async def then(there: Desk) -> None:
        there.end.words = "The session pauses soon."
        await there.press("f7")
        await there.until(lambda: there.end.words in there.text)
        await there.show(asking("continue").model_copy(update={"state": "paused"}))
        assert there.end.words not in there.text
        await there.show(ARMED)
        there.end.refusals = {"note": "The session ends at this moment."}
        await there.press("f2", "x", "enter")
        await there.until(lambda: there.end.refusals["note"] in there.notice)
        await there.show(asking("continue", 6).model_copy(update={"state": "paused"}))
        assert there.notice == there.end.refusals["note"]

    at_a_desk(tmp_path, ARMED, then)


NAMES = (
    "Knallfolie mit Luftpolstern, 3 mm dick",
    "クラフト紙のしわくちゃな円筒",
    "Polypropylenverpackungsfolienzylinder A4",
    "Butterbrotpapier",
    "aluminum foil 0203 of Toyo, 11 um thick",
    "紙",
    "Donaudampfschifffahrtsgesellschaftspapie",
    "cellophane, of the kind that is crisp oh",
)


@pytest.mark.parametrize("size", [(80, 24), (140, 50)])
def test_eight_materials_are_whole_on_the_screen(tmp_path: Path, size: tuple[int, int]) -> None:
    others = (("n", "no answer"), ("r", "repeat this trial"), ("+", "masker louder"), ("-", "masker softer"))
    choices = tuple(Choice(key=str(number), words=name, answer=True) for number, name in enumerate(NAMES, start=1))
    choices += tuple(Choice(key=key, words=words) for key, words in others)
    asked = question("answer").model_copy(update={"choices": choices, "text": "What did the participant say?"})
    view = ARMED.model_copy(update={"question": asked, "label": "PRACTICE", "gauges": Gauges(left_s=3600)})

    async def run() -> str:
        async with desk(tmp_path, view, size) as there:
            there.end.refusals = {"z": "'z' is not a key here."}
            await there.press("z")
            await there.until(lambda: "is not a key here" in there.text and NAMES[-1] in there.text)
            return there.text

    text = asyncio.run(run())
    for told in (*NAMES, *(words for _, words in others), "PRACTICE", "ANSWER", "60 min left", "2 typing paper"):
        assert told in text


@pytest.mark.parametrize("size", [(120, 36), (160, 45)], ids=["120x36", "160x45"])
def test_on_a_large_screen_keys_are_three_rows_high_and_the_question_is_bold_in_short_lines(
    tmp_path: Path, size: tuple[int, int]
) -> None:
    text = "The masker is at its level, and the participant does not hear the panel that vibrates below."

    async def then(there: Desk) -> None:
        for number, kind in enumerate((*KINDS, "write", "break")):
            view = ARMED.model_copy(update={"question": question(kind, number=number, text=text)})
            await there.show(view)
            await there.until(lambda: there.app.screen.query_one("#asked").region.width <= panes.LINE)
            asked = there.app.screen.query_one("#asked", Pane)
            assert all(one.style is not None and one.style.bold for one in drawn(there, asked) if one.text.strip())
            for choice in view.question.choices if view.question else ():
                if choice.answer or kind != "answer":
                    assert rows_of_key(there, choice.key) == 3

    at_a_desk(tmp_path, ARMED, then, size)


@pytest.mark.parametrize(("answers", "size", "rows"), [(9, (120, 36), 3), (9, (160, 45), 3), (20, (120, 36), 1)])
def test_all_answers_stay_on_a_large_screen_beside_one_another_if_need_be(
    tmp_path: Path, answers: int, size: tuple[int, int], rows: int
) -> None:
    keys = "abcdefghijklmopqrstuvwxyz"[:answers]

    async def then(there: Desk) -> None:
        await there.show(ARMED.model_copy(update={"question": question("answer", keys=keys)}))
        assert {rows_of_key(there, key) for key in keys} == {rows}
        assert "no answer" in there.text

    at_a_desk(tmp_path, ARMED, then, size)
