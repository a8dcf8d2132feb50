"""What a mixer plays: stimuli that wait or sound, and loops.

The callback and the session's thread share no lock. A stimulus that waits lies in a deque of at most one place, and
whoever pops it owns it: the callback to start it, the session's thread to move or withdraw it. So a stimulus either
starts at the frame that was asked for last, or the session knows that it can no longer be moved. Whether it sounds at
all is settled once, in the same way: whoever pops the one entry of `Cue.unsettled`, the callback to start it or the
session's thread to withdraw it, has its way, wherever the stimulus lies meanwhile.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

AT_ONCE = -1
"""In place of a frame: with the next block."""

Block = NDArray[np.float32]


class Cue:
    """A stimulus handed to the mixer.

    The callback alone writes `started` and `late`, the session's thread alone `frame` and `withdrawn`. `done` is
    written by whoever took it out of the mixer: the callback, or the session's thread that withdrew it while it waited.

    Attributes:
        channel: output channel, from 0.
        samples: its length.
        frame: frame at which its first sample is to leave, or `AT_ONCE`.
        started: frame at which it left; None as long as it has not.
        late: its frame had passed when the callback came to it, so it was not played.
        withdrawn: it was taken back before it started; nothing of it sounds.
        done: nothing more of it will sound, and the mixer holds it no longer.
        unsettled: one entry for as long as nobody has started or withdrawn it.
    """

    __slots__ = ("channel", "done", "frame", "late", "samples", "slot", "started", "unsettled", "withdrawn")

    def __init__(self, slot: int, channel: int, samples: int, frame: int) -> None:
        self.slot = slot
        self.channel = channel
        self.samples = samples
        self.frame = frame
        self.started: int | None = None
        self.late = False
        self.withdrawn = False
        self.done = False
        self.unsettled: deque[None] = deque([None], maxlen=1)

    def settle(self) -> bool:
        """Have the say whether it sounds; False if the other side had it before."""
        try:
            self.unsettled.pop()
        except IndexError:
            return False
        return True


class Slot:
    """A place for one stimulus."""

    __slots__ = ("buffer", "cue", "playing", "position", "waiting")

    def __init__(self, samples: int) -> None:
        self.buffer = np.zeros(samples, np.float32)
        self.waiting: deque[Cue] = deque(maxlen=1)
        self.cue: Cue | None = None
        self.playing: Cue | None = None
        self.position = 0


class Loop:
    """Samples without end, which the mixer plays with a gain that changes in ramps. The callback alone writes `gain`.

    Attributes:
        samples: one round, float32, shape (n,); frame f of the stream plays sample f modulo n.
        channels: output channels, from 0.
        wanted: the gain to go to.
        step: largest change of gain from a frame to the next.
        gain: the gain of the last frame played.
    """

    __slots__ = ("channels", "gain", "samples", "step", "wanted")

    def __init__(self, samples: Block, channels: tuple[int, ...], step: float) -> None:
        self.samples = samples
        self.channels = channels
        self.step = step
        self.wanted = 0.0
        self.gain = 0.0
