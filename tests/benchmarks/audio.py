"""Which engine starts a stimulus at its sample: run `python -m tests.benchmarks.audio [STARTS] [--wall]`.

With --wall starts are asked for and heard by the clock on the wall instead of in frames, so that what stands still
shows: `wall.py` says how.

A JACK server of our own with its dummy driver; each engine in a process of its own is asked for starts at known times,
and a tap outside of it hears what its output carries. A start counts as missed where the tap did not hear it, and its
error is what it was heard at minus what was asked for, less the median of all (the engine's own latency). The engines:
palpate's stream (sounddevice, a NumPy callback), rtmixer (a callback in C, times in seconds), and PsychoPy's engine
where `PALPATE_PTB_PYTHON` names an interpreter that has psychtoolbox. Each alone; with both cores loaded; and with a
thread of its own that never rests. Not a test: it asserts nothing, because these figures belong to the machine that
printed them.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time

import jack
import numpy as np
from numpy.typing import NDArray

from palpate.experiment.rehearsal.wires.listener import Tap
from palpate.experiment.rehearsal.wires.sound_card import DEVICE, SoundCard
from tests.benchmarks import wall
from tests.rig.sound import HOST_API

RATE_HZ = 48_000
BLOCK = 256
SPACING = 960
"""Frames from one start to the next, to which up to `JITTER` are added: 20 ms."""
JITTER = 200
SAMPLES = 64

LOOP = "while True: pass"


def offsets(starts: int) -> np.ndarray:
    """Frames from the first start to each."""
    rng = np.random.default_rng(1)
    return np.arange(starts) * SPACING + rng.integers(0, JITTER, starts)


def palpate(starts: int) -> None:
    """Starts through the session's stream; prints the frame of each, or that it came too late."""
    from palpate.experiment.apparatus.audio.stream import AudioStream, StreamSettings
    from palpate.experiment.clock import MonotonicClock

    stream = AudioStream(StreamSettings(HOST_API, DEVICE, RATE_HZ, BLOCK, 1, (1.0,)), MonotonicClock())
    print("ready", flush=True)
    sys.stdin.readline()
    frames = stream.next_frame + RATE_HZ // 5 + offsets(starts)
    wave, cues = np.full(SAMPLES, 0.5, np.float32), []
    for frame in frames.tolist():
        stream.wait(frame - 3 * SPACING)
        cues.append(stream.schedule(wave, channel=0, frame=frame))
    stream.wait(int(frames[-1]) + RATE_HZ // 5)
    health = stream.health
    stream.close()
    said = {"late": sum(cue.late for cue in cues), "xruns": health.xruns, "gaps": health.gaps}
    print(json.dumps({"asked": frames.tolist(), "said": said, "cpu_s": time.process_time()}))


def rtmixer(starts: int) -> None:
    """Starts through rtmixer, by its stream's time."""
    import rtmixer as engine
    import sounddevice as sd

    device = next(i for i, d in enumerate(sd.query_devices()) if sd.query_hostapis(d["hostapi"])["name"] == HOST_API)
    mixer = engine.Mixer(channels=1, device=device, samplerate=RATE_HZ, blocksize=BLOCK, latency="low")
    mixer.start()
    print("ready", flush=True)
    sys.stdin.readline()
    begin_s = mixer.time + 0.3
    times = begin_s + offsets(starts) / RATE_HZ
    wave, actions = np.full((SAMPLES, 1), 0.5, np.float32), []
    for at in times.tolist():
        while mixer.time < at - 3 * SPACING / RATE_HZ:
            time.sleep(0.001)
        actions.append(mixer.play_buffer(wave, channels=1, start=at, allow_belated=False))
    time.sleep(0.3)
    late = sum(action.done_frames == 0 for action in actions)
    mixer.close()
    asked = ((times - begin_s) * RATE_HZ).tolist()
    print(json.dumps({"asked": asked, "said": {"late": late}, "cpu_s": time.process_time()}))


PTB = f"""
import ctypes, json, sys, time
import numpy as np
# Its wheels carry a libjack of their own, which servers of other versions do not understand: the system's comes first.
ctypes.CDLL("libjack.so.0", ctypes.RTLD_GLOBAL)
from psychtoolbox import PsychPortAudio as ppa, GetSecs
ppa("Verbosity", 0)
device = next(int(d["DeviceIndex"]) for d in ppa("GetDevices") if d["HostAudioAPIName"] == "{HOST_API}")
handle = ppa("Open", device, 1, 3, {RATE_HZ}, 1, {BLOCK})
ppa("RunMode", handle, 1)
ppa("FillBuffer", handle, np.zeros(({SAMPLES}, 1)))
ppa("Start", handle, 1, 0, 1)
ppa("Stop", handle, 3)
ppa("FillBuffer", handle, np.full(({SAMPLES}, 1), 0.5))
print("ready", flush=True)
sys.stdin.readline()
offsets = json.loads(sys.argv[1])
begin = GetSecs() + 0.3
for frame in offsets:
    ppa("Start", handle, 1, begin + frame / {RATE_HZ}, 0)
    ppa("Stop", handle, 3)
time.sleep(0.3)
print(json.dumps({{"asked": offsets, "said": {{}}, "cpu_s": time.process_time()}}))
"""


def tapped(seconds: float) -> Tap:
    """Hear whatever plays on the card's first output."""
    server = os.environ["JACK_DEFAULT_SERVER"]
    with jack.Client("wiring", servername=server, no_start_server=True) as client:
        [source] = client.get_all_connections("system:playback_1")
        return Tap(server, source.name, seconds=seconds)


def measure(engine: str, starts: int, *, loaded: bool, busy: bool, exact: bool) -> str:
    """One line of the table."""
    card = SoundCard(rate_hz=RATE_HZ, block=BLOCK, inputs=1, outputs=1, exact=exact)
    load = [subprocess.Popen([sys.executable, "-c", LOOP]) for _ in range(os.cpu_count() or 1)] if loaded else []
    try:
        if engine == "PTB":
            command = [os.environ["PALPATE_PTB_PYTHON"], "-c", PTB, json.dumps(offsets(starts).tolist())]
        else:
            command = [sys.executable, "-m", "tests.benchmarks.audio", engine, str(starts), str(int(busy))]
        child = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        assert child.stdout is not None
        # An engine may print words of its own first.
        while child.stdout.readline() not in ("ready\n", ""):
            pass
        tap = tapped(seconds=SPACING * starts / RATE_HZ + 20)
        begun = time.perf_counter()
        said, _ = child.communicate("go\n")
        took_s = time.perf_counter() - begun
        result = json.loads(said.splitlines()[-1])
        time.sleep(0.2)
        heard = tap.since(0)[1] != 0
        tap.close()
    finally:
        for each in load:
            each.kill()
            each.wait()
        card.close()
    begins = np.flatnonzero(heard & ~np.concatenate([[False], heard[:-1]]))
    asked: NDArray[np.float64] = np.array(result["asked"])
    # Each start asked for is the one heard nearest to it, once the engine's latency is taken off.
    latency = float(np.median(begins[:20] - asked[: min(len(begins), 20)])) if len(begins) else 0.0
    near = begins[np.argmin(np.abs(begins[None, :] - latency - asked[:, None]), axis=1)] if len(begins) else asked
    errors = near - latency - asked
    found = np.abs(errors) < SPACING / 2
    kept = errors[found]
    missed, spread = starts - int(found.sum()), np.ptp(kept) if kept.size else 0
    cpu = 100 * result["cpu_s"] / took_s
    return (
        f"{missed:6d} missed  {np.std(kept):9.4f} SD  {spread:8.1f} range, frames   {cpu:5.1f} % of a core   "
        f"{result['said']}"
    )


def main() -> None:
    if "--wall" in sys.argv:
        numbers = [int(word) for word in sys.argv[1:] if word != "--wall"]
        wall.report(*numbers)
        return
    if len(sys.argv) == 4:
        if int(sys.argv[3]):
            threading.Thread(target=exec, args=(LOOP,), daemon=True).start()
        {"palpate": palpate, "rtmixer": rtmixer}[sys.argv[1]](int(sys.argv[2]))
        return
    starts = int(sys.argv[1]) if len(sys.argv) > 1 else 500
    engines = ["palpate", "rtmixer"] + (["PTB"] if "PALPATE_PTB_PYTHON" in os.environ else [])
    print(f"{starts} starts, 48 kHz, blocks of {BLOCK}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} before")
    for exact in (True, False):
        for name, loaded, busy in (
            ("alone", False, False),
            ("cores loaded", True, False),
            ("busy thread", False, True),
        ):
            for engine in engines:
                if engine == "PTB" and busy:
                    continue
                line = measure(engine, starts, loaded=loaded, busy=busy, exact=exact)
                server = "waits" if exact else "does not wait"
                print(f"server {server:13s}  {name:13s}  {engine:8s} {line}", flush=True)


if __name__ == "__main__":
    main()
