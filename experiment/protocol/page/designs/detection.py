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
    of_signals = f"A block has {count(own.signal_trials, 'trial')} with each signal"
    blank = "" if own.blank is None else f" (every material except {named(own.blank)})"
    if own.intervals == 2:
        return (
            f"{of_signals}{blank}. Each trial presents a signal and {named(own.blank or '')}. The signal comes first "
            "in half of its trials and second in the other half, selected at random before the first trial."
        )
    if not own.catch_trials:
        return f"{of_signals}{blank}. Every trial presents a signal."
    return f"{of_signals}{blank} and {count(own.catch_trials, 'catch trial')} without a signal."


def _question_words(protocol: Protocol) -> str:
    if protocol.table(Detection).intervals == 2:
        return "Participants say in which of the two intervals they felt something; they must choose one."
    return "Participants say whether they felt something."


def _odd(protocol: Protocol) -> Iterator[tuple[str, str, str]]:
    own = protocol.table(Detection)
    for place, test in enumerate(protocol.analysis):
        if test.test == "sensitivity" and own.intervals == 1 and not own.catch_trials:
            allowed = "usually 1 or more with the test 'sensitivity': d' requires catch trials"
            yield "detection.catch_trials", f"0, and analysis[{place}].test is 'sensitivity'", allowed
    for place, task in enumerate(protocol.tasks):
        levels = task.levels
        if levels is None or own.intervals != 2:
            continue
        up, down = levels.up or 1, levels.down or 0
        if down and (up / (up + 1)) ** (1 / down) <= GUESSED:
            allowed = "usually 2 or more (or a higher `up`): this rule converges on 50 % correct, the guess rate"
            yield f"tasks[{place}].levels.down", f"{down}", allowed
        if levels.guess is not None and abs(levels.guess - GUESSED) > GUESSED / 10:
            allowed = "usually 0.5: a guess between two intervals is correct in half of the trials"
            yield f"tasks[{place}].levels.guess", f"{levels.guess:g}", allowed


WORDS = DesignWords(
    odd=_odd,
    answers=lambda protocol: list(protocol.table(Detection).answers.items()),
    noun="trial",
    track="each signal",
    pairs=_block,
    asked=_question_words,
    tests={
        "threshold": "thresholds from psychometric functions fitted to each participant's answers",
        "sensitivity": "d' of each participant",
    },
    index="The threshold of each participant for each signal.",
)
