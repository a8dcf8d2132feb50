"""Fits of decaying sinusoids: made ones with known f and B, real ones, clipped ones, and what is none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.errors import RecordingError
from palpate.experiment.recordings.readers import Recording
from palpate.experiment.recordings.tap_fit import Tapped, clipped_samples, of_file, of_taps, read_taps, ring
from tests.approved import Refuses

RATE_HZ = 50_000.0


def made(samples: NDArray[np.float64], name: str = "made.wav") -> Recording:
    return Recording(name, "channel 1", ("channel 1",), samples, "g", RATE_HZ, "WAV header")


def decaying(f: float = 802.0, decay: float = 55.0, peak: float = 10.0, length: float = 0.1) -> NDArray[np.float64]:
    t = np.arange(round(length * RATE_HZ)) / RATE_HZ
    tail = peak * np.exp(-decay * t) * np.cos(2 * np.pi * f * t)
    return np.concatenate([np.zeros(100), tail])


@pytest.mark.parametrize(("f", "decay"), [(43.0, 10.0), (802.0, 55.0), (4000.0, 400.0)])
def test_f_b_and_peak_come_back(f: float, decay: float) -> None:
    found = ring(made(decaying(f, decay) + 0.5))
    assert not found.misfit
    assert found.f_hz == pytest.approx(f, rel=1e-9)
    assert found.decay_per_s == pytest.approx(decay, rel=1e-7)
    assert found.peak == pytest.approx(10.0, rel=1e-7)
    assert found.baseline == pytest.approx(0.5, rel=1e-6)
    assert found.r2 == pytest.approx(1.0)
    assert found.f_drift_hz == pytest.approx(0.0, abs=1e-6)
    assert found.clipped_samples == 0


def test_clipped_samples_are_left_out_and_told(approved: SnapshotAssertion) -> None:
    found = ring(made(np.clip(decaying(), -7.0, 7.0)))
    assert found.clipped_samples > 10
    assert found.clipped_at == (-7.0, 7.0)
    assert found.recorded_peak == 7.0
    assert found.f_hz == pytest.approx(802.0, rel=1e-6)
    assert found.decay_per_s == pytest.approx(55.0, rel=1e-4)
    assert found.peak is not None
    assert found.peak > 9.0
    assert [line for line in found.text().splitlines() if "clipped" in line] == approved


@pytest.mark.parametrize("alike", [0.0, 0.8])
def test_standard_errors_are_the_spread_of_fits_to_correlated_noise(alike: float) -> None:
    """The spread over recordings, each with noise of its own, an autoregression of first order; peaks are clipped."""
    rng, found = np.random.default_rng(3), []
    # Clipped at 7 first, so that every fit begins at the same sample.
    clean = np.clip(decaying(length=0.04), -6.5, 7.0)
    clipped = (clean == 7.0) | (clean == -6.5)
    for _ in range(60):
        noise = lfilter([1.0], [1.0, -alike], rng.normal(scale=0.2, size=clean.size))
        found.append(ring(made(np.where(clipped, clean, np.clip(clean + noise, -6.49, 6.99)))))
    for value, error in (("f_hz", "f_se_hz"), ("decay_per_s", "decay_se_per_s"), ("peak", "peak_se")):
        spread = float(np.std([getattr(one, value) for one in found], ddof=1))
        assert np.mean([getattr(one, error) for one in found]) == pytest.approx(spread, rel=0.25), value
    assert "standard error" in found[0].text()
    assert "peak of the" in found[0].text()


def test_the_flat_top_of_a_slow_wave_is_not_clipped() -> None:
    """43 Hz at 50 kHz through 12 bits: dozens of samples in a row are alike at the top."""
    step = 20.0 / 4096
    assert not clipped_samples(np.round(decaying(43.0, 10.0) / step) * step).any()


def test_drifts_are_told() -> None:
    t = np.arange(5000) / RATE_HZ
    swept = np.exp(-50 * t) * np.cos(2 * np.pi * (800 * t + 100 * t**2)) + 2.0 * t
    found = ring(made(swept))
    assert found.f_drift_hz is not None
    assert 1.0 < found.f_drift_hz < 5.0
    assert found.baseline_drift == pytest.approx(2.0, abs=0.3)
    assert "drift of f" in found.text()


@pytest.mark.parametrize(
    ("samples", "words"),
    [
        (np.random.default_rng(1).normal(size=4000), "does not show"),
        (decaying() + decaying(1310.0), "does not show"),
        (np.concatenate([np.zeros(50), np.exp(-np.arange(4000) / 300)]), "does not show|periods"),
        (np.zeros(4000), "the signal does not change"),
        (np.concatenate([np.zeros(50), [1.0, 0.5]]), "samples follow the peak"),
        (np.exp(np.arange(4000) / 2000.0) * np.sin(np.arange(4000) / 9.0), "does not show|samples follow"),
    ],
)
def test_what_does_not_ring_in_one_mode_is_called_a_misfit(samples: NDArray[np.float64], words: str) -> None:
    found = ring(made(samples))
    assert any(word in found.misfit for word in words.split("|")), found
    assert (found.f_hz, found.decay_per_s, found.r2) == (None, None, None)
    assert "MISFIT" in found.text()


def test_real_shocks_ring_at_802_hz_and_decay_faster_with_every_shock(real_recordings: Path) -> None:
    found = [of_file(real_recordings / f"shock_ring_a{n}.txt") for n in (0, 7, 23)]
    decays = [one.decay_per_s or 0.0 for one in found]
    for one in found:
        assert 801 <= (one.f_hz or 0) <= 803
        assert (one.r2 or 0) > 0.99
        assert one.clipped_samples >= 10
        assert "clipped" in one.text()
    assert decays == sorted(decays)


def rings_and_taps() -> tuple[list[Tapped], list[Recording]]:
    taps, recordings = [], []
    for surface, stiffness, f, level in (("foam", 4500.0, 50.0, 1.0), ("wood", 19_000.0, 75.0, 3.0)):
        for speed in (0.1, 0.2, 0.3):
            name = f"{surface}-{speed}.wav"
            taps.append(Tapped(name, surface, stiffness, speed))
            recordings.append(made(decaying(f, 20.0, level * speed / 0.2), name))
    return taps, recordings


def test_a_set_at_several_speeds_gives_l_d_and_the_curve(approved: SnapshotAssertion) -> None:
    taps, recordings = rings_and_taps()
    found = of_taps([ring(one) for one in recordings], taps)
    assert found.surfaces == ("foam", "wood")
    assert [one.amplitude for one in found.scalings if one] == pytest.approx([1.0, 3.0], rel=1e-5)
    assert [one.per_speed_s_m for one in found.scalings if one] == pytest.approx([5.0, 5.0], rel=1e-5)
    assert found.curve is not None
    assert found.curve.at(4500.0) == pytest.approx(50.0, rel=1e-6)
    assert found.curve.per_n_m == pytest.approx(14_500 / np.log(1.5), rel=1e-6)
    assert [line for line in found.text().splitlines() if " N/m, " in line] == approved


def test_recordings_are_brought_to_the_unit_of_the_first() -> None:
    taps, recordings = rings_and_taps()
    in_g = [replace(one, samples=one.samples / 9.80665, unit="g") for one in recordings]
    mixed = [in_g[0], *(replace(one, unit="m/s^2") for one in recordings[1:])]
    found = of_taps([ring(one) for one in mixed], taps)
    assert found.unit == "g"
    assert [one.amplitude * 9.80665 for one in found.scalings if one] == pytest.approx([1.0, 3.0], rel=1e-5)
    with pytest.raises(RecordingError):
        of_taps([ring(one) for one in (in_g[0], replace(recordings[1], unit="mV"), *recordings[2:])], taps)


def test_a_set_that_is_too_small_says_what_it_takes(approved: SnapshotAssertion) -> None:
    taps, recordings = rings_and_taps()
    found = of_taps([ring(recordings[0])], taps)
    assert found.curve is None
    assert [line for line in found.text().splitlines() if "two " in line] == approved


def test_a_recording_that_the_table_does_not_name_is_refused(refuses: Refuses) -> None:
    taps, recordings = rings_and_taps()
    with refuses(RecordingError):
        of_taps([ring(recordings[0])], taps[1:])
    with refuses(RecordingError):
        of_taps([ring(one) for one in recordings[:2]], [taps[0], Tapped(taps[1].file, "foam", 1.0, 0.2)])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("file,surface\na,b\n", "got the columns file, surface; allowed: file, surface, stiffness_n_m, speed_m_s"),
        ("", r"got the columns \(none\)"),
        ("file,surface,stiffness_n_m,speed_m_s\n", "got no row below the heading; allowed: a row for each recording"),
        ("file,surface,stiffness_n_m,speed_m_s\na,b,4500,1,1\n", "got a row with more cells than the heading"),
        ("file,surface,stiffness_n_m,speed_m_s\na,b,4500 N/m,0.2\n", "line 2: got '4500 N/m' N/m"),
        ("file,surface,stiffness_n_m,speed_m_s\na,b,4500,-1\n", "finite numbers above zero"),
    ],
)
def test_a_broken_table_is_refused(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "taps.csv").write_text(text)
    with pytest.raises(RecordingError, match=words):
        read_taps(tmp_path / "taps.csv")
    with pytest.raises(RecordingError, match="cannot be read"):
        read_taps(tmp_path / "none.csv")
