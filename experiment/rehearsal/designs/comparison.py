"""Comparison by a simulated participant: the stronger of two, each felt with an error."""

from collections.abc import Sequence

import numpy as np

from palpate.experiment.protocol.designs.comparison import FIRST, SECOND, TIE, WORDS, Comparison
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.rehearsal.designs import Judged, Percept

NEARLY = 0.5
"""Nearer than this, in what is just told apart, is a tie where one is allowed. Ours."""


def judge(protocol: Protocol, percepts: Sequence[Percept], rng: np.random.Generator) -> Judged:
    """Return which of two was stronger."""
    first, second = (one.strength + one.error * one.told_apart * rng.normal() for one in percepts)
    told_apart, favour = percepts[0].told_apart, percepts[0].favour
    apart = (first - second) / told_apart
    leaning = apart + favour / told_apart
    keys = {answer: key for key, answer in protocol.table(Comparison).answers.items()}
    answer = TIE if TIE in keys and abs(leaning) < NEARLY else FIRST if leaning > 0 else SECOND
    return Judged(keys[answer], WORDS[answer], apart)
