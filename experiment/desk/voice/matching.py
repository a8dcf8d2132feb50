"""Matches an utterance against what the same participant said at enrolment, by dynamic time warping.

Two utterances are aligned so that their frames differ least: steps of 1 in either, or in both, weights 1, 1 and 2, and
the sum divided by both lengths (H. Sakoe and S. Chiba, IEEE Transactions on Acoustics, Speech, and Signal Processing 26
(1978) 43-49, the symmetric form without a slope constraint). So whatever language it is, no model is needed but two
takes of each answer; and their distances say how far apart takes of one answer are for this participant, and takes of
different answers. An utterance's distance is told in those terms: an **agreement** of 1 is that of two takes of one
answer, 0 that of different answers.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.errors import VoiceError

Take = NDArray[np.float64]
"""The cepstra of an utterance, shape (frames, coefficients)."""

AGREES = 0.7
"""Agreement from which an utterance is an answer.

Midway between the 3rd percentile of answers, 0.91, and the 95th of other words, 0.49, to a tenth: 360 utterances of
each by ten SYNTHETIC voices, English and Japanese, at 20, 10 and 0 dB, apart from those of the measured figures
(`python -m tests.benchmarks.voice thresholds`). It says nothing of real participants.
"""

CLEARLY = 0.05
"""In units of agreement: five times the gain from another beginning in clean answers of those voices, a third of that
in answers that began within another sound.
"""

_TAKES = 2
"""At least, of each answer: fewer do not say how far apart they are."""


@dataclass(frozen=True, eq=False)
class Enrolment:
    """One participant's takes of each answer, and mean distances of two takes of one (`own`) or of two (`other`)."""

    answers: tuple[str, ...]
    takes: tuple[Take, ...]
    own: float
    other: float


@dataclass(frozen=True)
class Match:
    """The answer that an utterance is nearest to.

    Attributes:
        answer: that one.
        agreement: from 0, as far as another answer, to 1, as near as a take of this one.
        lead: how much further the next answer is, in the same unit.
        begin: frame of the utterance from which it was compared.
    """

    answer: str
    agreement: float
    lead: float
    begin: int


def enrolled(takes: Mapping[str, Sequence[Take]]) -> Enrolment:
    """Return a participant's enrolment from two takes or more of each of two answers or more.

    Raises `VoiceError` for fewer, or a take nearest to one of another answer (`unlike`).
    """
    few = [answer for answer, said in takes.items() if len(said) < _TAKES]
    if few or len(takes) < 2:
        raise VoiceError(
            "enrolment",
            f"got {len(takes)} answers, and too few recordings of {few}",
            "record them again",
            allowed="at least two answers, each recorded at least twice",
        )
    answers, every, apart = _apart(takes)
    same = np.array(answers)[:, None] == np.array(answers)
    if mistaken := _mistaken(answers, apart):
        raise VoiceError(
            "enrolment",
            "got "
            + ", ".join(
                f"a recording of {one!r} that is closest to one of {other!r}" for one, other in mistaken.items()
            ),
            "record each of these answers twice again",
            allowed="recordings whose closest match is another recording of the same answer",
        )
    own = float(np.mean(apart[same & np.isfinite(apart)]))
    return Enrolment(answers, every, own, float(np.mean(apart[~same])))


def unlike(takes: Mapping[str, Sequence[Take]]) -> dict[str, str]:
    """Return each answer of which a take is nearest to one of another answer, with that other one."""
    answers, _, apart = _apart(takes)
    return _mistaken(answers, apart)


def _mistaken(answers: tuple[str, ...], apart: NDArray[np.float64]) -> dict[str, str]:
    nearest = (answers[j] for j in np.argmin(apart, axis=1))
    return {one: other for one, other in zip(answers, nearest, strict=True) if one != other}


def _apart(takes: Mapping[str, Sequence[Take]]) -> tuple[tuple[str, ...], tuple[Take, ...], NDArray[np.float64]]:
    """Return the answer of every take, the takes, and how far they are apart, inf from themselves, (takes, takes)."""
    answers = tuple(answer for answer, said in takes.items() for _ in said)
    every = tuple(take for said in takes.values() for take in said)
    apart = np.array([_rests(take, every)[0] for take in every])
    np.fill_diagonal(apart, np.inf)
    return answers, every, apart


def match(utterance: Take, enrolment: Enrolment, begins: Sequence[int] = (0,)) -> Match:
    """Return the nearest answer to an utterance, from the frame among `begins` from which it is so.

    A later frame, after another sound, counts if it agrees more by `CLEARLY`. Raises `VoiceError` for frames of another
    kind, and for bad beginnings.
    """
    coefficients = enrolment.takes[0].shape[1]
    if utterance.ndim != 2 or utterance.shape[1] != coefficients or not all(0 <= b < len(utterance) for b in begins):
        raise VoiceError(
            "utterance",
            f"got shape {utterance.shape}, from frames {tuple(begins)} on",
            "compute its cepstra",
            allowed=f"one or more frames of {coefficients} coefficients each, and starts that are among those frames",
        )
    rests = _rests(utterance, enrolment.takes)
    nearest = np.min(rests, axis=1)
    begin, any_frame = min(begins, key=lambda each: float(nearest[each])), int(np.argmin(nearest))
    clearly = nearest[begin] - nearest[any_frame] > CLEARLY * (enrolment.other - enrolment.own)
    return _nearest(rests, enrolment, any_frame if clearly else begin)


def _rests(utterance: Take, takes: Sequence[Take]) -> NDArray[np.float64]:
    """Return the distance of an utterance from each frame on from every take, (frames, takes), by warping backwards."""
    return distances(utterance[::-1], [take[::-1] for take in takes])[::-1]


def _nearest(rests: NDArray[np.float64], enrolment: Enrolment, begin: int) -> Match:
    nearest: dict[str, float] = {}
    for answer, distance in zip(enrolment.answers, rests[begin].tolist(), strict=True):
        nearest[answer] = min(distance, nearest.get(answer, np.inf))
    first, second = sorted(nearest, key=lambda each: nearest[each])[:2]
    unit = max(enrolment.other - enrolment.own, np.finfo(np.float64).tiny)
    agreement = min(max((enrolment.other - nearest[first]) / unit, 0.0), 1.0)
    return Match(first, agreement, (nearest[second] - nearest[first]) / unit, begin)


def distances(utterance: Take, takes: Sequence[Take]) -> NDArray[np.float64]:
    """Return the warped distance of every beginning of an utterance from every take, shape (frames, takes).

    Row i is for the first i + 1 frames, in the unit of the coefficients. All takes are warped at once.
    """
    lengths = np.array([len(take) for take in takes])
    padded = np.zeros((len(takes), int(np.max(lengths)), utterance.shape[1]))
    for row, take in zip(padded, takes, strict=True):
        row[: len(take)] = take
    squares = np.sum(utterance**2, axis=1)[:, None, None] + np.sum(padded**2, axis=2)
    apart = np.sqrt(np.maximum(squares - 2 * np.einsum("if,tjf->itj", utterance, padded), 0.0))
    ends = np.arange(len(takes)), lengths - 1
    found = np.empty((len(utterance), len(takes)))
    sums = np.full(padded.shape[:2], np.inf)
    for i, here in enumerate(apart):
        entered = sums + here
        entered[:, 1:] = np.minimum(entered[:, 1:], sums[:, :-1] + 2 * here[:, 1:])
        if i == 0:
            entered[:, 0] = 2 * here[:, 0]
        # Steps along a take add what lies between: the least of all places at which its row can be entered.
        along = np.cumsum(here, axis=1)
        sums = along + np.minimum.accumulate(entered - along, axis=1)
        found[i] = sums[ends] / (i + 1 + lengths)
    return found
