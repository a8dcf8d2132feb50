"""From what a protocol declares to the waveforms of a device's rate."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import sqrt
from typing import Any

import numpy as np

from palpate.experiment.errors import RecordingError, SynthesisError
from palpate.experiment.protocol import files
from palpate.experiment.protocol.kinds.presented import Part, Presented, PresentedStimulus, Recorded
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.synthesis.signals import waves
from palpate.experiment.synthesis.signals.waves import Declared, Times, Wave
from palpate.experiment.synthesis.spectra import BAND_HZ, bin_frequencies_hz, spectrum

WAVES: Mapping[str, Callable[[Any, Times], Wave]] = {
    "sinusoid": lambda it, at: waves.sinusoid(at, frequency_hz=it.frequency_hz, amplitude_m_s2=it.amplitude_m_s2),
    "decaying": lambda it, at: waves.decaying(
        at, frequency_hz=it.frequency_hz, amplitude_m_s2=it.amplitude_m_s2, decay_per_s=it.decay_per_s
    ),
    "noise": lambda it, at: waves.band_noise(
        at, low_hz=it.low_hz, high_hz=it.high_hz, rms_m_s2=it.rms_m_s2, seed=it.seed
    ),
    "sweep": lambda it, at: waves.sweep(
        at, from_hz=it.from_hz, to_hz=it.to_hz, amplitude_m_s2=it.amplitude_m_s2, by_ratio=it.by == "octaves"
    ),
    "pulses": lambda it, at: waves.pulses(
        at, every_s=it.every_s, cycle_hz=it.cycle_hz, amplitude_m_s2=it.amplitude_m_s2
    ),
    "silence": lambda _, at: waves.silence(at),
}
"""What makes each wave, by its table, at the times of its samples."""

HIGHEST = ("frequency_hz", "high_hz", "from_hz", "to_hz", "cycle_hz")
"""Keys of waves that are frequencies which a device's rate has to carry."""


def rendered(protocol: Protocol, rate_hz: int) -> dict[str, Declared]:
    """Return the stimulus of each material, by its id, at a rate, Hz.

    Raises `SynthesisError` for a frequency that the rate does not carry, and as `waves.band_noise`; `ProtocolError` and
    `RecordingError` for a recording.
    """
    return {
        one.material: Declared(
            waves.joined([_part(protocol, part, rate_hz, one.material) for part in one.parts]),
            rate_hz,
            _uncarried(protocol, one, rate_hz),
        )
        for one in protocol.table(Presented).stimuli
    }


def scaled(stimulus: Declared, factor: float) -> Declared:
    """Return a stimulus times a factor."""
    if factor == 1.0:
        return stimulus
    rms, felt = stimulus.omitted_m_s2
    return Declared(factor * stimulus.waveform_m_s2, stimulus.rate_hz, (factor * rms, factor * felt))


def peak_m_s2(stimulus: Declared) -> float:
    """Return the largest magnitude of a sample, m/s^2."""
    return float(np.abs(stimulus.waveform_m_s2).max())


def _part(protocol: Protocol, part: Part, rate_hz: int, material: str) -> Wave:
    name, wave = part.wave
    for key in HIGHEST:
        if 2 * getattr(wave, key, 0.0) >= rate_hz:
            raise SynthesisError(
                f"{name} of {material}: got {key} {getattr(wave, key):g} at {rate_hz} samples a second; allowed: less "
                "than half of that; give a rig with a higher actuator.rate_hz"
            )
    at = waves.times(part.lasts_s, rate_hz)
    if isinstance(wave, Recorded):
        played = recording(protocol, wave)
        made = waves.resampled(at, played.m_s2, recorded_hz=played.rate_hz)
    else:
        made = WAVES[name](wave, at)
    return waves.ramped(made, rate_hz=rate_hz, ramp_s=part.ramp_s)


def _uncarried(protocol: Protocol, stimulus: PresentedStimulus, rate_hz: int) -> tuple[float, float]:
    """Return what a rate does not carry of the recordings of a stimulus: its rms, and its sum in (6), m/s^2."""
    energy, felt = 0.0, 0.0
    for part in stimulus.parts:
        if part.recorded is None:
            continue
        played = recording(protocol, part.recorded)
        left = waves.uncarried(waves.times(part.lasts_s, rate_hz), played.m_s2, recorded_hz=played.rate_hz)
        left, share = waves.ramped(left, rate_hz=played.rate_hz, ramp_s=part.ramp_s), part.lasts_s / stimulus.lasts_s
        energy += share * float(np.mean(left**2))
        f = bin_frequencies_hz(bins=left.size, rate_hz=played.rate_hz)
        felt += share * float(np.abs(spectrum(left))[1:][f[1:] <= BAND_HZ[1]].sum())
    return sqrt(energy), felt


@dataclass(frozen=True)
class Recording:
    """The samples of a recording that are played, m/s^2, shape (m,), their rate, and how long the file goes on, s."""

    file: str
    m_s2: Wave
    rate_hz: int
    left_s: float


def recording(protocol: Protocol, wave: Recorded) -> Recording:
    """Return a recording that a protocol plays. Raises `RecordingError`, and `ProtocolError` as `files.companion`."""
    from palpate.experiment.recordings.wav import wav_samples

    stored_hz, stored = wav_samples(files.companion(protocol, wave.file), file=wave.file)
    first = round(wave.begins_s * stored_hz)
    samples = stored[first : first + round(wave.lasts_s * stored_hz)]
    if samples.ndim != 1 or samples.shape[0] < round(wave.lasts_s * stored_hz):
        got = f"got {stored.shape[0] / stored_hz:g} s of {1 if stored.ndim == 1 else stored.shape[1]} channels"
        raise RecordingError(wave.file, got, allowed=f"one channel of at least {wave.begins_s + wave.lasts_s:g} s")
    if stored.dtype.kind not in "if":
        raise RecordingError(wave.file, "got samples of 8 bits", "export it again", allowed="16 bits or more, or float")
    whole = float(np.iinfo(stored.dtype).max) + 1 if stored.dtype.kind == "i" else 1.0
    m_s2 = samples.astype(np.float64) * (wave.full_scale_m_s2 / whole)
    return Recording(wave.file, m_s2, stored_hz, (stored.shape[0] - first - samples.shape[0]) / stored_hz)
