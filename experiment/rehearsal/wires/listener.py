"""REHEARSAL: listens to an output of the simulated sound card, from a process of its own.

So the session need not wait for it at each block of the sound server. It is asked over a socket: a number in a line,
answered by a line and the samples.
"""

import os
import sys
from contextlib import ExitStack
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.errors import AudioError
from palpate.experiment.rehearsal.wires.neighbour import Neighbour, end_soon, far_end

CLIENT = "panel"
"""The listener, as JACK names it."""

SPARE_S = 1.0
"""How much more is held than is told, s, so that new blocks never overwrite what is being told."""

_LISTENING = b"listening\n"

_SAMPLE_BYTES = np.float32().nbytes


class Tap:
    """What one output carries, kept from the moment of tapping on."""

    def __init__(self, server: str, output: str, *, seconds: float) -> None:
        """Listen to a port of a running JACK server, both by name; keep the last `seconds`. Raises `AudioError`."""
        self.listener = Neighbour("palpate.experiment.rehearsal.wires.listener", server, output, str(seconds))
        try:
            said = self.listener.line.readline()
        except OSError as error:
            raise self._failed(str(error)) from error
        if said != _LISTENING:
            raise self._failed(said.decode("utf-8", "replace"))

    def since(self, first: int) -> tuple[int, NDArray[np.float32]]:
        """Return the first sample's number, at least `first`, and all samples from there on, counted from the tapping.

        Raises `AudioError` if the listener has ended, or does not answer.
        """
        try:
            self.listener.line.write(b"%d\n" % first)
            self.listener.line.flush()
            begin, _, count = self.listener.line.readline().partition(b" ")
            told = self.listener.line.read(int(count or 0) * _SAMPLE_BYTES)
        except OSError as error:
            raise self._failed(str(error)) from error
        if not count or len(told) != int(count) * _SAMPLE_BYTES:
            raise self._failed("its answer was cut off")
        return int(begin), np.frombuffer(told, np.float32)

    def close(self) -> None:
        """Listen no more."""
        self.listener.close()

    def _failed(self, why: str) -> AudioError:
        self.listener.kill()
        said = f" ({why.strip()})" if why.strip() else ""
        return AudioError("simulated sound card", f"its listener has stopped{said}", "start again")


class Kept:
    """The last `samples` of a stream without end, told while another thread adds up to `spare` more."""

    def __init__(self, samples: int, *, spare: int) -> None:
        self._told = samples
        self._ring = np.zeros(samples + spare, np.float32)
        self._count = 0

    def add(self, block: NDArray[np.float32]) -> None:
        """Take the next samples, at most `spare`."""
        ring = self._ring
        at = self._count % len(ring)
        until_end = min(len(block), len(ring) - at)
        ring[at : at + until_end] = block[:until_end]
        ring[: len(block) - until_end] = block[until_end:]
        self._count += len(block)

    def since(self, first: int) -> tuple[int, NDArray[np.float32]]:
        """See `Tap.since`."""
        count = self._count
        first = max(first, count - self._told)
        return first, self._ring[np.arange(first, count) % len(self._ring)]


def listen(server: str, output: str, seconds: float, requests: BinaryIO, told: BinaryIO) -> None:
    """Keep what a port carries, and tell of it on request until the process that asks has gone."""
    with ExitStack() as opened:
        try:
            import jack

            client: Any = jack.Client(CLIENT, servername=server, no_start_server=True)
            kept = Kept(round(seconds * client.samplerate), spare=round(SPARE_S * client.samplerate))
            entry = client.inports.register("in")
            client.set_process_callback(lambda _frames: kept.add(entry.get_array()))
            # A listener whose server has ended must not go on answering.
            client.set_shutdown_callback(lambda *_: os._exit(1))
            opened.enter_context(client)
            client.connect(output, entry)
        except Exception as error:
            told.write(f"{error}\n".encode())
            raise
        told.write(_LISTENING)
        told.flush()
        for asked in requests:
            first, samples = kept.since(int(asked))
            told.write(b"%d %d\n" % (first, samples.size))
            told.write(samples.tobytes())
            told.flush()
        end_soon()


if __name__ == "__main__":
    with far_end() as (requests, told):
        listen(sys.argv[1], sys.argv[2], float(sys.argv[3]), requests, told)
