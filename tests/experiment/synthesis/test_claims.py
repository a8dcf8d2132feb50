"""Every way keeps the error that it claims: at the paper's size and in extreme cases (random: `test_bounds.py`)."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from palpate.analysis.numerics import cases
from palpate.analysis.numerics.cases import PRINTED_SUM, WAYS, Way
from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis.crinkle import CrinkleSpectra
from palpate.experiment.synthesis.spectra import grid, rms
from palpate.experiment.synthesis.waveforms import prepare, relative_error
from tests.approved import Refuses
from tests.experiment.synthesis.oracle import exact, random_spectra, spectrum_at, worst_excess
from tests.experiment.synthesis.resampled import resampled

EXACT = 1e-12
"""What an error relative to the peak must stay below; the claims are relative to the rms, and smaller."""

SPEEDS = np.array([50.0, 100.0, 200.0, 300.0])
EXTREME_SPEEDS = [0.0, 1e-6, 75.0, 150.0, 250.0, *SPEEDS.tolist(), np.nextafter(200.0, 0), 301.0, 650.0, 1e4]


def extreme() -> dict[str, NDArray[np.float64]]:
    """Amplitudes at four speeds, by name."""
    rng = np.random.default_rng(11)
    some = np.abs(rng.normal(size=(4, 13)))
    one, falling = np.zeros((4, 13)), some.copy()
    one[:, 5] = [1.0, 2.0, 1.5, 3.0]
    falling[:, 4] = [3.0, 2.0, 1.0, 0.0]
    vanishing = np.outer([1.0, 1.0, 1.0, 1e-20], some[0])
    return {
        "zeros": np.zeros((4, 13)),
        "one bin": one,
        "denormals": rng.integers(0, 50, size=(4, 13)) * 5e-324,
        "1e300": some * 1e300,
        "1e-300": some * 1e-300,
        "a bin falling to zero": falling,
        "all vanishing at the last speed": vanishing,
        "1e300 beside 1e-300": np.outer([1e300, 1e-300, 1e300, 1e-300], some[1]),
        "rising everywhere": np.cumsum(some, axis=0),
        "N = 1": some[:, :1],
        "N = 2": some[:, :2],
        "odd": some[:, :9],
        "prime": some[:, :11],
    }


def of(amplitudes: NDArray[np.float64], seed: int = 3) -> CrinkleSpectra:
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], size=amplitudes.shape)
    return CrinkleSpectra(SPEEDS, 50, amplitudes, signs)


@pytest.mark.parametrize("output_rate_hz", [480, 53, 37])
@pytest.mark.parametrize("case", extreme())
def test_every_claimed_bound_holds_in_extreme_cases(case: str, output_rate_hz: int) -> None:
    s = of(extreme()[case])
    for way in WAYS:
        assert worst_excess(way, s, EXTREME_SPEEDS, output_rate_hz) <= 1, way.name


@pytest.mark.parametrize("v", [0.0, 20.0, 120.0, 275.0, 310.0, 1e4])
def test_at_the_size_of_the_paper_exact_means_below_1e_12_of_the_peak(v: float) -> None:
    s = random_spectra(np.random.default_rng(8), speeds=4, bins=2500, rate_hz=5000, v=SPEEDS)
    places = tuple(np.random.default_rng(9).integers(0, 24_000, 30).tolist())
    wanted = exact(s, [v], 48_000, places).samples[0]
    for way in WAYS:
        if way is not PRINTED_SUM:
            made = way.prepare(s, 48_000)[0](v)
            error = np.max(np.abs(made[list(places)] - wanted)) / np.max(np.abs(made))
            assert error < EXACT, way.name


@pytest.mark.parametrize("rate_hz", [5000, 44_100, 48_000, 96_000, 192_000])
def test_every_way_claims_less_than_1e_12_at_the_size_of_the_paper(rate_hz: int) -> None:
    s = random_spectra(np.random.default_rng(8), speeds=4, bins=2500, rate_hz=5000, v=SPEEDS)
    assert all(way.claim(s.grid(rate_hz)) < EXACT for way in WAYS)


@pytest.mark.parametrize("v", [0.0, 20.0, 100.0, 120.0, 310.0])
def test_a_stimulus_is_the_sum_of_the_bins_that_it_names(v: float) -> None:
    s = of(extreme()["odd"])
    made = prepare(s, material="odd", output_rate_hz=480).at(v)
    assert (made.bins.samples, made.bins.rate_hz) == (s.samples, s.rate_hz)
    summed = resampled(made.bins.coefficients, rate_hz=made.bins.rate_hz, output_rate_hz=480)
    error = np.sqrt(np.mean((made.waveform_m_s2 - summed) ** 2)) / np.sqrt(np.mean(summed**2))
    assert error < relative_error(made.basis.on) + EXACT


def test_a_printed_sum_of_several_chunks_is_the_sum_of_one(monkeypatch: pytest.MonkeyPatch) -> None:
    s = of(extreme()["odd"])
    whole = PRINTED_SUM.prepare(s, 480)[0](120.0)
    monkeypatch.setattr(cases, "CHUNK_BYTES", 500)
    np.testing.assert_array_equal(PRINTED_SUM.prepare(s, 480)[0](120.0), whole)


def test_counts_and_flags_are_those_of_the_line() -> None:
    s = of(extreme()["a bin falling to zero"])
    basis = prepare(s, material="falling", output_rate_hz=20)
    for v in EXTREME_SPEEDS:
        made = basis.at(v)
        _, floored, outside = spectrum_at(s, v)
        assert (made.floored_bins, made.extrapolated) == (floored, outside is not None)
        assert s.dropped(basis.on) == 13 - 6


@pytest.mark.parametrize("way", WAYS, ids=lambda way: way.name)
def test_a_rendered_waveform_is_the_caller_s_own(way: Way) -> None:
    render, _ = way.prepare(of(extreme()["odd"]), 50)
    for v in (100.0, 120.0, 0.0, 1e4):
        made = render(v)
        kept = made.copy()
        made[:] = np.nan
        np.testing.assert_array_equal(render(v), kept)
        assert made.dtype == np.float64


@pytest.mark.parametrize("way", WAYS, ids=lambda way: way.name)
@pytest.mark.parametrize("v", [-1.0, np.nan, np.inf, -np.inf])
def test_impossible_speeds_are_refused(way: Way, v: float) -> None:
    render, _ = way.prepare(of(extreme()["odd"]), 50)
    with pytest.raises(SynthesisError, match="speed_mm_s: got"):
        render(v)


@pytest.mark.parametrize("v", [-1.0, np.nan, np.inf, -np.inf])
def test_an_impossible_speed_is_refused_before_anything_is_summed(v: float) -> None:
    basis = prepare(of(extreme()["odd"]), material="odd", output_rate_hz=50)
    with pytest.raises(SynthesisError, match="speed_mm_s: got"):
        basis.at(v)


@pytest.mark.parametrize("way", WAYS, ids=lambda way: way.name)
def test_a_rate_without_a_sample_is_refused(way: Way, refuses: Refuses) -> None:
    with refuses(SynthesisError):
        way.prepare(of(extreme()["N = 2"]), 1)


@pytest.mark.parametrize(
    ("speeds", "amplitudes", "signs", "match"),
    [
        ([1.0, 2.0], [[1.0], [np.nan]], [[1.0], [1.0]], "amplitudes: got 1 NaN"),
        ([1.0, 2.0], [[1.0], [np.inf]], [[1.0], [1.0]], "amplitudes: got 1 NaN"),
        ([1.0, 2.0], [[1.0], [1.0]], [[1.0], [np.nan]], "signs: got 1 NaN"),
        ([1.0, np.inf], [[1.0], [1.0]], [[1.0], [1.0]], "speeds_mm_s: got 1 NaN"),
        ([2.0, 1.0], [[1.0], [1.0]], [[1.0], [1.0]], "strictly rising"),
        ([1.0, 2.0], [[1.0], [-1.0]], [[1.0], [1.0]], "zero or more"),
        ([1.0, 2.0], [[1.0], [1.0]], [[1.0], [0.0]], r"-1 or \+1"),
        ([1.0, 2.0], [[1.0, 1.0], [1.0, 1.0]], [[1.0], [1.0]], "got shapes"),
        ([1.0, 2.0], [[1.0]], [[1.0]], "got shapes"),
    ],
)
def test_spectra_that_no_equation_accepts_are_refused(
    speeds: list[float], amplitudes: list[list[float]], signs: list[list[float]], match: str
) -> None:
    with pytest.raises(SynthesisError, match=match):
        CrinkleSpectra(np.array(speeds), 50, np.array(amplitudes), np.array(signs))


def test_fewer_samples_than_bins_are_refused(refuses: Refuses) -> None:
    with refuses(SynthesisError):
        CrinkleSpectra(SPEEDS, 50, np.ones((4, 13)), np.ones((4, 13)), recorded=3)


def test_recordings_that_would_overflow_are_refused(refuses: Refuses) -> None:
    with refuses(SynthesisError):
        of(np.full((4, 13), 1e308))


@pytest.mark.parametrize("way", WAYS, ids=lambda way: way.name)
def test_a_speed_at_which_the_sum_overflows_is_refused(way: Way, refuses: Refuses) -> None:
    render, _ = way.prepare(of(np.outer([1e302, 2e302, 3e302, 4e302], np.ones(13))), 480)
    assert np.isfinite(render(1e4)).all()
    with refuses(SynthesisError):
        render(1e7)


@pytest.mark.parametrize("way", [way for way in WAYS if way is not PRINTED_SUM], ids=lambda way: way.name)
def test_a_transform_that_is_too_long_is_refused_before_the_first_step(way: Way) -> None:
    s = CrinkleSpectra(SPEEDS, 99_989, np.ones((4, 99_991)), np.ones((4, 99_991)))
    with pytest.raises(SynthesisError, match="use a rounder rate"):
        way.prepare(s, 191_999)


def test_rms_is_parseval_s_at_any_scale() -> None:
    s = of(extreme()["prime"])
    on = s.grid(480)
    whole = grid(samples=11, bins=11, rate_hz=50, output_rate_hz=500)
    level = float(rms(s.amplitudes[1], whole))
    assert np.sqrt(np.mean(PRINTED_SUM.prepare(s, 500)[0](100.0) ** 2)) == pytest.approx(level, rel=1e-13)
    assert np.sqrt(np.mean(PRINTED_SUM.prepare(s, 480)[0](100.0) ** 2)) == pytest.approx(level, rel=0.05)
    assert float(rms(s.amplitudes[1] * 2.0**1000, on)) == float(rms(s.amplitudes[1], on)) * 2.0**1000


def test_what_is_said_to_be_held_is_held() -> None:
    """The basis: ten arrays for four speeds and the spectra, to the byte."""
    s = random_spectra(np.random.default_rng(5), speeds=4, bins=2500, rate_hz=5000, v=SPEEDS)
    basis = prepare(s, material="paper", output_rate_hz=48_000)
    arrays = 10 * 24_000 * 8
    assert len({id(waveform) for halves in basis.pairs for pair in halves for waveform in pair}) == 10
    assert basis.nbytes == arrays + s.amplitudes.nbytes + s.signs.nbytes + s.speeds_mm_s.nbytes
