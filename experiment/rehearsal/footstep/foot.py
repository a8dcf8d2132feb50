"""REHEARSAL: the simulated foot with its sensor and the firmware of its tracker, at the device's end of a serial line.

Accelerated, a step goes into the line as fast as the reader takes it, and nothing is sent from the lift of the foot to
the next step: the device's time then jumps while sequence numbers run on. In real time frames go out by the clock,
between steps too, and what a full line does not take is lost, as on a real device.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from experiment.apparatus import host
from experiment.apparatus.rig import TrackerRig
from experiment.apparatus.tracker.frames import encode
from experiment.clock import Clock, MonotonicClock
from experiment.rehearsal.footstep import movement
from experiment.rehearsal.footstep.movement import Hesitation, Trajectory
from experiment.rehearsal.wires.serial_line import SerialLine, UnpluggedError

TICK_S = 0.002
"""How often frames go out in real time, s."""


@dataclass(frozen=True)
class Faults:
    """What goes wrong in one step; frames are numbered from 0, the first of the step.

    Attributes:
        drop: frames that are never sent.
        corrupt: frames with a flipped bit.
        repeat: frames that are sent twice.
        silent_from: the device sends nothing from this frame on, ever.
        unplug_at: the line is unplugged instead of sending this frame.
    """

    drop: frozenset[int] = frozenset()
    corrupt: frozenset[int] = frozenset()
    repeat: frozenset[int] = frozenset()
    silent_from: int | None = None
    unplug_at: int | None = None

    @property
    def end(self) -> float:
        """First frame that is not sent; infinity if all are."""
        return min(frame if frame is not None else math.inf for frame in (self.silent_from, self.unplug_at))


@dataclass(frozen=True)
class _Step:
    """A step in samples of the device: its frame 0 is sample `first`."""

    trajectory: Trajectory
    faults: Faults
    first: int
    sensed_mm: NDArray[np.float64]

    @property
    def end(self) -> int:
        return self.first + self.sensed_mm.size


class Foot:
    """A foot above a tracker. Steps are done one after the other."""

    def __init__(
        self,
        line: SerialLine,
        tracker: TrackerRig,
        *,
        real_time: bool = False,
        clock: Clock | None = None,
        clock_start_us: int = 0,
        rest_mm: float = 70.0,
        noise_mm: float = 0.1,
        sole_mm: float = 0.0,
    ) -> None:
        """Power the device.

        Args:
            line: the serial line; the foot never closes it.
            tracker: rate and calibration of the rig.
            real_time: send by the clock, also between steps.
            clock: paces real time; the machine's monotonic clock if None.
            clock_start_us: what the device's clock shows now, microseconds.
            rest_mm: height at which the foot waits, mm.
            noise_mm: standard deviation of the sensor's noise, mm.
            sole_mm: how far above the sole the sensor sees the foot, mm; for tests of zeroing, none in rehearsals.
        """
        self._line = line
        self._tracker = tracker
        self._clock = clock or MonotonicClock()
        self._origin_ns = self._clock.now_ns()
        self._clock_start_us = clock_start_us
        self._rest_mm = rest_mm
        self._between_mm = rest_mm
        self._noise_mm = noise_mm
        self._sole_mm = sole_mm
        self._rest_noise = np.random.default_rng(0)
        self._changed = threading.Condition()
        self._steps: deque[_Step] = deque()
        self._next_sample = 0
        self._free_sample = 0
        self._sequence = 0
        self._off = False
        self._full = False
        self._last: _Step | None = None
        self._thread = threading.Thread(target=self._run, args=(real_time,), name="foot", daemon=True)
        with host.elsewhere():
            self._thread.start()

    def trajectory(
        self, rng: np.random.Generator, speed_mm_s: float, hesitation: Hesitation | None = None
    ) -> Trajectory:
        """Draw a step of this foot with the given mean speed through the gate, mm/s; see `movement.trajectory`."""
        return movement.trajectory(rng, speed_mm_s, rest_mm=self._rest_mm, hesitation=hesitation)

    def step(self, trajectory: Trajectory, start_us: int, faults: Faults | None = None) -> None:
        """Begin a step; returns at once.

        Args:
            trajectory: how the foot moves.
            start_us: when it begins, device time, microseconds. It begins later where the foot is still busy, or
                where that time is past.
            faults: what goes wrong; None for nothing.
        """
        rate_hz = self._tracker.rate_hz
        wanted = -((self._clock_start_us - start_us) * rate_hz // 1_000_000)
        times_us = np.arange(int(trajectory.duration_us * rate_hz / 1e6) + 1) * (1e6 / rate_hz)
        noise_mm = np.random.default_rng(trajectory.noise_seed).normal(0.0, self._noise_mm, times_us.size)
        sensed_mm = trajectory.at(times_us) + self._sole_mm + noise_mm
        with self._changed:
            self._between_mm = self._rest_mm
            first = max(wanted, self._free_sample, self._next_sample)
            self._last = _Step(trajectory, faults or Faults(), first, sensed_mm)
            self._free_sample = self._last.end
            self._steps.append(self._last)
            self._changed.notify_all()

    def put_down(self) -> None:
        """Rest on the panel until the next step, in real time."""
        self._between_mm = 0.0

    def finish(self) -> bool:
        """Wait until the line has taken every step, or is full.

        Returns:
            Whether it has. Where it is full, the rest follows as soon as somebody reads.
        """
        with self._changed:
            # It may have been full only until the reader's last look.
            self._full = False
            self._changed.wait_for(lambda: not self._steps or self._full or self._off)
            return not self._steps

    @property
    def true_speed_mm_s(self) -> float:
        """Mean speed of the last step through the gate, mm/s."""
        return self._last_step().trajectory.speed_mm_s

    @property
    def true_contact_us(self) -> float:
        """When the last step meets the panel, device time, microseconds."""
        step = self._last_step()
        return self._time_us(step.first) + step.trajectory.contact_us

    @property
    def free_us(self) -> int:
        """When the foot has done every step so far, device time, microseconds."""
        with self._changed:
            return self._time_us(max(self._free_sample, self._next_sample))

    def close(self) -> None:
        """Switch the device off: it sends nothing more."""
        with self._changed:
            self._off = True
            self._changed.notify_all()
        self._thread.join()

    def _last_step(self) -> _Step:
        if self._last is None:
            raise RuntimeError("the foot has not stepped yet")
        return self._last

    def _time_us(self, sample: int) -> int:
        return self._clock_start_us + round(sample * 1_000_000 / self._tracker.rate_hz)

    def _run(self, real_time: bool) -> None:
        try:
            while not self._off:
                if real_time:
                    self._send_due()
                else:
                    self._send_step()
        except UnpluggedError:
            # A device whose plug was pulled knows nothing of it; whoever reads the port learns.
            return
        finally:
            with self._changed:
                self._off = True
                self._changed.notify_all()

    def _send_step(self) -> None:
        """Accelerated: the next step, up to the lift, which nobody waits for."""
        with self._changed:
            self._changed.wait_for(lambda: self._steps or self._off)
            if self._off:
                return
            step = self._steps[0]
        watched = int(step.trajectory.lift_us * self._tracker.rate_hz / 1e6) + 1
        self._send(step.first, step.sensed_mm[:watched], step, wait=True)
        self._done()

    def _send_due(self) -> None:
        """Real time: every sample that is due, of steps and of the rest between them."""
        with self._changed:
            self._changed.wait_for(lambda: self._off, TICK_S)
        due = (self._clock.now_ns() - self._origin_ns) * self._tracker.rate_hz // 1_000_000_000 + 1
        while self._next_sample < due and not self._off:
            with self._changed:
                first = self._next_sample
                step = self._steps[0] if self._steps else None
                begin = min(step.first, due) if step else due
                resting = first < begin
                end = begin if resting or step is None else min(step.end, due)
                self._next_sample = end
            if resting or step is None:
                noise_mm = self._rest_noise.normal(0.0, self._noise_mm, end - first)
                self._send(first, self._between_mm + self._sole_mm + noise_mm, None, wait=False)
            else:
                self._send(first, step.sensed_mm[first - step.first : end - step.first], step, wait=False)
                if end == step.end:
                    self._done()

    def _done(self) -> None:
        with self._changed:
            self._steps.popleft()
            self._changed.notify_all()

    def _send(self, first: int, sensed_mm: NDArray[np.float64], step: _Step | None, *, wait: bool) -> None:
        """Send the samples from `first` on; `step` is the one they belong to."""
        readings = self._tracker.counts(sensed_mm).tolist()
        frames = [encode(self._sequence + i, self._time_us(first + i), reading) for i, reading in enumerate(readings)]
        self._sequence += len(frames)
        fails = False
        if step is not None:
            number = first - step.first
            fails = step.faults.end < number + len(frames)
            frames = _spoilt(frames[: max(int(step.faults.end) - number, 0)] if fails else frames, number, step.faults)
        self._write(b"".join(frames), wait=wait)
        if step is not None and fails:
            if step.faults.end == step.faults.unplug_at:
                self._line.unplug()
            self._off = True

    def _write(self, data: bytes, *, wait: bool) -> None:
        left = memoryview(data)
        while (left := left[self._line.offer(left) :]) and wait and not self._off:
            self._set_full(True)
            self._line.wait()
        self._set_full(False)

    def _set_full(self, full: bool) -> None:
        if full != self._full:
            with self._changed:
                self._full = full
                self._changed.notify_all()


def _spoilt(frames: list[bytes], number: int, faults: Faults) -> list[bytes]:
    """Frames from `number` on, as the faults leave them."""
    sent = []
    for i, frame in enumerate(frames, start=number):
        if i in faults.drop:
            continue
        sent.append(_flipped(frame) if i in faults.corrupt else frame)
        if i in faults.repeat:
            sent.append(frame)
    return sent


def _flipped(frame: bytes) -> bytes:
    """The frame with one bit of its second byte flipped; no byte becomes 0x00, which would tear it in two."""
    bit = 0x01 if frame[1] != 0x01 else 0x02
    return bytes([frame[0], frame[1] ^ bit, *frame[2:]])
