"""From a rig file to its opened audio device: the session's stream, and the masker on it."""

from __future__ import annotations

from datetime import date
from typing import TYPE_CHECKING

from experiment.apparatus.rig import Rig
from experiment.apparatus.rig_audio import AudioRig, check_calibrations
from experiment.apparatus.rig_panel import REHEARSAL
from experiment.clock import Clock
from experiment.errors import RigError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from experiment.apparatus.audio.masker import Masker, MaskerNoise
    from experiment.apparatus.audio.stream import AudioStream


def audio_of(rig: Rig) -> AudioRig:
    """The settings of the rig's audio device.

    Raises:
        RigError: the rig has none.
    """
    if rig.audio is None:
        raise RigError(
            f"rig '{rig.rig.name}': got no table [audio]; allowed: one, for masker and loopback need it; "
            "`palpate devices` lists what this machine has"
        )
    return rig.audio


def open_audio(
    rig: Rig, *, limit_m_s2: float, masker: MaskerNoise | None, clock: Clock, today: date, device: str | None = None
) -> AudioStream:
    """Open the rig's audio device, with a limit on every channel: what is neither headphones nor actuator stays silent.

    Args:
        rig: the rig.
        limit_m_s2: the protocol's limit for the magnitude of any sample of a stimulus, m/s^2.
        masker: what the headphones will play; None for silence.
        clock: the session's clock; it must go by itself.
        today: calibrations must not be too old by then; those of a simulated rig do not age.
        device: used instead of the one that the rig names.

    Raises:
        RigError: the rig has no audio device, a calibration is too old, or it exists in simulation alone.
        AudioError: the device cannot be opened.
    """
    from experiment.apparatus.conditioning import Conditioner

    audio = audio_of(rig)
    if device is None and audio.device == REHEARSAL:
        raise RigError(simulated_only(rig, "audio.device"))
    if not rig.rig.simulated:
        check_calibrations(audio, today)
    ceilings = [0.0] * audio.channels.outputs
    for channel in audio.channels.headphones:
        ceilings[channel - 1] = masker.ceiling if masker is not None else 0.0
    if rig.actuator.driver == "audio":
        volts = rig.actuator.shaping is not None
        ceilings[audio.channels.actuator - 1] = (
            1.0 if volts else Conditioner(full_scale=rig.actuator.full_scale, limit_m_s2=limit_m_s2).ceiling
        )
    return _stream(audio, ceilings, clock, device)


def open_probing(rig: Rig, *, peak: float, clock: Clock, device: str | None = None) -> AudioStream:
    """Open the rig's audio device to measure it, whatever the age of its calibrations.

    Args:
        rig: the rig.
        peak: largest magnitude of a probe on the actuator's channel, 1.0 being full scale; other channels are silent.
        clock: the session's clock; it must go by itself.
        device: used instead of the one that the rig names.

    Raises:
        RigError: the rig has no audio device.
        AudioError: the device cannot be opened.
    """
    audio = audio_of(rig)
    ceilings = [0.0] * audio.channels.outputs
    ceilings[audio.channels.actuator - 1] = peak
    return _stream(audio, ceilings, clock, device)


def _stream(audio: AudioRig, ceilings: list[float], clock: Clock, device: str | None) -> AudioStream:
    from experiment.apparatus.audio.stream import AudioStream, StreamSettings

    settings = StreamSettings(
        host_api=audio.host_api,
        device=device or audio.device,
        rate_hz=audio.rate_hz,
        block=audio.block,
        inputs=audio.channels.inputs,
        ceilings=tuple(ceilings),
    )
    return AudioStream(settings, clock)


def masker_noise(rig: Rig, *, samples: NDArray[np.float64], limit_db_a: float) -> MaskerNoise:
    """A masker as the rig's headphones play it.

    Args:
        rig: the rig.
        samples: one round of noise at the rate of the audio device, of rms 1, shape (n,).
        limit_db_a: the protocol's limit, dB(A).

    Raises:
        RigError: the rig has no audio device.
        AudioError: the headphones cannot play even the softest level.
    """
    from experiment.apparatus.audio import masker

    audio = audio_of(rig)
    return masker.masker_noise(
        samples,
        rate_hz=audio.rate_hz,
        pink_full_scale_db_a=audio.headphones.full_scale_db_a,
        limit_db_a=limit_db_a,
    )


def open_masker(rig: Rig, *, stream: AudioStream, noise: MaskerNoise, clock: Clock, dose_before: float = 0.0) -> Masker:
    """The masker on the rig's headphones, silent as yet.

    Args:
        rig: the rig.
        stream: the session's, opened for this noise.
        noise: what to play.
        clock: the session's clock.
        dose_before: what the participant's earlier sessions of the day used up.

    Raises:
        RigError: the rig has no audio device.
    """
    from experiment.apparatus.audio.masker import Masker

    channels = audio_of(rig).channels.headphones
    return Masker(stream, noise, channels=channels, clock=clock, dose_before=dose_before)


def simulated_only(rig: Rig, key: str) -> str:
    """Why a device that exists in simulation alone cannot be opened; `key` names it in the rig file."""
    return (
        f"rig '{rig.rig.name}' is simulated: its devices exist only inside `palpate rehearse`; "
        f"give a rig file whose {key} names a real one"
    )
