"""The masker's level, limit and dose, on a mixer without a device; its noise in octave bands and across the seam."""

from __future__ import annotations

from contextlib import suppress
from typing import cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal, stats

from palpate.experiment.apparatus.audio import masker as sound_level
from palpate.experiment.apparatus.audio.masker import (
    RESERVE_S,
    ROUND_S,
    SOFTEST_DB_A,
    AudioMasker,
    MaskerNoise,
    masker_noise,
)
from palpate.experiment.apparatus.audio.mixer import SOMETIME, Block, Layout, Loop, Mixer
from palpate.experiment.apparatus.audio.stream import AudioStream
from palpate.experiment.errors import AudioError, DoseUsedUp
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.session import scene
from palpate.experiment.synthesis.signals.noise import Colour
from tests.approved import Refuses

RATE_HZ = 48_000
FULL_SCALE_DB_A = 100.0
CENTRES_HZ = 1000.0 * 10.0 ** (0.3 * np.arange(-5, 5))
"""Exact centres of the octave bands from 31.5 Hz to 16 kHz (IEC 61260-1, base ten)."""


class LoopOnly:
    """As much of a stream as a masker needs: its mixer."""

    def __init__(self) -> None:
        self.mixer = Mixer(Layout(2, 1, 256, 100, 1000, (1.0, 1.0)))
        self.ends_ns = SOMETIME

    def play_loop(self, samples: Block, channels: tuple[int, ...]) -> Loop:
        self.mixer.loop = Loop(1 / 2400, samples=samples, channels=channels)
        return self.mixer.loop

    def heard(self, frames: int) -> np.ndarray:
        blocks = []
        for _ in range(frames // 256):
            block = np.zeros((256, 2), np.float32)
            self.mixer.fill(block, np.zeros((256, 1), np.float32))
            blocks.append(block)
        return np.concatenate(blocks)


def made(noise: Colour = "pink", *, limit_db_a: float = 80.0, full_scale_db_a: float = FULL_SCALE_DB_A) -> MaskerNoise:
    samples = scene.masker_samples(colour=noise, rate_hz=RATE_HZ, seconds=ROUND_S)
    return masker_noise(samples, rate_hz=RATE_HZ, pink_full_scale_db_a=full_scale_db_a, limit_db_a=limit_db_a)


@pytest.fixture(scope="module")
def pink() -> MaskerNoise:
    return made()


def started(noise: MaskerNoise, *, dose_before: float = 0.0) -> tuple[AudioMasker, LoopOnly, ManualClock]:
    stream, clock = LoopOnly(), ManualClock(10**18)
    masker = AudioMasker(cast("AudioStream", stream), noise, channels=(1, 2), clock=clock, dose_before=dose_before)
    return masker, stream, clock


def level_db_a(samples: np.ndarray) -> float:
    """A-weighted level of what the headphones carry, by this test's own periodogram."""
    f, power = signal.periodogram(samples.astype(np.float64), RATE_HZ, scaling="spectrum", detrend=False)
    weighted = power[1:] * 10 ** (sound_level.a_weighting_db(frequency_hz=f[1:]) / 10)
    return FULL_SCALE_DB_A - sound_level.pink_weighted_db(rate_hz=RATE_HZ) + 10 * float(np.log10(weighted.sum()))


@pytest.mark.parametrize(("colour", "slope_db"), [("pink", 0.0), ("white", 10 * np.log10(2))])
def test_what_the_headphones_carry_has_its_slope_in_every_octave(colour: Colour, slope_db: float) -> None:
    masker, stream, _ = started(made(colour))
    masker.start(70.0)
    # From the middle of one round to that of the next, so that the seam is in it.
    stream.heard(7 * RATE_HZ)
    heard = stream.heard(round(ROUND_S * RATE_HZ))[:, 0].astype(np.float64)
    f, density = signal.welch(heard, RATE_HZ, nperseg=RATE_HZ, detrend=False)
    edge = 10**0.15
    levels = [10 * np.log10(density[(f >= centre / edge) & (f < centre * edge)].sum()) for centre in CENTRES_HZ]
    off_db = np.array(levels) - slope_db * np.arange(10)
    assert np.max(np.abs(off_db - off_db[5])) <= 0.5


def test_the_seam_is_like_any_other_place(pink: MaskerNoise) -> None:
    around = np.concatenate([pink.samples[-2400:], pink.samples[:2400]]).astype(np.float64)
    step = abs(around[2400] - around[2399])
    steps = np.abs(np.diff(pink.samples.astype(np.float64)))
    # Larger than it are more than a thousandth of all steps: nothing sticks out.
    assert np.mean(steps > step) > 1e-3
    # The spectrum of 0.1 s over the seam lies within those of as long pieces elsewhere, band by band.
    pieces = pink.samples[: 4800 * 99].reshape(99, 4800).astype(np.float64)

    def bands(piece: np.ndarray) -> np.ndarray:
        f, density = signal.periodogram(piece, RATE_HZ, window="hann", detrend=False)
        return np.array([density[(f >= low) & (f < 2 * low)].sum() for low in 62.5 * 2.0 ** np.arange(8)])

    elsewhere = np.array([bands(piece) for piece in pieces])
    places = np.array(
        [stats.percentileofscore(column, at) for column, at in zip(elsewhere.T, bands(around), strict=True)]
    )
    assert np.all((places > 0) & (places < 100))


@pytest.mark.parametrize("colour", ["pink", "white"])
def test_a_level_is_what_the_headphones_bring_to_the_ear(colour: Colour) -> None:
    masker, stream, _ = started(made(colour))
    assert masker.start(65.0) == 65.0
    stream.heard(RATE_HZ)
    assert level_db_a(stream.heard(round(ROUND_S * RATE_HZ))[:, 0]) == pytest.approx(65.0, abs=0.05)


def test_no_level_is_above_the_limit_and_the_ceiling_is_that_of_the_limit(pink: MaskerNoise) -> None:
    masker, stream, _ = started(pink)
    assert masker.start(120.0) == 80.0
    assert masker.limit_db_a == 80.0
    assert masker.set_level(-20.0) == SOFTEST_DB_A
    masker.set_level(80.0)
    stream.heard(RATE_HZ)
    peak = np.max(np.abs(stream.heard(round(ROUND_S * RATE_HZ))))
    assert peak <= pink.ceiling <= 1.001 * peak


def test_headphones_that_would_clip_lower_the_limit(refuses: Refuses) -> None:
    faint = made(full_scale_db_a=80.0)
    crest_db = 20 * np.log10(np.max(np.abs(faint.samples)))
    assert faint.loudest_db_a == pytest.approx(80.0 - crest_db, abs=0.01)
    assert faint.ceiling == pytest.approx(1.0, abs=1e-5)
    with refuses(AudioError):
        made(full_scale_db_a=40.0)


def test_it_fades_in_and_out_and_its_level_changes_without_a_click(pink: MaskerNoise) -> None:
    masker, stream, _ = started(pink)
    heard = [stream.heard(512)]
    assert not heard[0].any()
    for change in (lambda: masker.start(60.0), lambda: masker.set_level(80.0), masker.stop):
        change()
        heard.append(stream.heard(9600))
    assert masker.level_db_a is None
    assert not heard[-1][-256:].any()
    whole = np.concatenate(heard)[:, 0].astype(np.float64)
    # No step is larger than those of the noise at the loudest level by more than what a ramp adds.
    largest = np.max(np.abs(np.diff(pink.samples.astype(np.float64)))) * pink.gain(80.0)
    assert np.max(np.abs(np.diff(whole))) <= largest + np.max(np.abs(pink.samples)) / 2400


@settings(max_examples=50)
@given(stretches=st.lists(st.tuples(st.floats(30, 80), st.integers(0, 3600 * 10**9)), min_size=1, max_size=6))
def test_the_dose_is_the_sum_over_levels_and_times(stretches: list[tuple[float, int]]) -> None:
    noise = MaskerNoise(np.ones(10, np.float32), FULL_SCALE_DB_A, 80.0)
    masker, _, clock = started(noise)
    expected = 0.0
    for level, nanoseconds in stretches:
        masker.start(level)
        clock.sleep_ns(nanoseconds)
        # Directive 2003/10/EC: 80 dB(A) for eight hours is 1, 3 dB more is twice as much.
        expected += nanoseconds / 28.8e12 * 2 ** ((level - 80) / (10 * np.log10(2)))
    masker.stop()
    clock.sleep_ns(3600 * 10**9)
    told = masker.exposure()
    assert told.dose == pytest.approx(expected, rel=1e-9, abs=1e-15)
    assert (told.level_db_a, told.left_s) == (None, None)


def test_when_the_dose_is_used_up_it_falls_silent_and_says_so(pink: MaskerNoise, refuses: Refuses) -> None:
    masker, _, clock = started(pink, dose_before=0.75)
    masker.start(80.0)
    left_s = masker.exposure().left_s
    assert left_s == pytest.approx(2 * 3600)
    clock.sleep_ns(2 * 3600 * 10**9)
    with refuses(AudioError):
        masker.set_level(70.0)
    assert masker.level_db_a is None
    assert masker.exposure().daily_level_db_a == pytest.approx(80.0, abs=1e-3)
    with pytest.raises(DoseUsedUp):
        masker.start(SOFTEST_DB_A)


@settings(max_examples=50, deadline=None)
@given(
    before=st.floats(0, 0.9999),
    changes=st.lists(st.tuples(st.floats(50, 80), st.integers(1, 8 * 3600 * 10**9)), min_size=1, max_size=6),
)
def test_the_stream_ends_the_noise_where_the_dose_would_be_used_up(
    before: float, changes: list[tuple[float, int]]
) -> None:
    """What the stream plays, by the ends and gains that it is given, is what the masker accounts."""
    noise = MaskerNoise(np.ones(10, np.float32), FULL_SCALE_DB_A, 80.0)
    masker, stream, clock = started(noise, dose_before=before)
    loop, truth = stream.mixer.loop, before
    assert loop is not None
    for level, nanoseconds in changes:
        with suppress(DoseUsedUp):
            masker.start(level)
        begun_ns, plays = clock.now_ns(), masker.level_db_a is not None
        clock.sleep_ns(nanoseconds)
        lasted_ns = max(min(clock.now_ns(), loop.ends_ns) - begun_ns, 0) if loop.wanted > 0 else 0
        truth += lasted_ns / 28.8e12 * 10 ** ((level - 80) / 10)
        assert (lasted_ns > 0) == plays
        exposure = masker.exposure()
        assert exposure.dose == pytest.approx(truth, rel=1e-9)
        assert exposure.dose < 1
        if lasted_ns < nanoseconds:
            assert (exposure.level_db_a, exposure.left_s) == (None, 0.0)
            if plays:
                left_s = sound_level.left_s(dose=exposure.dose, level_db_a=level)
                assert left_s == pytest.approx(RESERVE_S, abs=1e-3)


def test_what_is_silent_with_the_whole_sound_counts_no_longer(pink: MaskerNoise) -> None:
    masker, stream, clock = started(pink)
    masker.start(80.0)
    clock.sleep_ns(3600 * 10**9)
    stream.ends_ns = clock.now_ns()
    clock.sleep_ns(3600 * 10**9)
    exposure = masker.exposure()
    assert (exposure.level_db_a, exposure.left_s) == (None, None)
    assert exposure.dose == pytest.approx(1 / 8)


@pytest.mark.parametrize("level", [float("nan"), float("inf"), -float("inf")])
def test_what_is_no_level_is_refused(pink: MaskerNoise, level: float, refuses: Refuses) -> None:
    masker, _, _ = started(pink)
    with refuses(AudioError):
        masker.start(level)


def test_a_silent_masker_has_no_level_to_change(pink: MaskerNoise, refuses: Refuses) -> None:
    masker, _, _ = started(pink)
    with refuses(AudioError):
        masker.set_level(60.0)
