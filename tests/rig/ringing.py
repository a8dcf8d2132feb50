"""A session that only has a vibration sound, in a process of its own: it opens a stream, and sounds when told."""

from __future__ import annotations

import sys

import numpy as np

from palpate.experiment.apparatus import host
from palpate.experiment.apparatus.audio.stream import AudioStream, StreamSettings
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.rehearsal.wires.sound_card import DEVICE
from tests.rig import sound


def main() -> None:
    """Sound through the running card, whose blocks have the frames of the argument, for longer than anybody listens."""
    block = int(sys.argv[1])
    settings = StreamSettings(sound.HOST_API, DEVICE, sound.RATE_HZ, block, 2, (1.0,) * 4)
    with host.raised():
        stream = AudioStream(settings, MonotonicClock())
        sys.stdout.write("open\n")
        sys.stdout.flush()
        sys.stdin.readline()
        frame = stream.next_frame + 8 * block
        stream.schedule(np.full(3 * sound.RATE_HZ, 0.5), channel=0, frame=frame)
        stream.wait(frame + 8 * block)
        sys.stdout.write("sounding\n")
        sys.stdout.flush()
        sys.stdin.readline()


if __name__ == "__main__":
    main()
