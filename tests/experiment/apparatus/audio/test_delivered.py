"""Alignment of what was heard with what was intended: copies shifted, scaled, noised, cut and reversed by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.apparatus.audio.actuator import LEAST_DB, Alignment, align, objection, silence_objection
from palpate.experiment.apparatus.rig import DeliveredRig

TOLERANCE = DeliveredRig(onset_ms=1.0, contact_ms=5.0, gain_db=1.0, residual_db=-20.0)


def crinkle(n: int, seed: int = 0) -> np.ndarray:
    """Noise that decays, as a stimulus does."""
    return np.random.default_rng(seed).normal(0, 1, n) * np.exp(-5 * np.arange(n) / n)


def placed(waveform: np.ndarray, at: int, length: int) -> np.ndarray:
    heard = np.zeros(length)
    heard[at : at + waveform.size] = waveform[: length - at]
    return heard


@settings(max_examples=60, deadline=None)
@given(
    n=st.integers(200, 5000),
    at=st.integers(0, 3000),
    gain=st.floats(0.01, 10),
    sign=st.sampled_from([1, -1]),
    seed=st.integers(0, 100),
)
def test_a_shifted_and_scaled_copy_is_found_to_the_sample(n: int, at: int, gain: float, sign: int, seed: int) -> None:
    wanted = crinkle(n, seed)
    found = align(sign * gain * placed(wanted, at, n + 3000), wanted, gain=gain)
    assert found is not None
    assert found.onset == at
    assert found.gain == pytest.approx(sign * gain, rel=1e-9)
    assert found.residual_db < -180


def test_a_copy_bit_for_bit_leaves_nothing() -> None:
    wanted = crinkle(1000).astype(np.float32)
    found = align(placed(wanted, 7, 1100).astype(np.float32), wanted, gain=1.0)
    assert found is not None
    assert (found.onset, found.gain, found.residual_db) == (7, 1.0, LEAST_DB)


@pytest.mark.parametrize("snr_db", [0.0, 10.0, 30.0])
def test_the_residual_is_the_noise_that_was_added(snr_db: float) -> None:
    wanted = crinkle(24_000)
    heard = placed(wanted, 2400, 28_800)
    noise = np.random.default_rng(9).normal(0, 1, heard.size)
    noise *= np.sqrt(np.sum(wanted**2) / np.sum(noise**2)) * 10 ** (-snr_db / 20)
    found = align(heard + noise, wanted, gain=1.0)
    assert found is not None
    assert found.onset == 2400
    assert found.residual_db == pytest.approx(-snr_db, abs=0.1)
    # Standard error of a least-squares gain in white noise: its rms over the root of the waveform's energy.
    assert abs(found.gain - 1) < 5 * noise.std() / np.sqrt(np.sum(wanted**2))


@pytest.mark.parametrize("heard", [np.zeros(3000), np.random.default_rng(4).normal(0, 1, 3000)])
def test_silence_and_noise_are_not_the_waveform(heard: np.ndarray) -> None:
    assert align(heard, crinkle(1000), gain=1.0) is None


def judged(heard: np.ndarray, wanted: np.ndarray, *, expected_at: int = 500) -> str:
    found = align(heard, wanted, gain=1.0)
    assert found is not None
    error_ms = (found.onset - expected_at) / 48
    return objection(found, onset_error_ms=error_ms, contact_error_ms=0.0, gain=1.0, tolerance=TOLERANCE)


def test_what_is_as_intended_counts() -> None:
    wanted = crinkle(4800)
    heard = placed(wanted, 520, 6000) + np.random.default_rng(1).normal(0, 1e-3, 6000)
    assert judged(heard, wanted) == ""


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        (lambda w: placed(w, 600, 6000), r"its onset was off by \+2\.08 ms; allowed: 1 ms"),
        (lambda w: placed(w * 0.8, 500, 6000), r"its level was off by -1\.9 dB; allowed: 1 dB"),
        (lambda w: placed(-w, 500, 6000), r"its polarity is reversed"),
        (lambda w: placed(np.where(np.arange(w.size) < 700, w, 0), 500, 6000), r"off by|residual"),
        (lambda w: placed(w, 500, 6000) + placed(w, 3000, 6000) / 5, r"loopback residual is -1[34]\."),
        (lambda w: placed(np.where(np.arange(w.size) % 480 < 32, 0, w), 500, 6000), r"loopback residual is -11\."),
    ],
    ids=["late", "soft", "reversed", "cut short", "twice", "with holes"],
)
def test_what_is_not_as_intended_does_not_count(changed: object, reason: str) -> None:
    assert callable(changed)
    wanted = crinkle(4800)
    said = judged(changed(wanted), wanted)
    assert said
    import re

    assert re.search(reason, said), said


@pytest.mark.parametrize(
    ("loudest", "said"),
    [
        (0.0, ""),
        (0.199, ""),
        (-0.4, "the loopback recorded -14.0 dB re full scale where silence was intended; allowed: -20 dB"),
        (np.inf, "the loopback recorded inf dB re full scale where silence was intended; allowed: -20 dB"),
    ],
)
def test_a_silence_counts_where_little_was_heard(loudest: float, said: str) -> None:
    heard = placed(np.array([loudest]), 70, 100)
    assert silence_objection(heard, gain=2.0, tolerance=TOLERANCE) == said


def test_objections_stand_in_order_of_what_explains_most(approved: SnapshotAssertion) -> None:
    whole = Alignment(onset=0, gain=1.0, residual_db=-60.0)
    assert objection(whole, onset_error_ms=0.5, contact_error_ms=-5.0, gain=1.0, tolerance=TOLERANCE) == ""
    assert objection(whole, onset_error_ms=0.5, contact_error_ms=5.01, gain=1.0, tolerance=TOLERANCE) == approved
    assert "onset was off" in objection(whole, onset_error_ms=-1.5, contact_error_ms=9.0, gain=1.0, tolerance=TOLERANCE)
    assert "level" in objection(whole, onset_error_ms=-1.5, contact_error_ms=9.0, gain=2.0, tolerance=TOLERANCE)
