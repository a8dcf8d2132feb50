"""Samples that were lost on their way from an accelerometer: seen by when the others came, and told."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from palpate.experiment.apparatus.panel.accelerometer import LOST_S, RING_S, Listening
from palpate.experiment.clock import ManualClock

RATE_HZ, PIECE_S, LONG_S = 1000, 0.01, 3.0
START_NS = 10**15


class Real(ManualClock):
    """A clock of the machine's, which a test moves."""

    simulated = False


def heard(
    *,
    gap_s: float = 0.0,
    held_up_s: float = 0.0,
    ppm: float = 0.0,
    lasts_s: float = LONG_S,
    clock: ManualClock | None = None,
) -> Listening:
    """A stream whose samples are their own times, s: of pieces each up to 2 ms late, a gap after 1 s, and pieces that
    are held up from 2 s on.
    """
    listening = Listening(round(LONG_S * RATE_HZ), rate_hz=RATE_HZ, clock=clock or Real(START_NS))
    rng = np.random.default_rng(1)
    for begin_s in np.arange(0.0, lasts_s, PIECE_S):
        if 1.0 <= begin_s < 1.0 + gap_s:
            continue
        ends_s = (begin_s + PIECE_S) * (1 + ppm * 1e-6)
        arrived_s = max(ends_s, 2.0 + held_up_s) if ends_s > 2.0 else ends_s
        piece = np.linspace(begin_s, begin_s + PIECE_S, round(PIECE_S * RATE_HZ), endpoint=False)
        listening.add(piece.astype(np.float32), START_NS + round((arrived_s + rng.uniform(0, 0.002)) * 1e9))
    return listening


def from_s(listening: Listening, begin_s: float, lasts_s: float = 0.5) -> float | str:
    """How late the samples are that are given as those from a time on, s; or why none are."""
    found = listening.samples_from(START_NS + round(begin_s * 1e9), round(lasts_s * RATE_HZ))
    return found if isinstance(found, str) else float(found[0]) - begin_s


@pytest.mark.parametrize("gap_s", [0.01, 0.05, 0.12, 0.25, 1.0])
def test_what_comes_after_a_gap_is_dated_anew_and_what_has_it_in_it_is_not_given(gap_s: float) -> None:
    listening = heard(gap_s=gap_s)
    assert from_s(listening, 1.1 + gap_s) == pytest.approx(0.0, abs=0.003)
    assert from_s(listening, 0.45) == pytest.approx(0.0, abs=0.003)
    for begin_s in (0.6, 0.98, 1.0 + gap_s / 2):
        told = from_s(listening, begin_s)
        assert isinstance(told, str)
        assert float(re.findall(r"(\d+) ms", told)[0]) == pytest.approx(gap_s * 1e3, abs=3)


def test_a_gap_of_which_nothing_is_sure_yet_is_waited_for() -> None:
    assert isinstance(from_s(heard(gap_s=0.05, lasts_s=1.13), 0.58), str)


def test_a_take_with_a_gap_is_refused_and_one_without_is_given() -> None:
    for gap_s, given in ((0.0, True), (0.1, False)):
        for take in (
            heard(gap_s=gap_s).armed(),
            heard(gap_s=gap_s).take(START_NS, START_NS + 5 * 10**7, level=0.5),
        ):
            assert isinstance(take, str) is not given


@pytest.mark.parametrize(
    "stream",
    [
        {"held_up_s": 0.4},
        {"ppm": 200.0, "lasts_s": RING_S * 2},
        {"ppm": -200.0, "lasts_s": RING_S * 2},
        {"gap_s": LOST_S / 2},
    ],
)
def test_what_is_held_up_and_a_clock_that_drifts_are_no_gap(stream: dict[str, Any]) -> None:
    end_s = stream.get("lasts_s", LONG_S)
    assert from_s(heard(**stream), end_s - 0.6) == pytest.approx(0.0, abs=0.006)


def test_in_simulated_time_nothing_is_late() -> None:
    assert isinstance(from_s(heard(gap_s=0.1, clock=ManualClock(START_NS)), 1.1), float)
