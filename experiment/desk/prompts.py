"""What the participant's screen shows of a view: nothing that is presented or laid out passes.

It reads only the state, how answers are given, whether samples are compared or the step is the debriefing, the
question's kind and keys, the instruction with its pictures, the last step's pace and whether it counted, whether the
hand is too fast, its height and place, whether a masker was played, which of several stimuli plays, what a trial asks,
the end of a break, a fault at the end, the label of a practice, and how many trials are answered, of how many.
"""

from collections.abc import Mapping
from typing import get_args

from palpate.experiment.desk.link.wire import Asked, View
from palpate.experiment.desk.messages import ENTER, Gauges, Label, Prompt, Show
from palpate.experiment.desk.questions import DEBRIEFING, STEP
from palpate.experiment.protocol.designs import design_of
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.protocol.rules import HEARD_KEY, LOUDER_KEY, PROBE_KEY, SOFTER_KEY

KEYS = (LOUDER_KEY, HEARD_KEY, SOFTER_KEY, PROBE_KEY, ENTER)
"""The participant has these keys and no others."""

AT_QUESTION: dict[str, Show] = {
    "agree": "wait",
    "write": "wait",
    "familiarise": "instructions",
    "level": "masker",
    "say": "wait",
    "rest": "rest",
    "place": "wait",
    "play": "coming",
    "answer": "answer",
    "confirm": "answer",
    "debrief": "finished",
    "break": "break",
    "continue": "break",
}
"""What is shown while the experimenter is asked a question of this kind."""

INSTRUCTED = ("wait", "instructions", "ready", "coming", "compare")
"""Where the instruction is shown, if there is one."""

LIT = ("instructions", "ready", "coming", "answer", "compare")
"""Where the lamp is shown that says that the hand is too fast."""

AMONG_TRIALS = ("wait", "ready", "coming", "answer", "compare", "break")
"""Where progress is shown, if the protocol shows it."""

IN_STATE: dict[str, Show] = {
    "familiarising": "instructions",
    "armed": "ready",
    "answering": "answer",
    "paused": "break",
    "ended": "thanks",
}
"""What is shown in this state while nothing is asked; in any other the participant waits."""


def shown_answers(protocol: Protocol) -> dict[str, str]:
    """Return the answers that a protocol shows the participant at their screen, in every trial, in words by their keys;
    none unless it does, or has them given there.
    """
    if not protocol.answers.on_screen and protocol.answers.mode != "screen":
        return {}
    design = design_of(protocol.tasks[0].design)
    return dict(zip(design.answers(protocol, ()), design.shown(protocol), strict=True))


NO_GAUGES = Gauges(left_s=0.0)


def prompt(view: View, answers: Mapping[str, str]) -> Prompt:
    """Return what the participant's screen shows, with the number 0; `answers`, in words by their keys, are allowed in
    any trial.
    """
    asked, gauges, show = view.question, view.gauges or NO_GAUGES, _show(view)
    number, keys = _offered(asked, answers)
    return Prompt(
        show=show,
        text=view.instruction if show in INSTRUCTED else "",
        pictures=view.pictures if show in INSTRUCTED and view.instruction else (),
        interval=view.interval if show == "coming" else None,
        again=bool(view.again) and show == "ready",
        unplayed=show == "masker" and asked is not None and PROBE_KEY not in {one.key for one in asked.choices},
        answers=tuple(answers.values()) if show in ("answer", "compare") else (),
        asks=view.asks,
        mode=view.mode,
        question=number,
        keys=keys,
        pace=gauges.pace if show in ("ready", "answer") else None,
        lamp=gauges.too_fast if show in LIT else None,
        second=gauges.second if show == "compare" else None,
        hand_mm=gauges.hand_mm if show == "instructions" else None,
        unmasked=view.masked and show in ("break", "finished", "thanks"),
        until_ns=view.pause_until_ns if show == "break" else None,
        progress=_progress(view) if show in AMONG_TRIALS else None,
        label=next((label for label in get_args(Label) if label == view.label), ""),
    )


def _progress(view: View) -> tuple[int, int] | None:
    return (view.standing.answered, view.standing.trials) if view.progress else None


def _show(view: View) -> Show:
    asked, gauges = view.question, view.gauges
    show = IN_STATE.get(view.state, "wait") if asked is None else AT_QUESTION[asked.kind]
    if show == "thanks" and view.ended is not None and view.ended.exit_code:
        # A fault ended it; the experimenter sees to it, and the session goes on.
        show = "wait"
    if asked is None and view.state == "armed" and gauges is not None and gauges.stepped:
        show = "answer"
    if show == "ready" and view.may != STEP:
        return "coming"
    if show == "answer" and view.at_will:
        return "compare"
    if show == "answer" and view.mode != "oral" and (asked is None or asked.kind != "answer"):
        # Whoever presses is asked first.
        return "wait"
    return "finished" if show == "wait" and view.step == DEBRIEFING else show


def _offered(asked: Asked | None, answers: Mapping[str, str]) -> tuple[int | None, tuple[str, ...]]:
    """Return the number and the keys of a question that the participant may answer here; none of any other."""
    theirs = ("participant", "either")
    offered = {choice.key for choice in asked.choices if choice.by in theirs} if asked is not None else set()
    answering = asked is not None and asked.kind == "answer"
    if HEARD_KEY in offered and not answering:
        offered.discard(LOUDER_KEY)
    keys = tuple(key for key in (answers if answering else KEYS) if key in offered)
    return asked.number if asked is not None and keys else None, keys
