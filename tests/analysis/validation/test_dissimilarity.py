"""Takes put on speeds, and materials compared: hand-made spectra, naive sums, closed forms."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from palpate.analysis.validation import validate as d
from palpate.experiment.errors import RecordingError
from palpate.experiment.synthesis.crinkle import CrinkleSpectra, at_speed
from palpate.experiment.synthesis.spectra import inverse

SPEEDS = np.array([50.0, 100.0, 200.0, 300.0])
FRESH = np.array([150.0, 250.0, 400.0])
SHAPE = np.linspace(2.0, 1.0, 40)
"""A spectrum that is never zero; 40 bins of 5 Hz at 400 Hz."""


@dataclass(frozen=True)
class Takes:
    """Implements `Recorded`."""

    speeds_mm_s: NDArray[np.float64]
    panel: NDArray[np.float64]
    objects: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    label: str = "made by hand"
    simulated: bool = False
    rate_hz: int = 400


def sounding(amplitudes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Samples whose spectrum has these magnitudes (but for bin 0, which has none), with alternating signs."""
    return inverse(amplitudes * np.where(np.arange(amplitudes.shape[-1]) % 3 == 1, -1.0, 1.0))


def linear(speeds: NDArray[np.float64], takes: int, *, panel: float = 0.1) -> Takes:
    """Material whose amplitude is v/100 times `SHAPE` on top of a panel's steady `panel`."""
    bare = np.full((speeds.size, takes, 40), panel)
    both = bare + np.broadcast_to((speeds / 100)[:, None, None] * SHAPE, bare.shape)
    return Takes(speeds, sounding(bare), {"card": sounding(both)})


def test_takes_that_follow_the_linear_law_are_put_on_their_own_speed() -> None:
    recorded, fresh = linear(SPEEDS, 3), linear(FRESH, 10)
    known = d.known_spectra(recorded)["card"]
    made = d.classify("card", known=known, own=d.own_spectra(fresh, "card"), observed_mm_s=FRESH)
    assert made.candidates_mm_s.tolist() == [50, 100, 150, 200, 250, 300, 400]
    assert made.counts.tolist() == [[0, 0, 10, 0, 0, 0, 0], [0, 0, 0, 0, 10, 0, 0], [0, 0, 0, 0, 0, 0, 10]]
    assert made.close.tolist() == [10, 10, 10]
    assert made.takes == 30


def test_dissimilarities_are_the_printed_sum() -> None:
    rng = np.random.default_rng(1)
    known = CrinkleSpectra(SPEEDS, 400, rng.random((4, 40)), np.ones((4, 40)))
    own = rng.random((1, 2, 40))
    made = d.classify("card", known=known, own=own, observed_mm_s=np.array([250.0]))
    for take in range(2):
        for place, v in enumerate([50.0, 100.0, 200.0, 250.0, 300.0]):
            synthesised = at_speed(known, speed_mm_s=v).coefficients
            naive = sum(abs(own[0, take, k] - abs(synthesised[k])) for k in range(40))
            assert made.dissimilarities[0, take, place] == pytest.approx(naive, rel=1e-13)


def test_bins_above_500_hz_do_not_count() -> None:
    known = CrinkleSpectra(SPEEDS, 4000, np.ones((4, 40)), np.ones((4, 40)))
    own = np.ones((1, 1, 40))
    own[..., 11:] = 99.0
    assert not d.classify("card", known=known, own=own, observed_mm_s=np.array([100.0])).dissimilarities.any()


def test_equation_2_for_a_single_take() -> None:
    fresh = linear(FRESH, 2, panel=0.3)
    own = d.own_spectra(fresh, "card")
    np.testing.assert_allclose(own[:, :, 1:], np.broadcast_to((FRESH / 100)[:, None, None] * SHAPE, own.shape)[..., 1:])
    louder = Takes(FRESH, 100 * fresh.panel, fresh.objects)
    assert not d.own_spectra(louder, "card")[..., 1:].any()


@given(
    chosen=st.lists(st.lists(st.integers(0, 6), min_size=4, max_size=4), min_size=3, max_size=3),
)
def test_counts_and_neighbours_are_what_a_hand_counts(chosen: list[list[int]]) -> None:
    candidates = np.array([50.0, 100.0, 150.0, 200.0, 250.0, 300.0, 400.0])
    scores = np.ones((3, 4, 7))
    for i, row in enumerate(chosen):
        for j, place in enumerate(row):
            scores[i, j, place] = 0.5
    made = d.Classified("card", FRESH, candidates, scores)
    for i, own in enumerate((2, 4, 6)):
        assert made.counts[i].tolist() == [chosen[i].count(place) for place in range(7)]
        assert made.close[i] == sum(own - 1 <= place <= own + 1 for place in chosen[i])


def test_a_random_magnitude_is_nearest_to_its_median() -> None:
    """Why takes look slower than they were: for half a normal distribution the median is 0.845 of the mean
    (0.67449 / 0.79788), so noise whose strength is linear in speed is put on 0.845 of it."""
    rng = np.random.default_rng(3)
    mean = np.sqrt(2 / np.pi)
    known = CrinkleSpectra(
        np.array([1.0, 300.0]), 400, np.outer([1.0, 300.0], np.full(200_000, mean)), np.ones((2, 200_000))
    )
    own = 200.0 * np.abs(rng.normal(size=(1, 1, 200_000)))
    frequencies = np.arange(200_000) * 1e-3
    best = min(
        range(100, 260, 1),
        key=lambda v: float(np.abs(own[0, 0] - at_speed(known, speed_mm_s=v).coefficients)[frequencies <= 500].sum()),
    )
    assert best == pytest.approx(200 * 0.845, abs=2)


def test_overlay_is_of_as_many_takes_as_were_recorded() -> None:
    fresh = linear(FRESH, 10)
    fresh.objects["card"][:, 3:] = 1e6
    known = d.known_spectra(linear(SPEEDS, 3))["card"]
    made = d.overlay("card", known=known, fresh=fresh, speed_mm_s=150.0, takes=3)
    np.testing.assert_allclose(made.observed[1:], 1.5 * SHAPE[1:])
    np.testing.assert_allclose(made.synthesised[1:], 1.5 * SHAPE[1:])
    assert made.dissimilarity == pytest.approx(0, abs=1e-12)


def test_pairs_are_normalised_by_the_highest() -> None:
    spectra = {"a": np.zeros(40), "b": np.full(40, 1.0), "c": np.full(40, -4.0)}
    assert d.normalised_pairs(spectra, rate_hz=400) == {
        ("a", "b"): pytest.approx(0.25),
        ("a", "c"): 1.0,
        ("b", "c"): pytest.approx(0.75),
    }


def test_a_single_material_has_no_pair() -> None:
    assert d.normalised_pairs({"a": np.ones(40)}, rate_hz=400) == {}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rate_hz": 500}, "fresh takes: got 40 samples at 500 Hz; allowed: 40 at 400 Hz"),
        ({"panel": np.zeros((3, 1, 20))}, "fresh takes: got 20 samples at 400 Hz; allowed: 40 at 400 Hz"),
        ({"objects": {"foil": np.zeros((3, 1, 40))}}, "fresh takes: got none of card; allowed: every material"),
    ],
)
def test_takes_that_do_not_compare_are_refused(changes: dict[str, Any], message: str) -> None:
    fresh = replace(linear(FRESH, 1), **changes)
    with pytest.raises(RecordingError, match=message):
        d.check_comparable(linear(SPEEDS, 3), fresh)
