"""Warping against every path there is, and answers that are near and far by construction."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from palpate.experiment.desk.voice.matching import AGREES, Enrolment, distances, enrolled, match
from palpate.experiment.errors import VoiceError
from tests.approved import Refuses


def paths(frames: int, others: int) -> Iterator[list[tuple[int, int]]]:
    """Yield every path from the first pair of frames to the last, by steps of 1 in either or in both."""
    if (frames, others) == (1, 1):
        yield [(0, 0)]
        return
    for di, dj in ((1, 0), (0, 1), (1, 1)):
        if frames - di >= 1 and others - dj >= 1:
            for path in paths(frames - di, others - dj):
                yield [*path, (frames - 1, others - 1)]


def by_every_path(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Sakoe and Chiba's symmetric distance: the weight of a step is how far it goes in both, the first one's is 2."""
    least = np.inf
    for path in paths(len(one), len(other)):
        total = 2 * float(np.linalg.norm(one[0] - other[0]))
        for (i0, j0), (i1, j1) in pairwise(path):
            total += (i1 - i0 + j1 - j0) * float(np.linalg.norm(one[i1] - other[j1]))
        least = min(least, total)
    return least / (len(one) + len(other))


takes: st.SearchStrategy[NDArray[np.float64]] = st.integers(1, 5).flatmap(
    lambda n: st.lists(st.tuples(*[st.floats(-9, 9, width=16)] * 2), min_size=n, max_size=n).map(np.array)
)


@given(takes, st.lists(takes, min_size=1, max_size=3))
@settings(max_examples=150)
def test_the_distance_is_the_least_of_all_paths(one: NDArray[np.float64], others: list[NDArray[np.float64]]) -> None:
    found = distances(one, others)
    wanted = [[by_every_path(one[: i + 1], other) for other in others] for i in range(len(one))]
    # Distances come from the difference of squares, whose rounding shows near 0.
    assert found == pytest.approx(np.array(wanted), rel=1e-6, abs=1e-5)


@given(takes, takes)
@settings(max_examples=100)
def test_it_is_symmetric_and_none_to_oneself(one: NDArray[np.float64], other: NDArray[np.float64]) -> None:
    forth = distances(one, [other])[-1, 0]
    assert distances(other, [one])[-1, 0] == pytest.approx(forth, abs=1e-6)
    assert distances(one, [one])[-1, 0] == pytest.approx(0.0, abs=1e-5)


def said(answer: int, frames: int, seed: int) -> NDArray[np.float64]:
    """Return a take: a curve through a space of 12 dimensions that belongs to an answer, at some pace, with noise."""
    corners = np.random.default_rng(answer).normal(size=(6, 12)) * 3
    at = np.linspace(0, 5, frames)
    curve = np.stack([np.interp(at, np.arange(6), corner) for corner in corners.T], axis=1)
    return curve + 0.2 * np.random.default_rng([seed, answer]).normal(size=curve.shape)


@pytest.fixture
def enrolment() -> Enrolment:
    return enrolled({f"answer {k}": [said(k, 40, 1), said(k, 55, 2)] for k in range(4)})


@pytest.mark.parametrize("answer", range(4))
@pytest.mark.parametrize("frames", [30, 45, 70])
def test_an_answer_is_known_at_any_pace(enrolment: Enrolment, answer: int, frames: int) -> None:
    found = match(said(answer, frames, 3), enrolment)
    assert (found.answer, found.begin) == (f"answer {answer}", 0)
    assert found.agreement > 0.9
    assert found.lead > 0.3


@pytest.mark.parametrize("word", range(10, 30))
def test_another_word_does_not_agree(enrolment: Enrolment, word: int) -> None:
    assert match(said(word, 45, 3), enrolment).agreement < AGREES


def test_what_is_said_before_an_answer_is_left_out(enrolment: Enrolment) -> None:
    found = match(np.vstack([said(11, 35, 3), said(2, 45, 3)]), enrolment)
    assert found.answer == "answer 2"
    assert found.agreement >= AGREES
    assert abs(found.begin - 35) <= 3


def test_of_several_beginnings_the_nearest_is_taken(enrolment: Enrolment) -> None:
    found = match(np.vstack([said(11, 4, 3), said(2, 45, 3)]), enrolment, begins=(0, 4, 20))
    assert (found.answer, found.begin) == ("answer 2", 4)
    assert found.agreement > 0.9


def test_a_take_agrees_entirely_and_the_frames_scale_does_not_matter(enrolment: Enrolment) -> None:
    assert match(enrolment.takes[0], enrolment).agreement == 1.0
    word = said(12, 45, 3)
    larger = enrolled({f"answer {k}": [7 * said(k, 40, 1), 7 * said(k, 55, 2)] for k in range(4)})
    assert match(7 * word, larger).agreement == pytest.approx(match(word, enrolment).agreement, abs=1e-9)


@pytest.mark.parametrize("utterance", [np.zeros((1, 12)), np.zeros((500, 12)), np.full((3, 12), 1e6), said(0, 1, 0)])
def test_extreme_utterances_agree_between_0_and_1(enrolment: Enrolment, utterance: NDArray[np.float64]) -> None:
    found = match(utterance, enrolment)
    assert 0.0 <= found.agreement < AGREES
    assert np.isfinite(found.lead)


@pytest.mark.parametrize("shape", [(0, 12), (5, 11), (12,)])
def test_what_is_no_utterance_is_refused(enrolment: Enrolment, shape: tuple[int, ...], refuses: Refuses) -> None:
    with refuses(VoiceError):
        match(np.zeros(shape), enrolment)


@pytest.mark.parametrize("begins", [(-1,), (0, 5)])
def test_beginnings_outside_are_refused(enrolment: Enrolment, begins: tuple[int, ...], refuses: Refuses) -> None:
    with refuses(VoiceError):
        match(np.zeros((5, 12)), enrolment, begins)


def test_too_few_takes_and_too_few_answers_are_refused(refuses: Refuses) -> None:
    with refuses(VoiceError):
        enrolled({"paper": [said(0, 40, 1), said(0, 50, 2)], "foil": [said(1, 40, 1)]})
    with pytest.raises(VoiceError, match=r"got 1 answers"):
        enrolled({"paper": [said(0, 40, 1), said(0, 50, 2)]})
    with pytest.raises(VoiceError, match=r"got 0 answers"):
        enrolled({})


def test_takes_that_were_mixed_up_are_refused(refuses: Refuses) -> None:
    mixed = {"paper": [said(0, 40, 1), said(1, 50, 2)], "foil": [said(1, 40, 3), said(0, 50, 4)]}
    with refuses(VoiceError):
        enrolled(mixed)


def test_takes_that_are_all_the_same_are_refused_or_agree_with_nothing() -> None:
    same = np.zeros((5, 12))
    found = match(same + 1.0, enrolled({"paper": [same, same], "foil": [same + 1.0, same + 1.0]}))
    assert (found.answer, found.agreement) == ("foil", 1.0)
