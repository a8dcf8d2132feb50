"""The sound of one session: one audio stream, opened once and kept, with the masker on its headphones."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from experiment import scene
from experiment.apparatus import opening_audio
from experiment.apparatus.audio.masker import ROUND_S, Masker
from experiment.apparatus.audio.stream import AudioStream
from experiment.apparatus.rig import Rig
from experiment.clock import Clock, day
from experiment.protocol.models import Protocol
from experiment.session import journal, masking, places


@dataclass(frozen=True)
class Sound:
    """What plays during a session.

    Attributes:
        stream: masker, stimulus, microphone and loopback share its sample clock.
        masker: silent until the session starts it.
    """

    stream: AudioStream
    masker: Masker


def open_sound(
    rig: Rig, protocol: Protocol, *, clock: Clock, dose_before: float, opened: ExitStack, device: str | None = None
) -> Sound:
    """Open the rig's audio device for a session.

    Args:
        rig: a rig with an audio device.
        protocol: says which noise masks, and the limits.
        clock: the session's clock; it must go by itself.
        dose_before: of noise, what the participant's sessions of the day used up.
        opened: closes the stream.
        device: used instead of the one that the rig names.

    Raises:
        RigError: a calibration is too old, or the device exists in simulation alone.
        AudioError: the device cannot be opened.
    """
    audio = opening_audio.audio_of(rig)
    samples = scene.masker_samples(protocol=protocol, rate_hz=audio.rate_hz, seconds=ROUND_S)
    noise = opening_audio.masker_noise(rig, samples=samples, limit_db_a=protocol.exposure.masker_level_db_a)
    stream = opening_audio.open_audio(
        rig,
        limit_m_s2=protocol.exposure.vibration_peak_m_s2,
        masker=noise,
        clock=clock,
        today=day(clock.now_ns()),
        device=device,
    )
    opened.callback(stream.close)
    return Sound(
        stream, opening_audio.open_masker(rig, stream=stream, noise=noise, clock=clock, dose_before=dose_before)
    )


def dose_before(dataset: Path, protocol: Protocol, participant: str, clock: Clock) -> float:
    """What a participant's sessions of today used up of the dose of the day.

    Args:
        dataset: folder of the study's dataset.
        protocol: the study.
        participant: label.
        clock: the session's.

    Raises:
        JournalError: a journal cannot be trusted.
    """
    paths = (places.journal_path(dataset, participant, task.id) for task in protocol.tasks)
    return masking.dose_today([journal.read(path) for path in paths if path.exists()], clock.now_ns())
