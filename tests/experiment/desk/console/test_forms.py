"""What a form asks the session for."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.desk.console import forms
from palpate.experiment.desk.link.wire import Pause, Standing, Told, View
from palpate.experiment.desk.messages import Choice, TakeNote
from tests.approved import Refuses
from tests.experiment.desk.console.scripted import question

VIEW = View(trial=7, standing=Standing(recent=(Told(trial=6, words="felt"),)))


@pytest.mark.parametrize(("name", "first"), [("correct", "6"), ("repeat", "7"), ("break", forms.BREAK_MIN)])
def test_what_is_likely_stands_there_already(name: str, first: str) -> None:
    assert forms.opened(name, VIEW).blanks[0].text == first


def test_the_keys_of_a_correction_are_told_even_where_nothing_is_asked() -> None:
    told = VIEW.model_copy(update={"answers": (Choice(key="f", words="felt", answer=True),)})
    assert forms.opened("correct", told).hint == "Keys: f=felt"
    asked = VIEW.model_copy(update={"question": question("answer")})
    assert forms.opened("correct", asked).hint == "Keys: c=material c, a=material a"
    assert forms.opened("correct", VIEW).hint == ""


def test_who_stops_in_a_break_is_asked_about_the_day_and_no_trial(approved: SnapshotAssertion) -> None:
    assert [forms.opened("stop", view).title for view in (View(state="paused"), VIEW)] == approved


@pytest.mark.parametrize("kind", ["answer", "confirm", "level", "debrief"])
@pytest.mark.parametrize("name", ["break", "stop"])
def test_who_pauses_while_an_answer_is_asked_for_is_told_that_the_trial_comes_again(name: str, kind: str) -> None:
    title = forms.opened(name, VIEW.model_copy(update={"question": question(kind)})).title
    warned = "Trial 7, still unanswered, will be repeated." in title
    assert warned is (kind in ("answer", "confirm"))


@pytest.mark.parametrize("text", ["\u202e", "a\u0000b", "\u043enly"])
def test_what_cannot_go_on_record_is_said_before_it_is_sent(text: str, refuses: Refuses) -> None:
    with refuses(forms.NotFilledIn):
        forms.filled(forms.opened("note", VIEW), (text,))


@given(st.text(max_size=12))
def test_a_break_is_asked_for_in_minutes_that_a_message_may_hold(text: str) -> None:
    try:
        asked = forms.filled(forms.opened("break", VIEW), (text,))
    except forms.NotFilledIn:
        return
    assert isinstance(asked, Pause)
    assert asked.minutes is not None
    assert 0 < asked.minutes <= forms.MOST_MIN


@given(st.text(max_size=60))
def test_a_note_is_one_line_without_blanks_around_it(text: str) -> None:
    try:
        asked = forms.filled(forms.opened("note", VIEW), (text,))
    except forms.NotFilledIn:
        return
    assert isinstance(asked, TakeNote)
    assert asked.text == text.strip()
    assert asked.trial == 7
