"""The cycle in which something fails pushes nothing and lets nothing vibrate, by a clock that the test holds."""

from __future__ import annotations

import errno
import json
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from math import inf, nan
from types import SimpleNamespace

import numpy as np
import pytest

from palpate.experiment.apparatus.servo import process
from palpate.experiment.apparatus.servo.process import (
    BEAT,
    FORCE,
    HEARTBEAT_NS,
    RENDER,
    SILENT_NS,
    STOOD,
    TIME,
    TOUCH,
    Line,
    Orders,
    Servo,
)
from palpate.experiment.apparatus.servo.record import cycles_of
from palpate.experiment.apparatus.servo.rendering import FALLS_NS, NO_FORCE
from palpate.experiment.apparatus.tracker.frames import encode
from palpate.experiment.errors import ServoError
from palpate.experiment.synthesis.contact.block import Block, Pair

PERIOD_NS = 400_000
BLOCK = Block((800.0, 800.0), (5.0, 5.0), (inf, inf), into=(-1.0, 0.0), nominal_s=PERIOD_NS * 1e-9)
NONE_COUNTS = 65_000
"""A reading that is no number, by the calibration."""

BEGINS_NS = 10**12
NEVER_NS, BEAT_NS = BEGINS_NS + 10**12, 100_000_000
FAILS_NS = BEGINS_NS + 40_000_000
"""By then the hand, from 2 mm above the face at 100 mm/s, presses."""

TOUCHES_NS = BEGINS_NS + 20_000_000


@dataclass
class World:
    """A clock, a hand that comes down and rests 2 mm inside of the block, and a device that holds what it was told."""

    now_ns: int = BEGINS_NS
    sent: int = 0
    counts: Callable[[int, int], int | None] = lambda _now_ns, counts: counts
    """What a reading is sent as; None for no frame."""
    height_mm: Callable[[int], float] = lambda at_ns: max(2.0 - (at_ns - BEGINS_NS) * 1e-7, -2.0)
    fails_ns: int = FAILS_NS
    slides_mm_s: float | None = None
    """How fast the hand goes along the face; None for a tracker that is not planar."""
    gone: bool = False
    stalls: bool = False
    reads_long: bool = False
    dead: bool = False
    planar: bool = False
    beats: Callable[[int], bool] = lambda _now_ns: True
    """Whether the session gives a sign of life at a time."""
    until_ns: int = NEVER_NS
    last_beat_ns: int = 0
    session: Line = field(init=False)
    heard: list[tuple[int, bytes, int]] = field(default_factory=list)
    session_end: list[tuple[int, bytes, int]] = field(default_factory=list)
    pushed: list[tuple[int, Pair]] = field(default_factory=list)
    dropped: int = 0

    def monotonic_ns(self) -> int:
        return self.now_ns

    def sleep(self, seconds: float) -> None:
        self.now_ns += max(round(seconds * 1e9), 1)

    def take(self) -> bytes:
        """What the hand's tracker sent since the cycle before; the session beats and hears meanwhile."""
        if self.now_ns >= self.last_beat_ns + BEAT_NS and self.beats(self.now_ns):
            self.last_beat_ns = self.now_ns
            self.session.tell(BEAT, b"", self.now_ns)
        self.heard += self.session.hear()
        if self.gone and self.now_ns >= self.fails_ns:
            raise OSError(errno.EIO, "unplugged")
        data = b""
        while BEGINS_NS + self.sent * PERIOD_NS <= self.now_ns:
            at_ns = BEGINS_NS + self.sent * PERIOD_NS
            counts = self.counts(at_ns, round((self.height_mm(at_ns) + 20.0) * 1000))
            slid_mm = (self.slides_mm_s or 0.0) * (at_ns - BEGINS_NS) * 1e-9
            along = [] if self.slides_mm_s is None else [round((slid_mm + 30.0) * 1000)]
            data += b"" if counts is None else encode(self.sent, at_ns // 1000, counts, *along)
            self.sent += 1
        if self.reads_long and self.now_ns >= self.fails_ns:
            self.reads_long = False
            self.now_ns += SILENT_NS
        return data

    def discard(self) -> None:
        pass

    def push(self, force_n: Pair, *, fast: bool, now_ns: int) -> Pair:
        self.pushed.append((now_ns, force_n))
        if self.stalls and now_ns >= self.fails_ns:
            self.stalls = False
            self.now_ns += SILENT_NS + PERIOD_NS
        return force_n

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
    world.session = Line(ours)
    world.session.tell(RENDER, json.dumps([asdict(BLOCK), world.until_ns]).encode(), 0)
    orders = Orders("", 1, 2500, 2000, (0.0, 60_000.0, 65_535.0), (-20.0, 40.0, nan), "", 100.0, 3.0, 2500, 175.0)
    if world.planar:
        orders = replace(orders, along_counts=(0.0, 60_000.0, 65_535.0), along_mm=(-30.0, 30.0, nan))
    pulse = memoryview(bytearray(8)).cast("q")
    servo = Servo(orders, Line(theirs), pulse)
    with suppress(ServoError):
        servo.run()
    if world.dead or world.gone:
        servo.close()
    with suppress(EOFError):
        world.session_end = world.session.hear()
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


def test_the_force_of_each_cycle_near_the_block_is_handed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(dead=True)
    run(world, monkeypatch)
    cycles = cycles_of(b"".join(content for kind, content, _ in [*world.heard, *world.session_end] if kind == FORCE))
    assert cycles["number"].tolist() == list(range(cycles.size))
    assert {after - one for one, after in pairwise(cycles["cycle"].tolist())} == {1}
    sent = dict(world.pushed)
    at_ns = cycles["t_ns"].tolist()
    assert cycles["sent_n"].tolist() == [pytest.approx(sent[one]) for one in at_ns]
    # The hand comes down at 100 mm/s, and one count is 1 um.
    height_mm = np.maximum(2.0 - (np.array(at_ns) - BEGINS_NS) * 1e-7, -2.0)
    assert cycles["place_mm"][:, 0].tolist() == pytest.approx(height_mm.tolist(), abs=0.1)
    assert at_ns[-1] == FAILS_NS - PERIOD_NS


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


def back_and_again(at_ns: int) -> float:
    """From 2 mm above the face to as deep inside, out after 60 ms, and in again after 100; at 100 mm/s."""
    return abs((at_ns - BEGINS_NS) % 80_000_000 - 40_000_000) * 1e-7 - 2.0


@pytest.mark.parametrize(
    "world",
    [
        World(stalls=True),
        World(reads_long=True),
        World(counts=lambda at_ns, counts: None if 0 <= at_ns - TOUCHES_NS + 1_000_000 < 5_000_000 else counts),
    ],
    ids=["late", "held up", "without the hand"],
)
def test_a_touch_during_a_fault_counts_and_pushes_nothing_until_the_hand_was_outside(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    world.height_mm, world.fails_ns = back_and_again, TOUCHES_NS - 1_000_000
    run(world, monkeypatch, until_ns=TOUCHES_NS + 100_000_000)
    began_ns = next(at_ns for at_ns, force_n in world.pushed if any(force_n))
    assert 0 < began_ns - (TOUCHES_NS + 80_000_000) <= PERIOD_NS
    world.heard += world.session_end
    assert len([kind for kind, *_ in world.heard if kind == TOUCH]) == 2


@pytest.mark.parametrize("world", [World(gone=True), World(dead=True)], ids=["tracker", "session"])
def test_a_tracker_that_has_gone_and_a_session_that_is_dead_end_both(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, pulse_ns = run(world, monkeypatch)
    assert lets_go_ns(world) <= PERIOD_NS
    assert pulse_ns == 0


def falls(world: World, from_ns: int) -> None:
    """Assert that the whole force is there until a time, falls evenly from then on, and is gone for good after it."""
    whole = 800.0 * 2e-3
    for at_ns, (out_n, _) in world.pushed:
        left = 1.0 - (at_ns - from_ns) / FALLS_NS
        if at_ns >= FAILS_NS + 4_000_000:
            assert out_n == pytest.approx(whole * min(max(left, 0.0), 1.0), abs=1e-6)


def test_the_force_falls_after_the_last_heartbeat_and_stays_away_when_it_comes_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It comes back while the force still falls: one that rose again inside of the block would strike."""
    back_ns = FAILS_NS + HEARTBEAT_NS + FALLS_NS // 2
    world = World(beats=lambda now_ns: now_ns < FAILS_NS or now_ns >= back_ns)
    _, pulse_ns = run(world, monkeypatch, until_ns=back_ns + 4 * FALLS_NS)
    assert world.last_beat_ns > back_ns
    stood = [TIME.unpack(content)[0] for kind, content, _ in world.heard if kind == STOOD]
    assert len(stood) == 1
    assert BEGINS_NS <= stood[0] < FAILS_NS
    falls(world, stood[0] + HEARTBEAT_NS)
    assert pulse_ns == 0


def test_nothing_vibrates_from_the_moment_on_in_which_the_force_falls(monkeypatch: pytest.MonkeyPatch) -> None:
    until_ns = FAILS_NS + 10_000_000
    _, pulse_ns = run(World(until_ns=until_ns), monkeypatch, until_ns=until_ns + FALLS_NS // 2)
    assert pulse_ns == 0


def test_no_block_is_there_after_the_end_of_the_session(monkeypatch: pytest.MonkeyPatch) -> None:
    until_ns = FAILS_NS + 10_000_000
    world = World(until_ns=until_ns)
    run(world, monkeypatch, until_ns=until_ns + 4 * FALLS_NS)
    falls(world, until_ns)
    assert not [kind for kind, *_ in world.heard if kind == STOOD]


def test_no_block_is_there_before_the_first_heartbeat_and_it_waits_for_that(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first one comes while the hand is inside: nothing is pushed before it has been outside."""
    world = World(beats=lambda now_ns: now_ns >= FAILS_NS)
    run(world, monkeypatch)
    assert {force_n for _, force_n in world.pushed} == {NO_FORCE}
    first_ns = BEGINS_NS + 5_000_000
    world = World(beats=lambda now_ns: now_ns >= first_ns)
    run(world, monkeypatch)
    assert world.pushed[-1][1][0] == pytest.approx(800.0 * 2e-3, rel=0.01)
    assert not [kind for kind, *_ in world.heard if kind == STOOD]


def test_threads_that_speak_at_once_are_all_heard_whole() -> None:
    ours, theirs = socket.socketpair()
    line, other = Line(ours), Line(theirs)
    told = {n: [f"{n} {k}".encode() * 50 for k in range(300)] for n in range(4)}

    def tell(n: int) -> None:
        for content in told[n]:
            line.tell(n, content, n)

    threads = [threading.Thread(target=tell, args=(n,)) for n in told]
    for thread in threads:
        thread.start()
    heard: dict[int, list[bytes]] = {n: [] for n in told}
    while any(thread.is_alive() for thread in threads) or heard != told:
        line.tell(4, b"", 0)
        for kind, content, _ in other.hear(1.0):
            heard.get(kind, []).append(content)
    ours.close()
    theirs.close()
