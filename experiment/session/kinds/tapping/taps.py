"""Taps on a virtual surface, while a question is open, each with its vibration, and each on record.

A thread reads the hand. While it falls, its touch is predicted and the vibration aimed at that; what was not aimed
sounds at the touch. The force is the servo's alone.
"""

import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from palpate.experiment.apparatus import host
from palpate.experiment.apparatus.panel.conditioning import Played
from palpate.experiment.apparatus.ports import Actuator
from palpate.experiment.apparatus.servo.link import Servo
from palpate.experiment.apparatus.servo.record import cycles_of, lost_cycles
from palpate.experiment.apparatus.servo.rendering import AGAIN_MM, Felt, Touch
from palpate.experiment.apparatus.tracker.clock_map import ClockMap
from palpate.experiment.apparatus.tracker.landing import Falling, Landing, LandingPredictor
from palpate.experiment.errors import PalpateError, ServoError
from palpate.experiment.protocol.kinds.tapping import Tapping
from palpate.experiment.protocol.models import Step
from palpate.experiment.records.entries import Note
from palpate.experiment.records.kinds.tapping import ForceTrace, Place, Pushed, Tapped
from palpate.experiment.records.stimulus import Onset
from palpate.experiment.session.kind import Lent, nothing_more
from palpate.experiment.synthesis.contact.block import Block
from palpate.experiment.synthesis.tap import Rings

FROM_MM, WANDER_MM = 10.0, 10.0
"""Height from which a touch is predicted, mm, and the travel that changes acceleration by its own scale. Ours."""

AHEAD_NS = 15_000_000
"""A vibration is made ready when the touch lies no further ahead than this and the actuator's own lead, ns. Ours."""

SURE_US = 2_000.0
"""A prediction with a larger standard error aims at nothing, microseconds. Ours."""

ANEW_PART = 0.02
"""A vibration is made anew where the speed to expect has changed by more than this part: a tenth of what is felt."""

MAKES_NS = 3_000_000
"""Nearer to the actuator's lead than this a vibration that is aimed is not made anew: it would come late, ns. Ours."""

LIT_NS, LATE_NS = 500_000_000, 200_000_000
"""So long the lamp stays lit after a hand that was too fast; a touch so long ago sounds no more, ns. Ours."""

ENDS_NS = 150_000_000
"""So long after its end a vibration has been heard by the loopback, ns: `audio.actuator` looks 50 ms around it."""


KEEPS_NS = 2_000_000_000
"""So often force is put on disk, ns, but for a vibration that is on its way. Ours."""


@dataclass(frozen=True)
class Lying:
    """The surface that the hand meets: of which attempt, at which place of the pair, its vibrations and its block.

    They begin `ahead_ns` before the touch; later ones begin with silence.
    """

    trial: int
    attempt: int
    place: Place
    material: str
    rings: Rings
    block: Block
    ahead_ns: int = 0


@dataclass
class _Sounding:
    """One vibration on its way; `speed_mm_s` is what it was made for."""

    lying: Lying
    speed_mm_s: float
    played: Played
    aimed: Landing | None = None
    scheduled_ns: int | None = None
    touch: Touch | None = None
    touch_mm_s: float = 0.0
    contact_ns: int = 0
    fast: bool = False


@dataclass(kw_only=True)
class Taps:
    """The taps of one session, followed from now on; nothing lies there yet, but a `block` for practice.

    `noise_mm` is the tracker's, mm rms.
    """

    servo: Servo
    actuator: Actuator
    block: Block
    noise_mm: float
    lent: Lent

    def __post_init__(self) -> None:
        step = Step(gate_top_mm=FROM_MM, gate_bottom_mm=AGAIN_MM, contact_mm=0.0)
        self._predictor = LandingPredictor(step, noise_mm=self.noise_mm, wander_mm=WANDER_MM)
        self._state: Falling | None = None
        self._armed = True
        self._lying: Lying | None = None
        self._there = True
        self._sounding: _Sounding | None = None
        self.felt: Felt | None = None
        """The newest read."""
        self.touched: set[Place] = set()
        """Where the hand touched a surface since this was cleared."""
        self.last = ""
        """How fast the last touch was."""
        self._dark_ns = self._number = 0
        self._kept_ns = self.lent.clock.now_ns()
        self.failed: PalpateError | None = None
        """Why nothing is rendered any more; None while all is well."""
        self._lock = threading.Lock()
        self._closing = False
        # For practice, without a vibration: nothing lies there before the first trial.
        self._rendered: Block | None = self.block
        self.servo.render(self._rendered, self.lent.limits.ends_ns)
        self._begin()

    def _begin(self) -> None:
        self._thread = threading.Thread(target=self._run, args=(host.joining(),), name="taps", daemon=True)
        self._thread.start()

    @property
    def too_fast(self) -> bool:
        """Whether the lamp is lit that says so: the hand is faster than the protocol has it, or was so just now."""
        return self.lent.clock.now_ns() < self._dark_ns

    @property
    def renders(self) -> bool:
        """Whether a surface can be touched."""
        return self._lying is not None and self.failed is None

    def lay(self, lying: Lying | None) -> None:
        """Have the hand meet a surface from now on, or none. What vibrates goes on record first."""
        force = self.servo.forces()
        with self._lock:
            self._settle(wait=True)
            self._withdraw()
            self._keep(force)
            block = None if lying is None else lying.block
            if (lying is None) != (self._lying is None) or block != self._rendered:
                self._there, self._rendered = lying is not None, block
                self.servo.render(block, self.lent.limits.ends_ns)
            self._lying = lying

    def reconnect(self) -> None:
        """Open what failed anew. Raises `ServoError`."""
        self.servo.reconnect()
        self._state = self.failed = self.felt = None
        self._begin()

    def close(self) -> None:
        """Follow no longer."""
        self._closing = True
        self.servo.stop()
        self._thread.join()

    def _run(self, join: Callable[[], None]) -> None:
        join()
        while not self._closing:
            try:
                felt = self.servo.read()
                with self._lock:
                    self._settle(wait=False)
                    if felt is not None:
                        self.felt = felt
                        if felt.fast:
                            self._dark_ns = self.lent.clock.now_ns() + LIT_NS
                        self._follow(felt)
                    self._keep_now_and_then()
            except PalpateError as error:
                self.servo.render(None)
                self.actuator.withdraw()
                self._sounding, self.failed = None, error
                again = "This trial will be repeated, whatever its answer." if self._lying is not None else ""
                self.lent.show(f"Rendering stopped: {error.sentence()}. {again}")
                return

    def _follow(self, felt: Felt) -> None:
        if self._there and (over := self.lent.limits.end_reason()):
            # Who says so has taken the block away.
            self._there, self._lying = False, None
            self._withdraw()
            self.lent.show(nothing_more(over))
        touches = list(felt.touches)
        for us, mm in zip(felt.device_us, felt.height_mm, strict=True):
            while touches and touches[0].device_us <= us:
                self._touched(touches.pop(0), felt)
            self._armed = self._armed or mm > AGAIN_MM
            self._state = self._predictor.step(self._state, us, mm) if self._armed else None
        for touch in touches:
            self._touched(touch, felt)
        if self._state is not None and self._lying is not None and self.actuator.lead_ns:
            self._expect(self._state, self._lying, felt.clock)

    def _expect(self, state: Falling, lying: Lying, clock: ClockMap) -> None:
        """Aim at a touch that is predicted well and comes soon; take back what was aimed at one that does not come."""
        landing = self._predictor.landing(state)
        if landing is None or landing.standard_error_us > SURE_US:
            if landing is None and self._sounding is not None and self._sounding.touch is None:
                self._withdraw()
            return
        onset_ns = clock.session_ns(landing.us) - lying.ahead_ns
        left_ns, one = onset_ns - self.lent.clock.now_ns() - self.actuator.lead_ns, self._sounding
        if left_ns > AHEAD_NS:
            return
        aimed = one is not None and one.touch is None and one.scheduled_ns is not None
        if one is None or not aimed or (left_ns >= MAKES_NS and self.actuator.aim(onset_ns)):
            one = self._ready(lying, max(_speed_mm_s(state, landing.us), 0.0))
        if one.touch is None and self.actuator.aim(onset_ns):
            one.aimed, one.scheduled_ns = landing, onset_ns

    def _touched(self, touch: Touch, felt: Felt) -> None:
        self._armed = False
        lying, state = self._lying, self._state
        if lying is None:
            return
        contact_ns = felt.clock.session_ns(touch.device_us)
        late_ns = self.lent.clock.now_ns() - contact_ns
        if late_ns > LATE_NS and not self.lent.clock.simulated:
            got = f"the touch was received {late_ns / 1e6:.0f} ms late; allowed: {LATE_NS / 1e6:g} ms"
            raise ServoError(f"{got}; nothing sounded", remedy="find out what delayed the computer or its disk")
        speed_mm_s = touch.speed_mm_s if state is None else _speed_mm_s(state, touch.device_us)
        speed_mm_s = max(speed_mm_s, 0.0)
        self.touched.add(lying.place)
        self.last = f"{speed_mm_s:.0f} mm/s"
        sounding = self._sounding
        if sounding is None or sounding.aimed is None or sounding.lying is not lying:
            sounding = self._ready(lying, speed_mm_s)
        sounding.touch, sounding.touch_mm_s = touch, speed_mm_s
        sounding.fast = touch.mean_mm_s > self.lent.protocol.table(Tapping).fastest_mm_s
        sounding.contact_ns = contact_ns
        self.actuator.landed(contact_ns)
        self._settle(wait=self.lent.clock.simulated or not self.actuator.lead_ns)

    def _ready(self, lying: Lying, speed_mm_s: float) -> _Sounding:
        """Return the vibration of a speed, made ready unless one as good is."""
        self._settle(wait=True)
        was = self._sounding
        if was is None or was.lying is not lying or abs(was.speed_mm_s - speed_mm_s) > ANEW_PART * speed_mm_s:
            self._sounding = was = _Sounding(
                lying, speed_mm_s, self.actuator.prepare(lying.rings.at(speed_mm_s * 1e-3))
            )
        return was

    def _settle(self, *, wait: bool) -> None:
        """Put a touch on record whose vibration has ended; wait for its end if asked to."""
        one = self._sounding
        if one is None or one.touch is None:
            return
        lasts_ns = one.played.samples.size * 10**9 // one.played.stimulus.rate_hz
        if not wait and self.lent.clock.now_ns() < one.contact_ns + lasts_ns + self.actuator.lead_ns + ENDS_NS:
            return
        aimed, touch = one.aimed, one.touch
        onset = Onset(
            predicted_us=aimed.us if aimed else None,
            standard_error_ms=aimed.standard_error_us / 1e3 if aimed else None,
            predicted_from_us=aimed.from_us if aimed else None,
            prediction_error_ms=(aimed.us - touch.device_us) / 1e3 if aimed else None,
            contact_ns=one.contact_ns,
            scheduled_ns=one.scheduled_ns,
            gate_to_scheduled_ms=None,
            delivered=self.actuator.delivered(one.contact_ns - one.lying.ahead_ns),
        )
        self._sounding = None
        self.lent.log.write(
            Tapped(
                trial=one.lying.trial,
                attempt=one.lying.attempt,
                place=one.lying.place,
                material=one.lying.material,
                device_us=touch.device_us,
                speed_mm_s=one.touch_mm_s,
                fast=one.fast,
                stimulus=one.played.on_record(),
                onset=onset,
            )
        )

    def _keep_now_and_then(self) -> None:
        clock = self.lent.clock
        if self._there and self._sounding is None and not clock.simulated and clock.now_ns() > self._kept_ns + KEEPS_NS:
            self._keep(self.servo.forces())

    def _keep(self, raw: bytes) -> None:
        """Put on record the force that was sent since this was called last."""
        self._kept_ns = self.lent.clock.now_ns()
        if not raw:
            return
        numbers = cycles_of(raw)["number"].astype(np.int64)
        lost, self._number = lost_cycles(numbers, self._number), int(numbers[-1]) + 1
        trace = ForceTrace.model_validate(self.lent.log.keep(raw).model_dump())
        self.lent.log.write(Pushed(trace=trace, cycles=numbers.size, lost=lost))

    def _withdraw(self) -> None:
        one, self._sounding = self._sounding, None
        if one is not None and not self.actuator.withdraw() and one.touch is None:
            self.lent.log.write(Note(trial=one.lying.trial, text="A vibration began, but no touch followed."))


def _speed_mm_s(state: Falling, us: float) -> float:
    """Return how fast the hand falls at a device time, mm/s."""
    return -(state.mm_s + state.mm_s2 * (us - state.us) * 1e-6)
