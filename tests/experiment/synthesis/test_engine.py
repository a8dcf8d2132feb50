"""The engine takes the first method whose promises suffice."""

from __future__ import annotations

import numpy as np
import pytest

from experiment.errors import SynthesisError
from experiment.synthesis.basis import Basis
from experiment.synthesis.crinkle import CrinkleSpectra
from experiment.synthesis.engine import FASTEST_FIRST, TAKEN, choose, methods
from tests.experiment.synthesis.oracle import random_spectra


def paper(high_hz: float = 2500.0) -> CrinkleSpectra:
    """The paper's size, silent above a frequency."""
    s = random_spectra(
        np.random.default_rng(5), speeds=4, bins=2500, rate_hz=5000, v=np.array([50.0, 100.0, 200.0, 300.0])
    )
    amplitudes = np.where(np.arange(2500) <= high_hz, s.amplitudes, 0.0)
    return CrinkleSpectra(s.speeds_mm_s, 5000, amplitudes, s.signs)


def test_exactness_takes_the_basis() -> None:
    choice = choose(paper(), output_rate_hz=48_000)
    assert choice.method.name == "basis waveforms"


def test_more_exactness_than_the_basis_claims_takes_the_inverse_dct() -> None:
    choice = choose(paper(), output_rate_hz=48_000, allowed_relative_error=5e-14)
    assert choice.method.name == "inverse DCT"
    claims = [m.estimate(paper(), output_rate_hz=48_000).relative_error for m in FASTEST_FIRST[:4]]
    assert [claim > 5e-14 for claim in claims] == [True, True, True, False]


@pytest.mark.parametrize(
    ("memory_bytes", "name"), [(3e6, "basis waveforms"), (2e6, "single precision"), (2e5, "inverse DCT")]
)
def test_little_memory_takes_what_fits(memory_bytes: float, name: str) -> None:
    choice = choose(paper(), output_rate_hz=48_000, allowed_relative_error=1e-5, allowed_memory_bytes=memory_bytes)
    assert choice.method.name == name
    assert choice.estimate.memory_bytes <= memory_bytes


def test_a_band_is_pruned_where_what_it_leaves_out_is_allowed() -> None:
    loud, quiet = paper(), paper(high_hz=500.0)
    for s, name in ((loud, "basis waveforms"), (quiet, "basis waveforms, 0 to 500 Hz")):
        assert choose(s, output_rate_hz=48_000, band_hz=(0.0, 500.0)).method.name == name


def test_what_cannot_be_had_is_refused_with_what_can() -> None:
    with pytest.raises(SynthesisError, match=r"got 1e-18 within inf bytes; allowed: 1\.6e-14 or more"):
        choose(paper(), output_rate_hz=48_000, allowed_relative_error=1e-18)
    with pytest.raises(SynthesisError, match="allowed_relative_error: got nan"):
        choose(paper(), output_rate_hz=48_000, allowed_relative_error=np.nan)


def test_a_choice_prepares_what_it_chose() -> None:
    s = paper()
    choice = choose(s, output_rate_hz=48_000)
    made = choice.prepare(s, output_rate_hz=48_000)(120.0)
    np.testing.assert_array_equal(
        made.waveform_m_s2, choice.method.prepare(s, output_rate_hz=48_000)(120.0).waveform_m_s2
    )


def test_every_method_has_a_name_of_its_own() -> None:
    names = [m.name for m in methods(band_hz=(10.0, 500.0))]
    assert len(set(names)) == len(names) == 2 * len(FASTEST_FIRST)


def test_it_is_said_of_every_method_when_it_is_taken() -> None:
    assert list(TAKEN) == [method.name for method in FASTEST_FIRST]


@pytest.mark.parametrize("error", [1e-18, 1e-14, 5e-14, 1.3e-13, 1e-12, 1e-9, 1.8e-6, 2e-6, 1e-3, 1.0])
def test_what_is_said_to_be_never_chosen_is_never_chosen(error: float) -> None:
    """And the others when they are said to be: over every error and memory that makes a difference."""
    s = paper()
    estimates = {m.name: m.estimate(s, output_rate_hz=48_000) for m in FASTEST_FIRST}
    basis, single = estimates["basis waveforms"], estimates["single precision"]
    for memory in [*(e.memory_bytes + step for e in estimates.values() for step in (-1, 0)), 1e12]:
        try:
            name = choose(
                s, output_rate_hz=48_000, allowed_relative_error=error, allowed_memory_bytes=memory
            ).method.name
        except SynthesisError:
            continue
        fits = basis.memory_bytes <= memory and basis.relative_error <= error
        halved = single.memory_bytes <= memory and single.relative_error <= error
        assert name == ("basis waveforms" if fits else "single precision" if halved else "inverse DCT")


def test_what_is_promised_to_be_held_is_held() -> None:
    """The basis: ten arrays for four speeds and the spectra, to the byte."""
    s = paper()
    choice = choose(s, output_rate_hz=48_000)
    pairs = Basis().prepare(s, output_rate_hz=48_000).pairs
    assert len({id(waveform) for halves in pairs for pair in halves for waveform in pair}) == 10
    arrays = 10 * 24_000 * 8
    assert choice.estimate.memory_bytes == arrays + s.amplitudes.nbytes + s.signs.nbytes + s.speeds_mm_s.nbytes
