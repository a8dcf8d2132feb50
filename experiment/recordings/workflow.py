"""Recording a protocol's materials: the walk through materials, speeds and takes, each step shown beside its target.

A take begins where the panel first shakes after the foot reached what lies there. An object is lower than the gate's
top, so the stretch begins when the foot passes that; on the bare panel it begins at contact. Both times come from the
tracker's counter, tied to the host's clock by the least delayed frame, as the accelerometer's samples are. `SOONER_NS`
and `LATER_NS` are the margins.
"""

from collections import deque
from contextlib import closing
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Protocol as Port

from palpate.experiment.apparatus import opening
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.panel import accelerometer as accelerometers
from palpate.experiment.apparatus.panel.accelerometer import Accelerometer, Window
from palpate.experiment.apparatus.ports import Tracker
from palpate.experiment.apparatus.rig import tracker_of
from palpate.experiment.apparatus.tracker import zeroing
from palpate.experiment.apparatus.tracker.gate import Contact, Gate, GateDetector
from palpate.experiment.apparatus.tracker.zeroing import ZeroedTracker
from palpate.experiment.clock import Clock, MonotonicClock, day
from palpate.experiment.errors import RecordingError
from palpate.experiment.protocol import files
from palpate.experiment.protocol.kinds.footstep import Footstep
from palpate.experiment.recordings import store
from palpate.experiment.recordings.store import Condition, Plan, plan

SPEED_TOLERANCE = 0.10
"""A step is on target when its speed is off by this part at most: less than half the way to the next recorded speed."""

SOONER_NS = 50_000_000
"""How much earlier a take may begin, ns: streams stall by up to 31 ms, and a predicted contact is some ms uncertain."""

LATER_NS = 150_000_000
"""How much later than contact a take may begin, ns: also for up to 100 ms of delay in a sound server."""

REST_NS = 20_000_000
"""A take that begins this soon after a knock may be its remainder, ns."""

RECENT_FRAMES = 1000
"""The counter is tied to the host's clock by the last pieces of the stream, so that the two may drift apart slowly."""


@dataclass(frozen=True)
class Step:
    """A recorded step.

    `achieved_mm_s` is the foot's mean speed through the gate; `window` is None if the panel did not shake. A knock came
    `knock_ms` before contact, None for none; if `restless`, the panel may still have shaken from it.
    """

    condition: Condition
    achieved_mm_s: float
    window: Window | None
    knock_ms: float | None = None
    restless: bool = False

    @property
    def deviation(self) -> float:
        """Return how far the achieved speed is from its target, as a part of the target."""
        return self.achieved_mm_s / self.condition.speed_mm_s - 1

    @property
    def problems(self) -> tuple[str, ...]:
        """Return what speaks against keeping the step; empty for a good take."""
        found = []
        if abs(self.deviation) > SPEED_TOLERANCE:
            found.append(f"the speed is off by {self.deviation:+.0%}, more than {SPEED_TOLERANCE:.0%}")
        if self.window is None:
            found.append("the panel did not vibrate")
        elif self.window.clipped:
            found.append(f"{self.window.clipped} samples exceed the accelerometer's full scale")
        found += [gap.sentence for gap in self.window.gaps] if self.window is not None else []
        if self.restless:
            found.append("the panel may still have been vibrating from an earlier knock")
        return tuple(found)

    @property
    def verdict(self) -> str:
        """Return what the experimenter should know about the step."""
        notes = () if self.knock_ms is None else (f"an impact {self.knock_ms:.0f} ms before contact was ignored",)
        return "; ".join([*(self.problems or (f"within {SPEED_TOLERANCE:.0%}",)), *notes])


@dataclass(frozen=True)
class Landing:
    """A foot that came down: its speed through the gate, and the host's time at the gate's top and at the panel."""

    speed_mm_s: float
    gate_ns: int
    contact_ns: int


class TakesConsole(Port):
    """What the experimenter sees and keys while takes are recorded."""

    def place(self, condition: Condition, *, done: int, total: int) -> None:
        """Have the panel made ready; return when it is."""

    def arm(self, condition: Condition, *, attempt: int) -> None:
        """Say that the foot may step; return at once."""

    def keeps(self, step: Step) -> bool:
        """Show the step beside its target; return whether it is kept. A step without a window never is."""


class RigConsole(TakesConsole, Port):
    """What the experimenter sees and keys at a real rig: a foot may have to rest there."""

    def rest(self, why: str) -> None:
        """Return when the foot rests on the bare panel; `why` says what was wrong the time before."""


def record_on_rig(
    *,
    protocol_file: Path,
    rig_file: Path,
    out: Path,
    console: RigConsole,
    speeds_mm_s: tuple[float, ...] = (),
    takes: int | None = None,
) -> Path:
    """Record on a real rig, or continue, and return the manifest's path.

    The rig file needs a table `[accelerometer]`; nothing is played. `out` is new or empty. `speeds_mm_s` and `takes`
    replace the protocol's unless empty or None. Raises `PalpateError` if a file or a part cannot be used.
    """
    protocol, rig = files.load(protocol_file), rigs.load(rig_file)
    if rig.rig.simulated:
        raise RecordingError(
            rig_file, "is a simulated rig", "give another rig, or record with --simulated", allowed="a real one"
        )
    rigs.check(rig, protocol.table(Footstep).step)
    clock = MonotonicClock()
    zeroing.check_age(rig, day(clock.now_ns()))
    planned = plan(
        protocol,
        source=f"rig {rig.rig.name}",
        simulated=False,
        rig_sha256=rigs.sha256(rig),
        speeds_mm_s=speeds_mm_s,
        takes=takes,
    )
    store.check(out, planned)
    accelerometer = accelerometers.open_accelerometer(
        rig, rate_hz=protocol.table(Footstep).synthesis.rate_hz, clock=clock
    )
    with closing(accelerometer):
        tracker = opening.open_tracker(rig, clock=clock, contact_mm=protocol.table(Footstep).step.contact_mm)
        with closing(tracker):
            zeroing.check_reading(tracker, tracker_of(rig))
            if isinstance(tracker, ZeroedTracker):
                tracker.settle(console.rest)
            return record(
                planned,
                out,
                tracker=tracker,
                accelerometer=accelerometer,
                detector=GateDetector(protocol.table(Footstep).step),
                console=console,
                clock=clock,
            )


def record(
    planned: Plan,
    out: Path,
    *,
    tracker: Tracker,
    accelerometer: Accelerometer,
    detector: GateDetector,
    console: TakesConsole,
    clock: Clock,
    note: str = "",
) -> Path:
    """Record what is missing, write the recordings, and return the manifest's path.

    `note` is for the manifest. Raises `RecordingError` as `store.check` or of the accelerometer, and `TrackerError`.
    """
    conditions = planned.conditions()
    with store.begun(planned, out) as folder:
        for place, condition in enumerate(conditions):
            path = store.take_path(folder, place)
            if path.exists():
                continue
            console.place(condition, done=place, total=len(conditions))
            for attempt in count(1):
                tracker.drain()
                accelerometer.arm(planned.samples)
                console.arm(condition, attempt=attempt)
                step = _listened(condition, _landing(tracker, detector, clock), accelerometer)
                if console.keeps(step) and step.window is not None:
                    zero = tracker.zero if isinstance(tracker, ZeroedTracker) else None
                    store.save_take(path, step.window, step.achieved_mm_s, zero)
                    break
        return store.publish(planned, out, note=note)


def _landing(tracker: Tracker, detector: GateDetector, clock: Clock) -> Landing:
    """Follow the foot until it is down, and return its landing."""
    state = detector.init()
    gate: Gate | None = None
    recent_ns: deque[int] = deque(maxlen=RECENT_FRAMES)
    while True:
        samples = tracker.read()
        recent_ns.append(clock.now_ns() - int(samples.device_us[-1]) * 1000)
        state, events = detector.step(state, samples)
        for event in events:
            if isinstance(event, Gate):
                gate = event
            elif isinstance(event, Contact) and gate is not None:
                gate_ns, contact_ns = (round(us * 1e3) + min(recent_ns) for us in (gate.top_us, event.us))
                return Landing(round(gate.speed_mm_s, 3), gate_ns, contact_ns)


def _listened(condition: Condition, landing: Landing, accelerometer: Accelerometer) -> Step:
    """Return the step, with what the accelerometer recorded of it."""
    touched_ns = landing.contact_ns if condition.material is None else landing.gate_ns
    heard = accelerometer.heard(earliest_ns=touched_ns - SOONER_NS, latest_ns=landing.contact_ns + LATER_NS)
    if heard.knock_ns is None:
        return Step(condition, landing.speed_mm_s, heard.window)
    restless = heard.begun_ns is not None and heard.begun_ns - heard.knock_ns < REST_NS
    knock_ms = (landing.contact_ns - heard.knock_ns) / 1e6
    return Step(condition, landing.speed_mm_s, heard.window, knock_ms, restless)
