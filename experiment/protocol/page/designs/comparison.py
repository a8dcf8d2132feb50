"""What a board's page says of comparison: two materials a trial, and participants say which has more of a quality."""

from palpate.experiment.protocol.blocks import named
from palpate.experiment.protocol.designs.comparison import Comparison
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.protocol.page.words import DesignWords


def _question_words(protocol: Protocol) -> str:
    comparison = protocol.table(Comparison)
    tie = ", or neither" if comparison.tie_key is not None else "; they have to choose"
    return f"Participants say which of the two has more {named(comparison.quality)}{tie}."


def _ranked(protocol: Protocol) -> str:
    comparison = protocol.table(Comparison)
    if comparison.ordered:
        return f"From the least {named(comparison.quality)} to the most:"
    return f"In no order of {named(comparison.quality)}, so that no choice is right or wrong:"


WORDS = DesignWords(
    answers=lambda protocol: list(protocol.table(Comparison).answers.items()),
    noun="pair",
    tests={
        "factors": "what a doubling of each number that varies over the stimuli adds on a scale of Bradley and Terry, "
        "with 95 % intervals over participants",
        "delays": "what a vibration adds that comes earlier or later than the touch, on a scale of Bradley and Terry, "
        "and which delay is just noticed, with 95 % intervals over participants",
        "crossover": "where on a scale of Bradley and Terry over the crossover from force to vibration most of the "
        "quality lies, with its 95 % interval over participants",
    },
    track="each two materials",
    pairs=lambda _: (
        "A pair is two of the materials, or twice the same one. In half of the trials with a pair, drawn at random, "
        "the one of its materials is presented first, in the other half the other."
    ),
    asked=_question_words,
    ranked=_ranked,
    index="The share of trials in which a participant named one of two materials, for each task and pair.",
)
