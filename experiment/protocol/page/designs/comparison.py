"""What a board's page says of comparison: two materials a trial, and participants say which has more of a quality."""

from palpate.experiment.protocol.blocks import named
from palpate.experiment.protocol.designs.comparison import Comparison
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.protocol.page.words import DesignWords


def _question_words(protocol: Protocol) -> str:
    comparison = protocol.table(Comparison)
    tie = ", or neither" if comparison.tie_key is not None else "; they must choose one"
    asked = f"say which of the two has more {named(comparison.quality)}"
    if all(task.question for task in protocol.tasks):
        asked = "answer the question of the task, word for word as in section 5"
    return f"Participants {asked}{tie}."


def _ranked(protocol: Protocol) -> str:
    comparison = protocol.table(Comparison)
    if comparison.ordered:
        return f"In order, from least to most {named(comparison.quality)}:"
    return f"The materials are not ranked by {named(comparison.quality)}, so no choice is right or wrong:"


WORDS = DesignWords(
    answers=lambda protocol: list(protocol.table(Comparison).answers.items()),
    noun="pair",
    tests={
        "factors": "the effect of doubling each number that varies between stimuli on a Bradley-Terry scale, with 95 % "
        "confidence intervals across participants",
        "delays": "the effect of a vibration before or after the touch on a Bradley-Terry scale, and the just "
        "noticeable delay, with 95 % confidence intervals across participants",
        "crossover": "the crossover from force to vibration that has the most of the quality on a Bradley-Terry "
        "scale, with its 95 % confidence interval across participants",
    },
    track="each two materials",
    pairs=lambda _: (
        "A pair is two of the materials, or the same one twice. In half of a pair's trials, selected at random, one "
        "of its materials comes first; in the other half, the other comes first."
    ),
    asked=_question_words,
    ranked=_ranked,
    index="The proportion of trials in which a participant chose one of the two materials, for each task and pair.",
)
