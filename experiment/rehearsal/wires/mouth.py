"""REHEARSAL: a participant's mouth before the microphone of the simulated sound card, from a process of its own.

The microphone hears the mouth, the quiet of a room, and the headphones' output through an impulse response. The session
writes samples over a socket.
"""

import os
import sys
from collections import deque
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.errors import AudioError
from palpate.experiment.rehearsal.wires.neighbour import Neighbour, end_soon, far_end

CLIENT = "mouth"
"""The mouth, as JACK names it."""

QUIET = 2e-4
"""Rms of the room's own noise, full scale being 1: 48 dB below a simulated voice; ours."""

LEAK, LEAK_S = 0.05, 0.02
"""Of the headphones' samples that much reaches the microphone, within so long, s; ours."""

LARGEST_BLOCK = 1024
"""Of the server, frames."""

ROUND = 1 << 17
"""Samples after which the room's noise is the same again."""

_SPEAKING = b"speaking\n"

Samples = NDArray[np.float32]


def leak(*, rate_hz: int) -> Samples:
    """Return a simulated way from headphones to microphone, an impulse response that falls by 60 dB, shape (n,)."""
    n = round(LEAK_S * rate_hz)
    wave = np.random.default_rng(1).normal(size=n) * 10 ** (-3 * np.arange(n) / n)
    return np.asarray(LEAK * wave / np.sqrt(np.sum(wave**2)), np.float32)


class Mouth:
    """Speaks into one input of the simulated card."""

    def __init__(self, server: str, *, headphones: str, microphone: str, response: Samples) -> None:
        """Stand between two ports of a JACK server, by name; `response` is the leak's, (n,). Raises `AudioError`."""
        self._process = Neighbour("palpate.experiment.rehearsal.wires.mouth", server, headphones, microphone)
        try:
            self.say(response)
            told = self._process.line.readline()
        except OSError as error:
            told = str(error).encode()
        if told != _SPEAKING:
            self._process.kill()
            raise AudioError(
                "simulated sound card",
                f"its simulated voice cannot be played ({told.decode('utf-8', 'replace')[:200]})",
            )

    def say(self, samples: Samples) -> None:
        """Say samples, 1 being full scale, shape (n,), after what is said already; return at once."""
        self._process.line.write(b"%d\n" % samples.size + np.asarray(samples, "<f4").tobytes())
        self._process.line.flush()

    def close(self) -> None:
        """Fall silent."""
        self._process.close()


class Room:
    """What the microphone hears, block by block."""

    def __init__(self, response: Samples) -> None:
        self._transform = 1 << (response.size + LARGEST_BLOCK - 1).bit_length()
        self._response = np.fft.rfft(response, self._transform)
        self._played = np.zeros(self._transform, np.float32)
        self._quiet = np.random.default_rng(2).normal(scale=QUIET, size=ROUND + LARGEST_BLOCK)
        self._frame = 0
        self.said: deque[Samples] = deque()
        self._saying, self._at = np.zeros(0, np.float32), 0

    def fill(self, played: Samples, heard: Samples) -> None:
        """Fill the next block of the microphone, shape (n,), while the headphones play theirs."""
        n = len(heard)
        self._played = np.concatenate([self._played[n:], played])
        heard[:] = np.fft.irfft(np.fft.rfft(self._played) * self._response, self._transform)[-n:]
        heard += self._quiet[self._frame % ROUND :][:n]
        self._frame += n
        done = 0
        while done < n:
            if self._at == self._saying.size:
                if not self.said:
                    return
                self._saying, self._at = self.said.popleft(), 0
            part = self._saying[self._at : self._at + n - done]
            heard[done : done + part.size] += part
            done, self._at = done + part.size, self._at + part.size


def _read(said: BinaryIO) -> Samples | None:
    """Return the next samples to say; None where nobody asks for more."""
    count = said.readline()
    return np.frombuffer(said.read(4 * int(count)), "<f4").astype(np.float32) if count else None


def speak(server: str, headphones: str, microphone: str, said: BinaryIO, told: BinaryIO) -> None:
    """Say what is asked for until the process that asks has gone."""
    response = _read(said)
    if response is None:
        return
    try:
        import jack

        client: Any = jack.Client(CLIENT, servername=server, no_start_server=True)
        room = Room(response)
        entry, out = client.inports.register("in"), client.outports.register("out")
        client.set_process_callback(lambda _frames: room.fill(entry.get_array(), out.get_array()))
        client.set_shutdown_callback(lambda *_: os._exit(1))
        with client:
            client.connect(headphones, entry)
            client.connect(out, microphone)
            told.write(_SPEAKING)
            told.flush()
            while (samples := _read(said)) is not None:
                room.said.append(samples)
            end_soon()
    except Exception as error:
        told.write(f"{error}\n".encode())
        raise


if __name__ == "__main__":
    with far_end() as (said, told):
        speak(sys.argv[1], sys.argv[2], sys.argv[3], said, told)
