"""The cycle in which something fails pushes nothing and lets nothing vibrate, by a clock that the test holds."""

from __future__ import annotations

import errno
import json
import socket
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from math import inf, nan
from types import SimpleNamespace

import pytest

from palpate.experiment.apparatus.servo import process
from palpate.experiment.apparatus.servo.process import RENDER, SILENT_NS, Line, Orders, Servo
from palpate.experiment.apparatus.servo.rendering import NO_FORCE
from palpate.experiment.apparatus.tracker.frames import encode
from palpate.experiment.errors import ServoError
from palpate.experiment.synthesis.contact.block import Block, Pair

PERIOD_NS = 400_000
BLOCK = Block((800.0, 800.0), (5.0, 5.0), (inf, inf), into=(-1.0, 0.0), nominal_s=PERIOD_NS * 1e-9)
NONE_COUNTS = 65_000
"""A reading that is no number, by the calibration."""

BEGINS_NS = 10**12
FAILS_NS = BEGINS_NS + 40_000_000
"""By then the hand, from 2 mm above the face at 100 mm/s, presses."""


@dataclass
class World:
    """A clock, a hand that comes down and rests 2 mm inside of the block, and a device that holds what it was told."""

    now_ns: int = BEGINS_NS
    sent: int = 0
    counts: Callable[[int, int], int | None] = lambda _now_ns, counts: counts
    """What a reading is sent as; None for no frame."""
    slides_mm_s: float | None = None
    """How fast the hand goes along the face; None for a tracker that is not planar."""
    gone: bool = False
    stalls: bool = False
    reads_long: bool = False
    dead: bool = False
    planar: bool = False
    pushed: list[tuple[int, Pair]] = field(default_factory=list)
    dropped: int = 0

    def monotonic_ns(self) -> int:
        return self.now_ns

    def sleep(self, seconds: float) -> None:
        self.now_ns += max(round(seconds * 1e9), 1)

    def take(self) -> bytes:
        """What the hand's tracker sent since the cycle before."""
        if self.gone and self.now_ns >= FAILS_NS:
            raise OSError(errno.EIO, "unplugged")
        data = b""
        while BEGINS_NS + self.sent * PERIOD_NS <= self.now_ns:
            at_ns = BEGINS_NS + self.sent * PERIOD_NS
            mm = max(2.0 - (at_ns - BEGINS_NS) * 1e-7, -2.0)
            counts = self.counts(at_ns, round((mm + 20.0) * 1000))
            slid_mm = (self.slides_mm_s or 0.0) * (at_ns - BEGINS_NS) * 1e-9
            along = [] if self.slides_mm_s is None else [round((slid_mm + 30.0) * 1000)]
            data += b"" if counts is None else encode(self.sent, at_ns // 1000, counts, *along)
            self.sent += 1
        if self.reads_long and self.now_ns >= FAILS_NS:
            self.reads_long = False
            self.now_ns += SILENT_NS
        return data

    def discard(self) -> None:
        pass

    def push(self, force_n: Pair, *, fast: bool, now_ns: int) -> None:
        self.pushed.append((now_ns, force_n))
        if self.stalls and now_ns >= FAILS_NS:
            self.stalls = False
            self.now_ns += SILENT_NS + PERIOD_NS

    def late_ns(self, now_ns: int) -> int:
        return 0

    def close(self) -> None:
        # A device that is hung up on lets go of the hand.
        self.pushed.append((self.now_ns, NO_FORCE))


def run(world: World, monkeypatch: pytest.MonkeyPatch, *, until_ns: int = FAILS_NS + 30_000_000) -> tuple[Servo, int]:
    """Run a servo until then; return it and its pulse in the end."""
    monkeypatch.setattr(process, "time", SimpleNamespace(monotonic_ns=world.monotonic_ns, sleep=world.sleep))
    monkeypatch.setattr(process, "SerialPort", lambda *_: world)
    monkeypatch.setattr(process, "ForceDevice", lambda *_, **__: world)
    dies = property(lambda _: world.now_ns >= (FAILS_NS if world.dead else until_ns))
    monkeypatch.setattr(process.Session, "dies", dies)
    ours, theirs = socket.socketpair()
    told = Line(ours)
    told.tell(RENDER, json.dumps(asdict(BLOCK)).encode(), 0)
    orders = Orders("", 1, 2500, 2000, (0.0, 60_000.0, 65_535.0), (-20.0, 40.0, nan), "", 100.0, 3.0, 2500, 175.0)
    if world.planar:
        orders = replace(orders, along_counts=(0.0, 60_000.0, 65_535.0), along_mm=(-30.0, 30.0, nan))
    pulse = memoryview(bytearray(8)).cast("q")
    servo = Servo(orders, Line(theirs), pulse)
    with suppress(ServoError):
        servo.run()
    if world.dead or world.gone:
        servo.close()
    ours.close()
    theirs.close()
    return servo, pulse[0]


def lets_go_ns(world: World) -> int:
    """Return how long after the failure the hand was let go of, ns, for good."""
    last = max(n for n, (_, force_n) in enumerate(world.pushed) if any(force_n))
    assert world.pushed[last][0] > FAILS_NS - 2 * PERIOD_NS, "the hand did not press when something failed"
    return world.pushed[last + 1][0] - FAILS_NS


def test_a_hand_that_presses_is_pushed_and_may_be_vibrated(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World()
    _, pulse_ns = run(world, monkeypatch)
    assert world.pushed[-1][1][0] == pytest.approx(800.0 * 2e-3, rel=0.01)
    assert world.now_ns - pulse_ns < SILENT_NS


def test_a_hand_that_slides_is_pushed_back_along_the_face(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(slides_mm_s=20.0, planar=True)
    run(world, monkeypatch)
    # It touched 20 ms after the beginning; one cycle is 0.4 ms, and a count is 1 um in 0.4 ms.
    touched_ns = BEGINS_NS + 20_000_000
    for at_ns, (_, along_n) in world.pushed[60:]:
        slid_m = 20e-3 * (at_ns - touched_ns) * 1e-9
        assert along_n == pytest.approx(-800.0 * slid_m - 5.0 * 20e-3, abs=0.03)
    assert {along for at_ns, (_, along) in world.pushed if at_ns < touched_ns} == {0.0}


@pytest.mark.parametrize("planar", [False, True])
def test_frames_of_the_other_kind_push_nothing(monkeypatch: pytest.MonkeyPatch, planar: bool) -> None:
    world = World(slides_mm_s=None if planar else 20.0, planar=planar)
    run(world, monkeypatch)
    assert {force_n for _, force_n in world.pushed} == {NO_FORCE}


def test_a_number_that_is_none_ends_both_in_its_cycle(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(counts=lambda at_ns, counts: NONE_COUNTS if at_ns >= FAILS_NS else counts)
    servo, pulse_ns = run(world, monkeypatch)
    assert lets_go_ns(world) <= PERIOD_NS
    assert (pulse_ns, servo.counts["unbelievable"]) == (0, 1)


def test_a_missed_deadline_ends_both_in_the_next_cycle(monkeypatch: pytest.MonkeyPatch) -> None:
    """Meanwhile the device has let go by itself, and the pulse is too old."""
    world = World(stalls=True)
    servo, pulse_ns = run(world, monkeypatch)
    assert lets_go_ns(world) <= SILENT_NS + 2 * PERIOD_NS
    assert (pulse_ns, servo.counts["late"]) == (0, 1)


def test_a_cycle_that_is_held_up_pushes_no_force_of_before(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(reads_long=True)
    servo, pulse_ns = run(world, monkeypatch)
    assert lets_go_ns(world) <= PERIOD_NS
    assert (pulse_ns, servo.counts["late"]) == (0, 1)


def test_a_tracker_that_falls_silent_ends_both(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(counts=lambda at_ns, counts: None if at_ns >= FAILS_NS else counts)
    servo, pulse_ns = run(world, monkeypatch)
    assert lets_go_ns(world) <= SILENT_NS + PERIOD_NS
    assert (pulse_ns, servo.counts["without the hand"]) == (0, 1)


@pytest.mark.parametrize("world", [World(gone=True), World(dead=True)], ids=["tracker", "session"])
def test_a_tracker_that_has_gone_and_a_session_that_is_dead_end_both(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, pulse_ns = run(world, monkeypatch)
    assert lets_go_ns(world) <= PERIOD_NS
    assert pulse_ns == 0
