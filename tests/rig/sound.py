"""Audio servers for tests: a JACK server with its dummy driver, sample-exact; and streams on it."""

from __future__ import annotations

import importlib.util
import shutil
import signal
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from palpate.experiment.apparatus.audio.stream import AudioStream, StreamSettings
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.rehearsal.wires.sound_card import DEVICE, SoundCard

HOST_API = "JACK Audio Connection Kit"
"""Where PortAudio has the simulated card."""

RATE_HZ = 48_000
BLOCK = 256


@contextmanager
def sound_card(*, rate_hz: int = RATE_HZ, block: int = BLOCK, inputs: int = 2, outputs: int = 4) -> Iterator[SoundCard]:
    """A JACK server of our own; skips where the parts are not installed."""
    for part, package in (("jack", "JACK-Client"), ("sounddevice", "sounddevice")):
        if importlib.util.find_spec(part) is None:
            pytest.skip(f"needs the package {package}")
    if shutil.which("jackd") is None:
        pytest.skip("needs JACK 2 (package jackd2)")
    card = SoundCard(rate_hz=rate_hz, block=block, inputs=inputs, outputs=outputs)
    try:
        yield card
    finally:
        card.close()


@contextmanager
def halted(card: SoundCard) -> Iterator[None]:
    """Halt the server meanwhile, as a driver that hangs does."""
    card.server.send_signal(signal.SIGSTOP)
    try:
        yield
    finally:
        card.server.send_signal(signal.SIGCONT)


@contextmanager
def stream(
    *, ceilings: tuple[float, ...] = (1.0,) * 4, inputs: int = 2, rate_hz: int = RATE_HZ, block: int = BLOCK
) -> Iterator[AudioStream]:
    """A stream on the running card."""
    opened = AudioStream(StreamSettings(HOST_API, DEVICE, rate_hz, block, inputs, ceilings), MonotonicClock())
    try:
        yield opened
    finally:
        opened.close()
