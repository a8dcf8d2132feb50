"""The process that drives the force device: `link` starts it, and hears what the hand did.

Each cycle it reads the tracker's line, steps the block, and hands the device a force. It never waits for the session:
up to `MOST_KEPT_BYTES` are kept for it. It ends, with the force at zero, when the session is gone. On Linux it sees a
kill at the next cycle, as the signal pending in /proc; elsewhere some milliseconds later, when their line ends.

The force is zero from a fault until the hand touches anew from outside: a cycle that began `SILENT_NS` or more late, no
frame of the tracker for that long and a period, or a sample that `rendering` does not believe. A touch in the samples
that come first after a fault counts, without force. The vibration is zero as the force is: the audio stream asks before
each block whether the servo has rendered within `SILENT_NS` (`pulse`). After a late device, a tracker that has gone or
was silent for the rig's `stall_ms`, the process reports it and ends.

At the session's end and `HEARTBEAT_NS` after its last heartbeat, the force falls to zero over `FALLS_NS`, and the
vibration ends at once. The session has to ask anew.
"""

from __future__ import annotations

import ctypes
import json
import os
import select
import signal
import socket
import struct
import sys
import threading
import time
from collections import Counter, deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from mmap import mmap
from typing import Any

import numpy as np

from palpate.experiment.apparatus import host
from palpate.experiment.apparatus.servo import rendering
from palpate.experiment.apparatus.servo.device import ForceDevice
from palpate.experiment.apparatus.servo.record import ForceRecord
from palpate.experiment.apparatus.servo.rendering import NO_FORCE, Rendered, share
from palpate.experiment.apparatus.tracker.frames import Decoder, Frames
from palpate.experiment.apparatus.tracker.serial_port import VANISHED, SerialPort, reason
from palpate.experiment.errors import PalpateError, ServoError
from palpate.experiment.synthesis.contact.block import Block, Pair
from palpate.experiment.synthesis.contact.observer import Observer

SILENT_NS = 2_000_000
"""After so long without what a force rests on there is none, ns."""

HEARTBEAT_NS = 500_000_000
"""So long after the session's last heartbeat its block is taken away, ns: five beats."""

MOST_KEPT_BYTES = 1 << 20
"""What the session is late to read, bytes: half a minute of frames."""

SAMPLES, TOUCH, COUNTS, ENDED, STOOD, RENDER, BEAT, FORCE = range(8)
"""Kinds of messages: the tracker's bytes, a touch, cycles, an end, a stall; to it, a block and a heartbeat; and again
from it, the force that it sent."""

HEAD = struct.Struct("<BIq")
TOUCHED = struct.Struct("<ddd")
TIME = struct.Struct("<q")

PR_SET_TIMERSLACK = 29
PF_EXITING = 0x4
SIGKILL_PENDING = 1 << 8


@dataclass(frozen=True)
class Orders:
    """What the process needs when it begins; keys as in the rig file and the protocol.

    `counts` and `mm` are the tracker's calibration, `along_counts` and `along_mm` along a planar one's face; its noise
    includes the rounding to counts. `told_kg` is the mass that the observer is told; without one there is no observer.
    `secret` is what the device is shown first, hexadecimal.
    """

    port: str
    baud: int
    tracker_hz: int
    stall_ms: float
    counts: tuple[float, ...]
    mm: tuple[float, ...]
    address: str
    answer_ms: float
    limit_n: float
    rate_hz: int
    fastest_mm_s: float
    along_counts: tuple[float, ...] = ()
    along_mm: tuple[float, ...] = ()
    noise_m: float = 0.0
    told_kg: float = 0.0
    secret: str = ""

    def observer(self) -> Observer | None:
        """Return what tells where the hand is; None where nothing is known of the device's mass."""
        if not self.told_kg:
            return None
        return Observer(1.0 / self.tracker_hz, self.noise_m, self.told_kg)

    def decoder(self) -> Decoder:
        """Return what reads the tracker's frames, from the first on."""
        return Decoder(period_us=1e6 / self.tracker_hz, readings=2 if self.along_mm else 1)

    def places(self, frames: Frames) -> list[tuple[int, Pair]]:
        """Return each frame's device time, and the hand's height and place along the face (0 unless planar), mm."""
        heights = np.interp(frames.counts, self.counts, self.mm)
        along = np.interp(frames.along, self.along_counts, self.along_mm) if self.along_mm else np.zeros(heights.size)
        return list(zip(frames.device_us.tolist(), zip(heights.tolist(), along.tolist(), strict=True), strict=True))


class Line:
    """One end of the stream between session and servo; it waits only on request. Any thread may speak, one hears."""

    def __init__(self, end: socket.socket) -> None:
        self._end = end
        end.setblocking(False)
        self._heard = bytearray()
        self._unsent = bytearray()
        self._waiting: deque[bytes] = deque()
        self._turn = threading.Lock()

    def tell(self, kind: int, content: bytes, now_ns: int) -> None:
        """Send a message now, or as soon as there is room. What nobody reads for too long is thrown away, whole."""
        if len(self._unsent) < MOST_KEPT_BYTES:
            self._waiting.append(HEAD.pack(kind, len(content), now_ns) + content)
        # Whoever has the turn sends what others leave waiting meanwhile, so that nobody waits for it.
        while self._waiting and self._turn.acquire(blocking=False):
            try:
                while self._waiting:
                    self._unsent += self._waiting.popleft()
                del self._unsent[: self._end.send(self._unsent)]
            except OSError:
                # There is no room, or nobody: then `hear` says so.
                return
            finally:
                self._turn.release()

    def hear(self, timeout_s: float = 0.0) -> list[tuple[int, bytes, int]]:
        """Return the messages that have come: kind, content, and when each was sent. Raises `EOFError` at the end."""
        if timeout_s and not select.select([self._end], [], [], timeout_s)[0]:
            return []
        ended = False
        try:
            # All of it: why nothing is pushed any more may come behind much that is old.
            while heard := self._end.recv(1 << 16):
                self._heard += heard
            ended = True
        except BlockingIOError:
            pass
        except ConnectionError:
            ended = True
        found = []
        while len(self._heard) >= HEAD.size:
            kind, length, sent_ns = HEAD.unpack_from(self._heard)
            if len(self._heard) < HEAD.size + length:
                break
            found.append((kind, bytes(self._heard[HEAD.size : HEAD.size + length]), sent_ns))
            del self._heard[: HEAD.size + length]
        if ended and not found:
            raise EOFError
        return found

    def end(self) -> None:
        """Say that no message follows; what the other end says can still be heard."""
        self._end.shutdown(socket.SHUT_WR)

    def close(self) -> None:
        """Close this end."""
        self._end.close()


def pulse(file: int) -> memoryview[int]:
    """Return shared memory, by a file of eight bytes that may then be closed: when the servo rendered last.

    It is by the machine's monotonic clock, ns; 0 where no block or hand is followed.
    """
    return memoryview(mmap(file, 8)).cast("q")


class Session:
    """Whether the process that started this one lives."""

    def __init__(self) -> None:
        """Look at the parent; without a /proc nothing is known of it."""
        pid = os.getppid()
        try:
            self._stat = os.open(f"/proc/{pid}/task/{pid}/stat", os.O_RDONLY)
        except OSError:
            self._stat = -1

    @property
    def dies(self) -> bool:
        """Whether it is known to be gone, going, or killed."""
        if self._stat < 0:
            return False
        try:
            fields = os.pread(self._stat, 1024, 0).rpartition(b")")[2].split()
        except OSError:
            return True
        return fields[0] in b"ZX" or bool(int(fields[6]) & PF_EXITING or int(fields[28]) & SIGKILL_PENDING)


class Servo:
    """The cycles of one process."""

    def __init__(self, orders: Orders, line: Line, pulse: memoryview[int]) -> None:
        """Open tracker and device. Raises `PalpateError` if one cannot be opened."""
        self._orders, self._line, self._pulse = orders, line, pulse
        self._session = Session()
        self._device = ForceDevice(orders.address, limit_n=orders.limit_n, secret=orders.secret)
        self._port = SerialPort(orders.port, orders.baud)
        self._port.discard()
        self._decoder = orders.decoder()
        self._block: Block | None = None
        self._until_ns = self._beat_ns = 0
        self._at = Rendered()
        self._observer = orders.observer()
        self._sent_n = NO_FORCE
        self._arrived_ns = 0
        self._faulted = False
        self._record = ForceRecord()
        self.counts: Counter[str] = Counter()

    def run(self) -> None:
        """Drive the device until the session is gone. Raises `PalpateError` if a part failed."""
        period_ns = 1_000_000_000 // self._orders.rate_hz
        due_ns = time.monotonic_ns() + period_ns
        while not self._session.dies:
            now_ns = time.monotonic_ns()
            if now_ns < due_ns:
                time.sleep((due_ns - now_ns) * 1e-9)
                continue
            late_ns = now_ns - due_ns
            self.counts["cycles"] += 1
            self.counts["missed"] += late_ns // period_ns
            if late_ns >= SILENT_NS:
                self._fall_silent("late")
            due_ns += period_ns * (1 + late_ns // period_ns)
            self.cycle(now_ns)

    def cycle(self, now_ns: int) -> None:
        """Read, step and push once. Raises `PalpateError` if a part failed, and `EOFError` if the session is gone."""
        for kind, content, sent_ns in self._line.hear():
            if kind == BEAT:
                self._beat_ns = sent_ns
            elif kind == RENDER:
                told, self._until_ns = json.loads(content)
                self._block = None if told is None else Block(**_tuples(told))
                self._at = self._at.silent()
        part = self._share(now_ns)
        block = self._block if part else None
        samples = self._read(now_ns, block)
        if time.monotonic_ns() - now_ns >= SILENT_NS:
            self._fall_silent("late")
        (out_n, along_n), fast = self._at.force_n, self._at.speed_mm_s > self._orders.fastest_mm_s
        self._sent_n = self._device.push((part * out_n, part * along_n), fast=fast, now_ns=now_ns)
        self._pulse[0] = now_ns if self._at.state is not None and part == 1 else 0
        if block is not None:
            met = self.counts["cycles"] + self.counts["missed"]
            at = self._at
            self._hand_over(self._record.add(met, now_ns, samples, at.place_mm, at.force_n, self._sent_n))
        waited_ns = self._device.late_ns(now_ns)
        if waited_ns > self._orders.answer_ms * 1e6:
            raise ServoError(
                f"force device at {self._orders.address}",
                f"no answer for {waited_ns / 1e6:.1f} ms",
                "restart the device and reconnect its cable, then continue",
                allowed=f"{self._orders.answer_ms:g} ms (servo.answer_ms in the rig file)",
            )

    def _share(self, now_ns: int) -> float:
        """Return which part of the force the session allows now; none before its first heartbeat."""
        if not self._beat_ns:
            return 0.0
        allowed_ns = self._beat_ns + HEARTBEAT_NS
        if self._block is not None and self._until_ns > allowed_ns and now_ns > allowed_ns:
            # For good: a force that came back in the middle of a block would strike.
            self._until_ns = allowed_ns
            self._line.tell(STOOD, TIME.pack(self._beat_ns), now_ns)
        return share(now_ns, self._until_ns)

    def _hand_over(self, record: bytes) -> None:
        if record:
            self._line.tell(FORCE, record, time.monotonic_ns())

    def _read(self, now_ns: int, block: Block | None) -> int:
        """Read the hand, and return how many samples came."""
        where = f"tracker at {self._orders.port}"
        try:
            data = self._port.take()
        except VANISHED as error:
            raise ServoError(
                where, f"the port has disappeared ({reason(error)})", "plug in the device again"
            ) from error
        samples = 0
        if data:
            self._decoder, frames = self._decoder.feed(data)
            # After the read: a stamp from before a stall would put samples before they were taken, for good.
            arrived_ns = time.monotonic_ns()
            self._line.tell(SAMPLES, data, arrived_ns)
            samples = int(frames.device_us.size)
            if samples:
                self._arrived_ns = arrived_ns
                for us, place_mm in self._orders.places(frames):
                    pushed = self._at.state is not None
                    told = self._observer, self._sent_n, self._orders.limit_n
                    self._at, touches = rendering.step(block, self._at, us, place_mm, *told)
                    self.counts["unbelievable"] += pushed and self._at.state is None
                    for touch in touches:
                        self._line.tell(TOUCH, TOUCHED.pack(*touch), now_ns)
                if self._faulted:
                    # A hand that went in meanwhile never worked against the spring, which would strike it.
                    self._faulted, self._at = False, self._at.silent()
        silent_ns = now_ns - self._arrived_ns
        if self._arrived_ns and silent_ns > self._orders.stall_ms * 1e6:
            late = f"no frame for {silent_ns / 1e6:.0f} ms"
            raise ServoError(where, late, "check that the device is powered, connected and sampling")
        if silent_ns > SILENT_NS + 1e9 / self._orders.tracker_hz:
            self._fall_silent("without the hand")
        return samples

    def _fall_silent(self, why: str) -> None:
        self.counts[why] += any(self._at.force_n)
        self._faulted, self._at = True, self._at.silent()

    def close(self) -> None:
        """Take force and vibration away, and tell how the cycles went."""
        self._pulse[0] = 0
        self._device.close()
        self._port.close()
        self.counts["dropped"] = self._device.dropped
        self._hand_over(self._record.take())
        self._line.tell(COUNTS, json.dumps(self.counts).encode(), time.monotonic_ns())


def _tuples(told: dict[str, Any]) -> dict[str, Any]:
    return {key: tuple(value) if isinstance(value, list) else value for key, value in told.items()}


def main() -> None:
    """Be the process: its arguments are the numbers of an open socket and of its pulse's file, and its orders."""
    # Ctrl-C at the terminal is the session's, which then ends this process, with the force at zero.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    line = Line(socket.socket(fileno=int(sys.argv[1])))
    with _prompt():
        try:
            servo = Servo(Orders(**_tuples(json.loads(sys.argv[3]))), line, pulse(int(sys.argv[2])))
            try:
                servo.run()
            finally:
                servo.close()
        except EOFError:
            return
        except PalpateError as error:
            ended = error.finding
            parts = ended.place(), ended.what, str(ended.remedy), ended.allowed
            line.tell(ENDED, json.dumps(parts).encode(), time.monotonic_ns())


@contextmanager
def _prompt() -> Iterator[None]:
    """Have the process wake when it asked to: raised, with no collections and no slack of the system's timers."""
    with host.raised(), host.undisturbed():
        host.joining()()
        if sys.platform == "linux":
            ctypes.CDLL(None).prctl(PR_SET_TIMERSLACK, 1)
        yield


if __name__ == "__main__":
    main()
