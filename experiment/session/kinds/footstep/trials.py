"""Footstep trials, a kind of trial: lay out and arm, watch the step, and say what goes on record of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, replace
from datetime import date
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from palpate.experiment.apparatus import opening
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.ports import Actuator, Tracker
from palpate.experiment.apparatus.rig import Rig, tracker_of
from palpate.experiment.apparatus.tracker import zeroing
from palpate.experiment.apparatus.tracker.clock_map import ClockMap
from palpate.experiment.apparatus.tracker.frames import LinkCounts
from palpate.experiment.apparatus.tracker.gate import GateDetector, Scrutiny
from palpate.experiment.apparatus.tracker.landing import NOISE_MM, LandingPredictor
from palpate.experiment.apparatus.tracker.settings import TrackerRig
from palpate.experiment.apparatus.tracker.zeroing import ZeroedTracker
from palpate.experiment.clock import lasted_ms
from palpate.experiment.desk.messages import TRACE_S, Lamp, Measured, Pace
from palpate.experiment.desk.questions import STEP, Place, Rest
from palpate.experiment.errors import ActuatorError, RecordingError, TrackerError, TrackerStopped
from palpate.experiment.protocol.kinds.footstep import Footstep
from palpate.experiment.protocol.models import ExclusionRule, Protocol, Task
from palpate.experiment.records.entries import PlannedTrial, Trace, TrackerOpened
from palpate.experiment.records.kinds.footstep import BrokenOff, FootStep, Probed, Zeroed
from palpate.experiment.records.stimulus import Onset
from palpate.experiment.records.tracker import Link, TrackerClock
from palpate.experiment.session import scene
from palpate.experiment.session.kind import (
    FarEnds,
    Kind,
    Lent,
    Seen,
    SessionKind,
    Sitting,
    Stimuli,
    nothing_more,
    open_actuator,
)
from palpate.experiment.session.kinds.footstep.stimulus import Sounder
from palpate.experiment.session.kinds.footstep.watch import (
    TAIL_US,
    BrokenStep,
    Feed,
    Watch,
    WatchedStep,
    watch,
)

if TYPE_CHECKING:
    from palpate.experiment.apparatus.audio.stream import AudioStream
    from palpate.experiment.synthesis.waveforms import Basis

CLOCKS_PART_US = 10e6
"""Device and session time may part by this much: a slow step, and what came before the first."""

CLOCKS_DRIFT = 0.01
"""And by this part of the time passed: the largest drift that clock_map.py believes, twice a ceramic resonator's."""

PROBE_TAKES_NS = 200_000_000
"""From a probe that is asked for until it sounds at the latest, ns: one block of any audio device, and its latency."""

SILENT_NS = 1_000_000_000
"""So long the device of an earlier stimulus may take to fall silent, ns."""

LOOK_NS = 5_000_000
"""Between two looks whether it is, ns."""

TRACE_US = 50_000
"""The trace has a point for so long, microseconds."""

STILL_PLAYS = "the last stimulus may still be playing; restart the actuator's server, then resume the session"

MISSING = 0.01
"""A tracker of whose frames a larger share is lost or damaged is told as not good."""


@dataclass(frozen=True)
class FootstepDevices:
    """Implements `KindDevices`; what the task's scene leaves out is None.

    A `ZeroedTracker` is zeroed before the first attempt, and after a reconnection. `tracker_port` is the port's name in
    the journal, `noise_mm` the sensor's noise, mm rms. `scrutiny` checks readings; `materials` are prepared, by id.
    `weighed` are the tracker's settings where the force of the foot goes on record.
    """

    tracker: Tracker
    tracker_port: str
    noise_mm: float
    scrutiny: Scrutiny
    actuator: Actuator | None
    materials: Mapping[str, Basis] | None
    weighed: TrackerRig | None = None

    def begin(self, lent: Lent) -> Footsteps:
        return Footsteps(self, lent)


def open_footsteps(sitting: Sitting, stream: AudioStream | None, ends: FarEnds, opened: ExitStack) -> FootstepDevices:
    """Open what a task of footsteps needs, until `opened` closes; otherwise as `laboratory.open_laboratory`."""
    protocol, rig, clock = sitting.protocol, sitting.rig, sitting.clock
    planned = scene.plan(protocol=protocol, task_id=sitting.task_id)
    stimuli = Stimuli({}, None)
    if planned.synthesis:
        if sitting.recordings is None:
            where = f"task '{sitting.task_id}'"
            raise RecordingError(where, "got no recordings", "give one", allowed="a folder of recordings")
        stimuli = ends.stimuli(partial(_prepared, planned, sitting, sitting.recordings))
    actuator: Actuator | None = None
    if planned.actuator:
        actuator = open_actuator(sitting, stimuli.drive, stream=stream, ends=ends, opened=opened)
    port, clock_map = ends.tracker(opened)
    contact_mm = protocol.table(Footstep).step.contact_mm
    tracker = opening.open_tracker(rig, clock=clock, port=port, clock_map=clock_map, contact_mm=contact_mm)
    opened.callback(tracker.close)
    ends.check(tracker, rig)
    settings = tracker_of(rig)
    noise_mm = NOISE_MM if settings.noise_mm is None else settings.noise_mm
    return FootstepDevices(
        tracker,
        tracker_port=port or settings.port,
        noise_mm=noise_mm,
        scrutiny=Scrutiny(rate_hz=settings.rate_hz, noise_mm=noise_mm, resolution_mm=settings.resolution_mm),
        actuator=actuator,
        materials=stimuli.materials or None,
        weighed=settings if protocol.table(Footstep).force else None,
    )


def _prepared(planned: scene.Scene, sitting: Sitting, recordings: Path) -> Stimuli:
    from palpate.experiment.apparatus.panel.conditioning import open_drive
    from palpate.experiment.session.kinds.footstep.preparation import open_stimuli

    protocol, rig = sitting.protocol, sitting.rig
    materials = open_stimuli(
        scene=planned,
        protocol=protocol,
        recordings=recordings,
        output_rate_hz=rig.actuator.rate_hz,
        participant=sitting.participant,
    )
    folder, limit_m_s2 = sitting.rig_file.parent, protocol.exposure.vibration_peak_m_s2
    return Stimuli(materials, open_drive(folder, rig.actuator, limit_m_s2=limit_m_s2, materials=materials))


@dataclass(frozen=True)
class Armed:
    """An attempt that was armed; `dead_time_ms` as in `FootStep`."""

    planned: PlannedTrial
    attempt: int
    dead_time_ms: float | None


class Footsteps(Kind):
    """Each attempt is one step of the foot."""

    def __init__(self, devices: FootstepDevices, lent: Lent) -> None:
        """Set up before the first attempt."""
        protocol, clock, limits = lent.protocol, lent.clock, lent.limits
        step = protocol.table(Footstep).step
        self._protocol = protocol
        self._task = task = protocol.task(lent.header.task)
        self._devices = devices
        self._lent = lent
        self._clock = clock
        self._log = lent.log
        self._limits = limits
        self._watch = Watch(
            feed=Feed(devices.tracker, simulated_time=clock.simulated),
            scrutiny=devices.scrutiny,
            detector=GateDetector(step),
            predictor=LandingPredictor(step, noise_mm=devices.noise_mm),
            clock=clock,
            limits=limits,
            sounder=Sounder(devices.materials, devices.actuator, task.ahead)
            if devices.materials and devices.actuator
            else None,
            tail_us=import_module(FORCE).UNTIL_US if devices.weighed else TAIL_US,
        )
        self._steps = self._watch
        """With what the stimulus of the attempt under way is."""
        self._opened: TrackerOpened | None = None
        self._broken: tuple[int, BrokenStep] | None = None
        self._armed: Armed | None = None
        self._last = ""
        self._pace: Pace | None = None
        self._counted = False
        self._delivered: bool | None = None
        self._silent = False

    def ready(self, planned: PlannedTrial, attempt: int, answered_ns: int | None) -> None:
        """Arm the attempt. After a step that broke off the foot is still watched, so that nothing is missed."""
        self._counted = False
        if (level := self._log.done.levels.get(planned.trial)) is not None:
            levels = import_module("palpate.experiment.session.kinds.footstep.levels")
            self._steps = levels.at_level(self._watch, planned.presented[0], level)
        try:
            self._arm(planned, attempt, answered_ns)
        except TrackerStopped:
            self._silent = True
            raise

    def _arm(self, planned: PlannedTrial, attempt: int, answered_ns: int | None) -> None:
        clock, tracker = self._clock, self._devices.tracker
        broken, self._broken = self._broken, None
        if isinstance(tracker, ZeroedTracker) and tracker.zero is None:
            zero = tracker.settle(lambda why: self._lent.console.ask(Rest(why)))
            self._log.write(Zeroed(offset_mm=zero.offset_mm, spread_mm=zero.spread_mm, samples=zero.samples))
            self._lent.show(f"Zeroed: the foot rests at {zero.offset_mm:+.2f} mm from contact.")
        silent = self._falls_silent(self._limits.end_reason)
        if self._limits.end_reason():
            return
        if not silent:
            raise ActuatorError("actuator", STILL_PLAYS)
        if broken is not None and broken[0] == planned.trial and not broken[1].felt:
            if self._lent.arm(planned, attempt, may=STEP, broken_off=broken[1].reason):
                self._watch.feed.drain()
            self._armed = Armed(planned, attempt, None)
            return
        laid_ns = 0
        if self._task.stimulus == "real":
            begun_ns = clock.now_ns()
            self._lent.console.ask(Place(planned.trial, planned.presented))
            laid_ns = clock.now_ns() - begun_ns
            if self._limits.end_reason():
                return
        self._watch.feed.drain()
        if self._lent.arm(planned, attempt, may=STEP):
            # A step that was made while nobody was at the console is none of a trial.
            self._watch.feed.drain()
        dead_time_ms = None if answered_ns is None else lasted_ms(clock, answered_ns + laid_ns)
        self._armed = Armed(planned, attempt, dead_time_ms)

    def watch(self, waiting: Callable[[], AbstractContextManager[None]]) -> Seen:
        """Watch the step that was armed, and put its raw frames on disk."""
        armed, self._armed = self._armed, None
        if armed is None:
            raise RuntimeError("no step is watched before it was armed")
        step = watch(self._steps, armed.planned.presented[0], waiting)
        clock, error = self._parted(step)
        if clock is not None:
            step = _reclocked(clock, step)
        self._silent = isinstance(step, BrokenStep) and step.stopped is not None
        trace = self._log.keep(step.raw)
        if isinstance(step, BrokenStep):
            silent = self.is_silent()
            self._broken = armed.planned.trial, step
            if step.felt and step.stopped is None and step.failed is None:
                self._lent.show(f"This step does not count: {step.reason}.")
            return Seen(
                _broken_off(armed, step, trace, silent=silent),
                reason=step.reason,
                lost=step.stopped is not None,
                failed=step.failed or error,
            )
        heard = step.onset.delivered if step.onset is not None else None
        repeat, self._last = self._repeat(step), f"{step.gate.speed_mm_s:.0f} mm/s"
        self._counted = not repeat and error is None
        self._pace = pace(step.gate.speed_mm_s, self._protocol.exclusion)
        self._delivered = None if heard is None else heard.delivered
        return Seen(
            _foot_step(armed, step, trace, self._devices.weighed),
            answerable_ns=step.contact_ns,
            failed=error,
            delivered=self._delivered,
            repeat=repeat,
        )

    def quiet(self, why: str) -> None:  # noqa: ARG002
        """Take back the stimulus that is prepared, and hang up on one that plays."""
        if self._devices.actuator is not None:
            self._devices.actuator.withdraw()

    def is_silent(self) -> bool | None:
        """Return whether the panel is silent, and tell the experimenter if it is not; None without an actuator."""
        if self._devices.actuator is None:
            return None
        silent = self._falls_silent(lambda: "")
        if not silent:
            self._lent.show(f"The panel may move at any time: {STILL_PLAYS}.")
        return silent

    def _falls_silent(self, over: Callable[[], str]) -> bool:
        """Return whether no earlier stimulus can sound any more; wait for that, unless the session is over."""
        actuator, ends_ns = self._devices.actuator, self._clock.now_ns() + SILENT_NS
        while actuator is not None and not actuator.is_silent():
            if over() or self._clock.now_ns() >= ends_ns:
                return False
            self._clock.sleep_ns(LOOK_NS)
        return True

    def measured(self) -> Measured:
        """Return the foot's height in the last seconds, mm, and how the last step went."""
        gone = self._silent or getattr(self._devices.tracker, "gone", False)
        # A trace that stands still would show a foot that rests.
        newest, step = () if gone else tuple(self._watch.feed.newest), self._protocol.table(Footstep).step
        heights = _sampled(newest)
        falling = len(heights) > 1 and heights[-1] < heights[-2]
        return Measured(
            trace=heights,
            trace_unit="mm",
            moving=falling and step.contact_mm < heights[-1] <= step.gate_top_mm,
            stepped=self._counted,
            last=self._last,
            pace=self._pace,
            delivered=self._delivered,
            lamps=(self._tracker_lamp(gone=gone),),
        )

    @property
    def probe(self) -> Callable[[], None] | None:
        """What plays the masker's probe; None without one, or without an actuator."""
        return None if self._protocol.masker.probe is None or self._watch.sounder is None else self._play_probe

    def _play_probe(self) -> None:
        probe, sounder = self._protocol.masker.probe, self._watch.sounder
        if probe is None or sounder is None:
            raise RuntimeError("there is no probe to play, or no actuator to play it")
        if over := self._limits.end_reason():
            self._lent.show(nothing_more(over))
            return
        played = sounder.actuator.prepare(sounder.materials[probe.material].at(probe.speed_mm_s))
        stimulus = played.on_record()
        self._log.write(Probed(material=probe.material, speed_mm_s=probe.speed_mm_s, stimulus=stimulus))
        began_ns = self._clock.now_ns()
        sounder.actuator.landed(began_ns)
        # Nothing else may be asked of the actuator before this has ended.
        self._clock.sleep_ns(PROBE_TAKES_NS + stimulus.samples * 10**9 // stimulus.rate_hz)
        self._lent.show("The probe was played.")

    def _tracker_lamp(self, *, gone: bool) -> Lamp:
        if gone:
            return Lamp(name="tracker", good=False, words="no signal; unplug it and plug it in again")
        counts = self._watch.feed.counts
        missing = counts.lost + counts.damaged
        share = missing / max(counts.received + missing, 1)
        words = "no frame lost" if not missing else f"{missing} frames lost or damaged ({share:.2%})"
        return Lamp(name="tracker", good=share <= MISSING, words=words if counts.received else "no frame yet")

    def reconnect(self, timeout_s: float) -> None:
        """Wait for the tracker; its device time may be another when it is back."""
        self._devices.tracker.reconnect(timeout_s)
        self._watch.feed.begin_anew()
        self._opened = self._broken = None
        self._silent = False

    def _parted(self, step: WatchedStep | BrokenStep) -> tuple[ClockMap, TrackerError] | tuple[None, None]:
        """Journal the tracker's first frame; return the clock map and the fault of a clock that has parted since."""
        if step.first_us is None or step.clock is None:
            return None, None
        port, now_ns = self._devices.tracker_port, self._clock.now_ns()
        at_us = (step.at_us or 0) if isinstance(step, BrokenStep) else int(step.contact.us)
        if self._opened is None:
            first_ns = step.clock.session_ns(step.first_us)
            self._opened = TrackerOpened(port=port, device_us=step.first_us, t_ns=first_ns)
            self._log.write(self._opened)
        # Where the foot is late on one clock and early on the other, the device restarted between two steps.
        passed_us = (now_ns - self._opened.t_ns) / 1e3
        ahead_us = at_us - self._opened.device_us - passed_us
        if abs(ahead_us) <= CLOCKS_PART_US + CLOCKS_DRIFT * abs(passed_us):
            return None, None
        error = TrackerError(
            f"tracker at {port}",
            f"its clock and the session's differ by {ahead_us / 1e6:.1f} s; the device restarted, or does not "
            "count microseconds",
            "check that it has power and that its frames count microseconds, then resume the session",
        )
        # The step was now, whatever its device says.
        return ClockMap(at_us, now_ns), error

    def _repeat(self, step: WatchedStep) -> str:
        """Return why the protocol has this step done again, if it has."""
        heard = step.onset.delivered if step.onset is not None else None
        for rule in self._protocol.exclusion:
            if rule.action != "repeat-trial":
                continue
            limit = rule.limit or 0.0
            broken = {
                "frames-lost": step.link.lost + step.link.damaged > limit,
                "speed-below": step.gate.speed_mm_s < limit,
                "speed-above": step.gate.speed_mm_s > limit,
                "undelivered": heard is not None and not heard.delivered,
            }
            if broken.get(rule.when, False):
                return f"{rule.id}: {rule.reason}"
        return "" if step.onset is None else self._missed(step.onset)

    def _missed(self, onset: Onset) -> str:
        """Return why a stimulus began too far from its time before contact; empty where it did not."""
        ahead, actuator = self._task.ahead, self._devices.actuator
        # A rehearsal's actuator may be one that cannot be told when to begin: what it plays comes at contact.
        if ahead is None or ahead.error_max_ms is None or actuator is None or not actuator.lead_ns:
            return ""
        if abs(onset.off_ms) <= ahead.error_max_ms:
            return ""
        return f"ahead: the vibration began {onset.off_ms:+.1f} ms off schedule; allowed: {ahead.error_max_ms:g} ms"


def pace(speed_mm_s: float, rules: Iterable[ExclusionRule]) -> Pace | None:
    """Return how a speed lies to the range that a protocol's rules leave; None where no rule is about speed."""
    speeds = [(rule.when, rule.limit) for rule in rules if rule.limit is not None and rule.when.startswith("speed-")]
    if any(when == "speed-below" and speed_mm_s < limit_mm_s for when, limit_mm_s in speeds):
        return "slow"
    if any(when == "speed-above" and speed_mm_s > limit_mm_s for when, limit_mm_s in speeds):
        return "fast"
    return "right" if speeds else None


def _sampled(newest: tuple[tuple[int, float], ...]) -> tuple[float, ...]:
    """Return the heights of the last seconds, mm, one for each twentieth of a second, oldest first."""
    if not newest:
        return ()
    last_us = newest[-1][0]
    by_age = {(last_us - us) // TRACE_US: mm for us, mm in newest if 0 <= last_us - us < TRACE_S * 1e6}
    return tuple(round(by_age[age], 1) for age in sorted(by_age, reverse=True))


def _reclocked(clock: ClockMap, step: WatchedStep | BrokenStep) -> WatchedStep | BrokenStep:
    """Return the step by another clock."""
    if isinstance(step, BrokenStep):
        return replace(step, clock=clock)
    contact_ns = clock.session_ns(step.contact.us)
    onset = step.onset.model_copy(update={"contact_ns": contact_ns}) if step.onset is not None else None
    return replace(step, clock=clock, contact_ns=contact_ns, onset=onset)


def _foot_step(armed: Armed, step: WatchedStep, trace: Trace, weighed: TrackerRig | None) -> FootStep:
    return FootStep(
        trial=armed.planned.trial,
        attempt=armed.attempt,
        presented=armed.planned.presented,
        clock=_clock(step.clock),
        dead_time_ms=armed.dead_time_ms,
        gate_top_us=step.gate.top_us,
        gate_bottom_us=step.gate.bottom_us,
        contact_us=step.contact.us,
        contact_standard_error_ms=step.contact.standard_error_us / 1e3,
        speed_mm_s=step.gate.speed_mm_s,
        link=_link(step.link),
        trace=trace,
        stimulus=step.stimulus,
        onset=step.onset,
        force=import_module(FORCE).pressed(step.raw, weighed, step.gate.top_us, step.contact.us) if weighed else None,
    )


def _broken_off(armed: Armed, step: BrokenStep, trace: Trace, *, silent: bool | None) -> BrokenOff:
    gate = step.gate
    return BrokenOff(
        trial=armed.planned.trial,
        attempt=armed.attempt,
        presented=armed.planned.presented,
        reason=step.reason,
        felt=step.felt,
        silent=silent,
        clock=_clock(step.clock) if step.clock else None,
        dead_time_ms=armed.dead_time_ms,
        at_us=step.at_us,
        gate_top_us=gate.top_us if gate else None,
        gate_bottom_us=gate.bottom_us if gate else None,
        speed_mm_s=gate.speed_mm_s if gate else None,
        link=_link(step.link),
        trace=trace,
        stimulus=step.stimulus,
        begun=step.begun,
    )


def _clock(known: ClockMap) -> TrackerClock:
    return TrackerClock(anchor_us=known.anchor_us, anchor_ns=known.anchor_ns, drift_ppm=known.drift_ppm)


def _link(counts: LinkCounts) -> Link:
    return Link(received=counts.received, lost=counts.lost, damaged=counts.damaged, repeated=counts.repeated)


def _recorded(protocol: Protocol, tasks: Sequence[Task]) -> set[str]:
    probe = protocol.masker.probe
    wanted = {material for task in tasks for material in protocol.materials_of(task)}
    return wanted | {probe.material for task in tasks if probe is not None and task.masker != "none"}


def _check_rig(protocol: Protocol, rig: Rig, today: date) -> None:
    rigs.check(rig, protocol.table(Footstep).step)
    check_force(rig, protocol)
    zeroing.check_age(rig, today)
    if protocol.table(Footstep).force:
        import_module(FORCE).check_age(rig, today)


def check_force(rig: Rig, protocol: Protocol) -> None:
    """Raise `RigError` for a rig without a tracker, or whose sensor of the force does not go with the protocol."""
    if (tracker_of(rig).force is None) == (recorded := protocol.table(Footstep).force):
        getattr(import_module(FORCE), "check" if recorded else "refuse")(rig)


FORCE, _ROOM = "palpate.experiment.apparatus.wires.foot_force", "palpate.experiment.session.kinds.footstep"
KIND = SessionKind(
    open_footsteps,
    _recorded,
    _check_rig,
    f"{_ROOM}.fidelity",
    f"{_ROOM}.doctor",
    frames=lambda _: Trace,
    recordings=f"{_ROOM}.preparation",
)
