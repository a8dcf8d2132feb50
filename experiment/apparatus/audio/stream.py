"""The one stream of a session, out and in: opened once and kept, on frames that count from 0 at its first sample.

A block's samples are made by `mixer.Mixer` in the device's callback. A stimulus at least `lead_frames` ahead leaves at
its very frame; a late one is never played. Devices are known by host API and name; PortAudio's errors become
`AudioError`s.
"""

import atexit
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus import host
from palpate.experiment.apparatus.audio.mixer import Block, Cue, Layout, Loop, Mixer
from palpate.experiment.clock import Clock
from palpate.experiment.errors import AudioError

WINDOW = 64
"""Callbacks that the line rests on."""

IN_A_ROW = 4
"""Late callbacks in a row that make a gap: fewer are a slow machine."""

NONE_NS = 2**63 - 1
"""Offset of a callback that has not come, ns."""

KEPT = 8192
"""Callbacks whose lateness is remembered: 22 s of blocks of 128 frames at 48 kHz, longer than any stimulus."""


@dataclass(frozen=True)
class Fit:
    """How late callbacks come on the timeline, ms: median, 95th percentile and worst."""

    median_ms: float
    p95_ms: float
    worst_ms: float


class Timeline:
    """Kept by the callback through `note`, read by the session's thread, without a lock.

    The callback publishes the counts of callbacks and gaps together and last, and a reader takes both at once. Of what
    it then reads, the callback changes at most the line of the last three. `frame_at` takes the present line alone.
    """

    def __init__(self, *, rate_hz: float, block: int) -> None:
        self._ns_per_frame = 1e9 / rate_hz
        self._quarter_block_ns = 0.25 * block * self._ns_per_frame
        # Of each callback: its first frame, ns less the ns that this frame stands for, and gaps before it.
        self._frames = np.zeros(KEPT, np.int64)
        self._offsets_ns = np.zeros(KEPT, np.int64)
        self._line = np.zeros(KEPT, np.int64)
        # Offsets of the last callbacks on the line that holds now, and the lowest of them.
        self._window_ns = np.full(WINDOW, NONE_NS)
        self._origin_ns = NONE_NS
        self._late = 0
        self._count_and_gaps = (0, 0)

    def note(self, frame: int, now_ns: int) -> None:
        """Note that the callback for a block with this first frame came now; this touches preallocated memory alone."""
        count, gaps = self._count_and_gaps
        offset_ns = now_ns - int(frame * self._ns_per_frame)
        self._late = self._late + 1 if offset_ns - self._origin_ns > self._quarter_block_ns else 0
        place = count % KEPT
        self._frames[place], self._offsets_ns[place], self._line[place] = frame, offset_ns, gaps
        self._window_ns[count % WINDOW] = offset_ns
        count += 1
        if self._late == IN_A_ROW:
            gaps += 1
            self._late = 0
            self._window_ns.fill(NONE_NS)
            for back in range(1, IN_A_ROW + 1):
                place = (count - back) % KEPT
                self._line[place] = gaps
                self._window_ns[(count - back) % WINDOW] = self._offsets_ns[place]
        self._origin_ns = int(self._window_ns.min())
        self._count_and_gaps = count, gaps

    @property
    def gaps(self) -> int:
        """Gaps seen."""
        return self._count_and_gaps[1]

    def ns_of(self, frame: float) -> int:
        """Return the session time at which the stream takes a frame, or took it, ns; without the output's latency."""
        count, _ = self._count_and_gaps
        places = np.arange(max(count - KEPT, 0), count) % KEPT
        lines = self._line[places]
        at = int(np.searchsorted(self._frames[places], frame, side="right")) - 1
        near = slice(max(at - WINDOW + 1, 0), at + WINDOW) if at >= 0 else slice(1)
        same = self._offsets_ns[places[near]][lines[near] == lines[max(at, 0)]]
        return int(same.min()) + round(frame * self._ns_per_frame)

    def frame_at(self, t_ns: int) -> int:
        """Return the frame nearest to a session time."""
        return round((t_ns - self._origin_ns) / self._ns_per_frame)

    def fit(self) -> Fit:
        """Return how well the last callbacks kept to it."""
        count, gaps = self._count_and_gaps
        places = np.arange(max(count - WINDOW, 0), count) % KEPT
        window = self._offsets_ns[places[self._line[places] == gaps]]
        late_ms = (window - window.min()) / 1e6
        return Fit(float(np.median(late_ms)), float(np.percentile(late_ms, 95)), float(late_ms.max()))


CLOSE_S = 5.0
"""How long a device may take to close, s."""

_left_alone = False
"""Whether PortAudio still waits for a stream that was to be closed."""

_REMEDIES = (
    ("unavailable", ": another program is using it, or it was unplugged", "close that program, then start again"),
    ("sample rate", ": it does not run at {} Hz", "set it to that rate, or correct audio.rate_hz in the rig file"),
    ("channels", ": it has fewer channels", "correct audio.channels in the rig file"),
    ("", "", "plug in the device and start its server, then start again"),
)
"""What PortAudio's message holds, and what that means to an experimenter."""


@dataclass(frozen=True)
class Device:
    """A device as PortAudio names it."""

    host_api: str
    name: str
    inputs: int
    outputs: int
    rate_hz: float


def library() -> Any:
    """Return the module `sounddevice`; `AudioError` if it, or the PortAudio that it needs, is not installed."""
    begins = "sounddevice" not in sys.modules
    try:
        with host.taking_turns() if begins else nullcontext():
            import sounddevice
    except (ImportError, OSError) as error:
        raise AudioError(
            "audio",
            f"sounddevice cannot be used ({error})",
            "install palpate[lab] and PortAudio (system package libportaudio2)",
        ) from error
    except Exception as error:
        # It begins as it is imported, and where it cannot its own error is out of reach.
        if type(error).__name__ != "PortAudioError":
            raise
        raise AudioError("audio", str(error), "start the sound server, then run the command again") from error
    return sounddevice


def close_stream(stream: Any) -> None:
    """Close a stream of this process.

    PortAudio waits for ten minutes to close one whose JACK server has gone or stands still, and would do so again as
    the process ends. So such a stream is left alone after `CLOSE_S`, for good.
    """
    global _left_alone
    failed: list[Exception] = []

    def closing() -> None:
        try:
            stream.close()
        except Exception as error:
            failed.append(error)

    thread = threading.Thread(target=closing, name="closing", daemon=True)
    thread.start()
    thread.join(CLOSE_S)
    if thread.is_alive():
        _left_alone = True
        atexit.unregister(library()._exit_handler)
    elif failed:
        raise failed[0]


@contextmanager
def looking_anew() -> Iterator[None]:
    """Have PortAudio look for devices again at the end. No stream may be open in this process.

    Servers are started or stopped inside: PortAudio must have left a server that goes.
    """
    with host.taking_turns():
        if _left_alone:
            yield
            return
        sounddevice = library()
        sounddevice._terminate()
        try:
            yield
        finally:
            sounddevice._initialize()


def devices() -> tuple[Device, ...]:
    """Return every device of every host API."""
    sounddevice = library()
    apis = [api["name"] for api in sounddevice.query_hostapis()]
    return tuple(
        Device(
            host_api=apis[each["hostapi"]],
            name=each["name"],
            inputs=each["max_input_channels"],
            outputs=each["max_output_channels"],
            rate_hz=each["default_samplerate"],
        )
        for each in sounddevice.query_devices()
    )


def find(*, host_api: str, name: str, inputs: int, outputs: int) -> int:
    """Return the number of a device with so many inputs and outputs in PortAudio's `host_api`. Raises `AudioError`."""
    present = devices()
    named = [(i, each) for i, each in enumerate(present) if (each.host_api, each.name) == (host_api, name)]
    if not named:
        names = {f"{each.host_api}: {each.name}" for each in present}
        there = "; ".join(sorted(names)) or "a device of this computer, which has none now"
        raise AudioError(
            f"audio device '{name}' of {host_api}",
            "got no device with this name",
            "plug it in, start its server, close the program that uses it, or correct [audio] in the rig file",
            allowed=there,
        )
    for i, each in named:
        if each.inputs >= inputs and each.outputs >= outputs:
            return i
    widest = max(named, key=lambda pair: (pair[1].outputs, pair[1].inputs))[1]
    raise AudioError(
        f"audio device '{name}' of {host_api}",
        f"got {widest.outputs} outputs and {widest.inputs} inputs",
        "close any program that uses it (a device in use may show fewer), correct audio.channels, or choose another "
        "device",
        allowed=f"at least {outputs} and {inputs}, as in audio.channels in the rig file",
    )


@contextmanager
def explained(name: str, *, rate_hz: int) -> Iterator[None]:
    """Turn an error of PortAudio into one that an experimenter understands; the device was asked for `rate_hz`."""
    sounddevice = library()
    try:
        yield
    except (sounddevice.PortAudioError, ValueError) as error:
        said = str(error)
        why, remedy = next((why, remedy) for sign, why, remedy in _REMEDIES if sign in said.lower())
        raise AudioError(f"audio device '{name}'", said + why.format(rate_hz), remedy) from error


STIMULUS_S = 4.0
"""Longest stimulus, s."""

KEPT_S = 30.0
"""How much input is kept, s."""

NOTHING = np.zeros((2**20, 0), np.float32)
"""What comes in where there is no input: it takes no memory."""

SILENT_S = 2.0
"""A stream whose device asks for nothing for this long has stopped, s."""

FADE_S = 0.02
"""How long a sound takes from silence to full scale and back, s: a step would click."""

STILL_NS = 100_000_000
"""After so long without a block, ns, the device stood still: a stimulus that waited for its frame comes too late."""

SWITCH_S = 0.0002
"""How long another thread of the process may hold the callback up while a stream is open, s; CPython's own is 5 ms."""


@dataclass(frozen=True)
class StreamSettings:
    """How a stream is opened: a device by PortAudio's names, its input channels, and an output for each ceiling.

    A ceiling is the largest magnitude, 1.0 being full scale. `block` is in frames; with JACK the server's period, lest
    a buffer be added. The output `sent`, from 0, is kept; None for none. `stimuli`: places for some are reserved. A
    frame leaves `output_ms` after the stream takes it.
    """

    host_api: str
    device: str
    rate_hz: int
    block: int
    inputs: int
    ceilings: tuple[float, ...]
    sent: int | None = None
    stimuli: bool = True
    output_ms: float = 0.0

    def layout(self) -> Layout:
        """Return what is held of sound while such a stream is open."""
        return Layout(
            outputs=len(self.ceilings),
            inputs=self.inputs,
            block=self.block,
            stimulus_frames=round(STIMULUS_S * self.rate_hz) if self.stimuli else 0,
            kept_frames=round(KEPT_S * self.rate_hz),
            ceilings=self.ceilings,
            sent=self.sent,
            step=1 / (FADE_S * self.rate_hz),
        )


@dataclass(frozen=True)
class StreamHealth:
    """The frames made since a stream was opened, the callbacks that its device marked as after an under-run or an
    overflow (`xruns`), and the times at which it stood still or lost frames, by the clock (`gaps`).
    """

    frames: int
    xruns: int
    gaps: int
    fit: Fit


class AudioStream:
    """A session's sound, in and out."""

    def __init__(self, settings: StreamSettings, clock: Clock) -> None:
        """Open the device and wait until it runs; the session's clock must go by itself. Raises `AudioError`."""
        self._settings = settings
        self._clock = clock
        outputs = len(settings.ceilings)
        self._mixer = Mixer(settings.layout())
        self._timeline = Timeline(rate_hz=settings.rate_hz, block=settings.block)
        self.xruns = 0
        """Callbacks that the device marked, as in `health`, which takes longer."""
        self._broken: Exception | None = None
        self._called_ns = clock.now_ns()
        self._settling: tuple[Callable[[], object], ...] = (host.joining(), host.leaving())
        """What the callback's thread does first."""
        self._switch_s = sys.getswitchinterval()
        with host.elsewhere(), self._explained():
            sounddevice = library()
            self._abort = sounddevice.CallbackAbort
            number = find(host_api=settings.host_api, name=settings.device, inputs=settings.inputs, outputs=outputs)
            asked = {"samplerate": settings.rate_hz, "blocksize": settings.block, "dtype": "float32", "latency": "low"}
            if settings.inputs:
                self._stream = sounddevice.Stream(
                    device=(number, number), channels=(settings.inputs, outputs), callback=self._called, **asked
                )
            else:
                self._stream = sounddevice.OutputStream(
                    device=number, channels=outputs, callback=partial(self._called, NOTHING), **asked
                )
        try:
            with host.elsewhere(), self._explained():
                self._stream.start()
            sys.setswitchinterval(min(SWITCH_S, self._switch_s))
            self._called_ns = clock.now_ns()
            self.wait(2 * settings.block)
        except BaseException:
            # What went wrong first is what is told.
            with suppress(AudioError):
                self.close()
            raise

    @property
    def rate_hz(self) -> int:
        """Frames a second."""
        return self._settings.rate_hz

    @property
    def lead_frames(self) -> int:
        """How far ahead of `next_frame` a stimulus must be scheduled so that it is not too late."""
        return self._settings.block

    @property
    def next_frame(self) -> int:
        """The first frame that has not been handed to the device."""
        return self._mixer.frame

    @property
    def reported_latency_s(self) -> tuple[float, float]:
        """Latencies of input and output as the driver states them, s."""
        entry, out = self._stream.latency
        return float(entry), float(out)

    @property
    def gaps(self) -> int:
        """Times at which the device stood still or lost frames, as in `health`."""
        return self._timeline.gaps

    @property
    def health(self) -> StreamHealth:
        """What went on since it was opened."""
        return StreamHealth(self._mixer.frame, self.xruns, self._timeline.gaps, self._timeline.fit())

    def limited(self, channel: int) -> int:
        """Return how many samples of an output the limiter has changed since it was opened; channels count from 0."""
        return self._mixer.limited[channel]

    def ns_of(self, frame: float) -> int:
        """Return the session time at which the stream takes a frame, ns; the output's latency comes on top."""
        return self._timeline.ns_of(frame)

    def frame_at(self, t_ns: int) -> int:
        """Return the frame that the stream takes at a session time."""
        return self._timeline.frame_at(t_ns)

    def schedule(self, waveform: NDArray[np.floating[Any]], *, channel: int, frame: int) -> Cue:
        """Have a waveform play as `Mixer.schedule` says; `AudioError` if it cannot, or the stream has stopped."""
        self.check()
        return self._mixer.schedule(waveform, channel=channel, frame=frame)

    def move(self, cue: Cue, frame: int) -> bool:
        """Have a waiting stimulus start at another frame; see `Mixer.move`."""
        return self._mixer.move(cue, frame)

    def withdraw(self, cue: Cue) -> bool:
        """Take a stimulus back; return True if nothing of it has sounded or will."""
        return self._mixer.withdraw(cue)

    def allow(self, stimuli: Callable[[], bool]) -> None:
        """Have stimuli sound only in blocks before which this says so; the callback asks, so it waits for nothing."""
        self._mixer.allowed = stimuli

    @property
    def ends_ns(self) -> int:
        """The session time from which on nothing sounds, ns."""
        return self._mixer.whole.ends_ns

    def end(self, at_ns: int) -> None:
        """Silence everything, stimuli included, at a session time or before; the callback fades within `FADE_S`."""
        self._mixer.whole.ends_ns = min(self._mixer.whole.ends_ns, at_ns)

    def silence(self) -> None:
        """Have everything, stimuli included, silent from now on and for good; it returns at once."""
        self.end(self._clock.now_ns())

    def play_loop(self, samples: Block, channels: tuple[int, ...]) -> Loop:
        """Play samples without end on some channels, in silence until the loop's `wanted` gain is raised."""
        loop = Loop(1 / (FADE_S * self.rate_hz), samples=np.ascontiguousarray(samples, np.float32), channels=channels)
        self._mixer.loop = loop
        return loop

    def recorded_inputs(self, frame: int, frames: int) -> Block:
        """Return what the inputs heard, once they have: shape (frames, inputs); `AudioError` if that cannot be had."""
        self.wait(frame + frames)
        return self._mixer.recorded_inputs(frame, frames)

    def sent(self, frame: int, frames: int) -> Block:
        """Return what left on the output that is kept, once it has, shape (frames,); errors as `recorded_inputs`."""
        self.wait(frame + frames)
        return self._mixer.sent(frame, frames)

    def check(self) -> None:
        """Raise `AudioError` if the stream has stopped, or its device has asked for no sample within `SILENT_S`."""
        if self._broken is not None:
            raise AudioError("audio", f"the stream broke ({self._broken})", "start again") from self._broken
        if not self._stream.active:
            raise AudioError(
                f"audio device '{self._settings.device}'",
                "it stopped",
                "check that it is plugged in and its server is running, then start again",
            )
        if self._clock.now_ns() - self._called_ns > SILENT_S * 1e9:
            raise AudioError(
                f"audio device '{self._settings.device}'",
                f"has not requested samples for {SILENT_S:g} s",
                "check that the device is plugged in and its server is running, then start again",
            )

    def wait(self, frame: int) -> None:
        """Wait until every frame before `frame` has been made; `AudioError` if the stream has stopped."""
        while self._mixer.frame < frame:
            self._clock.sleep_ns(int(0.5e9 * self._settings.block / self.rate_hz))
            self.check()

    def close(self) -> None:
        """Fade what loops, stop and close the device."""
        sys.setswitchinterval(self._switch_s)
        loop = self._mixer.loop
        try:
            if loop is not None and loop.gain > 0 and self._stream.active:
                loop.wanted = 0.0
                self.wait(self._mixer.frame + round(FADE_S * self.rate_hz) + 2 * self._settings.block)
        finally:
            with self._explained():
                close_stream(self._stream)

    def _called(self, inputs: Block, outputs: Block, frames: int, _time: object, status: Any) -> None:
        try:
            for settle in self._settling:
                settle()
            self._settling = ()
            now_ns, mixer = self._clock.now_ns(), self._mixer
            self._timeline.note(mixer.frame, now_ns)
            mixer.stood_still = mixer.frame > 0 and now_ns - self._called_ns > STILL_NS
            self._called_ns = now_ns
            for gain in (mixer.whole, mixer.loop):
                if gain is not None:
                    gain.ends = mixer.frame + round(self._frames_until(gain.ends_ns, now_ns))
            if status:
                self.xruns += 1
            mixer.fill(outputs, inputs[:frames])
        except Exception as error:
            outputs.fill(0)
            self._broken = error
            raise self._abort from error

    def _frames_until(self, t_ns: int, now_ns: int) -> float:
        """Return how many frames after this block's first one has to leave to leave at a session time."""
        return (t_ns - now_ns - self._settings.output_ms * 1e6) * self.rate_hz / 1e9

    def _explained(self) -> AbstractContextManager[None]:
        return explained(self._settings.device, rate_hz=self._settings.rate_hz)
