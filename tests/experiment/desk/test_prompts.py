"""What reaches the participant's screen: nothing that is presented or laid out, and no key that is not theirs."""

from __future__ import annotations

import pytest
from hypothesis import given

from palpate.experiment.desk.link.wire import Asked, Ended, Standing, View, line
from palpate.experiment.desk.messages import ENTER, By, Choice, Gauges, Prompt
from palpate.experiment.desk.prompts import AT_QUESTION, prompt, shown_answers
from palpate.experiment.desk.questions import ANSWERED_BY, STEP, Level, TrialAnswer, keyed
from palpate.experiment.protocol.files import ProtocolFile
from palpate.experiment.protocol.rules import HEARD_KEY, PROBE_KEY, Mode
from tests.experiment.desk.views import KINDS, MARK, views
from tests.experiment.protocol.small import changed, document
from tests.experiment.protocol.tapping import comparing

SHOWN = {"f": "felt", "c": "cork"}
WORDS = tuple(SHOWN.values())
LEVEL = keyed({"+": "louder", "-": "softer", ENTER: "keep"}, by="participant")


@pytest.mark.parametrize(("state", "shown"), [("armed", "interval 1"), ("paused", "break"), ("waiting", "wait")])
def test_an_interval_is_on_record_only_while_it_is_shown(state: str, shown: str) -> None:
    assert prompt(View.model_validate({"state": state, "interval": 1}), {}).on_record == shown


@given(view=views)
def test_nothing_that_is_presented_reaches_the_screen(view: View) -> None:
    assert MARK.encode() not in line(prompt(view, {}))


@pytest.mark.parametrize(
    ("state", "lamp"),
    [("familiarising", True), ("armed", True), ("answering", True), ("paused", None), ("ended", None)],
)
def test_the_lamp_is_lit_where_the_participant_taps(state: str, lamp: bool | None) -> None:
    for too_fast, shown in ((True, lamp), (None, None)):
        view = View.model_validate({"state": state, "gauges": Gauges(left_s=1.0, too_fast=too_fast)})
        assert prompt(view, SHOWN).lamp is shown


@pytest.mark.parametrize("state", ["familiarising", "armed", "answering", "paused", "preparing"])
def test_the_hand_is_shown_for_practice_alone(state: str) -> None:
    view = View.model_validate({"state": state, "gauges": Gauges(left_s=1.0, hand_mm=3.5)})
    assert prompt(view, SHOWN).hand_mm == (3.5 if state == "familiarising" else None)


@given(view=views, other=views)
def test_only_a_few_things_of_a_view_matter(view: View, other: View) -> None:
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
        for name in (
            "state",
            "step",
            "at_will",
            "mode",
            "instruction",
            "interval",
            "asks",
            "again",
            "masked",
            "pause_until_ns",
            "label",
        )
    }
    ended = view.ended
    if ended is not None and other.ended is not None:
        ended = other.ended.model_copy(update={"exit_code": ended.exit_code})
    exchanged = other.model_copy(update={**matters, "question": question, "gauges": gauges, "ended": ended})
    assert prompt(exchanged, SHOWN) == prompt(view, SHOWN)


@given(view=views)
def test_the_participant_has_four_keys_five_meanings_and_those_only_for_their_own_choices(view: View) -> None:
    shown = prompt(view, SHOWN)
    answers = set(SHOWN) if view.question is not None and view.question.kind == "answer" else set()
    assert set(shown.keys) <= (answers or {"+", HEARD_KEY, "-", ENTER, PROBE_KEY})
    by = ("participant", "either")
    theirs = {one.key for one in view.question.choices if one.by in by} if view.question else set()
    assert set(shown.keys) <= theirs
    assert shown.question == (view.question.number if view.question and shown.keys else None)


def test_every_kind_of_question_has_its_page() -> None:
    assert tuple(AT_QUESTION) == KINDS


@pytest.mark.parametrize(
    ("state", "show"),
    [
        ("preparing", "wait"),
        ("familiarising", "instructions"),
        ("armed", "coming"),
        ("answering", "answer"),
        ("waiting", "wait"),
        ("paused", "break"),
        ("ended", "thanks"),
    ],
)
def test_every_state_has_its_page(state: str, show: str) -> None:
    assert prompt(View.model_validate({"state": state}), SHOWN).show == show


def test_who_compares_is_told_to_feel_both() -> None:
    asked = Asked(number=3, kind="answer", text="", choices=())
    shown = prompt(View(at_will=True, question=asked, gauges=Gauges(left_s=1.0, too_fast=True)), SHOWN)
    assert (shown.show, shown.answers, shown.lamp) == ("compare", WORDS, True)
    felt = prompt(View(state="answering", at_will=True, gauges=Gauges(left_s=1.0, second=True)), SHOWN)
    assert (felt.show, felt.second) == ("compare", True)


def test_who_has_stepped_may_answer_before_the_experimenter_is_asked() -> None:
    view = View(state="armed", gauges=Gauges(left_s=1.0, stepped=True))
    assert prompt(view, SHOWN).show == "answer"
    zeroing = Asked(number=3, kind="rest", text="", choices=())
    assert prompt(view.model_copy(update={"question": zeroing}), SHOWN).show == "rest"


@pytest.mark.parametrize("kind", ["write", "debrief"])
def test_who_has_answered_everything_is_told_so_until_the_end(kind: str) -> None:
    asked = Asked.model_validate({"number": 3, "kind": kind, "text": "", "choices": ()})
    assert prompt(View(step="debriefing", question=asked), SHOWN).show == "finished"
    assert prompt(View(step="debriefing"), SHOWN).show == "finished"


def test_who_wore_headphones_may_take_them_off_in_a_break_and_once_everything_is_answered() -> None:
    off = {"finished": View(step="debriefing"), "thanks": View(state="ended"), "break": View(state="paused")}
    for show, view in {**off, "wait": View()}.items():
        told = prompt(view.model_copy(update={"masked": True}), SHOWN)
        assert (told.show, told.unmasked) == (show, show != "wait")
        assert not prompt(view, SHOWN).unmasked


@pytest.mark.parametrize(
    ("state", "shown"), [("armed", True), ("answering", True), ("paused", True), ("familiarising", False)]
)
def test_progress_is_shown_among_trials_where_the_protocol_shows_it(state: str, shown: bool) -> None:
    view = View.model_validate({"state": state, "standing": Standing(trials=40, answered=3, remaining=37)})
    assert prompt(view, {}).progress is None
    assert prompt(view.model_copy(update={"progress": True}), {}).progress == ((3, 40) if shown else None)


@pytest.mark.parametrize(("exit_code", "show"), [(0, "thanks"), (2, "wait"), (70, "wait")])
def test_nobody_is_thanked_because_of_a_fault(exit_code: int, show: str) -> None:
    assert prompt(View(state="ended", ended=Ended(words="", exit_code=exit_code)), SHOWN).show == show


def test_real_objects_are_laid_out_behind_a_page_that_is_always_the_same() -> None:
    laid = {
        prompt(
            View(
                state="answering",
                lay_out=material,
                question=Asked(number=7, kind="place", text=material, choices=()),
            ),
            SHOWN,
        )
        for material in ("copy paper", "aluminum foil")
    }
    assert laid == {Prompt(show="wait")}


@pytest.mark.parametrize(
    ("choices", "keys"),
    [
        (LEVEL, ("+", "-", ENTER)),
        ((*LEVEL, *keyed({HEARD_KEY: "still audible"}, by="participant")), (HEARD_KEY, "-", ENTER)),
    ],
)
def test_a_masker_at_its_limit_can_be_said_to_be_heard_and_is_no_louder(
    choices: tuple[Choice, ...], keys: tuple[str, ...]
) -> None:
    asked = Asked(number=3, kind="level", text="", choices=choices)
    shown = prompt(View(question=asked), SHOWN)
    assert (shown.show, shown.question, shown.keys, shown.unplayed) == ("masker", 3, keys, True)
    probed = asked.model_copy(update={"choices": (*choices, *keyed({PROBE_KEY: "feel it"}, by="participant"))})
    shown = prompt(View(question=probed), SHOWN)
    assert (shown.keys, shown.unplayed) == ((*keys[:-1], PROBE_KEY, ENTER), False)


@pytest.mark.parametrize(
    ("view", "show"),
    [
        (View(), "wait"),
        (View(question=Asked(number=3, kind="place", text="", choices=())), "wait"),
        (View(state="armed"), "coming"),
        (View(state="armed", may=STEP), "ready"),
        (View(at_will=True, question=Asked(number=3, kind="answer", text="", choices=())), "compare"),
    ],
)
def test_the_tasks_instruction_is_shown_until_the_first_answer(view: View, show: str) -> None:
    told = prompt(view.model_copy(update={"instruction": "Step, and say what you felt."}), SHOWN)
    assert (told.show, told.text) == (show, "Step, and say what you felt.")


def test_a_step_that_did_not_count_is_told_without_its_reason() -> None:
    told = prompt(View(state="armed", may=STEP, again="The foot stopped"), SHOWN)
    assert told == Prompt(show="ready", again=True)


@pytest.mark.parametrize(
    ("by", "keys"), [("participant", ("+", "-", ENTER)), ("experimenter", ()), ("either", ("+", "-", ENTER))]
)
def test_whoever_sets_the_masker_is_offered_its_keys(by: By, keys: tuple[str, ...]) -> None:
    asked = Level(50, 80, "Nothing.", probe=False, by=by)
    shown = prompt(View(question=Asked(number=3, kind="level", text="", choices=asked.choices)), {})
    assert (shown.question, shown.keys) == (3 if keys else None, keys)


def test_answers_are_shown_only_where_the_protocol_says_so_and_only_while_one_is_wanted() -> None:
    study = ProtocolFile.model_validate(changed(document(), ("answers", "on_screen"), True))
    said = tuple(material.spoken[0] for material in study.materials)
    assert tuple(shown_answers(study).values()) == said
    for kind in KINDS:
        asked = Asked.model_validate({"number": 3, "kind": kind, "text": "", "choices": ()})
        shown = prompt(View(question=asked), shown_answers(study))
        assert shown.answers == (said if kind in ("answer", "confirm") else ())
    assert prompt(View(state="armed"), shown_answers(study)).answers == ()


@pytest.mark.parametrize(("tie_key", "said"), [(None, ("first", "second")), ("3", ("first", "second", "tie"))])
def test_of_a_pair_the_answers_are_places_and_name_no_material(tie_key: str | None, said: tuple[str, ...]) -> None:
    study = ProtocolFile.model_validate(changed(comparing(tie_key=tie_key), ("answers", "on_screen"), True))
    assert tuple(shown_answers(study).values()) == said
    assert shown_answers(ProtocolFile.model_validate(comparing(tie_key=tie_key))) == {}


@pytest.mark.parametrize(("mode", "keys"), [("screen", ("c", "f")), ("keys", ())])
def test_answers_are_offered_where_they_are_given_and_while_they_are_asked_for(
    mode: Mode, keys: tuple[str, ...]
) -> None:
    answers = {"c": "cork", "f": "felt"}
    asked = TrialAnswer(1, {"f": "felt (laid out)", "c": "cork"}, "n", {"r": "again"}, ANSWERED_BY[mode])
    question = Asked(number=3, kind="answer", text="", choices=asked.choices)
    view = View(state="answering", mode=mode, question=question)
    shown = prompt(view, answers)
    assert (shown.show, shown.question, shown.keys) == ("answer", 3 if keys else None, keys)
    confirming = question.model_copy(update={"kind": "confirm", "choices": ()})
    for other in (None, confirming):
        waits = prompt(view.model_copy(update={"question": other}), answers)
        assert (waits.show, waits.keys) == ("wait", ())
    stepped = View(state="armed", mode=mode, gauges=Gauges(left_s=1.0, stepped=True))
    assert prompt(stepped, answers).show == "wait"
