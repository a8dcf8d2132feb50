"""From what a protocol declares to the waveforms of a device's rate."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from palpate.experiment.errors import SynthesisError
from palpate.experiment.protocol.kinds.presented import Part, Presented, PresentedStimulus
from palpate.experiment.synthesis.signals import waves
from palpate.experiment.synthesis.signals.waves import Declared, Times, Wave

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


def rendered(table: Presented, rate_hz: int) -> dict[str, Declared]:
    """Return the stimulus of each material, by its id, at a rate, Hz.

    Raises `SynthesisError` for a frequency that the rate does not carry, and as `waves.band_noise`.
    """
    return {one.material: _stimulus(one, rate_hz) for one in table.stimuli}


def scaled(stimulus: Declared, factor: float) -> Declared:
    """Return a stimulus times a factor."""
    return stimulus if factor == 1.0 else Declared(factor * stimulus.waveform_m_s2, stimulus.rate_hz)


def peak_m_s2(stimulus: Declared) -> float:
    """Return the largest magnitude of a sample, m/s^2."""
    return float(np.abs(stimulus.waveform_m_s2).max())


def _stimulus(stimulus: PresentedStimulus, rate_hz: int) -> Declared:
    return Declared(waves.joined([_part(part, rate_hz, stimulus.material) for part in stimulus.parts]), rate_hz)


def _part(part: Part, rate_hz: int, material: str) -> Wave:
    name, wave = part.wave
    for key in HIGHEST:
        if 2 * getattr(wave, key, 0.0) >= rate_hz:
            raise SynthesisError(
                f"{name} of {material}: got {key} {getattr(wave, key):g} at {rate_hz} samples a second; allowed: less "
                "than half of that; give a rig with a higher actuator.rate_hz"
            )
    return waves.ramped(WAVES[name](wave, waves.times(part.lasts_s, rate_hz)), rate_hz=rate_hz, ramp_s=part.ramp_s)
