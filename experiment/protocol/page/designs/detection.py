"""What a board's page says of detection: whether something is felt, or in which of two intervals."""

from collections.abc import Iterator

from palpate.experiment.protocol.blocks import count, named
from palpate.experiment.protocol.designs.detection import Detection
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.protocol.page.words import DesignWords

GUESSED = 0.5
"""Share of right answers of whoever guesses between two intervals."""


def _block(protocol: Protocol) -> str:
    own = protocol.table(Detection)
    of_signals = f"A block has {count(own.signal_trials, 'trial')} of each signal"
    blank = "" if own.blank is None else f", which is every material but {named(own.blank)}"
    if own.intervals == 2:
        return (
            f"{of_signals}{blank}. A trial presents a signal and {named(own.blank or '')}; in half of the trials "
            "drawn for a signal, at random and before the first trial, it comes first, in the other half second."
        )
    if not own.catch_trials:
        return f"{of_signals}{blank}. Every trial presents a signal."
    return f"{of_signals}{blank}, and {count(own.catch_trials, 'catch trial')}, which presents that alone."


def _question_words(protocol: Protocol) -> str:
    if protocol.table(Detection).intervals == 2:
        return "Participants say in which of the two intervals they felt something; they have to choose."
    return "Participants say whether they felt something."


def _odd(protocol: Protocol) -> Iterator[tuple[str, str, str]]:
    own = protocol.table(Detection)
    for place, test in enumerate(protocol.analysis):
        if test.test == "sensitivity" and own.intervals == 1 and not own.catch_trials:
            allowed = "as a rule 1 or more with a test 'sensitivity': without trials of nothing there is no d'"
            yield "detection.catch_trials", f"0, and analysis[{place}].test is 'sensitivity'", allowed
    for place, task in enumerate(protocol.tasks):
        levels = task.levels
        if levels is None or own.intervals != 2:
            continue
        up, down = levels.up or 1, levels.down or 0
        if down and (up / (up + 1)) ** (1 / down) <= GUESSED:
            allowed = "as a rule 2 or more, or so for up: who guesses is right in half of the trials, where this aims"
            yield f"tasks[{place}].levels.down", f"{down}", allowed
        if levels.guess is not None and abs(levels.guess - GUESSED) > GUESSED / 10:
            allowed = "as a rule 0.5: who guesses between two intervals is right in half of the trials"
            yield f"tasks[{place}].levels.guess", f"{levels.guess:g}", allowed


WORDS = DesignWords(
    odd=_odd,
    answers=lambda protocol: list(protocol.table(Detection).answers.items()),
    noun="trial",
    track="each signal",
    pairs=_block,
    asked=_question_words,
    tests={
        "threshold": "thresholds of psychometric functions, fitted to each participant's answers",
        "sensitivity": "d' of each participant",
    },
    index="The threshold of each participant for each signal.",
)
