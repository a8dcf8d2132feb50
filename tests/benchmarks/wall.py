"""Which engine starts a stimulus at its moment: run `python -m tests.benchmarks.audio [STARTS] --wall`.

A start is asked for at a moment of the machine's monotonic clock, `LEAD_S` before it comes, as a prediction asks for
one, and an ear outside of the engine hears when it came on that clock. Whoever asks in frames and listens in frames
sees nothing of a server that stands still.

The ear notes when each of the server's periods reached it. The server takes its periods at the pace of its rate; one
that it is far too late for moves all that follow, and no later one is ever sooner again. So a period began at the
earliest time that it and every later one allow: the largest line that never falls and lies below all that was seen. In
these lines a stall shows within 0.1 ms. The server's own estimate, which PortAudio passes on to its engines, is no such
ruler: it is a filter of about a second, and was some 20 ms off where the server stood still again and again.

The error of a start is the moment heard less the moment asked for, less the median of that run, which is the engine's
own latency; a rig is calibrated by it. Printed are the share of all starts asked for that are within `NEAR_MS`, the
standard deviation and the worst error of those heard, and how many were missed: never heard, because the engine was
asked or came too late. A start carries its number in its samples, so that none is taken for another. Periods that did
not reach the ear, as happens where the server does not wait for its clients, are told with the run.

Each engine translates the moment to its own clock as it is asked, by two readings close to each other:

- palpate: its stream, aimed at the moment anew every `AIM_S` until it can no longer be moved, as a session does with
  every read of its tracker;
- palpate once: its stream, aimed as the others are, once;
- rtmixer: by the time of its stream;
- psychtoolbox: by its own clock; where `PALPATE_PTB_PYTHON` names an interpreter that has it.

Conditions: the server waits for its clients, or goes on without them, as a device does; engine and server at ordinary
priority, or as in a session, with the asking thread as `host.raised` leaves it and the server in real time; the machine
as it is, and with every core loaded. All of it is gone through `TURNS` times, engine by engine within each condition,
and medians of the turns are printed: one stall of a server makes one engine look bad in one run. The ear runs in real
time wherever the system allows it. Not a test: it asserts nothing, because these figures belong to the machine that
printed them.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, nullcontext, suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus import host
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.rehearsal.wires.neighbour import Neighbour, far_end
from palpate.experiment.rehearsal.wires.sound_card import DEVICE, SoundCard
from tests.benchmarks.scheduling import loaded
from tests.rig.sound import BLOCK, HOST_API, RATE_HZ

STARTS, TURNS = 150, 3
LEAD_S = 0.04
"""How long before its moment a start is asked for, s."""

SPACING_S, JITTER_S = 0.07, 0.01
"""From one start to the next, s, and what is drawn on top, more than a period of the server."""

FIRST_S = 0.3
"""From the word to begin to the first start, s."""

AIM_S = 0.002
NEAR_MS = 1.0
SAMPLES = 64
NUMBERS = 64
"""The amplitude of start n is (1 + n mod `NUMBERS`) of as many parts."""

READINGS, CLOSE_NS = 20, 20_000
"""Two clocks are read together at most so many times, until the readings are so close, ns."""

PATIENCE_S = 20.0

Ask = Callable[[NDArray[np.int64]], dict[str, int]]
"""Takes the moments, asks for every start, waits for the last, and returns what the engine says of them."""


def amplitude(number: int) -> float:
    return (1 + number % NUMBERS) / NUMBERS


def ahead_ns(own_s: Callable[[], float]) -> int:
    """Return how far a clock in s is ahead of the monotonic one, by the closest of several readings, ns."""
    closest_ns, found = 2**63, 0
    for _ in range(READINGS):
        before_ns, own_ns, after_ns = time.monotonic_ns(), own_s() * 1e9, time.monotonic_ns()
        if after_ns - before_ns < closest_ns:
            closest_ns, found = after_ns - before_ns, round(own_ns - (before_ns + after_ns) / 2)
        if closest_ns < CLOSE_NS:
            break
    return found


def sleep_until(moment_ns: int) -> None:
    time.sleep(max(moment_ns - time.monotonic_ns(), 0) / 1e9)


class Bare(MonotonicClock):
    """Counts from where the monotonic clock does."""

    def now_ns(self) -> int:
        return time.monotonic_ns()


def palpate(opened: ExitStack, *, anew: bool) -> Ask:
    """Start through the session's stream; see the module."""
    from palpate.experiment.apparatus.audio.mixer import SOMETIME
    from palpate.experiment.apparatus.audio.stream import AudioStream, StreamSettings

    stream = AudioStream(StreamSettings(HOST_API, DEVICE, RATE_HZ, BLOCK, 1, (1.0,)), Bare())
    opened.callback(stream.close)

    def ask(moments_ns: NDArray[np.int64]) -> dict[str, int]:
        unmoved, cues = 0, []
        for number, moment_ns in enumerate(moments_ns.tolist()):
            sleep_until(moment_ns - round(LEAD_S * 1e9))
            wave = np.full(SAMPLES, amplitude(number), np.float32)
            cue = stream.schedule(wave, channel=0, frame=SOMETIME)
            cues.append(cue)
            aimed = False
            while (frame := stream.frame_at(moment_ns)) >= stream.next_frame + stream.lead_frames:
                aimed = stream.move(cue, frame) or aimed
                if not anew:
                    break
                time.sleep(AIM_S)
            if not aimed:
                unmoved += 1
                stream.withdraw(cue)
        sleep_until(int(moments_ns[-1]) + round(FIRST_S * 1e9))
        return {"asked too late": unmoved, "late": sum(cue.late for cue in cues), "gaps": stream.gaps}

    return ask


def rtmixer(opened: ExitStack) -> Ask:
    """Start through rtmixer; see the module."""
    import rtmixer as engine
    import sounddevice as sd

    with host.elsewhere():
        numbers = enumerate(sd.query_devices())
        device = next(i for i, each in numbers if sd.query_hostapis(each["hostapi"])["name"] == HOST_API)
        mixer = engine.Mixer(channels=1, device=device, samplerate=RATE_HZ, blocksize=BLOCK, latency="low")
        opened.callback(mixer.close)
        mixer.start()

    def ask(moments_ns: NDArray[np.int64]) -> dict[str, int]:
        actions = []
        for number, moment_ns in enumerate(moments_ns.tolist()):
            sleep_until(moment_ns - round(LEAD_S * 1e9))
            wave = np.full((SAMPLES, 1), amplitude(number), np.float32)
            at_s = (moment_ns + ahead_ns(lambda: float(mixer.time))) / 1e9
            actions.append(mixer.play_buffer(wave, channels=1, start=at_s, allow_belated=False))
        sleep_until(int(moments_ns[-1]) + round(FIRST_S * 1e9))
        return {"late": sum(action.done_frames == 0 for action in actions)}

    return ask


PSYCHTOOLBOX = f"""
import ctypes, json, os, sys, time
import numpy as np
# Its wheels carry a libjack of their own, which servers of other versions do not understand: the system's comes first.
ctypes.CDLL("libjack.so.0", ctypes.RTLD_GLOBAL)
from psychtoolbox import PsychPortAudio as ppa, GetSecs

def ahead_s():
    closest, found = 1e9, 0.0
    for _ in range({READINGS}):
        before, own, after = time.monotonic(), GetSecs(), time.monotonic()
        if after - before < closest:
            closest, found = after - before, own - (before + after) / 2
        if closest < {CLOSE_NS} / 1e9:
            break
    return found

in_session = sys.argv[1] == "session"
if in_session:
    os.sched_setscheduler(0, os.SCHED_RR, os.sched_param({host.REAL_TIME}))
ppa("Verbosity", 0)
device = next(int(d["DeviceIndex"]) for d in ppa("GetDevices") if d["HostAudioAPIName"] == "{HOST_API}")
handle = ppa("Open", device, 1, 3, {RATE_HZ}, 1, {BLOCK})
ppa("RunMode", handle, 1)
ppa("FillBuffer", handle, np.zeros(({SAMPLES}, 1)))
ppa("Start", handle, 1, 0, 1)
ppa("Stop", handle, 3)
if in_session:
    # As a session does: the thread that asks has a core for itself, and the engine's threads the others.
    os.sched_setaffinity(0, {{max(os.sched_getaffinity(0))}})
print("ready", flush=True)
moments = json.loads(sys.stdin.readline())
for number, moment_ns in enumerate(moments):
    time.sleep(max(moment_ns - {LEAD_S * 1e9} - time.monotonic_ns(), 0) / 1e9)
    ppa("FillBuffer", handle, np.full(({SAMPLES}, 1), (1 + number % {NUMBERS}) / {NUMBERS}))
    ppa("Start", handle, 1, moment_ns / 1e9 + ahead_s(), 0)
    ppa("Stop", handle, 3)
time.sleep({FIRST_S})
print(json.dumps({{}}), flush=True)
"""

ENGINES: dict[str, Callable[[ExitStack], Ask]] = {
    "palpate": lambda opened: palpate(opened, anew=True),
    "palpate once": lambda opened: palpate(opened, anew=False),
    "rtmixer": rtmixer,
}
PTB = "psychtoolbox"


def play(engine: str, *, in_session: bool) -> None:
    """Be the engine's process: take the moments from standard input, and print what the engine says."""
    with ExitStack() as opened:
        opened.enter_context(host.raised() if in_session else nullcontext())
        ask = ENGINES[engine](opened)
        print("ready", flush=True)
        said = ask(np.array(json.loads(sys.stdin.readline()), np.int64))
        print(json.dumps(said), flush=True)


def listen(server: str, output: str) -> None:
    """Be the ear: hear what a port carries, and tell of each period and each start when asked.

    Of a period it tells the server's number of its first frame and when it came, ns; of a start its period, the frame
    within it and the amplitude.
    """
    import jack

    with ExitStack() as opened:
        requests, told = opened.enter_context(far_end())
        client = jack.Client("ear", servername=server, no_start_server=True)
        entry = client.inports.register("in")
        periods: list[tuple[int, int]] = []
        starts: list[tuple[int, int, float]] = []
        last = 0.0

        def hear(_frames: int) -> None:
            nonlocal last
            now_ns = time.monotonic_ns()
            if not periods:
                with suppress(OSError):
                    os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(host.REAL_TIME + 2))
            block = entry.get_array()
            before = np.concatenate([[last], block[:-1]])
            begins = np.flatnonzero((block != 0) & (before == 0))
            starts.extend((len(periods), at, float(block[at])) for at in begins.tolist())
            periods.append((client.last_frame_time, now_ns))
            last = float(block[-1])

        client.set_process_callback(hear)
        opened.enter_context(client)
        client.connect(output, entry)
        told.write(b"listening\n")
        told.flush()
        requests.readline()
        told.write(json.dumps({"starts": starts, "periods": periods}).encode() + b"\n")
        told.flush()


def begun_ns(frames: NDArray[np.int64], came_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return when each period truly began, from the numbers of their first frames and when they came; see the module.

    All arrays have shape (n,).
    """
    since_ns = np.rint((frames - frames[0]) * (1e9 / RATE_HZ)).astype(np.int64)
    behind_ns = came_ns - since_ns
    found_ns: NDArray[np.int64] = since_ns + np.minimum.accumulate(behind_ns[::-1])[::-1]
    return found_ns


@dataclass(frozen=True)
class Run:
    """What was heard of one engine in one run.

    Attributes:
        near: share of the starts asked for within `NEAR_MS`.
        sd_ms: standard deviation of the errors of those heard.
        worst_ms: largest error, without its sign.
        missed: starts never heard.
        latency_ms: median of what was heard less what was asked for.
        said: what the engine says of it, and periods lost.
    """

    near: float
    sd_ms: float
    worst_ms: float
    missed: int
    latency_ms: float
    said: str


def judged(moments_ns: NDArray[np.int64], heard: dict[str, Any], said: dict[str, int]) -> Run:
    """Set what was heard beside what was asked for; a number that comes again belongs to the nearest of its starts."""
    frames, came_ns = np.array(heard["periods"], np.int64).T
    periods_ns = begun_ns(frames, came_ns)
    errors_ms: dict[int, float] = {}
    for period, frame, found in heard["starts"]:
        start_ns = int(periods_ns[period]) + round(frame * 1e9 / RATE_HZ)
        same = np.arange(round(found * NUMBERS) - 1, moments_ns.size, NUMBERS)
        if same.size:
            at = int(same[np.argmin(np.abs(moments_ns[same] - start_ns))])
            errors_ms.setdefault(at, (start_ns - moments_ns[at]) / 1e6)
    heard_ms = np.array(list(errors_ms.values()))
    said = {**said, "periods lost": int(np.sum(np.diff(frames) // BLOCK - 1))}
    telling = ", ".join(f"{name} {count}" for name, count in said.items() if count)
    if not heard_ms.size:
        return Run(0.0, np.nan, np.nan, moments_ns.size, np.nan, telling)
    latency_ms = float(np.median(heard_ms))
    off_ms = np.abs(heard_ms - latency_ms)
    near = float(np.count_nonzero(off_ms <= NEAR_MS)) / moments_ns.size
    missed = moments_ns.size - heard_ms.size
    return Run(near, float(heard_ms.std()), float(off_ms.max()), missed, latency_ms, telling)


def said_by(child: subprocess.Popen[str], begins: str) -> str:
    """Return the next line of a process that begins so; an engine may print words of its own.

    RuntimeError if the process ends, or keeps silent.
    """
    assert child.stdout is not None
    patience = threading.Timer(PATIENCE_S, child.kill)
    patience.start()
    try:
        for line in child.stdout:
            if line.startswith(begins):
                return line
    finally:
        patience.cancel()
    raise RuntimeError("the engine's process has ended or kept silent")


def measure(engine: str, starts: int, seed: int, *, waits: bool, in_session: bool, cores: int) -> Run:
    """Run an engine once."""
    import jack

    rng = np.random.default_rng(seed)
    offsets_s = np.arange(starts) * SPACING_S + rng.uniform(0, JITTER_S, starts)
    how = "session" if in_session else "ordinary"
    if engine == PTB:
        command = [os.environ["PALPATE_PTB_PYTHON"], "-c", PSYCHTOOLBOX, how]
    else:
        command = [sys.executable, "-m", "tests.benchmarks.wall", "play", engine, how]
    with ExitStack() as opened:
        with host.raised() if in_session else nullcontext():
            card = SoundCard(rate_hz=RATE_HZ, block=BLOCK, inputs=1, outputs=1, exact=waits)
        opened.callback(card.close)
        child = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, bufsize=1
        )
        opened.enter_context(child)
        opened.callback(child.kill)
        assert child.stdin is not None
        said_by(child, "ready")
        with jack.Client("wiring too", servername=card.name, no_start_server=True) as client:
            [source] = client.get_all_connections("system:playback_1")
        ear = Neighbour("tests.benchmarks.wall", "listen", card.name, source.name)
        opened.callback(ear.close)
        if not ear.line.readline():
            raise RuntimeError("the ear has ended")
        opened.enter_context(loaded(cores))
        time.sleep(0.5 if cores else 0.0)
        moments_ns = time.monotonic_ns() + np.rint((FIRST_S + offsets_s) * 1e9).astype(np.int64)
        child.stdin.write(json.dumps(moments_ns.tolist()) + "\n")
        time.sleep(FIRST_S + offsets_s[-1])
        said: dict[str, int] = json.loads(said_by(child, "{"))
        ear.line.write(b"tell\n")
        ear.line.flush()
        heard: dict[str, Any] = json.loads(ear.line.readline())
    return judged(moments_ns, heard, said)


def report(starts: int = STARTS) -> None:
    """Go through every condition in turns, and print the medians."""
    engines = [*ENGINES, *([PTB] if "PALPATE_PTB_PYTHON" in os.environ else [])]
    cores = os.cpu_count() or 1
    with host.raised() as got:
        session = got.partition(":")[0]
    print(
        f"{starts} starts a run, {TURNS} turns, asked for {LEAD_S * 1e3:.0f} ms ahead, 48 kHz, periods of {BLOCK}, "
        f"{cores} cores, load average {os.getloadavg()[0]:.1f} before; a session's priority: {session}"
    )
    if PTB not in engines:
        print("psychtoolbox is left out: PALPATE_PTB_PYTHON names no interpreter that has it")
    conditions = [
        (waits, in_session, hogs) for waits in (True, False) for in_session in (False, True) for hogs in (0, cores)
    ]
    runs: dict[tuple[tuple[bool, bool, int], str], list[Run]] = {}
    for turn in range(TURNS):
        for condition in conditions:
            waits, in_session, hogs = condition
            for place in range(len(engines)):
                engine = engines[(place + turn) % len(engines)]
                try:
                    run = measure(engine, starts, turn, waits=waits, in_session=in_session, cores=hogs)
                except (OSError, RuntimeError, ValueError) as error:
                    print(f"turn {turn + 1}, {named(*condition)}, {engine}: {error}", file=sys.stderr)
                    continue
                runs.setdefault((condition, engine), []).append(run)
                print(f"turn {turn + 1}, {named(*condition)}: {row(engine, [run])}  {run.said}", file=sys.stderr)
    for condition in conditions:
        print(named(*condition))
        for engine in engines:
            found = runs.get((condition, engine), [])
            print(f"  {row(engine, found)}" if found else f"  {engine}: no run came to its end", flush=True)


def named(waits: bool, in_session: bool, hogs: int) -> str:
    """Return a condition in words."""
    server = "server waits" if waits else "server does not wait"
    return f"{server}, {'session' if in_session else 'ordinary'} priority, {'cores loaded' if hogs else 'idle'}"


def row(engine: str, runs: list[Run]) -> str:
    """Return the medians of some runs."""
    near, sd_ms, worst_ms, missed, latency_ms = (
        float(np.median([getattr(run, name) for run in runs]))
        for name in ("near", "sd_ms", "worst_ms", "missed", "latency_ms")
    )
    return (
        f"{engine:13s} {100 * near:5.1f} % within {NEAR_MS:g} ms   SD {sd_ms:7.3f} ms   worst {worst_ms:7.2f} ms   "
        f"missed {missed:4.0f}   own latency {latency_ms:6.2f} ms   ({len(runs)} turns)"
    )


if __name__ == "__main__":
    if sys.argv[1] == "play":
        play(sys.argv[2], in_session=sys.argv[3] == "session")
    else:
        listen(sys.argv[2], sys.argv[3])
