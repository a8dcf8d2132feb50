"""Taps on virtual surfaces, a kind of trial: the participant taps one, changes to the other, and says which."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, field, replace
from datetime import date
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING

from palpate.experiment.apparatus.panel.conditioning import open_conditioner, open_drive
from palpate.experiment.apparatus.panel.validity import refuse_unmeasured
from palpate.experiment.apparatus.ports import Actuator
from palpate.experiment.apparatus.rig import Rig, tracker_of
from palpate.experiment.apparatus.servo import budget, passivity
from palpate.experiment.apparatus.servo.link import Servo
from palpate.experiment.apparatus.servo.opening import open_servo, refuse_system, servo_of
from palpate.experiment.apparatus.servo.settings import largest_force_n
from palpate.experiment.apparatus.tracker import zeroing
from palpate.experiment.apparatus.tracker.landing import QUIETEST_MM
from palpate.experiment.clock import day
from palpate.experiment.desk.messages import Lamp, Measured
from palpate.experiment.errors import PalpateError, RigError, TrackerStopped
from palpate.experiment.protocol.kinds.tapping import Tapping
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records.entries import PlannedTrial
from palpate.experiment.records.kinds.tapping import Changed, PairLaidOut, Place
from palpate.experiment.session.kind import FarEnds, Kind, Lent, Seen, Sitting, open_actuator
from palpate.experiment.session.kinds.tapping.taps import Lying, Taps
from palpate.experiment.synthesis import tap
from palpate.experiment.synthesis.contact.block import Block
from palpate.experiment.synthesis.tap import Rings, Surface

if TYPE_CHECKING:
    from palpate.experiment.apparatus.audio.stream import AudioStream

PLACES: tuple[Place, Place] = ("first", "second")


@dataclass(frozen=True)
class SurfaceDevices:
    """`KindDevices`: servo, actuator, vibrations and blocks by their materials' ids; `opened` closes what a session
    begins.
    """

    servo: Servo
    actuator: Actuator
    rings: Mapping[str, Rings]
    blocks: Mapping[str, Block]
    noise_mm: float
    opened: ExitStack

    def begin(self, lent: Lent) -> VirtualSurfaces:
        block = max(self.blocks.values(), key=lambda one: one.crossover_hz)
        taps = Taps(servo=self.servo, actuator=self.actuator, block=block, noise_mm=self.noise_mm, lent=lent)
        self.opened.callback(taps.close)
        return VirtualSurfaces(self.rings, self.blocks, taps, lent)


def open_surfaces(sitting: Sitting, stream: AudioStream | None, ends: FarEnds, opened: ExitStack) -> SurfaceDevices:
    """Open what virtual surfaces need; otherwise as `laboratory.open_laboratory`.

    Raises `RigError` for a real rig that does not bear the protocol's block, `ServoError` for device or tracker, and as
    `conditioning.open_drive`.
    """
    protocol, rig, clock = sitting.protocol, sitting.rig, sitting.clock
    if not clock.simulated:
        refuse_system()
    virtual = protocol.table(Tapping)
    device = servo_of(rig)
    if not rig.rig.simulated:
        passivity.refuse_beyond(virtual, device, tracker_of(rig), rig=rig.rig.name)
        zeroing.check_age(rig, day(clock.now_ns()))
    limit_m_s2 = protocol.exposure.vibration_peak_m_s2
    drive = open_drive(sitting.rig_file.parent, rig.actuator, limit_m_s2=limit_m_s2)
    actuator = open_actuator(sitting, drive, stream=stream, ends=ends, opened=opened)
    if not rig.rig.simulated and (lacks := unable(virtual, rig, sitting.rig_file)):
        raise lacks
    force = ends.force(opened)
    port, clock_map = ends.tracker(opened)
    servo = open_servo(
        rig,
        virtual,
        limit_n=limit_n(protocol, rig),
        clock=clock,
        port=port,
        address=force,
        clock_map=clock_map,
    )
    opened.callback(servo.close)
    if stream is not None:
        stream.allow(servo.is_live)
    tracker = tracker_of(rig)
    noise_mm = tracker.noise_mm if tracker.noise_mm is not None else QUIETEST_MM
    rings = vibrations(virtual, rig.actuator.rate_hz)
    return SurfaceDevices(servo, actuator, rings, blocks(virtual, tracker_hz=tracker.rate_hz), noise_mm, opened)


def judge(*, protocol: Protocol, rig: Rig, rig_file: Path, today: date, **_: object) -> str:
    """Return what `left_out` says of a rig. Raises `RigError` for one that a session may not use."""
    refuse_system()
    virtual, device, tracker = protocol.table(Tapping), servo_of(rig), tracker_of(rig)
    passivity.refuse_beyond(virtual, device, tracker, rig=rig.rig.name)
    budget.refuse_beyond(virtual, device, tracker, limit_n=limit_n(protocol, rig), rig=rig.rig.name)
    if lacks := unable(virtual, rig, rig_file):
        raise lacks
    refuse_unmeasured(rig_file, rig, today)
    zeroing.check_age(rig, today)
    return left_out(protocol=protocol, rig=rig, rig_folder=rig_file.parent)


def examine(*, protocol: Protocol, rig: Rig, rig_file: Path, **_: object) -> tuple[str, PalpateError | None]:
    """Return what the board reads of a rig, and why no participant is run on it, if so; raises as `left_out`."""
    virtual, device, tracker = protocol.table(Tapping), servo_of(rig), tracker_of(rig)
    bears, told = passivity.judged(virtual, device, tracker)
    right, felt = budget.judged(virtual, device, tracker, limit_n=limit_n(protocol, rig))
    planar = "is planar: the block" if tracker_of(rig).along_calibration is not None else "is not planar: nothing"
    planar = "follows the hand: with crossovers nothing" if virtual.crossovers_hz else planar
    omitted = left_out(protocol=protocol, rig=rig, rig_folder=rig_file.parent)
    told = f"{told} {felt} The tracker {planar} pushes along the surface." + (
        f" Of its vibrations, {omitted}." if omitted else ""
    )
    if not bears:
        return told, RigError(rig_file, "cannot render the block of this protocol", "use another rig for participants")
    if lacks := unable(virtual, rig, rig_file):
        return told, lacks
    return told, None if right else RigError.at(budget.refusal(virtual, felt, rig=rig.rig.name))


def limit_n(protocol: Protocol, rig: Rig) -> float:
    """Return the largest force that a rig gives in a study, N."""
    return largest_force_n(protocol.exposure.force_peak_n, servo_of(rig))


def left_out(*, protocol: Protocol, rig: Rig, rig_folder: Path) -> str:
    """Return in words what is left out of a tap, at most; empty for nothing. Raises as `conditioning.open_drive`.

    Where no voltage or limit bends, the share is the same at every speed.
    """
    limit_m_s2, actuator, virtual = protocol.exposure.vibration_peak_m_s2, rig.actuator, protocol.table(Tapping)
    drive = open_drive(rig_folder, actuator, limit_m_s2=limit_m_s2)
    condition = open_conditioner(rig, limit_m_s2=limit_m_s2, drive=drive)
    shares = {}
    for name, rings in vibrations(virtual, actuator.rate_hz).items():
        error, _ = condition(rings.at(tap.REFERENCE_M_S)).budget()
        shares[name] = error.left_out
    most = max(shares, key=lambda name: shares[name])
    at = f"a tap on {most} at {tap.REFERENCE_M_S * 1e3:g} mm/s"
    return f"at most {shares[most]:.2%} (rms) of {at} is left out" if shares[most] else ""


def surfaces(virtual: Tapping) -> dict[str, Surface]:
    """Return the surfaces of a study, by their materials' ids: how each rings; all have one block."""
    return {
        one.material: Surface(
            name=one.material,
            stiffness_n_m=virtual.stiffness_n_m,
            amplitude=one.amplitude,
            attack_hz=one.attack_hz,
            decay_per_s=virtual.decay_per_s,
        )
        for one in virtual.surfaces
    }


def vibrations(virtual: Tapping, rate_hz: int) -> dict[str, Rings]:
    """Return the vibrations of each surface at the actuator's rate, above its crossover, if it has one.

    Those that come after the touch begin silent.
    """
    made, rings = surfaces(virtual), {}
    for one in virtual.surfaces:
        whole = tap.rings(made[one.material], rate_hz=rate_hz, aluminum_m_s2=virtual.full_m_s2)
        felt = whole if one.crossover_hz is None else whole.above(one.crossover_hz)
        rings[one.material] = felt.later(max(one.after_ms, 0.0) * 1e-3)
    return rings


def unable(virtual: Tapping, rig: Rig, rig_file: Path) -> RigError | None:
    """Return why a rig cannot vibrate before a touch, or push up to every crossover; None where it can or need not."""
    band_hz, highest_hz = servo_of(rig).band_hz, max(virtual.crossovers_hz, default=0.0)
    if band_hz is not None and band_hz < highest_hz:
        what = f"cannot push at frequencies up to {highest_hz:g} Hz, as the protocol's crossovers require"
        return RigError(rig_file, what, "use a device with a wider band", allowed="a servo.band_hz of at least that")
    if not virtual.ahead_ms or rig.actuator.driver == "audio":
        return None
    what = f"cannot vibrate {virtual.ahead_ms:g} ms before a touch, as the protocol requires"
    return RigError(
        rig_file, what, "use an actuator on the audio device, which can start at a set time", allowed="audio"
    )


def blocks(virtual: Tapping, *, tracker_hz: int) -> dict[str, Block]:
    """Return the block of each surface, below height zero, prepared for a tracker's rate, Hz.

    They differ by their crossovers alone.
    """
    k, c, m = virtual.stiffness_n_m, virtual.damping_n_s_m, inf if virtual.mass_kg is None else virtual.mass_kg
    whole = Block((k, k), (c, c), (m, m), into=(-1.0, 0.0), nominal_s=round(1e6 / tracker_hz) * 1e-6)
    return {one.material: replace(whole, crossover_hz=one.crossover_hz or inf) for one in virtual.surfaces}


@dataclass
class VirtualSurfaces(Kind):
    """Each attempt is a pair of surfaces, one rendered at a time; `rings` and `blocks` are theirs, by id.

    Question and response times begin when the first can be tapped.
    """

    rings: Mapping[str, Rings]
    blocks: Mapping[str, Block]
    taps: Taps
    lent: Lent
    _ready: PairLaidOut | None = field(default=None, init=False)
    _pair: PairLaidOut | None = field(default=None, init=False)
    _at: int = field(default=0, init=False)

    def ready(self, planned: PlannedTrial, attempt: int, answered_ns: int | None) -> None:  # noqa: ARG002
        """Say that a pair comes. Raises `TrackerStopped` if what renders it has failed."""
        if self.taps.failed is not None:
            raise TrackerStopped.saying(self.taps.failed)
        if self.lent.limits.end_reason():
            return
        self.lent.arm(planned, attempt, may="tap")
        self._ready = PairLaidOut(trial=planned.trial, attempt=attempt, presented=planned.presented, laid_ns=0)

    def watch(self, waiting: Callable[[], AbstractContextManager[None]]) -> Seen:  # noqa: ARG002
        """Render the first surface of the pair, and return at once: the participant tries both until the answer."""
        pair, self._ready = self._ready, None
        if pair is None:
            raise RuntimeError("no pair is watched before it was made ready")
        self._pair = pair.model_copy(update={"laid_ns": self.lent.clock.now_ns()})
        self.taps.touched.clear()
        self._lay(self._pair, 0)
        return Seen(self._pair, answerable_ns=self._pair.laid_ns)

    @property
    def keys(self) -> Mapping[str, str]:
        """The key that changes to the other surface."""
        return {self.lent.protocol.table(Tapping).switch_key: f"switch to the {PLACES[1 - self._at]} surface"}

    def press(self, key: str) -> None:  # noqa: ARG002
        """Change to the other surface, and put that on record."""
        if self._pair is None:
            raise RuntimeError("no surface is changed before one was rendered")
        self._lay(self._pair, 1 - self._at)
        place, material = PLACES[self._at], self._pair.presented[self._at]
        self.lent.log.write(Changed(trial=self._pair.trial, attempt=self._pair.attempt, place=place, material=material))
        self.lent.show(f"This is now the {place} surface.")

    def lacking(self) -> str:
        left, key = self._untouched() if self.taps.renders else "", self.lent.protocol.table(Tapping).switch_key
        change = "" if PLACES[self._at] in left else f" ([{key}] changes to it)"
        return f"Before answering, the participant must tap {left}{change}." if left else ""

    def _untouched(self) -> str:
        left = [place for place in PLACES if place not in self.taps.touched]
        return f"the {' and the '.join(left)} surface" if left else ""

    def rest(self) -> str:
        pair, self._pair = self._pair, None
        if pair is None:
            return ""
        # Once everything fell silent, nobody at the desk has to wait for a tap that cannot come.
        silent = "" if self.taps.renders else self._untouched()
        self.taps.lay(None)
        if self.taps.failed is not None:
            return self.taps.failed.sentence()
        return f"everything was silenced before {silent} was tapped" if silent else ""

    def quiet(self, why: str) -> None:  # noqa: ARG002
        # Without the lock of the taps, which a write may hold.
        self.taps.servo.render(None)
        self.taps.actuator.withdraw()

    def beat(self, ends_ns: int) -> None:  # noqa: ARG002
        self.taps.servo.beat()

    def measured(self) -> Measured:
        felt = self.taps.felt
        if felt is None:
            return Measured(too_fast=False, lamps=(Lamp(name="hand", good=False, words="no frame yet"),))
        fast = self.taps.too_fast
        words = f"faster than {self.lent.protocol.table(Tapping).fastest_mm_s:g} mm/s" if fast else "slow enough"
        return Measured(
            trace=felt.height_mm[-1:],
            trace_unit="mm",
            last=self.taps.last,
            second=None if self._pair is None else self._at == 1,
            too_fast=fast,
            hand_mm=felt.height_mm[-1],
            lamps=(Lamp(name="hand", good=not fast, words=words),),
        )

    def reconnect(self, timeout_s: float) -> None:  # noqa: ARG002
        self.taps.reconnect()

    def _lay(self, pair: PairLaidOut, place: int) -> None:
        self._at, material = place, pair.presented[place]
        rings = self.rings[material].scaled(self.lent.log.done.levels.get(pair.trial, 1.0))
        after_ms = self.lent.protocol.table(Tapping).numbers.get(material, {}).get("delay_ms", 0.0)
        ahead_ns = round(max(-after_ms, 0.0) * 1e6)
        lying = Lying(pair.trial, pair.attempt, PLACES[place], material, rings, self.blocks[material], ahead_ns)
        self.taps.lay(lying)
