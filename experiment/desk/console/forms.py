"""What the experimenter may ask for at any moment beside answering, and which fields have to be filled in for it."""

from dataclasses import dataclass, replace
from typing import Literal

from palpate.experiment.desk.link.wire import Asked, Deed, Pause, Stop, View, Write
from palpate.experiment.desk.messages import Choice, Correct, Repeat, TakeNote, TellIncident
from palpate.experiment.settings import characters

MOST_MIN = 240.0
"""The longest break, min."""

MOST_CHARACTERS = 400
"""Of a text that is typed."""


class NotFilledIn(ValueError):
    """A field of a form does not hold what it must."""


@dataclass(frozen=True)
class Blank:
    """One field to fill in: its name, what stands in it at first, and what it takes, None for anything."""

    name: str
    text: str = ""
    takes: str | None = None


@dataclass(frozen=True)
class Form:
    """What is asked for: `title`, `does` (of Enter) and `hint`, for a `trial` under way, or to answer a `question`."""

    name: str
    title: str
    does: str
    blanks: tuple[Blank, ...] = ()
    hint: str = ""
    trial: int | None = None
    question: int = 0


NUMBER = r"\d*"
"""What the number of a trial is typed with."""

BREAK_MIN = "5"
"""What stands in the field for a break's length at first, min."""


def opened(name: str, view: View) -> Form:
    """Return the form with this name as it is at first: `note`, `correct`, `repeat`, `incident` and so on."""
    trial, kind = view.trial, view.question.kind if view.question is not None else ""
    again = f" Trial {trial}, still unanswered, will be repeated." if kind in ("answer", "confirm") else ""
    answered = str(view.standing.recent[-1].trial) if view.standing.recent else ""
    match name:
        case "note":
            about = f"trial {trial}" if trial is not None else "the session"
            form = Form(name, f"Note on {about}. Do not name anyone.", "saves it", (Blank("Note"),))
        case "correct":
            blanks = (Blank("Trial", answered, NUMBER), Blank("Key"), Blank("Reason"))
            keys = ", ".join(f"{one.key}={one.words}" for one in answers(view))
            title = "Correct an answer. Both answers stay on record."
            form = Form(name, title, "corrects it", blanks, f"Keys: {keys}" if keys else "")
        case "repeat":
            under_way = str(trial) if trial is not None else answered
            title = "Repeat a trial at the end of its block. If it was answered, that answer no longer counts."
            form = Form(name, title, "repeats it", (Blank("Trial", under_way, NUMBER), Blank("Reason")))
        case "incident":
            title = "Adverse event, or deviation from the protocol. It is recorded permanently. Do not name anyone."
            blanks = (Blank("a or d"), Blank("Happened"), Blank("Done"))
            hint = "a: adverse event, d: deviation. Write what happened and what was done. Then run palpate incident."
            form = Form(name, title, "records it", blanks, hint)
        case "break":
            title = (
                "Take a break as soon as nothing can be felt. The screen shows when the break is over; then "
                "continue the session."
            )
            form = Form(name, title + again, "pauses", (Blank("Minutes", BREAK_MIN),))
        case "stop":
            paused = view.state == "paused"
            how = "is paused" if paused else "pauses as soon as nothing can be felt"
            title = (
                f"{'End' if paused else 'Stop'} for today? The session {how}, and the program closes. Every confirmed "
                "answer is saved. To continue another time, run the same command. To record a withdrawal, run "
                "palpate withdraw afterwards."
            )
            form = Form(name, title + again, "ends for today" if paused else "stops")
        case _:
            title = (
                "Leave the console? The session continues. To come back to it, run the same command. While no "
                "console is open, no further trial is armed, and the session pauses after a few minutes."
            )
            form = Form(name, title, "leaves")
    return replace(form, trial=trial)


def answering(question: Asked) -> Form:
    """Return the form for a question that is answered with a line of text."""
    hint = "Leave it blank if there is no answer."
    return Form("write", question.text, "writes it down", (Blank("Answer"),), hint, question=question.number)


def answers(view: View) -> tuple[Choice, ...]:
    """Return the answers that a trial may have, as far as the session has told them."""
    asked = view.question.choices if view.question is not None else ()
    return view.answers or tuple(choice for choice in asked if choice.answer)


def filled(form: Form, texts: tuple[str, ...]) -> Deed:
    """Return what a form asks for that was filled in with `texts`. Raises `NotFilledIn`, with what to do."""
    given = {blank.name: _line(blank.name, text) for blank, text in zip(form.blanks, texts, strict=True)}
    match form.name:
        case "note":
            return TakeNote(text=_some(given, "Note"), trial=form.trial)
        case "incident":
            return TellIncident(
                sort=_sort(given["a or d"]), text=_some(given, "Happened"), done=_some(given, "Done"), trial=form.trial
            )
        case "correct":
            return Correct(trial=_trial(given), key=_some(given, "Key").lower(), reason=_some(given, "Reason"))
        case "repeat":
            return Repeat(trial=_trial(given), reason=_some(given, "Reason"))
        case "write":
            return Write(question=form.question, text=given["Answer"])
        case "break":
            return Pause(minutes=_minutes(given["Minutes"]))
        case _:
            return Stop()


def _line(name: str, text: str) -> str:
    try:
        return characters.one_line(text.strip())
    except ValueError as error:
        raise NotFilledIn(f"{name} {error}, which cannot be recorded. Type it again without that character.") from error


def _some(given: dict[str, str], name: str) -> str:
    if not given[name]:
        raise NotFilledIn(f"{name} is blank. Fill it in, or press Escape to close this form.")
    return given[name]


def _sort(typed: str) -> Literal["adverse event", "deviation"]:
    match typed.lower():
        case "a":
            return "adverse event"
        case "d":
            return "deviation"
    raise NotFilledIn(f"{characters.quoted(typed)} is neither. Type a for an adverse event or d for a deviation.")


def _trial(given: dict[str, str]) -> int:
    typed = given["Trial"]
    if not (typed.isascii() and typed.isdecimal()):
        raise NotFilledIn(f"{characters.quoted(typed)} is not a trial. Type a trial number, such as 12.")
    return int(typed)


def _minutes(typed: str) -> float:
    try:
        minutes = float(typed.replace(",", "."))
    except ValueError:
        minutes = float("nan")
    if not 0 < minutes <= MOST_MIN:
        raise NotFilledIn(f"{characters.quoted(typed)} is not a valid break. Type minutes, at most {MOST_MIN:g}.")
    return minutes
