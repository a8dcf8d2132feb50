"""The session's end of the servo: what the hand did, read by read, and which block it meets.

`ServoProcess` is for real time; `ServoHere` renders simulated time in the session's own process.
"""

import json
import os
import socket
import subprocess
import tempfile
import threading
from collections import deque
from contextlib import suppress
from dataclasses import asdict
from typing import Protocol

import numpy as np

from palpate.experiment import storage
from palpate.experiment.apparatus import host
from palpate.experiment.apparatus.host import beside
from palpate.experiment.apparatus.ports import Tracker
from palpate.experiment.apparatus.servo import process, rendering
from palpate.experiment.apparatus.servo.device import ForceDevice
from palpate.experiment.apparatus.servo.process import Line, Orders
from palpate.experiment.apparatus.servo.record import ForceRecord, cycles_of
from palpate.experiment.apparatus.servo.rendering import Felt, Rendered, Touch
from palpate.experiment.apparatus.tracker import clock_map as clock_maps
from palpate.experiment.apparatus.tracker.clock_map import ClockMap, ClockState
from palpate.experiment.clock import Clock, monotonic_ns
from palpate.experiment.errors import ServoError, TrackerStopped
from palpate.experiment.synthesis.contact.block import Block, Pair

SLICE_S, PAUSE_NS = 0.05, 2_000_000
"""A read waits no longer for the hand, s, and so long before, ns: it costs far more than the samples in it."""

STARTS_S, ENDS_S = 10.0, 2.0
"""How long the process may take until it tells of the first frame, s, and to end: the machine may be busy."""

STANDS_NS = 1_000_000_000
"""So long after it would have told of a silent tracker, ns, a process that says nothing stands still. Ours."""

ANSWERS_MS = 150.0
"""A device that is late to answer within so long is not there, ms: one and a half times what a rig may allow. Ours."""

GOES_S = 5.0
"""In simulated time a hand is gone within so long, s, wall-clock time."""

BEHIND = 1000
"""In simulated time the device may be so many messages behind."""


class Servo(Protocol):
    """What renders a block to the hand; one thread reads, and others may have another block rendered."""

    def is_live(self) -> bool:
        """Return whether the hand is followed and the block rendered, now; this waits for nothing."""

    def render(self, block: Block | None, ends_ns: int = 0) -> None:
        """Have the hand meet a block, None for none, once outside of it, until a session time, ns; it needs the
        heartbeat.

        Any thread may call this, which never waits.
        """

    def beat(self) -> None:
        """Give a sign of life of the session: without one for 0.5 s the block is taken away, until it is asked for."""

    def read(self) -> Felt | None:
        """Return what the hand did since the read before; None if nothing came. Raises `ServoError` once it is gone."""

    def forces(self) -> bytes:
        """Return the force that was sent, as `record.CYCLE` has it in session time, since this was called last.

        Any thread may call it but, in simulated time, the one that reads: it waits until the hand has gone.
        """

    def reconnect(self) -> None:
        """Open it anew, with the same block. Raises `ServoError`."""

    def stop(self) -> None:
        """Have `read` wait for nothing any more, under whoever waits there; `close` still has to follow."""

    def close(self) -> None: ...


class ServoProcess:
    """Implements `Servo` in a process of its own."""

    def __init__(self, orders: Orders, clock: Clock) -> None:
        """Start it, and wait until the hand is there. Raises `ServoError` if a part cannot be opened."""
        self._orders, self._clock = orders, clock
        self._asked: tuple[Block | None, int] = (None, 0)
        self._forces: deque[bytes] = deque()
        self._begin()

    def _begin(self) -> None:
        ours, theirs = socket.socketpair()
        self._line = Line(ours)
        self._decoder = self._orders.decoder()
        self._state: ClockState | None = None
        self._speed = Rendered()
        self._waiting: Felt | None = None
        self._touches: list[Touch] = []
        self._heard_ns: int | None = None
        self.counts: dict[str, int] = {}
        with theirs, tempfile.TemporaryFile(dir=host.IN_MEMORY) as pulse, host.elsewhere(), beside.held_back():
            # Room that is there: a write to memory that is full would end the process.
            os.write(pulse.fileno(), bytes(8))
            self._pulse = process.pulse(pulse.fileno())
            fds = theirs.fileno(), pulse.fileno()
            told = storage.python_command("-m", process.__name__, *map(str, fds), json.dumps(asdict(self._orders)))
            self._process = subprocess.Popen(told, pass_fds=fds, stdin=subprocess.DEVNULL)  # noqa: S603
        for _ in range(round(STARTS_S / SLICE_S)):
            if (first := self.read()) is not None:
                break
        else:
            self.close()
            raise ServoError(
                "servo",
                f"the tracker at {self._orders.port} sent no frame for {STARTS_S:g} s",
                f"check that it is powered, connected and sampling, {self._decoder.kind}",
            )
        # A device that stands still takes connections, and answers nothing.
        answered_ns = monotonic_ns() + int(1e6 * ANSWERS_MS)
        while monotonic_ns() < answered_ns:
            first = self.read() or first
        self._waiting = first
        self._ask()

    def is_live(self) -> bool:
        """Return whether a cycle has rendered within `SILENT_NS`; the device lets go of the hand as soon."""
        return self._asked[0] is not None and monotonic_ns() - self._pulse[0] < process.SILENT_NS

    def render(self, block: Block | None, ends_ns: int = 0) -> None:
        self._asked = block, ends_ns
        self._ask()

    def _ask(self) -> None:
        """Order what was asked for last, also where another thread asks meanwhile."""
        asked = None
        while asked is not self._asked:
            block, ends_ns = asked = self._asked
            now_ns = monotonic_ns()
            order = json.dumps([block and asdict(block), ends_ns - self._clock.now_ns() + now_ns])
            self._line.tell(process.RENDER, order.encode(), now_ns)

    def beat(self) -> None:
        self._line.tell(process.BEAT, b"", monotonic_ns())

    def read(self) -> Felt | None:
        """Return what the hand did, or None after `SLICE_S`.

        Raises `ServoError` once the process is gone, with why, or stands still.
        """
        waiting, self._waiting = self._waiting, None
        if waiting is not None:
            return waiting
        self._clock.sleep_ns(PAUSE_NS)
        try:
            heard = self._line.hear(SLICE_S)
        except EOFError:
            raise ServoError(
                "servo", "its process has ended, so no force is applied now", "resume the session"
            ) from None
        now_ns = monotonic_ns()
        if heard:
            self._heard_ns = now_ns
        elif self._heard_ns is not None and now_ns - self._heard_ns > STANDS_NS + self._orders.stall_ms * 1e6:
            silent_s = (now_ns - self._heard_ns) / 1e9
            self._heard_ns = None
            stood = f"its process has sent nothing for {silent_s:.1f} s"
            raise ServoError("servo", stood, "find out what slowed down the computer")
        places: list[tuple[int, Pair]] = []
        for kind, content, sent_ns in heard:
            if kind == process.SAMPLES:
                self._decoder, frames = self._decoder.feed(content)
                if frames.device_us.size:
                    newest_us = int(frames.device_us[-1])
                    at_ns = self._clock.now_ns() - (monotonic_ns() - sent_ns)
                    last = self._state
                    self._state = clock_maps.step(last, newest_us, at_ns) if last else clock_maps.init(newest_us, at_ns)
                    places += self._orders.places(frames)
            elif kind == process.TOUCH:
                self._touches.append(Touch(*process.TOUCHED.unpack(content)))
            elif kind == process.FORCE:
                later_ns = self._clock.now_ns() - monotonic_ns()
                self._forces.append(cycles_of(content, later_ns=later_ns).tobytes())
            elif kind == process.COUNTS:
                self.counts = json.loads(content)
            elif kind == process.STOOD:
                stood_s = (monotonic_ns() - process.TIME.unpack(content)[0]) / 1e9
                lost = f"after {process.HEARTBEAT_NS / 1e9:g} s, the servo removed the block"
                stood = f"the session froze for {stood_s:.1f} s; {lost}"
                raise ServoError(stood, remedy="find out what slowed down the computer")
            elif kind == process.ENDED:
                where, what, remedy, allowed = json.loads(content)
                raise ServoError(where, what, remedy, allowed=allowed)
        if self._state is None or not places:
            return None
        for us, place_mm in places:
            self._speed, _ = rendering.step(None, self._speed, us, place_mm)
        # A touch may have been heard without a sample: it follows its own.
        touches, self._touches = self._touches, []
        return _felt(places, touches, self._state.map(), self._speed.speed_mm_s > self._orders.fastest_mm_s)

    def forces(self) -> bytes:
        return _emptied(self._forces)

    def reconnect(self) -> None:
        self.close()
        self._begin()

    def stop(self) -> None:
        """Do nothing: a read waits no longer than `SLICE_S`."""

    def close(self) -> None:
        """End the process, with the force at zero; `counts` then says how its cycles went."""
        if self._process.returncode is not None:
            return
        with suppress(ServoError, OSError):
            self._line.end()
            for _ in range(round(ENDS_S / SLICE_S)):
                self.read()
        self._line.close()
        try:
            self._process.wait(ENDS_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


class ServoHere:
    """Implements `Servo` in simulated time."""

    def __init__(self, orders: Orders, tracker: Tracker) -> None:
        """Render what the tracker reads. Raises `ServoError` if the device cannot be opened."""
        self._orders, self._tracker = orders, tracker
        self._device = ForceDevice(orders.address, limit_n=orders.limit_n, secret=orders.secret)
        self._asked: tuple[Block | None, int] = (None, 0)
        self._under: tuple[Block | None, int] = self._asked
        self._at = Rendered()
        self._observer = orders.observer()
        self._sent_n = rendering.NO_FORCE
        self._pushed = (rendering.NO_FORCE, False)
        self._record = ForceRecord()
        self._forces: deque[bytes] = deque()
        self._goes = threading.Condition()
        self._near = False

    def is_live(self) -> bool:
        """Return True: in simulated time nothing is late."""
        return True

    def render(self, block: Block | None, ends_ns: int = 0) -> None:
        self._asked = block, ends_ns

    def beat(self) -> None:
        """Do nothing: simulated time passes only where the session lets it."""

    def read(self) -> Felt | None:
        """Return what the hand did, as `ServoProcess.read`; a hand that rests sends nothing in simulated time."""
        try:
            samples = self._tracker.read()
        except TrackerStopped:
            self._hand_over(b"", near=False)
            return None
        clock = self._tracker.clock_map
        if clock is None:
            return None
        along = np.zeros(samples.height_mm.size) if samples.along_mm is None else samples.along_mm
        mm = zip(samples.height_mm.tolist(), along.tolist(), strict=True)
        places = list(zip(samples.device_us.tolist(), mm, strict=True))
        touches: list[Touch] = []
        record, near = b"", False
        for us, place_mm in places:
            if self._asked is not self._under:
                self._under, self._at = self._asked, self._at.silent()
            block, ends_ns = self._under
            part = rendering.share(clock.session_ns(us), ends_ns)
            meets = block if part else None
            told = self._observer, self._sent_n, self._orders.limit_n
            self._at, touched = rendering.step(meets, self._at, us, place_mm, *told)
            touches += touched
            # The device is handed what it does not push already.
            out_n, along_n = self._at.force_n
            wanted = (part * out_n, part * along_n), self._at.speed_mm_s > self._orders.fastest_mm_s
            if wanted != self._pushed:
                self._pushed = wanted
                self._sent_n = self._device.push(wanted[0], fast=wanted[1], now_ns=None)
                self._device.catch_up(BEHIND)
            if meets is not None:
                met, forces_n = round(us * self._orders.rate_hz / 1e6), (self._at.force_n, self._sent_n)
                record += self._record.add(met, clock.session_ns(us), 1, place_mm, *forces_n)
            near = meets is not None and self._record.near
        self._hand_over(record + self._record.take(), near=near)
        return _felt(places, touches, clock, self._at.speed_mm_s > self._orders.fastest_mm_s)

    def _hand_over(self, record: bytes, *, near: bool) -> None:
        with self._goes:
            self._forces.append(record)
            self._near = near
            self._goes.notify_all()

    def forces(self) -> bytes:
        with self._goes:
            # Otherwise it would depend on the machine how much of a tap is there.
            self._goes.wait_for(lambda: not self._near, GOES_S)
            return _emptied(self._forces)

    def reconnect(self) -> None:
        """Do nothing: no device falls silent in simulated time."""

    def stop(self) -> None:
        """Close the tracker: a hand that rests would keep a read waiting for as long as simulated time allows."""
        self._tracker.close()

    def close(self) -> None:
        """Take the force away."""
        self._device.close()
        self.stop()


def _emptied(waiting: deque[bytes]) -> bytes:
    return b"".join(waiting.popleft() for _ in range(len(waiting)))


def _felt(places: list[tuple[int, Pair]], touches: list[Touch], clock: ClockMap, fast: bool) -> Felt:
    times, heights = tuple(us for us, _ in places), tuple(mm for _, (mm, _) in places)
    return Felt(times, heights, tuple(touches), clock, fast)
