"""SIMULATED recording: a foot at the tracker's port, a sensor at the accelerometer's, and nobody at the keys.

The walk and the drivers are those of a real recording; the simulated experimenter keeps what is on target.

SIMULATED accelerometer, at the far end of its port, and the time of a simulated recording.

Nobody waits in a simulated recording, so the machine's clock cannot tell which vibration belongs to which step. The
host's clock is simulated there: it shows the foot's device time, moves on as frames of the foot are read, and the
sensor sends what it heard until then.
"""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from experiment.apparatus import opening
from experiment.apparatus import rig as rigs
from experiment.apparatus.ports import Accelerometer, Heard, Tracker
from experiment.apparatus.rig import AccelerometerRig
from experiment.apparatus.tracker.clock_map import ClockMap
from experiment.apparatus.tracker.frames import LinkCounts, Samples
from experiment.apparatus.tracker.gate import GateDetector
from experiment.clock import Clock, ManualClock
from experiment.errors import RecordingError
from experiment.protocol import files
from experiment.recordings import store, workflow
from experiment.recordings.manifest import Recordings
from experiment.recordings.store import Condition, Plan, plan
from experiment.recordings.workflow import Step
from experiment.rehearsal.footstep import recorded_takes
from experiment.rehearsal.footstep.foot import Foot
from experiment.rehearsal.footstep.recorded_takes import CRUSH_MM, RecordingSession
from experiment.rehearsal.wires.serial_line import SerialLine

REST_NOISE_M_S2 = 0.002
"""Standard deviation of what the sensor hears of a panel at rest, m/s^2."""

AFTER_S = 1.0
"""It goes on for this long after a take: longer than one may begin late, s."""


class Sensor:
    """Listens on the loopback interface; one connection a take."""

    def __init__(self, settings: AccelerometerRig, clock: Clock) -> None:
        """Listen at once.

        Args:
            settings: rate and full scale.
            clock: of the simulated host; only what was heard until now is sent.
        """
        self._settings = settings
        self._clock = clock
        self._server = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._server.getsockname()[1]}"
        """Where it listens, `host:port`."""
        self._connection: socket.socket | None = None
        self._begun_ns = 0
        self._unsent = np.empty(0)
        self.sent = 0
        """Samples sent since the connection was made."""
        self._closing = False
        self._thread = threading.Thread(target=self._listen, name="sensor", daemon=True)
        self._thread.start()

    def shake(self, heard_m_s2: NDArray[np.float64], at_ns: int, rng: np.random.Generator) -> None:
        """The panel will shake, and rest before and after; whoever is connected hears it when its time comes.

        Args:
            heard_m_s2: acceleration, m/s^2, shape (n,), at the sensor's rate.
            at_ns: when that begins.
            rng: noise of the sensor at rest.
        """
        after_m_s2 = rng.normal(0.0, REST_NOISE_M_S2, round(AFTER_S * self._settings.rate_hz))
        # Drawn from its end on, so that what comes just before does not depend on how long the panel has been at rest.
        before_m_s2 = rng.normal(0.0, REST_NOISE_M_S2, max(self._samples_until(at_ns) - self.sent, 0))[::-1]
        self._unsent = np.concatenate([before_m_s2, heard_m_s2, after_m_s2])

    @property
    def silent_ns(self) -> int:
        """When everything that it will hear has been heard."""
        samples = self.sent + self._unsent.size
        return self._begun_ns + -(-samples * 1_000_000_000 // self._settings.rate_hz)

    def send(self) -> None:
        """Send what was heard until now."""
        due = max(self._samples_until(self._clock.now_ns()) - self.sent, 0)
        piece, self._unsent = self._unsent[:due], self._unsent[due:]
        self.sent += piece.size
        self._put(piece)

    def close(self) -> None:
        """Stop listening."""
        self._closing = True
        # Closing the server alone would not end an accept that is under way.
        with suppress(OSError), socket.create_connection(self._server.getsockname(), timeout=1.0):
            pass
        self._thread.join()
        self._server.close()
        if self._connection is not None:
            self._connection.close()

    def _samples_until(self, now_ns: int) -> int:
        return (now_ns - self._begun_ns) * self._settings.rate_hz // 1_000_000_000

    def _put(self, heard_m_s2: NDArray[np.float64]) -> None:
        # Who hangs up has heard enough.
        with suppress(OSError):
            if self._connection is not None:
                self._connection.sendall((heard_m_s2 / self._settings.full_scale_m_s2).astype("<f4").tobytes())

    def _listen(self) -> None:
        while True:
            connection, _ = self._server.accept()
            if self._connection is not None:
                self._connection.close()
            self._connection = connection
            if self._closing:
                return
            # One sample at once: time stands still until it has arrived, so it tells when the stream began.
            self._begun_ns = self._clock.now_ns() - 1_000_000_000 // self._settings.rate_hz
            self.sent, self._unsent = 1, np.empty(0)
            self._put(np.zeros(1))


class PassingTime:
    """Implements `Tracker` and `Accelerometer` on others: time passes while they are waited for."""

    def __init__(self, tracker: Tracker, accelerometer: Accelerometer, sensor: Sensor, clock: ManualClock) -> None:
        """Take both ports.

        Args:
            tracker: the foot's.
            accelerometer: which listens to `sensor`.
            sensor: sends as time passes.
            clock: the simulated host's.
        """
        self._tracker = tracker
        self._accelerometer = accelerometer
        self._sensor = sensor
        self._clock = clock

    @property
    def counts(self) -> LinkCounts:
        return self._tracker.counts

    @property
    def clock_map(self) -> ClockMap | None:
        return self._tracker.clock_map

    def drain(self) -> None:
        self._tracker.drain()

    def read(self) -> Samples:
        samples = self._tracker.read()
        self._pass_until(int(samples.device_us[-1]) * 1000)
        return samples

    def reconnect(self, timeout_s: float) -> None:
        self._tracker.reconnect(timeout_s)

    @property
    def rate_hz(self) -> int:
        return self._accelerometer.rate_hz

    def arm(self, samples: int) -> None:
        self._accelerometer.arm(samples)

    def heard(self, *, earliest_ns: int, latest_ns: int) -> Heard:
        self._pass_until(self._sensor.silent_ns)
        return self._accelerometer.heard(earliest_ns=earliest_ns, latest_ns=latest_ns)

    def close(self) -> None:
        """Whoever opened the ports closes them."""

    def _pass_until(self, now_ns: int) -> None:
        self._clock.sleep_ns(now_ns - self._clock.now_ns())
        self._sensor.send()


MOST_ATTEMPTS = 50
"""The simulated experimenter gives up then: about one attempt in six is off target by chance."""

FRESH_SPEEDS_MM_S = (150.0, 250.0, 400.0)
FRESH_TAKES = 10
"""Okamoto et al., section 3.3."""

Tick = Callable[[], None]


class SimulatedExperimenter:
    """Implements `TakesConsole`: lays out, steps, and keeps every take without a problem."""

    def __init__(self, *, foot: Foot, sensor: Sensor, clock: Clock, session: RecordingSession, tick: Tick) -> None:
        """Take a place at the panel.

        Args:
            foot: at the tracker's port.
            sensor: at the accelerometer's.
            clock: of the simulated host: a step begins no sooner than now.
            session: every attempt at every take.
            tick: called after each kept take.
        """
        self._foot = foot
        self._sensor = sensor
        self._clock = clock
        self._session = session
        self._tick = tick
        self._problems: tuple[str, ...] = ()

    def place(self, condition: Condition, *, done: int, total: int) -> None:
        """Nothing has to be waited for."""

    def arm(self, condition: Condition, *, attempt: int) -> None:
        if attempt > MOST_ATTEMPTS:
            raise RecordingError(
                f"{condition.material or 'bare panel'} at {condition.speed_mm_s:g} mm/s: got {MOST_ATTEMPTS} attempts, "
                f"none of them good, the last with {'; '.join(self._problems)}; allowed: what the rig can record; give "
                "other speeds, or another rig"
            )
        drawn = self._session.attempt(condition, attempt)
        rng = self._session.rng(condition, attempt, 1)
        self._foot.step(self._foot.trajectory(rng, drawn.speed_mm_s), -(-self._clock.now_ns() // 1000))
        crushed_s = 0.0 if condition.material is None else CRUSH_MM / drawn.speed_mm_s
        self._sensor.shake(drawn.samples_m_s2, round(self._foot.true_contact_us * 1e3 - crushed_s * 1e9), rng)

    def keeps(self, step: Step) -> bool:
        self._foot.finish()
        self._problems = step.problems
        if step.problems:
            return False
        self._tick()
        return True


def record_simulated(
    *,
    protocol_file: Path,
    rig_file: Path,
    out: Path,
    seed: int,
    speeds_mm_s: tuple[float, ...] = (),
    takes: int | None = None,
    total: Callable[[int], None] = lambda _: None,
    tick: Tick = lambda: None,
) -> Path:
    """Record SIMULATED materials unattended, or go on with it. The rig's actuator and its table are not opened.

    Args:
        protocol_file: what is recorded; its materials have simulations.
        rig_file: of a simulated rig with an accelerometer.
        out: folder of the recordings; new or empty.
        seed: names every random draw.
        speeds_mm_s: instead of the protocol's; empty for those.
        takes: instead of the protocol's; None for those.
        total: called with the number of takes.
        tick: called after each kept take.

    Returns:
        Path of the manifest.

    Raises:
        PalpateError: a file that cannot be used, or a material without simulation.
    """
    protocol, rig = files.load(protocol_file), rigs.load(rig_file)
    if not rig.rig.simulated:
        raise RecordingError(f"{rig_file}: a real rig; allowed: one that says simulated = true; leave out --simulated")
    if rig.tracker.zeroing_mm is not None:
        raise RecordingError(
            f"{rig_file}: tracker.zeroing_mm: got {rig.tracker.zeroing_mm:g}; allowed: none, for in simulated time no "
            "foot rests on the panel; leave it out of this rig file"
        )
    rigs.check(rig, protocol.footstep.step)
    planned = plan(
        protocol,
        source=recorded_takes.source(seed),
        simulated=True,
        rig_sha256=rigs.sha256(rig),
        speeds_mm_s=speeds_mm_s,
        takes=takes,
    )
    store.check(out, planned)
    drawn = recorded_takes.session(planned, seed=seed)
    total(len(planned.conditions()))
    with ExitStack() as opened:
        line = opened.enter_context(SerialLine())
        foot = Foot(line, rig.tracker)
        opened.callback(foot.close)
        clock = ManualClock(0)
        known = ClockMap(anchor_us=0, anchor_ns=0)
        tracker = opening.open_tracker(rig, clock=clock, port=line.url, clock_map=known)
        opened.callback(tracker.close)
        sensor = Sensor(opening.accelerometer_of(rig), clock)
        opened.callback(sensor.close)
        accelerometer = opening.open_accelerometer(rig, rate_hz=planned.rate_hz, address=sensor.address, clock=clock)
        opened.callback(accelerometer.close)
        ports = PassingTime(tracker, accelerometer, sensor, clock)
        experimenter = SimulatedExperimenter(
            foot=foot,
            sensor=sensor,
            clock=clock,
            session=drawn,
            tick=tick,
        )
        return workflow.record(
            planned,
            out,
            tracker=ports,
            accelerometer=ports,
            detector=GateDetector(protocol.footstep.step),
            console=experimenter,
            clock=clock,
            note=recorded_takes.note(drawn),
        )


def fresh_takes(
    recorded: Recordings,
    *,
    seed: int,
    speeds_mm_s: tuple[float, ...] = FRESH_SPEEDS_MM_S,
    takes: int = FRESH_TAKES,
) -> Recordings:
    """New SIMULATED takes of the materials of simulated recordings, of a foot that aims at the speeds asked for.

    Args:
        recorded: simulated recordings.
        seed: names every random draw; none is one of a recording's.
        speeds_mm_s: rising.
        takes: of each material, and of the bare panel, at each speed.

    Raises:
        RecordingError: recordings of real materials, or of one without simulation.
    """
    if not recorded.simulated:
        raise RecordingError(
            "fresh takes: got none; allowed: takes of the real materials, for the recordings are real; record them "
            "with palpate record --speeds 150,250,400 --takes 10, then name their folder with --fresh"
        )
    planned = Plan(
        source=f"SIMULATED fresh takes, seed {seed}",
        protocol_sha256="",
        rig_sha256="",
        simulated=True,
        materials=tuple(recorded.objects),
        speeds_mm_s=speeds_mm_s,
        takes=takes,
        rate_hz=recorded.rate_hz,
        samples=recorded.panel.shape[-1],
    )
    return RecordingSession(planned, seed=seed, number=0).recordings()
