"""What is drawn of a view."""

from __future__ import annotations

from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.desk.console import picture
from palpate.experiment.desk.link.wire import Asked, Ended, Standing, Tally, Track, View
from palpate.experiment.desk.messages import Choice, Gauges, Lamp
from palpate.experiment.errors import Interrupted

FINITE = st.floats(-1e6, 1e6)


def test_every_question_and_every_state_has_its_place() -> None:
    assert picture.ASKED.keys() == set(get_args(Asked.model_fields["kind"].annotation))
    assert picture.STATES.keys() == set(get_args(View.model_fields["state"].annotation))


def test_armed_stepping_and_answer_differ_by_word_place_and_colour() -> None:
    three = [picture.STATES["armed"], picture.STEPPING, picture.ASKED["answer"]]
    for told in ("word", "place", "colour"):
        assert len({getattr(one, told) for one in three}) == 3


def test_every_place_where_something_is_lit_is_one_of_the_strip() -> None:
    lit = {
        one.place
        for one in (*picture.ASKED.values(), *picture.STATES.values(), picture.STEPPING, picture.GONE, picture.FAILED)
    }
    assert lit == {*picture.STIMULI, *picture.PAIRS}


def test_a_stimulus_has_a_place_of_its_own_whether_a_foot_or_the_program_begins_it() -> None:
    plays = View(state="armed", interval=2)
    steps = View(state="armed", gauges=Gauges(left_s=60, moving=True))
    words = [(picture.phase(view).word, picture.phase(view).place) for view in (plays, steps)]
    assert words == [("INTERVAL 2", "STIMULUS"), ("STEPPING", "STIMULUS")]
    assert "STIMULUS" in picture.strip(plays)


@pytest.mark.parametrize(
    ("trial", "remaining", "drawn"),
    [(3, 6, "of 8\n6 to do\n"), (3, None, "of 8\ntraining\n"), (None, 8, "8 trials\n8 to do\n")],
)
def test_a_trial_of_the_training_is_told_apart_from_one_that_counts(
    trial: int | None, remaining: int | None, drawn: str
) -> None:
    assert picture.counted(trial, 8, remaining, 1).plain == drawn


def test_where_samples_are_compared_nothing_is_armed_and_no_foot_is_measured() -> None:
    view = View(at_will=True)
    assert not {"ARMED", "STIMULUS"} & set(picture.strip(view))
    assert {"ARMED", "STIMULUS"} <= set(picture.strip(View()))
    virtual = view.model_copy(update={"gauges": Gauges(left_s=60, too_fast=False)})
    # Nobody lays out what is rendered.
    assert picture.strip(virtual) == ("", "ANSWER")
    told = picture.gauges(Gauges(left_s=60, lamps=(Lamp(name="disk", good=True, words="9 GB free"),)), True, 40).plain
    assert told == "● disk: 9 GB free"


def test_a_step_that_did_not_count_says_why_and_what_to_do(approved: SnapshotAssertion) -> None:
    told = picture.phase(View(state="armed", may="step", again="The foot stopped; nothing was played"))
    assert (told.word, told.place) == ("AGAIN", "ARMED")
    assert told.says == approved


@pytest.mark.parametrize(("step", "word"), [("real", "TASK DONE"), ("virtual", "TASK DONE"), ("debriefing", "DEBRIEF")])
def test_the_end_of_a_task_is_no_debriefing(step: str, word: str) -> None:
    asked = Asked(number=3, kind="debrief", text="", choices=())
    view = View(question=asked, step=step, steps=("real", "virtual", "debriefing"))
    assert picture.phase(view).word == word


def test_a_foot_that_moves_is_told_only_where_a_trial_is_armed() -> None:
    view = View(state="armed", gauges=Gauges(left_s=1, moving=True))
    assert picture.phase(view) is picture.STEPPING
    assert picture.phase(view.model_copy(update={"state": "waiting"})) is picture.STATES["waiting"]
    landed = view.model_copy(update={"gauges": Gauges(left_s=1, stepped=True)})
    assert picture.phase(landed) is picture.STEPPED


def test_what_is_tried_at_will_is_told_apart_from_an_answer_that_is_written() -> None:
    view = View(state="answering", at_will=True, may="tap")
    assert picture.phase(view) is picture.TRYING
    assert picture.phase(view.model_copy(update={"may": ""})) is picture.STATES["answering"]


@given(st.lists(FINITE, min_size=1, max_size=400), st.integers(12, 80), st.integers(1, 5))
def test_a_trace_stays_within_its_lines(values: list[float], width: int, rows: int) -> None:
    drawn = picture.trace(tuple(values), "mm", width, rows).plain.split("\n")
    assert len(drawn) == rows
    assert all(set(line) <= set(picture.BARS) for line in drawn[1:])
    assert all(len(line) < max(width, 12) for line in drawn[1:])


def test_a_trace_shows_heights_from_zero() -> None:
    assert picture.trace((0.0, 40.0, 80.0), "mm", 9, 1).plain == " ▄█ 80 mm"


def test_what_is_not_well_comes_first_and_with_words() -> None:
    lamps = (
        Lamp(name="disk", good=True, words="9 GB free"),
        Lamp(name="audio", good=None, words="not used"),
        Lamp(name="tracker", good=False, words="no frame"),
    )
    shown = picture.lamps(lamps, roomy=False, width=25).plain
    assert shown.split("\n") == ["▲ tracker: no frame", "○ audio: not used", "● disk"]
    assert picture.lamps(lamps, roomy=True, width=40).plain.endswith("● disk: 9 GB free")


@pytest.mark.parametrize(
    ("width", "drawn"),
    [(25, "● tracker  ● audio\n● screen  ● disk"), (40, "● tracker  ● audio  ● screen  ● disk"), (9, None)],
)
def test_the_name_of_a_lamp_stays_beside_it(width: int, drawn: str | None) -> None:
    names = ("tracker", "audio", "screen", "disk")
    told = tuple(Lamp(name=name, good=True, words="well") for name in names)
    assert picture.lamps(told, roomy=False, width=width).plain == (drawn or "\n".join(f"● {name}" for name in names))


def test_a_session_that_failed_is_told_apart_from_one_that_ended() -> None:
    ended, failed = (View(state="ended", ended=Ended(words="", exit_code=code)) for code in (0, 2))
    assert picture.phase(ended) is picture.STATES["ended"]
    assert picture.phase(failed) is picture.FAILED
    left = View(state="ended", ended=Ended(words="", exit_code=Interrupted.exit_code))
    # Who answers 'no, leave' is no fault.
    assert picture.phase(left) is picture.STATES["ended"]


@pytest.mark.parametrize(
    ("left_s", "words"), [(4800, "80 min left"), (119.4, "119 s left"), (0, "No time is left"), (-3, "No time is left")]
)
def test_the_time_that_is_left_is_told_in_words(left_s: float, words: str) -> None:
    assert picture.time_left(left_s) == words


@pytest.mark.parametrize(
    ("left_s", "shown"),
    [(300, "5:00"), (61.2, "1:02"), (60.0, "1:00"), (0.4, "0:01"), (0, "0:00"), (-9, "0:00"), (7200, "120:00")],
)
def test_a_break_is_counted_in_minutes_and_seconds(left_s: float, shown: str) -> None:
    assert picture.countdown(left_s) == shown


def test_what_counts_down_is_named_and_so_is_its_end(approved: SnapshotAssertion) -> None:
    early = Asked(number=1, kind="familiarise", text="Feel.", choices=())
    late = early.model_copy(update={"choices": (Choice(key="enter", words="familiar"),)})
    paused = early.model_copy(update={"kind": "continue"})
    told = [(question, lasts) for question in (None, paused, early, late) for lasts in (True, False)]
    assert [picture.counts_down(*one).plain.replace("\n", " ") for one in told] == approved


def test_what_was_heard_stands_under_the_question_of_an_answer_alone() -> None:
    heard = "heard: aluminum foil (0.92)"
    for kind, shown in (("answer", True), ("confirm", True), ("place", False), ("say", False)):
        asked = Asked(number=1, kind=kind, text="What did they say?", choices=())
        text = picture.question_text(asked, picture.ASKED[kind], "", heard, False).plain
        assert (text.split("\n")[-1] == heard) is shown
    assert heard not in picture.question_text(None, picture.STATES["armed"], "", heard, False).plain


MEASURED = Standing(answered=3, responses_s=(1.0, 2.0, 4.0), speeds_mm_s=(100.0, 200.0))


def test_the_last_value_stands_beside_the_median_above_its_bars() -> None:
    lines = picture.measures(MEASURED, steps=True).plain.split("\n")
    assert lines == ["Response time: 4.0 s, median 2.0", "▃▅█", "Speed: 200 mm/s, median 150", "▅█"]


def test_before_the_first_answer_the_strip_is_as_high() -> None:
    heights = [len(picture.measures(one, steps=True).plain.split("\n")) for one in (Standing(), MEASURED)]
    assert heights == [4, 4]


def test_speeds_are_those_of_steps_alone() -> None:
    assert "mm/s" not in picture.measures(MEASURED, steps=False).plain


def test_a_track_shows_its_last_level() -> None:
    told = MEASURED.model_copy(update={"tracks": (Track(name="hum", levels=(1.0, 0.5)),), "answered": 0})
    title, bars = picture.results(told, (), 30).plain.split("\n")[1:]
    assert (title.split()[2:], bars) == (["hum:", "last", "0.5"], "█▅")


@pytest.mark.parametrize(
    ("width", "rows"),
    [(12, ["        f  c", "felt    1 11"]), (11, ["felt: cork 11, felt 1"])],
    ids=["in columns", "without room for columns"],
)
def test_answers_are_counted_by_material_and_so_are_those_left_out(width: int, rows: list[str]) -> None:
    tally = Tally(presented="felt", answers=(("cork", 11), ("felt", 1)))
    told = MEASURED.model_copy(update={"tallies": (tally,), "answered": 13})
    answers = [Choice(key=name[0], words=name) for name in ("felt", "cork")]
    assert picture.results(told, answers, width).plain.split("\n")[1:] == [*rows, "other answers: 1"]


def test_that_nothing_has_moved_yet_is_shown_once() -> None:
    beside = picture.gauges(Gauges(left_s=60.0, trace_unit="mm"), True, 40)
    assert (picture.trace((), "mm", 20, 2).plain + beside.plain).lower().count("movement") == 1
