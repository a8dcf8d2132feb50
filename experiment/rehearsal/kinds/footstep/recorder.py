"""SIMULATED recording: a foot at the tracker's port, a sensor at the accelerometer's, and nobody at the keys.

Walk and drivers are the real ones. The host's clock shows the foot's device time and moves on as its frames are read,
so that vibrations belong to steps; the sensor sends what it recorded until then.
"""

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from palpate.experiment.apparatus import opening
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.panel import accelerometer as accelerometers
from palpate.experiment.apparatus.panel.accelerometer import Accelerometer, Heard
from palpate.experiment.apparatus.ports import Tracker
from palpate.experiment.apparatus.rig import tracker_of
from palpate.experiment.apparatus.tracker.clock_map import ClockMap
from palpate.experiment.apparatus.tracker.frames import LinkCounts, Samples
from palpate.experiment.apparatus.tracker.gate import GateDetector
from palpate.experiment.clock import Clock
from palpate.experiment.errors import RecordingError, Remedy
from palpate.experiment.protocol import files
from palpate.experiment.protocol.kinds.footstep import Footstep
from palpate.experiment.recordings import store, workflow
from palpate.experiment.recordings.manifest import RECORD, Recordings
from palpate.experiment.recordings.store import Condition, Plan, plan
from palpate.experiment.recordings.workflow import Step
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.rehearsal.kinds.footstep import recorded_takes
from palpate.experiment.rehearsal.kinds.footstep.recorded_takes import CRUSH_MM, RecordingSession
from palpate.experiment.rehearsal.wires.foot import Foot
from palpate.experiment.rehearsal.wires.sensor import Sensor
from palpate.experiment.rehearsal.wires.serial_line import SerialLine


@dataclass(frozen=True)
class PassingTime:
    """`Tracker` and `Accelerometer` on others: the simulated host's time passes while they are awaited."""

    tracker: Tracker
    accelerometer: Accelerometer
    sensor: Sensor
    clock: ManualClock

    @property
    def counts(self) -> LinkCounts:
        return self.tracker.counts

    @property
    def clock_map(self) -> ClockMap | None:
        return self.tracker.clock_map

    def drain(self) -> None:
        self.tracker.drain()

    def read(self) -> Samples:
        samples = self.tracker.read()
        self._pass_until(int(samples.device_us[-1]) * 1000)
        return samples

    def reconnect(self, timeout_s: float) -> None:
        self.tracker.reconnect(timeout_s)

    @property
    def rate_hz(self) -> int:
        return self.accelerometer.rate_hz

    def arm(self, samples: int) -> None:
        self.accelerometer.arm(samples)

    def heard(self, *, earliest_ns: int, latest_ns: int) -> Heard:
        self._pass_until(self.sensor.silent_ns)
        return self.accelerometer.heard(earliest_ns=earliest_ns, latest_ns=latest_ns)

    def close(self) -> None:
        """Close nothing: whoever opened the ports closes them."""

    def _pass_until(self, now_ns: int) -> None:
        self.clock.sleep_ns(now_ns - self.clock.now_ns())
        self.sensor.send()


MOST_ATTEMPTS = 50
"""After so many attempts the simulated experimenter gives up: about one in six is off target by chance."""

FRESH_SPEEDS_MM_S = (150.0, 250.0, 400.0)
FRESH_TAKES = 10
"""Okamoto et al., section 3.3."""


@dataclass
class SimulatedExperimenter:
    """Implements `TakesConsole`: lays out, steps, and keeps every take without a problem."""

    foot: Foot
    sensor: Sensor
    clock: Clock
    session: RecordingSession
    problems: tuple[str, ...] = ()
    """What was wrong with the last step."""

    def place(self, condition: Condition, *, done: int, total: int) -> None:
        """Wait for nothing."""

    def arm(self, condition: Condition, *, attempt: int) -> None:
        if attempt > MOST_ATTEMPTS:
            raise RecordingError(
                f"{condition.material or 'bare panel'} at {condition.speed_mm_s:g} mm/s",
                f"none of {MOST_ATTEMPTS} attempts was usable (the last: {'; '.join(self.problems)})",
                "use other speeds, or another rig",
                allowed="speeds that the rig can record",
            )
        drawn = self.session.attempt(condition, attempt)
        rng = self.session.rng(condition, attempt, 1)
        self.foot.step(self.foot.trajectory(rng, drawn.speed_mm_s), -(-self.clock.now_ns() // 1000))
        crushed_s = 0.0 if condition.material is None else CRUSH_MM / drawn.speed_mm_s
        self.sensor.shake(drawn.samples_m_s2, round(self.foot.true_contact_us * 1e3 - crushed_s * 1e9), rng)

    def keeps(self, step: Step) -> bool:
        self.foot.finish()
        self.problems = step.problems
        return not step.problems


def record_simulated(
    *,
    protocol_file: Path,
    rig_file: Path,
    out: Path,
    seed: int,
    speeds_mm_s: tuple[float, ...] = (),
    takes: int | None = None,
) -> Path:
    """Record SIMULATED materials unattended, or continue, and return the manifest's path.

    Arguments are as in `workflow.record_on_rig`; `seed` names the draws. Raises `PalpateError` for an unusable file.
    """
    protocol, rig = files.load(protocol_file), rigs.load(rig_file)
    if not rig.rig.simulated:
        raise RecordingError(
            rig_file, "is a real rig", "leave out --simulated", allowed="a rig file with simulated = true"
        )
    settings = tracker_of(rig)
    if settings.zeroing_mm is not None:
        raise RecordingError(
            rig_file,
            f"tracker.zeroing_mm: got {settings.zeroing_mm:g}",
            "remove this key from the rig file",
            allowed="none, because no foot rests on the panel in simulated time",
        )
    rigs.check(rig, protocol.table(Footstep).step)
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
    with ExitStack() as opened:
        line = opened.enter_context(SerialLine())
        foot = Foot(line, settings)
        opened.callback(foot.close)
        clock = ManualClock(0)
        known = ClockMap(anchor_us=0, anchor_ns=0)
        tracker = opening.open_tracker(rig, clock=clock, port=line.url, clock_map=known)
        opened.callback(tracker.close)
        sensor = Sensor(accelerometers.settings_of(rig), clock)
        opened.callback(sensor.close)
        accelerometer = accelerometers.open_accelerometer(
            rig, rate_hz=planned.rate_hz, address=sensor.address, clock=clock
        )
        opened.callback(accelerometer.close)
        ports = PassingTime(tracker, accelerometer, sensor, clock)
        return workflow.record(
            planned,
            out,
            tracker=ports,
            accelerometer=ports,
            detector=GateDetector(protocol.table(Footstep).step),
            console=SimulatedExperimenter(foot=foot, sensor=sensor, clock=clock, session=drawn),
            clock=clock,
            note=recorded_takes.note(drawn),
        )


def fresh_takes(recorded: Recordings, *, seed: int) -> Recordings:
    """Return new SIMULATED takes, with a `seed` of their own. Raises `RecordingError` if the old ones are real."""
    if not recorded.simulated:
        fresh = ("--speeds", ",".join(f"{speed:g}" for speed in FRESH_SPEEDS_MM_S), "--takes", f"{FRESH_TAKES}")
        raise RecordingError(
            "fresh takes",
            "got none",
            Remedy("record them with {}, then give their folder with --fresh", (*RECORD, *fresh), suffices=False),
            allowed="takes of the real materials, because the recordings are real",
        )
    planned = Plan(
        source=f"SIMULATED fresh takes, seed {seed}",
        protocol_sha256="",
        rig_sha256="",
        simulated=True,
        materials=tuple(recorded.objects),
        speeds_mm_s=FRESH_SPEEDS_MM_S,
        takes=FRESH_TAKES,
        rate_hz=recorded.rate_hz,
        samples=recorded.panel.shape[-1],
    )
    return RecordingSession(planned, seed=seed, number=0).recordings()
