"""The amplitude spectrum of a recording, its peaks, and a plot of both: what `palpate spectrum` shows.

It is the magnitude of the discrete Fourier transform of the whole record without its mean, scaled by 2/n, and without a
window, since transients begin with the record. Equation (1) of Okamoto et al. is a cosine transform, whose coefficients
depend on phase.

A peak is a local maximum with a prominence of at least `PROMINENCE` of the highest amplitude. Its frequency and
amplitude are those of the continuous spectrum's maximum between the neighboring bins.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import fft, optimize, signal

from palpate.experiment.errors import RecordingError
from palpate.experiment.recordings.readers import Axes, Recording, read
from palpate.experiment.settings.delimited import NOTHING_STATED, Stated

if TYPE_CHECKING:
    import pandas as pd

PROMINENCE = 0.1
MOST_PEAKS = 10
FEWEST_SAMPLES = 8

DRAWN = 16
"""Points of the drawn curve for each bin: no peak of the continuous spectrum lies more than 0.2 % above it."""


@dataclass(frozen=True)
class Peak:
    """A maximum of the spectrum: its frequency, Hz, and the sinusoid's amplitude in the recording's unit."""

    frequency_hz: float
    amplitude: float


@dataclass(frozen=True)
class AmplitudeSpectrum:
    """The spectrum of one channel.

    `frequencies_hz`, shape (K,), go from 0 to half the sampling rate, `amplitudes`, shape (K,), are in the recording's
    unit; at most `MOST_PEAKS` `peaks`, strongest first.
    """

    recording: Recording
    frequencies_hz: NDArray[np.float64]
    amplitudes: NDArray[np.float64]
    peaks: tuple[Peak, ...]

    def __repr__(self) -> str:
        strongest = ", ".join(f"{peak.frequency_hz:.1f} Hz" for peak in self.peaks[:3]) or "none"
        return f"<AmplitudeSpectrum of {self.recording.file}, {self.recording.channel}: peaks at {strongest}>"

    def to_frame(self) -> pd.DataFrame:
        """Return a row for each frequency: frequency_hz, and amplitude in the recording's unit."""
        import pandas as pd

        return pd.DataFrame({"frequency_hz": self.frequencies_hz, "amplitude": self.amplitudes})

    def as_dict(self) -> dict[str, object]:
        """Return everything but the spectrum itself, for JSON."""
        recording = self.recording
        return {
            "file": recording.file,
            "channel": recording.channel,
            "channels": list(recording.channels),
            "unit": recording.unit,
            "samples": recording.samples.size,
            "rate_hz": recording.rate_hz,
            "rate_source": recording.rate_source,
            "other_clocks": list(recording.other_clocks),
            "header_rate_hz": recording.header_rate_hz,
            "jitter_steps": recording.jitter,
            "segments": recording.segments,
            "read_as": recording.read_as.as_dict() if recording.read_as else None,
            "doubts": [doubt.sentence() for doubt in recording.doubts],
            "resolution_hz": recording.rate_hz / recording.samples.size,
            "peaks_hz": [peak.frequency_hz for peak in self.peaks],
            "peak_amplitudes": [peak.amplitude for peak in self.peaks],
        }

    def text(self) -> str:
        """Return the same for a reader, in a few lines."""
        recording = self.recording
        seconds = recording.samples.size / recording.rate_hz
        unit = f" {recording.unit}" if recording.unit else ""
        lines = [
            f"{recording.file}: {recording.channel}, {recording.samples.size} samples, {seconds:.6g} s",
            f"sampling rate {recording.rate_hz:.6g} Hz, from the {recording.rate_source}",
            f"resolution {1 / seconds:.4g} Hz",
        ]
        if recording.read_as is not None:
            lines.insert(1, recording.read_as.sentence())
        if len(recording.channels) > 1:
            lines.insert(1, f"channels: {', '.join(recording.channels)}")
        if recording.other_clocks:
            told = ", ".join(map(repr, recording.other_clocks))
            lines.insert(-1, f"other channels have different times: {told}")
        claimed = recording.header_rate_hz
        if claimed is not None and abs(claimed / recording.rate_hz - 1) > 1e-3:
            lines.append(f"the header gives {claimed:.6g} Hz, which was not used")
        if recording.jitter > 1e-3:
            lines.append(f"samples are up to {recording.jitter:.2g} steps off an even grid")
        lines += [f"CAUTION: {doubt.clause()}" for doubt in recording.doubts]
        lines.append("peaks:" if self.peaks else "no clear peak")
        lines += [f"  {peak.frequency_hz:10.2f} Hz  {peak.amplitude:.4g}{unit}" for peak in self.peaks]
        return "\n".join(lines)


def of_file(
    path: Path, *, channel: str | None = None, axes: Axes | None = None, stated: Stated = NOTHING_STATED
) -> AmplitudeSpectrum:
    """Return the spectrum of one channel of a file, or of several axes as one.

    Raises `RecordingError` as `read` and `amplitude_spectrum` do.
    """
    return amplitude_spectrum(read(path, channel=channel, axes=axes, stated=stated))


def amplitude_spectrum(recording: Recording) -> AmplitudeSpectrum:
    """Return the spectrum and its peaks. Raises `RecordingError` for under `FEWEST_SAMPLES` samples, or overflow."""
    n = recording.samples.size
    if n < FEWEST_SAMPLES:
        raise RecordingError(
            recording.file, f"got {n} samples", "record longer", allowed=f"{FEWEST_SAMPLES} or more for a spectrum"
        )
    with np.errstate(over="ignore", invalid="ignore"):
        centred = recording.samples - recording.samples.mean()
        amplitudes = np.abs(fft.rfft(centred)) * (2 / n)
    loudest = np.abs(recording.samples).max()
    if not np.all(np.isfinite(amplitudes)):
        raise RecordingError(
            recording.file,
            f"got samples up to {loudest:g}",
            "check the unit",
            allowed="smaller numbers, whose sum does not overflow",
        )
    bin_hz = recording.rate_hz / n
    places: Sequence[int] = ()
    # Below this there is only rounding.
    if amplitudes.max() > 1e-12 * loudest:
        places, _ = signal.find_peaks(amplitudes, prominence=PROMINENCE * amplitudes.max())
    peaks = sorted((_refined(centred, int(place), bin_hz) for place in places), key=lambda peak: -peak.amplitude)
    return AmplitudeSpectrum(recording, np.arange(amplitudes.size) * bin_hz, amplitudes, tuple(peaks[:MOST_PEAKS]))


def _refined(centred: NDArray[np.float64], place: int, bin_hz: float) -> Peak:
    """Return the maximum of the continuous spectrum between the bins beside `place`."""
    turns = -2j * np.pi * np.arange(centred.size) / centred.size

    def negative(at: float) -> float:
        return -float(np.abs(np.exp(turns * at) @ centred))

    best = optimize.minimize_scalar(negative, bounds=(place - 1, place + 1), method="bounded", options={"xatol": 1e-6})
    return Peak(frequency_hz=float(best.x) * bin_hz, amplitude=-float(best.fun) * 2 / centred.size)


def curve(spectrum: AmplitudeSpectrum) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return frequencies from the first bin on, Hz, and amplitudes of the continuous spectrum, both of shape (M,)."""
    samples = spectrum.recording.samples
    amplitudes = np.abs(fft.rfft(samples - samples.mean(), DRAWN * samples.size)) * (2 / samples.size)
    return np.arange(DRAWN, amplitudes.size) * (spectrum.frequencies_hz[1] / DRAWN), amplitudes[DRAWN:]


def plot(spectrum: AmplitudeSpectrum, path: Path) -> Path:
    """Draw the spectrum with its peaks as .png or .svg; return `path`. Raises `RecordingError` for a bad path."""
    if path.suffix.lower() not in (".png", ".svg"):
        raise RecordingError(
            path, f"got suffix {path.suffix!r}", "choose another name for the plot", allowed=".png, .svg"
        )
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    recording = spectrum.recording
    figure = Figure(figsize=(8, 4.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.plot(*curve(spectrum), linewidth=0.8)
    for peak in spectrum.peaks:
        axes.annotate(f"{peak.frequency_hz:.1f} Hz", (peak.frequency_hz, peak.amplitude), fontsize=8)
    axes.plot([p.frequency_hz for p in spectrum.peaks], [p.amplitude for p in spectrum.peaks], "v", markersize=5)
    axes.set_xscale("log")
    axes.set_xlabel("frequency (Hz)")
    axes.set_ylabel(f"amplitude ({recording.unit})" if recording.unit else "amplitude", parse_math=False)
    axes.set_title(f"{Path(recording.file).name}: {recording.channel}", parse_math=False)
    try:
        figure.savefig(path, dpi=150)
    except OSError as error:
        raise RecordingError(
            path,
            f"cannot be written ({error.strerror})",
            "choose another name for the plot",
            allowed="a writable place",
        ) from error
    return path
