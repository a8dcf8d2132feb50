"""Detection by a simulated participant: how strong each stimulus felt, with an error, beside a criterion or another.

A kind gives the strength of what the panel was played, in dB above threshold, so that an answer comes from the waveform
alone. With `told_apart` as the standard deviation, yes means that a stimulus felt stronger than `CRITERION` of these,
which without any signal happens in 7 % of trials; of two intervals the stronger one is named.
"""

from collections.abc import Sequence

import numpy as np

from palpate.experiment.protocol.designs.detection import FIRST, NO, SECOND, WORDS, YES, Detection
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.rehearsal.designs import Judged, Percept

CRITERION = 1.5
"""How much stronger than nothing something has to feel for a yes, in standard deviations of the error. Ours."""


def judge(protocol: Protocol, percepts: Sequence[Percept], rng: np.random.Generator) -> Judged:
    """Return whether something was felt, or in which interval."""
    felt = [_strength(one) + one.error * rng.normal() for one in percepts]
    keys = {answer: key for key, answer in protocol.table(Detection).answers.items()}
    if len(felt) == 1:
        answer, apart = (YES if felt[0] > CRITERION else NO), felt[0] - CRITERION
    else:
        answer, apart = (FIRST if felt[0] > felt[1] else SECOND), felt[0] - felt[1]
    return Judged(keys[answer], WORDS[answer], apart)


def _strength(percept: Percept) -> float:
    """Return how strong a stimulus is, in what is just told apart; of a kind that has no strength, noticed or not."""
    if percept.strength or percept.alike is None:
        return percept.strength / percept.told_apart
    return 2 * CRITERION * bool(percept.alike.size)
