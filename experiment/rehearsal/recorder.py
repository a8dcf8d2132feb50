"""SIMULATED recording: a foot at the tracker's port, a sensor at the accelerometer's, and nobody at the keys.

The walk and the drivers are those of a real recording; the simulated experimenter keeps what is on target.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from experiment.apparatus import opening
from experiment.apparatus import rig as rigs
from experiment.apparatus.clock_map import ClockMap
from experiment.apparatus.gate import GateDetector
from experiment.clock import Clock, ManualClock
from experiment.errors import RecordingError
from experiment.protocol import load
from experiment.recordings import partial, workflow
from experiment.recordings.manifest import Recordings
from experiment.recordings.plan import Condition, Plan, plan
from experiment.recordings.workflow import Step
from experiment.rehearsal import takes as takes_of
from experiment.rehearsal.foot import Foot
from experiment.rehearsal.materials import CRUSH_MM
from experiment.rehearsal.sensor import PassingTime, Sensor
from experiment.rehearsal.serial_line import SerialLine
from experiment.rehearsal.takes import RecordingSession

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
    protocol, rig = load.load(protocol_file), rigs.load(rig_file)
    if not rig.rig.simulated:
        raise RecordingError(f"{rig_file}: a real rig; allowed: one that says simulated = true; leave out --simulated")
    if rig.tracker.zeroing_mm is not None:
        raise RecordingError(
            f"{rig_file}: tracker.zeroing_mm: got {rig.tracker.zeroing_mm:g}; allowed: none, for in simulated time no "
            "foot rests on the panel; leave it out of this rig file"
        )
    rigs.check(rig, protocol.step)
    planned = plan(
        protocol,
        source=takes_of.source(seed),
        simulated=True,
        rig_sha256=rigs.sha256(rig),
        speeds_mm_s=speeds_mm_s,
        takes=takes,
    )
    partial.check(out, planned)
    drawn = takes_of.session(planned, seed=seed)
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
            detector=GateDetector(protocol.step),
            console=experimenter,
            clock=clock,
            note=takes_of.note(drawn),
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
