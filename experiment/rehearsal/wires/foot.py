"""REHEARSAL: the simulated foot: how it steps, and its sensor and firmware at the device's end of a serial line.

Steps are close to minimum jerk (Flash and Hogan 1985, "The coordination of arm movements: an experimentally confirmed
mathematical model", J. Neurosci. 5(7)): x(s) = 10 s^3 - 15 s^4 + 6 s^5. They aim below the panel, so they meet it at
speed. The pace wavers a little, and some steps hesitate.

In simulated time frames go out as fast as they are read, and none between steps: the device's time jumps, sequence
numbers run on. In real time frames go out by the clock, and what a full line does not take is lost.
"""

import math
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus import host
from palpate.experiment.apparatus.host import beside
from palpate.experiment.apparatus.tracker import frame_runs
from palpate.experiment.apparatus.tracker.frames import encode
from palpate.experiment.apparatus.tracker.settings import TrackerRig
from palpate.experiment.clock import Clock, MonotonicClock
from palpate.experiment.rehearsal.wires import weight
from palpate.experiment.rehearsal.wires.serial_line import SerialLine, UnpluggedError

Hesitation = Literal["none", "pause", "dip", "stop", "turn"]
"""Before its last passage a foot may pause above the gate, or dip into it; one that stops below does not land."""

GATE_TOP_MM = 20.0
GATE_BOTTOM_MM = 10.0
"""The published gate: a foot's speed is its mean speed from 20 mm to 10 mm above the panel."""

HESITATES = 0.1
"""Part of the steps that hesitate: half of these pause above the gate, half dip into it and withdraw first."""

BRAKES_MM = 3.0
"""Travel in which a foot that will not land comes to a halt, mm."""

_DENSITY_HZ = 4000
"""Number of a trajectory's knots in a second; straight lines between them are within 10^-4 mm."""

Curve = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Time, s, from 0, and height, mm, shape (n,) each."""


@dataclass(frozen=True)
class Trajectory:
    """One step of a foot: it comes down, rests on the panel, and goes up again.

    The truth is straight between knots at `us`, microseconds from 0, float64, and `height_mm`, shape (n,). On the last
    passage it crosses 20 mm at `gate_top_us` and 10 mm at `gate_bottom_us`, with the mean speed `speed_mm_s`;
    `contact_us` is infinity for no contact. At `lift_us` it leaves the panel, 0.22 s or more after contact, or the step
    ends. `noise_seed` names the sensor's noise; `along_mm` is the place along the face at each knot, None for zero.
    `force_n` is how hard the foot presses once it rests on the panel, N.
    """

    us: NDArray[np.float64]
    height_mm: NDArray[np.float64]
    gate_top_us: float
    gate_bottom_us: float
    contact_us: float
    lift_us: float
    speed_mm_s: float
    hesitation: Hesitation
    noise_seed: int
    along_mm: NDArray[np.float64] | None = None
    force_n: float = 0.0

    @property
    def duration_us(self) -> float:
        return float(self.us[-1])

    def at(self, us: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """Return the height at each time, mm, shape (n,); before and after the step that of its ends."""
        height_mm: NDArray[np.float64] = np.interp(us, self.us, self.height_mm)
        return height_mm

    def along_at(self, us: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """Return the place along the face at each time, as `at`."""
        return np.zeros(us.size) if self.along_mm is None else np.interp(us, self.us, self.along_mm)


def trajectory(
    rng: np.random.Generator, speed_mm_s: float, *, rest_mm: float = 70.0, hesitation: Hesitation | None = None
) -> Trajectory:
    """Return a step with the given mean speed from 20 mm to 10 mm above the panel; `rng` draws everything else.

    The foot waits at `rest_mm`, mm, above 45, before and after. `hesitation` None draws one of a step that lands.
    """
    if hesitation is None:
        hesitation = "none" if rng.random() >= HESITATES else ("pause" if rng.random() < 0.5 else "dip")
    if hesitation in ("stop", "turn"):
        return _in_vain(rng, speed_mm_s, rest_mm, hesitation)
    before, start_mm = _hesitation_path(rng, hesitation, speed_mm_s, rest_mm)
    descent, contact_mm_s = _descent(rng, start_mm, speed_mm_s)
    landing = _landing(rng, contact_mm_s)
    lift = _minimum_jerk(float(landing[1][-1]), rest_mm, rng.uniform(0.3, 0.45))
    time_s, height_mm = _joined([*before, descent, landing, lift])
    begun_us = float(sum(curve[0][-1] for curve in before)) * 1e6
    top_us, bottom_us = (begun_us + _passes(descent, level) * 1e6 for level in (GATE_TOP_MM, GATE_BOTTOM_MM))
    contact_us = begun_us + float(descent[0][-1]) * 1e6
    return Trajectory(
        us=time_s * 1e6,
        height_mm=height_mm,
        gate_top_us=top_us,
        gate_bottom_us=bottom_us,
        contact_us=contact_us,
        lift_us=contact_us + float(landing[0][-1]) * 1e6,
        speed_mm_s=(GATE_TOP_MM - GATE_BOTTOM_MM) * 1e6 / (bottom_us - top_us),
        hesitation=hesitation,
        noise_seed=int(rng.integers(2**63)),
    )


def _in_vain(rng: np.random.Generator, speed_mm_s: float, rest_mm: float, hesitation: Hesitation) -> Trajectory:
    """Return a step whose foot stops between gate and panel, or turns back there, and goes back to rest."""
    turn_mm = rng.uniform(4.0, 7.0)
    waits_s = rng.uniform(0.2, 0.5) if hesitation == "stop" else 0.001
    still = _still(rest_mm, rng.uniform(0.05, 0.15))
    # A reach that would end far below the panel is at full speed in the gate; it is braked in the last millimetres.
    fall, mm_s = _descent(rng, rest_mm, speed_mm_s)
    kept = fall[1] > turn_mm
    fall = fall[0][kept], fall[1][kept]
    brake_s = _times(2 * BRAKES_MM / mm_s)
    brake = brake_s, float(fall[1][-1]) - mm_s * brake_s + mm_s * brake_s**2 / (2 * brake_s[-1])
    rise = _minimum_jerk(float(brake[1][-1]), rest_mm, rng.uniform(0.3, 0.45))
    time_s, height_mm = _joined([still, fall, brake, _still(float(brake[1][-1]), waits_s), rise])
    top_us, bottom_us = ((float(still[0][-1]) + _passes(fall, level)) * 1e6 for level in (GATE_TOP_MM, GATE_BOTTOM_MM))
    return Trajectory(
        us=time_s * 1e6,
        height_mm=height_mm,
        gate_top_us=top_us,
        gate_bottom_us=bottom_us,
        contact_us=math.inf,
        lift_us=float(time_s[-1]) * 1e6,
        speed_mm_s=(GATE_TOP_MM - GATE_BOTTOM_MM) * 1e6 / (bottom_us - top_us),
        hesitation=hesitation,
        noise_seed=int(rng.integers(2**63)),
    )


def _hesitation_path(
    rng: np.random.Generator, hesitation: Hesitation, speed_mm_s: float, rest_mm: float
) -> tuple[list[Curve], float]:
    """Return what comes before the passage that leads to contact, and the height from which that passage begins."""
    curves = [_still(rest_mm, rng.uniform(0.05, 0.15))]
    if hesitation == "none":
        return curves, rest_mm
    if hesitation == "pause":
        hold_mm = rng.uniform(28.0, 45.0)
        curves += [_unhurried(rest_mm, hold_mm, speed_mm_s), _still(hold_mm, rng.uniform(0.15, 0.4))]
        return curves, hold_mm
    turn_mm, start_mm = rng.uniform(6.0, 17.0), rng.uniform(26.0, 40.0)
    curves += [_unhurried(rest_mm, turn_mm, speed_mm_s), _unhurried(turn_mm, start_mm, speed_mm_s)]
    return curves, start_mm


def _descent(rng: np.random.Generator, start_mm: float, speed_mm_s: float) -> tuple[Curve, float]:
    """Return the way from rest to the panel with the wanted speed through the gate, and the speed at contact, mm/s."""
    aim_mm = -rng.uniform(10.0, 25.0)
    s = np.linspace(0.0, 1.0, 2001)
    height_mm = start_mm + (aim_mm - start_mm) * progress(s)
    pace = s + sum(
        share / (2 * np.pi * k) * (np.sin(2 * np.pi * k * s + phase) - np.sin(phase))
        for k, share, phase in zip((1, 2, 3), rng.uniform(0.0, 0.15, 3), rng.uniform(0.0, 2 * np.pi, 3), strict=True)
    )
    gate = _passes((pace, height_mm), GATE_BOTTOM_MM) - _passes((pace, height_mm), GATE_TOP_MM)
    time_s = pace * (GATE_TOP_MM - GATE_BOTTOM_MM) / (speed_mm_s * gate)
    contact_s = _passes((time_s, height_mm), 0.0)
    last = int(np.searchsorted(time_s, contact_s))
    contact_mm_s = float((height_mm[last - 1] - height_mm[last]) / (time_s[last] - time_s[last - 1]))
    return (np.append(time_s[:last], contact_s), np.append(height_mm[:last], 0.0)), contact_mm_s


def _landing(rng: np.random.Generator, contact_mm_s: float) -> Curve:
    """Return how sole and panel give way and come to rest a little below zero."""
    time_s = _times(rng.uniform(0.22, 0.3))
    yielding_s, settling_s, sag_mm = 0.004, 0.01, rng.uniform(0.05, 0.2)
    dent_mm = contact_mm_s * time_s * np.exp(-time_s / yielding_s)
    return time_s, -dent_mm - sag_mm * (1 - np.exp(-time_s / settling_s))


def progress(s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how far a minimum jerk reach is at each part of its time, of 1, shape (n,)."""
    return s**3 * (10 - 15 * s + 6 * s**2)


def _minimum_jerk(from_mm: float, to_mm: float, duration_s: float) -> Curve:
    time_s = _times(duration_s)
    return time_s, from_mm + (to_mm - from_mm) * progress(time_s / time_s[-1])


def _unhurried(from_mm: float, to_mm: float, speed_mm_s: float) -> Curve:
    return _minimum_jerk(from_mm, to_mm, float(np.clip(1.5 * abs(to_mm - from_mm) / speed_mm_s, 0.15, 0.8)))


def _still(height_mm: float, duration_s: float) -> Curve:
    return np.array([0.0, duration_s]), np.array([height_mm, height_mm])


def _times(duration_s: float) -> NDArray[np.float64]:
    return np.linspace(0.0, duration_s, 2 + round(duration_s * _DENSITY_HZ))


def _passes(falling: Curve, level_mm: float) -> float:
    """Return when a falling curve passes a level."""
    time, height_mm = falling
    return float(np.interp(-level_mm, -height_mm, time))


def _joined(curves: list[Curve]) -> Curve:
    """Return one curve after the other; each begins where the one before ends."""
    begin_s = np.cumsum([0.0, *(curve[0][-1] for curve in curves[:-1])])
    first_s, first_mm = curves[0]
    time_s = [first_s, *(begin + curve[0][1:] for begin, curve in zip(begin_s[1:], curves[1:], strict=True))]
    return np.concatenate(time_s), np.concatenate([first_mm, *(curve[1][1:] for curve in curves[1:])])


TICK_S = 0.002
"""How often frames go out in real time, s."""


Fails = Callable[[bytes, int], tuple[bytes, Callable[[SerialLine], object] | None]]
"""A step's fault, in tests: from frame n, from 0, it returns what is sent and does to the line, None for nothing."""


@dataclass(frozen=True)
class _Step:
    """A step in samples of the device: its frame 0 is sample `first`; `readings` are of shape (n, 1) or (n, 2)."""

    trajectory: Trajectory
    fails: Fails | None
    first: int
    readings: NDArray[np.int64]

    @property
    def end(self) -> int:
        return self.first + len(self.readings)


class Foot:
    """A foot above a tracker. It does its steps one after the other."""

    def __init__(
        self,
        line: SerialLine,
        tracker: TrackerRig,
        *,
        real_time: bool = False,
        clock: Clock | None = None,
        rest_mm: float = 70.0,
        noise_mm: float = 0.1,
        sole_mm: float = 0.0,
        tick_s: float = TICK_S,
    ) -> None:
        """Power the device at a serial line, which the foot never closes; `tracker` has its rate and calibration.

        `real_time` sends every `tick_s` by `clock`, by default the machine's monotonic one. `noise_mm` is the sensor's
        standard deviation, `sole_mm` the sensed height of the sole, for tests of zeroing.
        """
        self._tick_s = tick_s
        self._line = line
        self._tracker = tracker
        self._clock = clock or MonotonicClock()
        self._origin_ns = self._clock.now_ns()
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
        """Return a step of this foot with the given mean speed through the gate, mm/s; see `trajectory`."""
        return trajectory(rng, speed_mm_s, rest_mm=self._rest_mm, hesitation=hesitation)

    def step(self, trajectory: Trajectory, start_us: int, fails: Fails | None = None) -> None:
        """Begin a step at device time `start_us`, or as soon as the foot is free; return at once."""
        rate_hz = self._tracker.rate_hz
        wanted = -(-start_us * rate_hz // 1_000_000)
        times_us = np.arange(int(trajectory.duration_us * rate_hz / 1e6) + 1) * (1e6 / rate_hz)
        noise = np.random.default_rng(trajectory.noise_seed)
        second = trajectory.along_at(times_us)
        if self._tracker.force is not None:
            second = weight.pressing_n(times_us, trajectory.force_n, trajectory.contact_us, trajectory.lift_us)
        readings = self._sensed(trajectory.at(times_us), second, noise)
        with self._changed:
            self._between_mm = self._rest_mm
            first = max(wanted, self._free_sample, self._next_sample)
            self._last = _Step(trajectory, fails, first, readings)
            self._free_sample = self._last.end
            self._steps.append(self._last)
            self._changed.notify_all()

    def put_down(self) -> None:
        """Rest on the panel until the next step, in real time."""
        self._between_mm = 0.0

    def finish(self) -> bool:
        """Wait until the line has taken every step, or is full until somebody reads; return whether it has."""
        with self._changed:
            # The line may have been full only until the reader looked last.
            self._full = False
            self._changed.wait_for(lambda: not self._steps or self._full or self._off)
            return not self._steps

    @property
    def true_speed_mm_s(self) -> float:
        """Return the mean speed of the last step through the gate, mm/s."""
        return self._last_step().trajectory.speed_mm_s

    @property
    def true_contact_us(self) -> float:
        """Return when the last step meets the panel, device time, microseconds."""
        step = self._last_step()
        return self._time_us(step.first) + step.trajectory.contact_us

    @property
    def free_us(self) -> int:
        """Return when the foot has done every step so far, device time, microseconds."""
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
        return round(sample * 1_000_000 / self._tracker.rate_hz)

    def _run(self, real_time: bool) -> None:
        if real_time:
            beside.raise_above_sessions()
        try:
            while not self._off:
                if real_time:
                    self._send_due()
                else:
                    self._send_step()
        except UnpluggedError:
            # An unplugged device does not notice; whoever reads the port does.
            return
        finally:
            with self._changed:
                self._off = True
                self._changed.notify_all()

    def _send_step(self) -> None:
        """Send the next step in simulated time, up to the lift, for which nobody waits."""
        with self._changed:
            self._changed.wait_for(lambda: self._steps or self._off)
            if self._off:
                return
            step = self._steps[0]
        watched = int(step.trajectory.lift_us * self._tracker.rate_hz / 1e6) + 1
        self._send(step.first, step.readings[:watched], step, wait=True)
        self._step_over()

    def _send_due(self) -> None:
        """Send every sample that is due in real time, of steps and of the rest between them."""
        with self._changed:
            self._changed.wait_for(lambda: self._off, self._tick_s)
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
                still_mm = np.full(end - first, self._between_mm)
                self._send(first, self._sensed(still_mm, 0.0 * still_mm, self._rest_noise), None, wait=False)
            else:
                self._send(first, step.readings[first - step.first : end - step.first], step, wait=False)
                if end == step.end:
                    self._step_over()

    def _step_over(self) -> None:
        with self._changed:
            self._steps.popleft()
            self._changed.notify_all()

    def _sensed(
        self, height_mm: NDArray[np.float64], second: NDArray[np.float64], noise: np.random.Generator
    ) -> NDArray[np.int64]:
        """Return what the sensor reads at n places, shape (n, 1), or (n, 2) with places along a face, mm, or forces, N.

        Of either sort the noise is as large as that of heights, in its own unit.
        """
        noise_mm = noise.normal(0.0, self._noise_mm, (self._tracker.readings, height_mm.size))
        counts = [self._tracker.counts(height_mm + self._sole_mm + noise_mm[0])]
        counts += [self._tracker.second_counts(second + each) for each in noise_mm[1:]]
        return np.column_stack(counts)

    def _send(self, first: int, readings: NDArray[np.int64], step: _Step | None, *, wait: bool) -> None:
        """Send the samples from `first` on; `step` is the one they belong to."""
        count = len(readings)
        if count >= frame_runs.FEWEST:
            numbers = self._sequence + np.arange(count)
            us = np.rint((first + np.arange(count)) * 1_000_000 / self._tracker.rate_hz).astype(np.int64)
            sent = frame_runs.encode(frame_runs.Run(numbers, us, readings))
        else:
            each = enumerate(readings.tolist())
            sent = b"".join(encode(self._sequence + i, self._time_us(first + i), *read) for i, read in each)
        self._sequence += count
        ends = None
        if step is not None and step.fails is not None:
            sent, ends = step.fails(sent, first - step.first)
        self._write(sent, wait=wait)
        if ends is not None:
            ends(self._line)
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
