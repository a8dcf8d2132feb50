"""The microphone on a stream: which samples of which moments, beside what was sent, and how loud; a stream made up."""

from __future__ import annotations

from typing import cast

import numpy as np
import pytest

from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.audio.microphone import AudioMicrophone, Loudness, objection
from palpate.experiment.apparatus.audio.mixer import Layout, Loop, Mixer
from palpate.experiment.apparatus.audio.stream import AudioStream
from palpate.experiment.errors import AudioError
from palpate.experiment.protocol.files import shipped
from tests.approved import Refuses

AUDIO = rigs.load(shipped("rigs/headless.toml")).audio
RATE_HZ, BLOCK = 48_000, 128
NS = 1e9 / RATE_HZ
ZERO_NS = 10**18


class Ran:
    """A stream that ran for some blocks: its headphones played a ramp, and input 1 heard the frame's number."""

    rate_hz = RATE_HZ

    def __init__(self, blocks: int, kept_frames: int = 48_000) -> None:
        layout = Layout(2, 2, BLOCK, 10, kept_frames, (1.0, 1.0), sent=0)
        self.mixer = Mixer(layout)
        self.mixer.loop = Loop(1.0, samples=(np.arange(1000) / 1000).astype(np.float32), channels=(0, 1))
        self.mixer.loop.wanted = self.mixer.loop.gain = 0.5
        for block in range(blocks):
            heard = np.zeros((BLOCK, 2), np.float32)
            heard[:, 0] = (np.arange(BLOCK) + block * BLOCK) / 1e6
            self.mixer.fill(np.empty((BLOCK, 2), np.float32), heard)

    @property
    def next_frame(self) -> int:
        return self.mixer.frame

    def frame_at(self, t_ns: int) -> int:
        return round((t_ns - ZERO_NS) / NS)

    def ns_of(self, frame: float) -> int:
        return ZERO_NS + round(frame * NS)

    def wait(self, frame: int) -> None:
        if frame > self.mixer.frame:
            raise AudioError("it stopped")

    def recorded_inputs(self, frame: int, frames: int) -> np.ndarray:
        return self.mixer.recorded_inputs(frame, frames)

    def sent(self, frame: int, frames: int) -> np.ndarray:
        return self.mixer.sent(frame, frames)


def microphone(blocks: int) -> AudioMicrophone:
    assert AUDIO is not None
    return AudioMicrophone(cast("AudioStream", Ran(blocks)), AUDIO)


def test_what_was_heard_stands_beside_what_was_sent_at_the_same_frames() -> None:
    assert AUDIO is not None
    late_ns = round(AUDIO.latency.input_ms * 1e6)
    found = microphone(100).heard(
        from_ns=ZERO_NS + round(200 * NS) - late_ns, until_ns=ZERO_NS + round(700 * NS) - late_ns
    )
    frames = np.arange(200, 700)
    assert found.microphone == pytest.approx(frames / 1e6, abs=1e-9)
    assert found.played == pytest.approx(0.5 * (frames % 1000) / 1000, abs=1e-7)
    # A sound arrived so much earlier at the input than its frame was handed over.
    assert found.begins_ns == pytest.approx(ZERO_NS + 200 * NS - late_ns, abs=1)


def test_what_is_too_long_ago_is_left_out_and_what_never_comes_is_an_error() -> None:
    one = microphone(20)
    assert one.heard(from_ns=ZERO_NS - 10**10, until_ns=ZERO_NS + 10**7).microphone.size == pytest.approx(608, abs=2)
    with pytest.raises(AudioError, match=r"it stopped"):
        one.heard(from_ns=ZERO_NS, until_ns=ZERO_NS + 10**10)


def test_a_stream_that_keeps_nothing_of_what_it_sends_cannot_be_asked(refuses: Refuses) -> None:
    mixer = Mixer(Layout(1, 1, BLOCK, 10, 1000, (1.0,)))
    mixer.fill(np.empty((BLOCK, 1), np.float32), np.zeros((BLOCK, 1), np.float32))
    with refuses(AudioError):
        mixer.sent(0, 10)


def test_loudness_is_that_of_the_last_moments() -> None:
    # Frames 3200 to 12799, a ramp to 0.0128: its rms is sqrt((a^2 + a b + b^2) / 3).
    low, high = 3200e-6, 12800e-6
    loud = microphone(100).loudness()
    assert loud.rms_db == pytest.approx(10 * np.log10((low**2 + low * high + high**2) / 3), abs=0.01)
    assert not loud.clipped
    assert microphone(0).loudness().rms_db < -150


@pytest.mark.parametrize(
    ("loud", "said"),
    [(Loudness(-40, False), ""), (Loudness(-140, False), "silent"), (Loudness(-3, True), "clipped")],
)
def test_what_speaks_against_a_microphone(loud: Loudness, said: str) -> None:
    assert objection(loud).partition(":")[0] == said


def test_a_rig_without_one_has_none(refuses: Refuses) -> None:
    assert AUDIO is not None
    without = AUDIO.model_copy(update={"channels": AUDIO.channels.model_copy(update={"microphone": None})})
    with refuses(AudioError):
        AudioMicrophone(cast("AudioStream", Ran(1)), without)
