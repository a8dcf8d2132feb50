"""What reaches the participant's screen: nothing that is presented or laid out, and no key that is not theirs."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.experiment.desk.messages import ENTER, Choice, Ended, Gauges, Prompt, Question, View, line
from palpate.experiment.desk.prompts import AT_QUESTION, Theirs, prompt, theirs
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.protocol.rules import HEARD_KEY, PROBE_KEY
from tests.experiment.desk.views import KINDS, MARK, views
from tests.experiment.protocol.small import changed, document
from tests.experiment.protocol.tapping import comparing

THEIRS = Theirs(frozenset({"level"}), ("felt", "cork"))
LEVEL = (Choice(key="+", words="louder"), Choice(key="-", words="softer"), Choice(key=ENTER, words="keep"))


@given(view=views, kinds=st.frozensets(st.sampled_from(KINDS)))
def test_nothing_that_is_presented_reaches_the_screen(view: View, kinds: frozenset[str]) -> None:
    assert MARK.encode() not in line(prompt(view, Theirs(kinds)))


@pytest.mark.parametrize(
    ("state", "lamp"),
    [("familiarising", True), ("armed", True), ("answering", True), ("paused", None), ("ended", None)],
)
def test_the_lamp_is_lit_where_the_participant_taps(state: str, lamp: bool | None) -> None:
    for too_fast, shown in ((True, lamp), (None, None)):
        view = View.model_validate({"state": state, "gauges": Gauges(left_s=1.0, too_fast=too_fast)})
        assert prompt(view, THEIRS).lamp is shown


@pytest.mark.parametrize("state", ["familiarising", "armed", "answering", "paused", "preparing"])
def test_the_hand_is_shown_for_practice_alone(state: str) -> None:
    view = View.model_validate({"state": state, "gauges": Gauges(left_s=1.0, hand_mm=3.5)})
    assert prompt(view, THEIRS).hand_mm == (3.5 if state == "familiarising" else None)


@given(view=views, other=views, kinds=st.frozensets(st.sampled_from(KINDS)))
def test_only_a_few_things_of_a_view_matter(view: View, other: View, kinds: frozenset[str]) -> None:
    """A view whose every other field is that of another view, at random, gives the same prompt."""
    question, gauges = view.question, view.gauges
    if question is not None and other.question is not None:
        words = other.question.text
        asked = tuple(choice.model_copy(update={"words": words, "answer": False}) for choice in question.choices)
        question = question.model_copy(update={"text": words, "choices": asked})
    if gauges is not None and other.gauges is not None:
        kept = {name: getattr(gauges, name) for name in ("pace", "too_fast", "second", "stepped")}
        gauges = other.gauges.model_copy(update=kept)
    matters = {
        name: getattr(view, name)
        for name in ("state", "step", "at_will", "instruction", "again", "masked", "pause_until_ns", "label")
    }
    ended = view.ended
    if ended is not None and other.ended is not None:
        ended = other.ended.model_copy(update={"exit_code": ended.exit_code})
    exchanged = other.model_copy(update={**matters, "question": question, "gauges": gauges, "ended": ended})
    assert prompt(exchanged, Theirs(kinds)) == prompt(view, Theirs(kinds))


@given(view=views, kinds=st.frozensets(st.sampled_from(KINDS)))
def test_the_participant_has_four_keys_five_meanings_and_those_only_for_their_own_questions(
    view: View, kinds: frozenset[str]
) -> None:
    shown = prompt(view, Theirs(kinds))
    assert set(shown.keys) <= {"+", HEARD_KEY, "-", ENTER, PROBE_KEY}
    if view.question is None or view.question.kind not in kinds:
        assert (shown.question, shown.keys) == (None, ())
    else:
        assert shown.question == view.question.number


def test_every_kind_of_question_has_its_page() -> None:
    assert tuple(AT_QUESTION) == KINDS


@pytest.mark.parametrize(
    ("state", "show"),
    [
        ("preparing", "wait"),
        ("familiarising", "instructions"),
        ("armed", "ready"),
        ("answering", "answer"),
        ("waiting", "wait"),
        ("paused", "break"),
        ("ended", "thanks"),
    ],
)
def test_every_state_has_its_page(state: str, show: str) -> None:
    assert prompt(View.model_validate({"state": state}), THEIRS).show == show


def test_who_compares_is_told_to_feel_both() -> None:
    asked = Question(number=3, kind="answer", text="", choices=())
    shown = prompt(View(at_will=True, question=asked, gauges=Gauges(left_s=1.0, too_fast=True)), THEIRS)
    assert (shown.show, shown.answers, shown.lamp) == ("compare", THEIRS.answers, True)
    felt = prompt(View(state="answering", at_will=True, gauges=Gauges(left_s=1.0, second=True)), THEIRS)
    assert (felt.show, felt.second) == ("compare", True)


def test_who_has_stepped_may_answer_before_the_experimenter_is_asked() -> None:
    view = View(state="armed", gauges=Gauges(left_s=1.0, stepped=True))
    assert prompt(view, THEIRS).show == "answer"
    zeroing = Question(number=3, kind="rest", text="", choices=())
    assert prompt(view.model_copy(update={"question": zeroing}), THEIRS).show == "rest"


@pytest.mark.parametrize("kind", ["write", "debrief"])
def test_who_has_answered_everything_is_told_so_until_the_end(kind: str) -> None:
    asked = Question.model_validate({"number": 3, "kind": kind, "text": "", "choices": ()})
    assert prompt(View(step="debriefing", question=asked), THEIRS).show == "finished"
    assert prompt(View(step="debriefing"), THEIRS).show == "finished"


def test_who_wore_headphones_may_take_them_off_once_everything_is_answered() -> None:
    for view, show in ((View(step="debriefing"), "finished"), (View(state="ended"), "thanks"), (View(), "wait")):
        told = prompt(view.model_copy(update={"masked": True}), THEIRS)
        assert (told.show, told.unmasked) == (show, show != "wait")
        assert not prompt(view, THEIRS).unmasked


@pytest.mark.parametrize(("exit_code", "show"), [(0, "thanks"), (2, "wait"), (70, "wait")])
def test_nobody_is_thanked_because_of_a_fault(exit_code: int, show: str) -> None:
    assert prompt(View(state="ended", ended=Ended(words="", exit_code=exit_code)), THEIRS).show == show


def test_real_objects_are_laid_out_behind_a_page_that_is_always_the_same() -> None:
    laid = {
        prompt(
            View(
                state="answering",
                lay_out=material,
                question=Question(number=7, kind="place", text=material, choices=()),
            ),
            THEIRS,
        )
        for material in ("copy paper", "aluminum foil")
    }
    assert laid == {Prompt(show="wait")}


@pytest.mark.parametrize(
    ("choices", "keys"),
    [(LEVEL, ("+", "-", ENTER)), ((*LEVEL, Choice(key=HEARD_KEY, words="still heard")), (HEARD_KEY, "-", ENTER))],
)
def test_a_masker_at_its_limit_can_be_said_to_be_heard_and_is_no_louder(
    choices: tuple[Choice, ...], keys: tuple[str, ...]
) -> None:
    asked = Question(number=3, kind="level", text="", choices=choices)
    shown = prompt(View(question=asked), THEIRS)
    assert (shown.show, shown.question, shown.keys, shown.unplayed) == ("masker", 3, keys, True)
    probed = asked.model_copy(update={"choices": (*choices, Choice(key=PROBE_KEY, words="feel it"))})
    shown = prompt(View(question=probed), THEIRS)
    assert (shown.keys, shown.unplayed) == ((*keys[:-1], PROBE_KEY, ENTER), False)


@pytest.mark.parametrize(
    ("view", "show"),
    [
        (View(), "wait"),
        (View(question=Question(number=3, kind="place", text="", choices=())), "wait"),
        (View(state="armed"), "ready"),
        (View(at_will=True, question=Question(number=3, kind="answer", text="", choices=())), "compare"),
    ],
)
def test_the_tasks_instruction_is_shown_until_the_first_answer(view: View, show: str) -> None:
    told = prompt(view.model_copy(update={"instruction": "Step, and say what you felt."}), THEIRS)
    assert (told.show, told.text) == (show, "Step, and say what you felt.")


def test_a_step_that_did_not_count_is_told_without_its_reason() -> None:
    told = prompt(View(state="armed", again="The foot stopped"), THEIRS)
    assert told == Prompt(show="ready", again=True)


@pytest.mark.parametrize(("by", "kinds"), [("participant", {"level"}), ("experimenter", set())])
def test_the_protocol_says_who_sets_the_masker(by: str, kinds: set[str]) -> None:
    study = Protocol.model_validate(changed(document(), ("masker", "level_set_by"), by))
    assert theirs(study) == Theirs(frozenset(kinds))


def test_answers_are_shown_only_where_the_protocol_says_so_and_only_while_one_is_wanted() -> None:
    study = Protocol.model_validate(changed(document(), ("answers", "on_screen"), True))
    said = tuple(material.spoken[0] for material in study.materials)
    assert theirs(study).answers == said
    for kind in KINDS:
        asked = Question.model_validate({"number": 3, "kind": kind, "text": "", "choices": ()})
        shown = prompt(View(question=asked), theirs(study))
        assert shown.answers == (said if kind in ("answer", "confirm") else ())
    assert prompt(View(state="armed"), theirs(study)).answers == ()


@pytest.mark.parametrize(("tie_key", "said"), [(None, ("first", "second")), ("3", ("first", "second", "tie"))])
def test_of_a_pair_the_answers_are_places_and_name_no_material(tie_key: str | None, said: tuple[str, ...]) -> None:
    study = Protocol.model_validate(changed(comparing(tie_key=tie_key), ("answers", "on_screen"), True))
    assert theirs(study).answers == said
    assert theirs(Protocol.model_validate(comparing(tie_key=tie_key))).answers == ()
