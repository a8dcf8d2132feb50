"""What a board's page says of detection: whether something is felt, or in which of two intervals."""

from palpate.experiment.protocol.blocks import count, named
from palpate.experiment.protocol.designs.detection import Detection
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.protocol.page.words import DesignWords


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


WORDS = DesignWords(
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
