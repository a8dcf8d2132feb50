"""A simulated participant who compares two samples by tapping them.

It judges hardness by how high taps feel (`surfaces.felt_hz`), with an error a sample: the higher live sample is the
harder one; for virtual ones of Table 1 hardness is FITTED to Table 3 of Wellman and Howe (`surfaces.virtual_hardness`).
A pair that feels nearly alike takes longer. `experiment/decisions.md` has the other parameters, none of which is
fitted. A vibration that comes later feels as more of whatever is asked.
"""

import time
from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.apparatus.servo.opening import servo_of
from palpate.experiment.desk.questions import Arm, Place, Question, Reply
from palpate.experiment.errors import ActuatorError
from palpate.experiment.protocol.designs.comparison import Comparison
from palpate.experiment.protocol.kinds.tapping import Tapping, rendered
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.rehearsal.designs import Percept, judge_of
from palpate.experiment.rehearsal.kind import Parts, RehearsalKind
from palpate.experiment.rehearsal.kinds.tapping import hand, pushed, surfaces
from palpate.experiment.rehearsal.participant import SimulatedPerson
from palpate.experiment.rehearsal.wires.foot import Foot
from palpate.experiment.rehearsal.wires.panel import CardPanel, Panel

DISCRIMINATION = 0.25
SPREAD = 0.3
LEANING = 0.05

DECIDES_LOG_S = (1.6, 0.35)
"""Mean and sd of log seconds from both samples laid out to the keyed answer: median 5 s, up to twice if alike. Ours."""

LAYS_OUT_S = (2.0, 5.0)
"""What the simulated experimenter takes to lay out a pair, s. Ours."""

THINKS_S = (0.3, 0.8)
"""Before each tap on a virtual surface, s. Ours."""

AGAIN = 0.3
"""Part of the pairs that feel nearly alike of which both are tapped once more. Ours."""

THRESHOLD_M_S2 = 0.1
"""A vibration with a lower peak is not felt. Ours: no tap of Table 1 is as weak."""

LATER_MS = 10.0
"""So much later a vibration feels as much more of whatever is asked as what is just told apart. Ours."""

BEGINS_PART = 0.05
"""A vibration begins where it first exceeds this part of its peak. Ours."""

FELT_TIMEOUT_S = 5.0
"""How long a vibration is waited for, and its entry in the journal, wall-clock time, s."""

TAPS_AT_MOST = 3
"""In real time a hand that feels nothing taps again, up to so often in all. Ours."""

_LOOK_S = 0.0005


@dataclass(frozen=True)
class Fingers:
    """A hand at the tracker's line, powered at session time `powered_ns`, and the vibration it feels, at `rate_hz`.

    It holds a `device`; None where nothing pushes it.
    """

    foot: Foot
    powered_ns: int
    panel: Panel | CardPanel | None
    rate_hz: int
    device: pushed.Device | None = None


@dataclass(kw_only=True)
class SimulatedTapper(SimulatedPerson):
    """Implements `Console`: a participant before two samples, and a simulated experimenter who lays them out.

    With `fingers` the samples are virtual: what is felt is what was delivered.
    """

    fingers: Fingers | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        rng = self._own_rng()
        self._discrimination = DISCRIMINATION * float(np.exp(SPREAD * rng.normal()))
        self._leaning = LEANING * float(rng.normal())
        names = [material.id for material in self.protocol.materials]
        rising = names if self.protocol.table(Comparison).ordered else surfaces.mixed(names)
        felt_hz = [surfaces.felt_hz(surfaces.rings(hz), surfaces.RATE_HZ) for hz in surfaces.frequencies_hz(rising)]
        self._heights = {name: (float(np.log(hz or 1.0)), 1.0) for name, hz in zip(rising, felt_hz, strict=True)}
        self._in_table_1 = all(name in surfaces.TABLE_1 for name in names)
        self._laid: tuple[str, ...] = ()
        self._times: Counter[int] = Counter()
        self._felt: list[tuple[float, float]] = []

    def ask(self, question: Question | Arm) -> Reply:
        reply = super().ask(question)
        match question:
            case Place(trial=trial, presented=presented):
                self._laid = presented
                self._times[trial] += 1
                self.clock.sleep_ns(int(self._rng(trial, self._times[trial], 0).uniform(*LAYS_OUT_S) * 1e9))
            case Arm(trial=trial, attempt=attempt):
                self._times[trial] = attempt
                self._felt = []
        return reply

    def says(self, trial: int) -> tuple[str, str]:
        rng = self._rng(trial, self._times[trial], 1)
        if self.fingers is None:
            heights = [self._heights[name] for name in self._laid]
        else:
            self._felt.append(self._tap(self.fingers, self._rng(trial, self._times[trial], 2, len(self._felt))))
            heights = self._felt[-2:]
            if len(self._felt) % 2 or self._tries_again(heights, rng.random()):
                return self.protocol.table(Tapping).switch_key, "the other one, please"
        felt = [
            Percept(strength=height, error=error, told_apart=self._discrimination, favour=self._leaning)
            for height, error in heights
        ]
        judged = judge_of(self.protocol.task(self.who[1]))(self.protocol, felt, rng)
        self.clock.sleep_ns(int(rng.lognormal(*DECIDES_LOG_S) * (1 + np.exp(-abs(judged.apart))) * 1e9))
        return judged.key, judged.words

    def _tries_again(self, heights: list[tuple[float, float]], drawn: float) -> bool:
        """Return whether both are tapped once more."""
        alike = abs(heights[0][0] - heights[1][0]) < self._discrimination
        return alike and drawn < AGAIN and len(self._felt) < 4

    def _tap(self, fingers: Fingers, rng: np.random.Generator) -> tuple[float, float]:
        """Tap the surface that lies there, and return how hard that felt, and its error in discriminations."""
        if fingers.panel is None:
            raise ActuatorError("the simulated fingers have no actuator", remedy="use a rig with an actuator")
        felt, left = self._once(fingers, fingers.panel, rng), TAPS_AT_MOST - 1
        while felt is None and left and not self.clock.simulated:
            felt, left = self._once(fingers, fingers.panel, rng), left - 1
        weak = felt is None or np.abs(felt).max(initial=0.0) < THRESHOLD_M_S2
        height_hz = None if felt is None or weak else surfaces.felt_hz(felt, fingers.rate_hz)
        later = 0.0 if felt is None or weak else DISCRIMINATION * _silent_ms(felt, fingers.rate_hz) / LATER_MS
        if not self._in_table_1:
            return float(np.log(height_hz or 1.0)) + later, 1.0
        hardness, error = surfaces.virtual_hardness(height_hz)
        return DISCRIMINATION * hardness + later, error

    def _once(self, fingers: Fingers, panel: Panel | CardPanel, rng: np.random.Generator) -> NDArray[np.float64] | None:
        """Tap once, and return what was felt of it, m/s^2, shape (n,); None for nothing at all."""
        while panel.felt(0) is not None:
            self.show("The participant felt a vibration from a tap that did not count")
        path = hand.tap(rng)
        if fingers.device is not None:
            path = pushed.moved(path, fingers.device)
        # Simulated time passes before the tap, and again once the tap is on record: no time on record depends on the
        # machine.
        begin_ns = max(
            self.clock.now_ns() + int(rng.uniform(*THINKS_S) * 1e9), fingers.powered_ns + fingers.foot.free_us * 1000
        )
        self.clock.sleep_ns(begin_ns + int(path.duration_us * 1e3) - self.clock.now_ns())
        if not self.clock.simulated:
            begin_ns = self.clock.now_ns()
        stimuli = self.stimuli()
        fingers.foot.step(path, (begin_ns - fingers.powered_ns) // 1000)
        fingers.foot.finish()
        felt = panel.felt(FELT_TIMEOUT_S)
        if felt is not None and self.clock.simulated and stimuli is not None:
            ends_s = time.monotonic() + FELT_TIMEOUT_S
            while self.stimuli() == stimuli and time.monotonic() < ends_s:
                time.sleep(_LOOK_S)
        return felt


def _silent_ms(felt: NDArray[np.float64], rate_hz: int) -> float:
    """Return how long after the touch a vibration, shape (n,), begins, ms."""
    return float(np.argmax(np.abs(felt) > BEGINS_PART * np.abs(felt).max())) / rate_hz * 1e3


def _person(parts: Parts, **everybody: Any) -> SimulatedTapper:
    """Return a participant who taps: with a hand at the tracker's line virtual surfaces, and without one samples."""
    fingers = None
    if parts.foot is not None:
        held = pushed.device_of(everybody["protocol"], parts.rig)
        fingers = Fingers(parts.foot, parts.powered_ns, parts.panel, parts.rig.actuator.rate_hz, held)
    return SimulatedTapper(**everybody, fingers=fingers)


def _rig(protocol: Protocol) -> str:
    """Return the rig with a hand's devices for a study that renders surfaces."""
    return "rigs/rehearsal.toml" if protocol.find(Tapping) is None else "rigs/tapping.toml"


def _lacks_nothing(rig: Rig, protocol: Protocol) -> None:
    if rendered(protocol) is not None:
        servo_of(rig)


REHEARSAL = RehearsalKind(
    person=_person, generic=surfaces.generic, rig=_rig, lacks_nothing=_lacks_nothing, moves=hand.moves
)
