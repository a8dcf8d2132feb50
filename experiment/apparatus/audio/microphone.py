"""A microphone on an input of the session's audio stream, beside what the headphones were sent: both on its frames."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus.audio.stream import KEPT_S, AudioStream
from palpate.experiment.apparatus.rig import AudioRig
from palpate.experiment.errors import AudioError

SPARE_S = 0.5
"""So much of what the stream keeps is left alone: it is overwritten while it is being read."""

LOOKED_AT_S = 0.2
"""Loudness is that of the last moments, s."""

SILENT_DB = -100.0
"""No microphone that is connected is as quiet: its own noise is louder than that, full scale being 0 dB; ours."""

FULL_SCALE = 0.999
"""A sample from here on is clipped: the largest of 16 bits is 0.99997."""


@dataclass(frozen=True, eq=False)
class Recorded:
    """What the microphone heard, and what the headphones were sent at the same moments.

    Attributes:
        microphone, played: 1 being full scale, float32, shape (n,) both.
        begins_ns: when the first sample arrived at the microphone, session time.
    """

    microphone: NDArray[np.float32]
    played: NDArray[np.float32]
    begins_ns: int


@dataclass(frozen=True)
class Loudness:
    """How loud a microphone was: rms below full scale, dB, and whether a sample was at or beyond full scale."""

    rms_db: float
    clipped: bool


class Microphone(Protocol):
    """What hears the participant, beside what the headphones play; it keeps the last seconds."""

    @property
    def rate_hz(self) -> int:
        """Samples a second."""

    def heard(self, *, from_ns: int, until_ns: int) -> Recorded:
        """Return what was heard between two session times, as far as it is kept. Raises `AudioError` if stopped."""

    def loudness(self) -> Loudness:
        """Return how loud it was in the last moments. Raises `AudioError` as `heard`."""


def objection(loudness: Loudness) -> str:
    """Return why nobody can be heard with a microphone that is as loud; empty where nothing speaks against it."""
    if loudness.rms_db < SILENT_DB:
        return "silent: no signal"
    return "clipped: turn down its level" if loudness.clipped else ""


class AudioMicrophone:
    """Implements `Microphone`."""

    def __init__(self, stream: AudioStream, audio: AudioRig) -> None:
        """Take the input that the rig names of its running stream. Raises `AudioError` if the rig names none."""
        if audio.channels.microphone is None:
            raise AudioError(
                "microphone", "got no audio.channels.microphone", "name it in the rig file", allowed="an input"
            )
        self._stream = stream
        self._entry = audio.channels.microphone - 1
        self._input_ns = round(audio.latency.input_ms * 1e6)

    @property
    def rate_hz(self) -> int:
        return self._stream.rate_hz

    def heard(self, *, from_ns: int, until_ns: int) -> Recorded:
        stream = self._stream
        end = max(stream.frame_at(until_ns + self._input_ns), 0)
        stream.wait(end)
        oldest = stream.next_frame - round((KEPT_S - SPARE_S) * stream.rate_hz)
        first = min(max(stream.frame_at(from_ns + self._input_ns), oldest, 0), end)
        return Recorded(
            microphone=np.ascontiguousarray(stream.recorded_inputs(first, end - first)[:, self._entry]),
            played=stream.sent(first, end - first),
            begins_ns=stream.ns_of(first) - self._input_ns,
        )

    def loudness(self) -> Loudness:
        end = self._stream.next_frame
        frames = min(end, round(LOOKED_AT_S * self._stream.rate_hz))
        samples = self._stream.recorded_inputs(end - frames, frames)[:, self._entry].astype(np.float64)
        power = float(np.mean(samples**2)) if samples.size else 0.0
        loudest = float(np.max(np.abs(samples), initial=0.0))
        return Loudness(10 * float(np.log10(max(power, 1e-20))), loudest >= FULL_SCALE)
