"""What an audio callback does with each block: loops and stimuli mixed, limited, and the inputs kept. No device.

`fill` allocates only views. Everything ends at a frame: the callback itself fades there, whatever threads do.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.errors import AudioError

AT_ONCE = -1
"""In place of a frame: with the next block."""

SOMETIME = 2**62
"""A frame, or a session time in ns, that never comes: a stimulus that is not aimed yet, a sound without an end."""

SLOTS = 8
"""Stimuli that may wait or sound at a time."""

UNSHARED = 500
"""Elements of a block's piece: in larger operations numpy lets other threads take the interpreter."""

Block = NDArray[np.float32]


@dataclass(slots=True, eq=False)
class Cue:
    """A stimulus of so many `samples`, handed to the mixer for an output channel, from 0.

    The callback alone writes `started`, the frame at which its first sample left, `late` (its frame had passed, and it
    was not played) and `cut` (it was not allowed to sound, or not any longer). The session's threads alone write
    `frame`, at which that sample is to leave, or `AT_ONCE`, and `withdrawn`: nothing of it sounds. `done`, after which
    the mixer holds it no longer, is written by whoever took it out.
    """

    slot: int
    channel: int
    samples: int
    frame: int
    started: int | None = None
    late: bool = False
    cut: bool = False
    withdrawn: bool = False
    done: bool = False
    unsettled: deque[None] = field(default_factory=lambda: deque([None], maxlen=1))
    """One entry for as long as nobody has started or withdrawn it."""

    def settle(self) -> bool:
        """Decide whether it sounds, and return True; return False if the other side decided before."""
        try:
            self.unsettled.pop()
        except IndexError:
            return False
        return True


@dataclass(slots=True, eq=False)
class Slot:
    """A place for one stimulus."""

    buffer: Block
    waiting: deque[Cue] = field(default_factory=lambda: deque(maxlen=1))
    cue: Cue | None = None
    playing: Cue | None = None
    position: int = 0


@dataclass(slots=True, eq=False)
class Gain:
    """What samples are multiplied by: it goes to `wanted` by at most `step` a frame, and to 0 from the frame `ends` on.

    The callback alone writes `gain`, that of the last frame. `ends` is translated from the session time `ends_ns`
    before each block, since a stalled device loses frames.
    """

    step: float
    wanted: float = 0.0
    gain: float = 0.0
    ends: int = SOMETIME
    ends_ns: int = SOMETIME


@dataclass(slots=True, eq=False, kw_only=True)
class Loop(Gain):
    """Samples on some output channels, from 0, float32, shape (n,): frame f of the stream plays sample f modulo n."""

    samples: Block
    channels: tuple[int, ...]


@dataclass(frozen=True)
class Layout:
    """What a mixer is made for: channels, the frames of the largest block, the longest stimulus and the input kept.

    `ceilings` are the largest magnitudes of each output channel, 1.0 being full scale. The output channel `sent`, from
    0, is kept too; None for none. At the end the gain falls by `step` a frame.
    """

    outputs: int
    inputs: int
    block: int
    stimulus_frames: int
    kept_frames: int
    ceilings: tuple[float, ...]
    sent: int | None = None
    step: float = 1.0


class Mixer:
    """Everything between the session's thread and the samples of a block."""

    def __init__(self, layout: Layout) -> None:
        """Allocate; `AudioError` for a ceiling outside 0 to 1."""
        if len(layout.ceilings) != layout.outputs or not all(0 <= c <= 1 for c in layout.ceilings):
            raise AudioError(
                "limiter",
                f"got ceilings {layout.ceilings}",
                allowed=f"from 0 to 1 for each of {layout.outputs} channels",
            )
        self.layout = layout
        self.frame = 0
        """First frame of the next block: whatever lies before it has been handed to the device."""
        self.limited = [0] * layout.outputs
        """Samples that the limiter changed, of each output: stimuli come limited, and a sum of two may not be."""
        self.loop: Loop | None = None
        self.whole = Gain(layout.step, wanted=1.0, gain=1.0)
        """Of everything that leaves."""
        self.stood_still = False
        """Set before a block that comes long after the one before: what waits for its frame, or sounds, is past."""
        self.allowed: Callable[[], bool] = lambda: True
        """Asked before each block: a stimulus that sounds where it is not allowed ends there."""
        pieces = -(-layout.block // max(UNSHARED // max(layout.outputs, layout.inputs, 1), 1))
        self._piece = -(-layout.block // pieces)
        """Frames that are made at a time."""
        self._slots = [Slot(np.zeros(layout.stimulus_frames, np.float32)) for _ in range(SLOTS)]
        self._kept = np.zeros((layout.kept_frames, layout.inputs), np.float32)
        self._sent = np.zeros(layout.kept_frames if layout.sent is not None else 0, np.float32)
        self._ceilings = np.array(layout.ceilings, np.float32)
        self._floors = -self._ceilings
        self._before = np.zeros((layout.block, layout.outputs), np.float32)
        self._changed = np.zeros((layout.block, layout.outputs), np.bool_)
        self._counting = np.arange(1, layout.block + 1, dtype=np.float32)
        self._gains = np.zeros(layout.block, np.float32)
        self._looped = np.zeros(layout.block, np.float32)

    def schedule(self, waveform: NDArray[np.floating[Any]], *, channel: int, frame: int) -> Cue:
        """Hand over a stimulus of samples, 1.0 being full scale, shape (n,), to a channel, from 0.

        Its first sample leaves at `frame`, or with the next block (`AT_ONCE`). Raises `AudioError` if it is empty or
        too long, the channel does not exist, or too many wait.
        """
        if np.ndim(waveform) != 1 or not 1 <= np.size(waveform) <= self.layout.stimulus_frames:
            raise AudioError(
                "audio",
                f"got a stimulus of shape {np.shape(waveform)}",
                "shorten it",
                allowed=f"one channel of 1 to {self.layout.stimulus_frames} samples",
            )
        if not 0 <= channel < self.layout.outputs:
            raise AudioError("audio", f"got output channel {channel + 1}", allowed=f"1 to {self.layout.outputs}")
        for number, slot in enumerate(self._slots):
            if slot.cue is None or slot.cue.done:
                slot.buffer[: len(waveform)] = waveform
                cue = slot.cue = Cue(number, channel, len(waveform), frame)
                slot.waiting.append(cue)
                return cue
        raise AudioError("audio", f"got more than the {SLOTS} stimuli that may be queued", "withdraw one")

    def move(self, cue: Cue, frame: int) -> bool:
        """Have a waiting stimulus start at another frame; return False, and change nothing, if it has started."""
        slot = self._slots[cue.slot]
        if cue.withdrawn or slot.cue is not cue or not slot.waiting:
            return False
        try:
            slot.waiting.pop()
        except IndexError:  # The callback was faster.
            return False
        cue.frame = frame
        slot.waiting.append(cue)
        return True

    def withdraw(self, cue: Cue) -> bool:
        """Take a stimulus back; return True if nothing of it has sounded or will."""
        if not cue.settle():
            return cue.withdrawn
        cue.withdrawn = True
        slot = self._slots[cue.slot]
        if slot.cue is cue:
            try:
                slot.waiting.pop()
            except IndexError:  # The callback has it in hand, and drops it, or dropped it as too late.
                return True
            cue.done = True
        return True

    def fill(self, outputs: Block, inputs: Block) -> None:
        """Fill the next block, and keep what was heard meanwhile, both of shape (frames, channels)."""
        first, frames = self.frame, len(outputs)
        whole = self.whole
        if self.stood_still:
            # It was silent meanwhile: what is over stays so, and the rest fades in.
            whole.gain = 0.0
        self._cuts = not self.allowed() or self.stood_still or (whole.gain == 0 and whole.ends <= first)
        # The limiter sees to what a sum of infinities leaves; nothing is to be said of it here.
        with np.errstate(invalid="ignore", over="ignore"):
            for begin in range(0, frames, self._piece):
                piece = slice(begin, begin + self._piece)
                self._fill(outputs[piece], inputs[piece], first + begin)
        self.frame = first + frames

    def recorded_inputs(self, frame: int, frames: int) -> Block:
        """Return what the inputs heard from a frame on, shape (frames, inputs); `AudioError` unless all is kept."""
        return self._taken(self._kept, frame, frames)

    def sent(self, frame: int, frames: int) -> Block:
        """Return what left on the output that is kept from a frame on, shape (frames,). Raises as `recorded_inputs`."""
        if self.layout.sent is None:
            raise AudioError(
                "audio", "got a request for the sent output", "open it with one", allowed="a recorded output"
            )
        return self._taken(self._sent, frame, frames)

    def _taken(self, ring: Block, frame: int, frames: int) -> Block:
        if frame < 0 or frames < 0 or frame + frames > self.frame:
            raise AudioError(
                "audio", f"got a request for sound up to frame {frame + frames}", allowed=f"up to {self.frame}"
            )
        taken = ring[np.arange(frame, frame + frames) % len(ring)]
        # The block under way may be overwriting what lies a whole ring behind it.
        oldest = self.frame + self.layout.block - len(ring)
        if frame < oldest:
            raise AudioError(
                "audio", f"got a request for sound from frame {frame}", "request it sooner", allowed=f"from {oldest}"
            )
        return taken

    def _fill(self, outputs: Block, inputs: Block, first: int) -> None:
        _keep(self._kept, inputs, first)
        outputs.fill(0)
        if self.loop is not None:
            self._play_loop(self.loop, outputs, first)
        for slot in self._slots:
            if slot.waiting:
                self._start(slot, first, first + len(outputs))
            if slot.playing is not None:
                self._play(slot, slot.playing, outputs, first)
        if first + len(outputs) > self.whole.ends or self.whole.gain != self.whole.wanted:
            np.multiply(outputs, self._ramp(self.whole, len(outputs), first)[:, None], out=outputs)
        self._limit(outputs)
        if self.layout.sent is not None:
            _keep(self._sent, outputs[:, self.layout.sent], first)

    def _start(self, slot: Slot, first: int, end: int) -> None:
        try:
            head = slot.waiting[0]
            if self._is_to_come(head, end):
                return
            cue = slot.waiting.pop()
        except IndexError:  # The session's thread is moving it, or has withdrawn it.
            return
        if self._is_to_come(cue, end):  # Moved since it was looked at.
            slot.waiting.append(cue)
        elif AT_ONCE < cue.frame < first or self.stood_still:
            cue.late = True
            cue.done = True
        elif max(cue.frame, first) >= self.whole.ends:
            cue.cut = True
            cue.done = True
        elif not cue.settle():  # Withdrawn since it was looked at.
            cue.done = True
        else:
            cue.started = max(cue.frame, first)
            slot.position = 0
            slot.playing = cue

    def _is_to_come(self, cue: Cue, end: int) -> bool:
        """Return whether a stimulus waits on, in a block that ends before the frame `end`."""
        return bool(cue.unsettled) and cue.frame >= (SOMETIME if self.stood_still else end)

    def _play(self, slot: Slot, cue: Cue, outputs: Block, first: int) -> None:
        begin = max((cue.started or 0) - first, 0)
        frames = min(cue.samples - slot.position, len(outputs) - begin)
        if self._cuts:
            cue.cut, frames, slot.position = True, 0, cue.samples
        cue.cut |= first + begin + frames > self.whole.ends
        outputs[begin : begin + frames, cue.channel] += slot.buffer[slot.position : slot.position + frames]
        slot.position += frames
        if slot.position == cue.samples:
            slot.playing = None
            cue.done = True

    def _play_loop(self, loop: Loop, outputs: Block, first: int) -> None:
        frames = len(outputs)
        wave = self._looped[:frames]
        done = 0
        while done < frames:
            at = (first + done) % len(loop.samples)
            piece = min(frames - done, len(loop.samples) - at)
            wave[done : done + piece] = loop.samples[at : at + piece]
            done += piece
        if loop.gain == loop.wanted and first + frames <= loop.ends:
            np.multiply(wave, loop.gain, out=wave)
        else:
            np.multiply(wave, self._ramp(loop, frames, first), out=wave)
        for channel in loop.channels:
            outputs[:, channel] += wave

    def _ramp(self, gain: Gain, frames: int, first: int) -> Block:
        """Return a gain at each frame of a piece, shape (frames,), and bring it there."""
        gains = self._gains[:frames]
        before = min(max(gain.ends - first, 0), frames)
        for piece, wanted in ((gains[:before], gain.wanted), (gains[before:], 0.0)):
            if not len(piece):
                continue
            np.multiply(self._counting[: len(piece)], gain.step if wanted > gain.gain else -gain.step, out=piece)
            np.add(piece, gain.gain, out=piece)
            (np.minimum if wanted > gain.gain else np.maximum)(piece, wanted, out=piece)
            reached = float(piece[-1])
            gain.gain = wanted if reached == np.float32(wanted) else reached
        return gains

    def _limit(self, outputs: Block) -> None:
        """Last before the device: no sample above its channel's ceiling, NaN to 0."""
        before, changed = self._before[: len(outputs)], self._changed[: len(outputs)]
        np.abs(outputs, out=before)
        np.less_equal(before, self._ceilings, out=changed)
        if changed.all():
            return
        np.copyto(before, outputs)
        np.isnan(outputs, out=changed)
        np.copyto(outputs, 0, where=changed)
        np.clip(outputs, self._floors, self._ceilings, out=outputs)
        np.not_equal(before, outputs, out=changed)
        for channel in range(len(self.limited)):
            self.limited[channel] += int(np.count_nonzero(changed[:, channel]))


def _keep(ring: Block, block: Block, first: int) -> None:
    """Put a block, whose first frame is `first`, at its place in a ring."""
    at = first % len(ring)
    until_end = min(len(block), len(ring) - at)
    ring[at : at + until_end] = block[:until_end]
    ring[: len(block) - until_end] = block[until_end:]
