"""Onsets of bursts that are known to the sample, and silences that are none."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from palpate.experiment.desk.voice.onset import Quiet, quiet, risen, utterances

RATE_HZ = 16_000


def recording(*bursts: tuple[int, int, float], noise: float = 0.01, samples: int = 48_000) -> NDArray[np.float64]:
    """Return noise with bursts of noise in it: first sample, last and rms."""
    rng = np.random.default_rng(0)
    made = noise * rng.normal(size=samples)
    for begin, end, rms in bursts:
        made[begin:end] += rms * rng.normal(size=end - begin)
    return made


@pytest.fixture
def still() -> Quiet:
    return quiet(recording())


@pytest.mark.parametrize("begin", [4801, 9000, 20_007, 40_000])
@pytest.mark.parametrize("rms", [0.1, 1.0])
def test_a_burst_is_found_to_half_a_millisecond(still: Quiet, begin: int, rms: float) -> None:
    (found,) = utterances(recording((begin, begin + 4000, rms)), after=4800, quiet=still)
    assert abs(found.begins[0] - begin) <= 8
    assert abs(found.end - begin - 4000) <= 80


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_scales_do_not_matter(scale: float) -> None:
    made = recording((9000, 15_000, 0.2))
    ((one,), (other,)) = (utterances(k * made, after=4800, quiet=quiet(k * recording())) for k in (1.0, scale))
    assert one == other


def test_a_tone_beside_a_coloured_quiet_is_found_where_it_begins() -> None:
    """Red noise is 7 dB louder than the tone as a whole, and far softer at its frequency."""
    rng = np.random.default_rng(1)
    red = np.zeros(48_000)
    for i, each in enumerate(rng.normal(size=red.size)):
        red[i] = 0.995 * red[i - 1] + each
    red *= 0.1 / np.std(red)
    tone = np.where(np.arange(red.size) >= 20_000, 0.06 * np.sin(2 * np.pi * 3000 * np.arange(red.size) / RATE_HZ), 0)
    (found,) = utterances(red + tone, after=4800, quiet=quiet(red))
    assert abs(found.begins[0] - 20_000) <= 16


def test_words_with_a_plosive_between_are_one_utterance_and_words_apart_are_two(still: Quiet) -> None:
    one = recording((10_000, 13_000, 0.3), (15_000, 19_000, 0.3))
    two = recording((10_000, 13_000, 0.3), (19_000, 23_000, 0.3))
    (found,) = utterances(one, after=4800, quiet=still)
    assert np.abs(np.array(found.begins) - [10_000, 15_000]).max() <= 8
    first, second = utterances(two, after=4800, quiet=still)
    assert abs(first.begins[0] - 10_000) <= 8
    assert abs(second.begins[0] - 19_000) <= 8


@pytest.mark.parametrize("rms", [0.1, 10.0])
def test_a_click_is_no_utterance_and_does_not_make_the_next_one_earlier(still: Quiet, rms: float) -> None:
    assert utterances(recording((8000, 8320, rms)), after=4800, quiet=still) == ()
    (found,) = utterances(recording((8000, 8320, rms), (12_000, 18_000, 0.3)), after=4800, quiet=still)
    assert abs(found.begins[0] - 12_000) <= 8


def test_what_begins_before_it_may_begins_then(still: Quiet) -> None:
    (found,) = utterances(recording((1000, 12_000, 0.3)), after=4800, quiet=still)
    assert abs(found.begins[0] - 4800) <= 240


def test_a_louder_room_than_before_is_no_utterance_and_hides_none(still: Quiet) -> None:
    louder = recording((24_000, 32_000, 2.0), noise=0.1)
    (found,) = utterances(louder, after=4800, quiet=still)
    assert abs(found.begins[0] - 24_000) <= 8


def test_noise_is_no_utterance() -> None:
    for seed in range(20):
        made = np.random.default_rng(seed).normal(size=100_000)
        assert utterances(made[50_000:], after=4800, quiet=quiet(made[:50_000])) == ()


def test_half_of_the_quiet_may_be_anything() -> None:
    disturbed = recording((0, 20_000, 1.0))
    assert quiet(disturbed).energy < 10 * quiet(recording()).energy


@pytest.mark.parametrize("samples", [0, 1, 79, 80, 100, 4800])
@pytest.mark.parametrize("value", [0.0, 1e-30, 0.5])
def test_silence_and_too_few_samples_hold_no_utterance(samples: int, value: float) -> None:
    made = np.full(samples, value)
    found = quiet(made)
    assert found.whitening.shape == (25,)
    assert np.all(np.isfinite(found.whitening))
    assert found.energy > 0
    assert utterances(np.zeros(samples), after=0, quiet=found) == ()
    assert utterances(made, after=samples + 10, quiet=found) == ()


def test_a_voice_in_digital_silence_is_found() -> None:
    made = recording((9000, 15_000, 0.1), noise=0.0)
    (found,) = utterances(made, after=4800, quiet=quiet(np.zeros(48_000)))
    assert abs(found.begins[0] - 9000) <= 8


def test_a_clipped_voice_is_found(still: Quiet) -> None:
    made = np.clip(recording((9000, 15_000, 10.0)), -1.0, 1.0)
    (found,) = utterances(made, after=4800, quiet=still)
    assert abs(found.begins[0] - 9000) <= 8


@pytest.mark.parametrize("off", [-600, 0, 600])
def test_a_voice_that_begins_within_another_sound_is_found_from_nearby(still: Quiet, off: int) -> None:
    made = recording((6000, 20_000, 0.1), (12_000, 20_000, 0.4))
    assert abs(risen(made, near=12_000 + off, quiet=still) - 12_000) <= 16


@pytest.mark.parametrize("near", [0, 3, 500, 999, 1000])
def test_the_change_is_looked_for_at_either_end_too(still: Quiet, near: int) -> None:
    assert 0 <= risen(recording(samples=1000), near=near, quiet=still) <= 1000
