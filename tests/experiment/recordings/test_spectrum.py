"""The spectrum against sinusoids in closed form, and on recordings that nobody here made."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.errors import RecordingError
from palpate.experiment.recordings.readers import Recording
from palpate.experiment.recordings.spectrum import AmplitudeSpectrum, amplitude_spectrum, curve, of_file, plot
from tests.approved import Refuses


def recording(samples: np.ndarray, rate_hz: float, **more: object) -> Recording:
    return Recording("made.txt", "a", ("a",), samples, "m/s^2", rate_hz, "test", **more)  # type: ignore[arg-type]


def sinusoid(frequency_hz: float, *, rate_hz: float, n: int, amplitude: float = 1.0, phase: float = 0.3) -> np.ndarray:
    return np.asarray(amplitude * np.sin(2 * np.pi * frequency_hz * np.arange(n) / rate_hz + phase))


@pytest.mark.parametrize(
    ("rate_hz", "n"), [(1000.0, 500), (5000.0, 2500), (5000.0, 2501), (48_000.0, 24_000), (44.1, 999)]
)
def test_a_sinusoid_on_a_bin_has_its_frequency_and_amplitude(rate_hz: float, n: int) -> None:
    frequency_hz = rate_hz / n * (n // 7)
    (peak,) = amplitude_spectrum(recording(sinusoid(frequency_hz, rate_hz=rate_hz, n=n, amplitude=3.0), rate_hz)).peaks
    assert peak.frequency_hz == pytest.approx(frequency_hz, abs=0.01 * rate_hz / n)
    assert peak.amplitude == pytest.approx(3.0, rel=0.01)


@given(
    cycles=st.floats(10.0, 240.0),
    rate_hz=st.sampled_from([100.0, 5000.0, 50_000.0]),
    phase=st.floats(0, 2 * math.pi),
    offset=st.floats(-10, 10),
)
def test_a_sinusoid_between_bins_is_found_within_a_tenth_of_a_bin(
    cycles: float, rate_hz: float, phase: float, offset: float
) -> None:
    n = 500
    frequency_hz = cycles * rate_hz / n
    made = amplitude_spectrum(recording(sinusoid(frequency_hz, rate_hz=rate_hz, n=n, phase=phase) + offset, rate_hz))
    assert made.peaks[0].frequency_hz == pytest.approx(frequency_hz, abs=0.1 * rate_hz / n)
    assert made.peaks[0].amplitude == pytest.approx(1.0, abs=0.05)


def test_peaks_come_strongest_first() -> None:
    rate_hz, n = 2000.0, 2000
    parts = [(50.0, 1.0), (300.0, 4.0), (700.0, 2.0)]
    samples = sum((sinusoid(f, rate_hz=rate_hz, n=n, amplitude=a) for f, a in parts), np.zeros(n))
    peaks = amplitude_spectrum(recording(samples, rate_hz)).peaks
    assert [round(peak.frequency_hz) for peak in peaks] == [300, 700, 50]


@pytest.mark.parametrize("n", [8, 9, 1000])
@pytest.mark.parametrize("value", [0.0, 0.1, -7e300])
def test_a_constant_has_no_peak(n: int, value: float) -> None:
    assert amplitude_spectrum(recording(np.full(n, value), 1000.0)).peaks == ()


def test_samples_whose_sum_overflows_are_refused(refuses: Refuses) -> None:
    with refuses(RecordingError):
        amplitude_spectrum(recording(np.full(100, 1.7e308), 1000.0))


def test_too_few_samples_are_refused(refuses: Refuses) -> None:
    with refuses(RecordingError):
        amplitude_spectrum(recording(np.zeros(7), 1000.0))


@pytest.mark.parametrize("take", ["a0", "a7", "a23"])
def test_the_ringing_of_real_shocks_is_the_strongest_peak(real_recordings: Path, take: str) -> None:
    """Dataset-5 of the High-Rate Structural Health Monitoring Working Group: one damped sinusoid near 802 Hz."""
    made = of_file(real_recordings / f"shock_ring_{take}.txt")
    assert made.recording.rate_hz == pytest.approx(50_000, rel=1e-9)
    assert made.recording.unit == "g"
    assert made.peaks[0].frequency_hz == pytest.approx(802, abs=9.1 / 2)  # half a bin: 5500 samples at 50 kHz


def ringing() -> AmplitudeSpectrum:
    return amplitude_spectrum(
        recording(sinusoid(100, rate_hz=1000, n=1000), 1000.0, header_rate_hz=1.0, jitter=0.02, segments=3)
    )


def test_the_dictionary_is_json() -> None:
    as_dict = ringing().as_dict()
    assert json.loads(json.dumps(as_dict, allow_nan=False)) == as_dict
    assert as_dict["peaks_hz"] == pytest.approx([100.0], abs=0.01)
    assert as_dict["resolution_hz"] == 1.0


def test_the_text_says_which_rate_is_not_used(approved: SnapshotAssertion) -> None:
    text = ringing().text()
    assert text == approved
    assert "100.00 Hz" in text


def test_the_times_of_other_channels_are_told(tmp_path: Path) -> None:
    file = tmp_path / "two.csv"
    rows = (f"{k / 1000:.4f},{math.sin(k / 3):.5f},{k / 2000:.5f},{k % 7}" for k in range(99))
    file.write_text("\n".join(["t_acc (s),acc_g,t_force (s),force_N", *rows]), "utf-8")
    found = of_file(file)
    assert found.as_dict()["other_clocks"] == ["t_force"]
    assert "'t_force'" in found.text()
    assert "t_acc" in of_file(file, channel="force_N").text()
    file.write_text("\n".join(["t (s),a,b", *(f"{k / 1000:.4f},{k % 5},{k % 7}" for k in range(99))]), "utf-8")
    assert of_file(file).as_dict()["other_clocks"] == []


def test_the_drawn_curve_goes_through_every_bin_and_its_marks() -> None:
    """A tone between two bins: its mark lies a third above either bin, and on the curve."""
    found = amplitude_spectrum(recording(sinusoid(100.5, rate_hz=1000, n=1000), 1000.0))
    f, amplitudes = curve(found)
    at_bins = np.searchsorted(f, found.frequencies_hz[1:] - 1e-9)
    np.testing.assert_allclose(amplitudes[at_bins], found.amplitudes[1:], rtol=0, atol=1e-12)
    [peak] = found.peaks
    assert peak.amplitude == pytest.approx(1.0, abs=0.01)
    assert found.amplitudes.max() < 0.66
    assert np.interp(peak.frequency_hz, f, amplitudes) == pytest.approx(peak.amplitude, rel=0.002)
    assert amplitudes.max() <= peak.amplitude


@pytest.mark.parametrize(("suffix", "magic"), [(".png", b"\x89PNG"), (".svg", b"<?xml")])
def test_the_plot_is_written(tmp_path: Path, suffix: str, magic: bytes) -> None:
    path = tmp_path / f"spectrum{suffix}"
    assert plot(ringing(), path) == path
    assert path.read_bytes().startswith(magic)


@pytest.mark.parametrize("name", ["spectrum.bmp", "no/such/folder/spectrum.png"])
def test_a_plot_that_cannot_be_written_is_refused(tmp_path: Path, name: str, refuses: Refuses) -> None:
    with refuses(RecordingError):
        plot(ringing(), tmp_path / name)
