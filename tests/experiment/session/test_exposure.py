"""Exposure: nothing is felt after the session's end, and no kill, pause or clock changes the dose."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, cast

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from syrupy.assertion import SnapshotAssertion

from palpate.experiment import storage
from palpate.experiment.apparatus.audio import masker as sound_level
from palpate.experiment.apparatus.audio.masker import RESERVE_S
from palpate.experiment.apparatus.ports import MaskerExposure
from palpate.experiment.apparatus.tracker.frames import Samples
from palpate.experiment.clock import MonotonicClock, Uptime
from palpate.experiment.desk.questions import Event, Notice, Place
from palpate.experiment.errors import AudioError, JournalError, ScreenGone, TrackerStopped
from palpate.experiment.protocol.models import Masker, Protocol
from palpate.experiment.records import bridging, journal, transcript
from palpate.experiment.records.entries import (
    Armed,
    Entry,
    Exposure,
    Footer,
    Header,
    MaskerSet,
    Note,
    Phase,
    Redo,
    Resumed,
    Trace,
)
from palpate.experiment.records.journal import Contents, Line
from palpate.experiment.records.kinds.footstep import BrokenOff, FootStep
from palpate.experiment.records.progress import Progress, progress
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.session import exposure
from palpate.experiment.session.exposure import (
    EVERY_NS,
    KILLED_NS,
    LOOK_S,
    WINDOW_NS,
    Exposed,
    dose_before,
    since_ended_ns,
    spent_ns,
)
from palpate.experiment.session.kind import nothing_more
from palpate.experiment.session.kinds.tapping.trials import Comparisons
from palpate.experiment.session.masker import Masking
from palpate.experiment.session.runner import SessionLog
from tests.approved import Refuses
from tests.experiment.session.bench import Bench, as_read, bench, entries, header
from tests.experiment.session.scripted import START_NS, ScriptedConsole

if TYPE_CHECKING:
    from palpate.experiment.apparatus.audio.stream import AudioStream

WANTED = Masker(noise="pink", level_set_by="participant", criterion="it hides all")
HOUR_NS = 3600 * 10**9
LEVEL_DB_A = 80.0
"""An hour of it is an eighth of the dose (2003/10/EC)."""


class Machine(ManualClock):
    """A machine's clock in real time, which may be set, and a machine that may start again."""

    simulated = False

    def __init__(self, start_ns: int = START_NS) -> None:
        super().__init__(start_ns)
        self._boot, self._off_ns = 1, start_ns

    def uptime(self) -> Uptime:
        return Uptime(f"boot {self._boot}", self._now_ns - self._off_ns)

    def set(self, by_ns: int) -> None:
        """Set the clock; the uptime goes on as it was."""
        self._now_ns += by_ns
        self._off_ns += by_ns

    def restart(self) -> None:
        self._boot, self._off_ns = self._boot + 1, self._now_ns


class SteadyMasker:
    """Implements `Masker` at one level."""

    limit_db_a = LEVEL_DB_A

    def __init__(self, clock: ManualClock, before: float = 0.0) -> None:
        self.level_db_a: float | None = None
        self.clock, self.before = clock, before
        self.begun_ns = self.stopped_ns = clock.now_ns()

    def start(self, level_db_a: float) -> float:
        self.level_db_a, self.begun_ns = LEVEL_DB_A, self.clock.now_ns()
        return LEVEL_DB_A

    def set_level(self, level_db_a: float) -> float:
        return LEVEL_DB_A

    def stop(self) -> None:
        if self.level_db_a is not None:
            self.level_db_a, self.stopped_ns = None, self.clock.now_ns()

    def exposure(self) -> MaskerExposure:
        until_ns = self.stopped_ns if self.level_db_a is None else self.clock.now_ns()
        dose = self.before + played(until_ns - self.begun_ns)
        left_s = None if self.level_db_a is None else sound_level.left_s(dose=dose, level_db_a=LEVEL_DB_A)
        return MaskerExposure(self.level_db_a, dose, None, left_s)


def wait_until(holds: Callable[[], bool]) -> None:
    ends_s = time.monotonic() + 30
    while not holds():
        assert time.monotonic() < ends_s
        time.sleep(0.001)


def played(duration_ns: int) -> float:
    """Directive 2003/10/EC: 80 dB(A) for eight hours is 1."""
    return duration_ns / 28.8e12


class Lines:
    """Implements `Log` in memory."""

    def __init__(self, clock: ManualClock) -> None:
        self.clock = clock
        self.lines: list[Line] = []
        self.failing = False
        self.waiting_s = 0.0

    def free_bytes(self) -> int:
        raise OSError

    @property
    def done(self) -> Progress:
        return progress((header("virtual"),))

    def write(self, entry: Entry) -> None:
        if self.failing:
            raise JournalError("the disk is full")
        self.lines.append(Line(self.clock.now_ns(), entry))

    def keep(self, raw: bytes) -> Trace:
        raise NotImplementedError

    @property
    def contents(self) -> Contents:
        return Contents(tuple(self.lines))


class StandingStill:
    """What is asked of an `AudioStream`, which may stand still."""

    stands = silenced = False

    def check(self) -> None:
        if self.stands:
            raise AudioError("the device is gone")

    def silence(self) -> None:
        self.silenced = True


class Felt(Comparisons):
    """A kind of trial that keeps what the session's limits ask of it."""

    def __init__(self) -> None:
        self.beats: list[int] = []
        self.quieted: list[str] = []

    def beat(self, ends_ns: int) -> None:
        self.beats.append(ends_ns)

    def quiet(self, why: str) -> None:
        self.quieted.append(why)


def watched(
    clock: ManualClock, log: Lines, *, lasts_ns: int = 10 * HOUR_NS, before: float | None = None
) -> tuple[Exposed, SteadyMasker | None, Masking | None]:
    console = ScriptedConsole(clock, "")
    console.levels.append(".")
    masker = None if before is None else SteadyMasker(clock, before)
    masking = None if masker is None else Masking(masker, console, log.write, clock)
    ends_ns = clock.now_ns() + lasts_ns
    return (
        Exposed(ends_ns=ends_ns, ended="it is over", masking=masking, console=console, clock=clock, log=log),
        masker,
        masking,
    )


def looking(exposed: Exposed, clock: ManualClock, duration_ns: int) -> None:
    """Let time pass as the watching thread does."""
    until_ns = clock.now_ns() + duration_ns
    while (left_ns := until_ns - clock.now_ns()) > 0:
        clock.sleep_ns(min(int(LOOK_S * 1e9), left_ns))
        exposed.look()
        exposed.record()


@settings(max_examples=60)
@given(
    runners=st.lists(
        st.tuples(
            st.integers(1, 2000).map(lambda tenths: tenths * 10**8),
            st.booleans(),
            st.integers(0, 2 * HOUR_NS),
            st.sampled_from([None, 0, -72 * HOUR_NS, 72 * HOUR_NS, -HOUR_NS]),
        ),
        min_size=1,
        max_size=6,
    )
)
def test_the_dose_is_that_of_every_session_whatever_ends_it_and_whatever_the_clock_is_set_to(
    runners: list[tuple[int, bool, int, int | None]],
) -> None:
    """Each runner plays, is ended or killed, and waits; then the clock is set, or the machine starts again.

    All is within 24 hours.
    """
    clock, logs, truth, kills = Machine(), [], 0.0, 0
    for n, (plays_ns, killed, waits_ns, set_ns) in enumerate(runners):
        if n % 2 == 0:
            logs.append(Lines(clock))
            logs[-1].write(header("virtual"))
        else:
            logs[-1].write(Resumed(torn="", remaining=()))
        exposed, _, masking = watched(clock, logs[-1], before=dose_before([log.contents for log in logs], clock))
        assert masking is not None
        exposed.record()
        masking.choose(WANTED, None, None)
        looking(exposed, clock, plays_ns)
        truth += played(plays_ns)
        if killed:
            kills += 1
        else:
            masking.end()
            masking.record()
        clock.sleep_ns(waits_ns)
        if set_ns is None:
            clock.restart()
        else:
            clock.set(set_ns)
    told = dose_before([log.contents for log in logs], clock)
    assert -1e-9 <= told - truth <= kills * played(KILLED_NS) + 1e-9


def told(clock: ManualClock, dose: float, level_db_a: float | None = LEVEL_DB_A) -> list[Line]:
    """A session of an hour that brought a dose, told by its journal until now."""
    end_ns, uptime = clock.now_ns(), clock.uptime()
    begun: list[Entry] = [header("virtual"), MaskerSet(level_db_a=60.0, dose=0.0, daily_level_db_a=None)]
    ended: list[Entry] = [MaskerSet(level_db_a=level_db_a, dose=dose, daily_level_db_a=None)]
    if uptime is not None:
        ended.append(Exposure(dose=dose, stimuli=0, vibration_s=0.0, boot=uptime.boot, up_ns=uptime.ns))
    return [*(Line(end_ns - HOUR_NS, entry) for entry in begun), *(Line(end_ns, entry) for entry in ended)]


def of(lines: list[Line], clock: ManualClock) -> float:
    return dose_before([Contents(tuple(lines))], clock)


def test_a_dose_is_forgotten_after_24_hours_and_not_at_midnight() -> None:
    clock = Machine()
    lines = told(clock, 0.4, None)
    for hour in range(24):
        assert of(lines, clock) == pytest.approx(0.4), hour
        clock.sleep_ns(HOUR_NS)
    assert of(lines, clock) == 0.0


@pytest.mark.parametrize("boots", [1, 2])
@pytest.mark.parametrize("set_ns", [-72 * HOUR_NS, 0, 72 * HOUR_NS])
def test_the_age_of_a_dose_is_the_machines_where_it_ran_on_and_never_negative(set_ns: int, boots: int) -> None:
    clock = Machine()
    lines = told(clock, 0.4, None)
    clock.set(set_ns)
    clock.sleep_ns(HOUR_NS)
    if boots > 1:
        clock.restart()
    # After a new start only the wall clock can tell how long ago it was; what seems to come is now.
    assert of(lines, clock) == (0.0 if boots > 1 and set_ns > 0 else pytest.approx(0.4))


@pytest.mark.parametrize("boots", [1, 2])
@pytest.mark.parametrize("set_ns", [-72 * HOUR_NS, 0, 72 * HOUR_NS])
def test_a_break_lasts_as_long_as_the_protocol_says_whatever_the_clock_was_set_to(set_ns: int, boots: int) -> None:
    clock = Machine()
    ended = Contents(tuple(told(clock, 0.4, None)))
    clock.set(set_ns)
    clock.sleep_ns(HOUR_NS)
    if boots > 1:
        clock.restart()
    passed_ns = HOUR_NS if boots == 1 else max(HOUR_NS + set_ns, 0)
    assert since_ended_ns(ended, clock) == passed_ns


@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize("set_ns", [-72 * HOUR_NS, -7 * HOUR_NS, 7 * HOUR_NS, 72 * HOUR_NS])
def test_a_session_after_the_clock_was_set_dates_those_before_it_whatever_starts_again(set_ns: int, order: int) -> None:
    """Sessions end after 0, 4, 6 and 8 h; the clock is set after 2 and 7 h, the machine starts again after 5 and 9."""
    clock, sessions = Machine(), []
    for until_set_h, until_next_h in ((2, 2), (1, 1), (1, 1)):
        sessions.append(told(clock, 0.1, None))
        clock.sleep_ns(until_set_h * HOUR_NS)
        if len(sessions) == 2:
            clock.restart()
        else:
            clock.set(set_ns)
        clock.sleep_ns(until_next_h * HOUR_NS)
    sessions.append(told(clock, 0.1, None))
    clock.sleep_ns(HOUR_NS)
    clock.restart()
    for place, lines in enumerate(sessions, 1):
        lines[0] = Line(lines[0].t_ns, header("virtual").model_copy(update={"task_position": place}))
    # The header of the last journal was torn.
    journals = [Contents(tuple(lines)) for lines in [*sessions[::order], []]]
    for hour in range(9, 34):
        counted = sum(hour - ended < 24 for ended in (0, 4, 6, 8))
        assert dose_before(journals, clock) == pytest.approx(0.1 * counted), hour
        clock.sleep_ns(HOUR_NS)


@pytest.mark.parametrize("after_ns", [0, 10**9, EVERY_NS, KILLED_NS, HOUR_NS, WINDOW_NS + HOUR_NS])
def test_a_killed_session_played_at_most_until_its_next_line_was_late(after_ns: int) -> None:
    clock = ManualClock(START_NS)
    lines = [*told(clock, 0.1), Line(START_NS + 2 * 10**9, Phase(state="armed"))]
    clock.sleep_ns(2 * 10**9 + after_ns)
    known = 0.1 + played(2 * 10**9 + min(after_ns, KILLED_NS))
    assert of(lines, clock) == (pytest.approx(known) if after_ns < WINDOW_NS else 0.0)


def test_a_machine_knows_how_long_it_has_been_on() -> None:
    clock = MonotonicClock()
    first, second = clock.uptime(), clock.uptime()
    if first is None or second is None:
        pytest.skip("the machine does not tell its uptime")
    assert first.boot == second.boot
    assert 0 < first.ns <= second.ns


@pytest.mark.parametrize("before", [0.5, 1 - 2 * played(10**9 * int(RESERVE_S))])
def test_the_masker_is_silent_before_the_dose_is_one(before: float, approved: SnapshotAssertion) -> None:
    clock = Machine()
    log = Lines(clock)
    exposed, masker, masking = watched(clock, log, before=before)
    assert masker is not None
    assert masking is not None
    masking.choose(WANTED, None, None)
    looking(exposed, clock, 5 * HOUR_NS)
    assert masker.level_db_a is None
    assert 1 - played(int(2 * RESERVE_S * 1e9)) <= masker.exposure().dose < 1
    assert exposed.end_reason() == approved
    last = [line.entry for line in log.lines if isinstance(line.entry, MaskerSet)][-1]
    assert (last.level_db_a, last.dose) == (None, masker.exposure().dose)
    masking.choose(WANTED, None, None)
    assert masking.change("+")
    # Nothing starts it again.
    assert masker.level_db_a is None


def test_the_masker_is_silent_when_the_session_is_over(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Machine()
    exposed, masker, masking = watched(clock, Lines(clock), lasts_ns=10 * 10**9, before=0.0)
    assert masker is not None
    assert masking is not None
    masking.choose(WANTED, None, None)
    looking(exposed, clock, 10 * 10**9)
    assert (exposed.end_reason(), masker.level_db_a) == ("", LEVEL_DB_A)
    looking(exposed, clock, 1)
    assert (masker.level_db_a, exposed.end_reason()) == (None, "it is over")


def test_the_exposure_is_on_disk_every_few_seconds_with_or_without_a_masker() -> None:
    for before in (None, 0.0):
        clock = Machine()
        log = Lines(clock)
        exposed, _, masking = watched(clock, log, before=before)
        exposed.record()
        if masking is not None:
            masking.choose(WANTED, None, None)
        looking(exposed, clock, 60 * 10**9)
        of_exposure = [line for line in log.lines if isinstance(line.entry, Exposure)]
        assert [line.t_ns - START_NS for line in of_exposure] == [n * EVERY_NS for n in range(13)]
        last = of_exposure[-1].entry
        assert isinstance(last, Exposure)
        assert last.dose == (None if before is None else pytest.approx(played(60 * 10**9)))


def test_what_the_watching_thread_cannot_write_is_raised_where_the_session_asks_next(
    monkeypatch: pytest.MonkeyPatch,
    refuses: Refuses,
) -> None:
    monkeypatch.setattr(exposure, "EVERY_NS", 0)
    monkeypatch.setattr(exposure, "LOOK_S", 0.0)
    clock = Machine()
    log = Lines(clock)
    exposed, masker, masking = watched(clock, log, before=0.0)
    assert masker is not None
    assert masking is not None
    masking.choose(WANTED, None, None)
    exposed.begin(Felt())
    log.failing = True
    wait_until(lambda: exposed._failed is not None and masker.level_db_a is None)
    # Nobody watches it any longer.
    assert masker.level_db_a is None
    with refuses(JournalError):
        exposed.end_reason()
    exposed.close()


def test_the_experimenter_is_told_that_the_session_is_over(
    monkeypatch: pytest.MonkeyPatch, approved: SnapshotAssertion
) -> None:
    monkeypatch.setattr(exposure, "LOOK_S", 0.0)
    clock = Machine()
    exposed, _, _ = watched(clock, Lines(clock), lasts_ns=-1)
    told: list[str] = []

    def gone(event: Event) -> None:
        assert isinstance(event, Notice)
        told.append(event.text)
        raise ScreenGone("the terminal was closed")

    monkeypatch.setattr(exposed.console, "tell", gone)
    exposed.begin(Felt())
    wait_until(lambda: exposed._failed is not None)
    exposed.close()
    assert told == approved
    with pytest.raises(ScreenGone):
        exposed.end_reason()


def test_sound_that_stands_still_ends_what_is_felt_though_nothing_is_waited_for() -> None:
    clock, felt = Machine(), Felt()
    exposed, _, _ = watched(clock, Lines(clock))
    stream = StandingStill()
    exposed.stream = cast("AudioStream", stream)
    exposed.begin(felt)
    wait_until(lambda: len(felt.beats) > 1)
    assert not felt.quieted
    stream.stands = True
    wait_until(lambda: bool(felt.quieted))
    exposed.close()
    assert stream.silenced
    assert "gone" in cast("ScriptedConsole", exposed.console).shown[-1]
    with pytest.raises(AudioError):
        exposed.end_reason()


def test_a_kind_hears_that_the_session_lives_and_from_its_end_on_to_be_quiet() -> None:
    clock, felt = Machine(), Felt()
    exposed, _, _ = watched(clock, Lines(clock), lasts_ns=10**9)
    exposed.begin(felt)
    wait_until(lambda: len(felt.beats) > 1)
    assert (set(felt.beats), felt.quieted) == ({START_NS + 10**9}, [])
    clock.sleep_ns(10**9 + 1)
    wait_until(lambda: bool(felt.quieted))
    exposed.close()
    assert set(felt.quieted) == {"it is over"}


def lasting(protocol: Protocol, seconds: float) -> Protocol:
    """Scripted participants handle the materials for 200 s first."""
    limit = protocol.exposure.model_copy(update={"session_min": (200 + seconds) / 60})
    return protocol.model_copy(update={"exposure": limit})


def real_time(keys: str, clock: ManualClock) -> Bench:
    """A foot of 100 mm/s, read in pieces of 4 ms, each of which takes as long."""
    one = bench(keys, [*as_read(2, 100.0)])
    one.clock, one.console, one.tracker._clock = clock, ScriptedConsole(clock, keys), clock
    read = one.tracker.read

    def slowly() -> Samples:
        clock.sleep_ns(4_000_000)
        return read()

    one.tracker.read = slowly  # type: ignore[method-assign]
    return one


def test_a_clock_that_was_set_back_in_a_pause_is_told_and_bridged_by_the_uptime(
    protocol: Protocol, tmp_path: Path
) -> None:
    machine = Machine()
    assert real_time("cq", machine).run(protocol, header("virtual"), tmp_path).reason == "paused"
    machine.sleep_ns(60 * 10**9)
    machine.set(-10_000 * 10**9)
    again = real_time("pp", machine)
    assert again.run(protocol, header("virtual"), tmp_path).reason == "complete"
    contents = journal.read(storage.journal_path(tmp_path, "01", "virtual"))
    assert bridging.set_back_ns(contents) == 10_000 * 10**9
    (note,) = (entry.text for entry in contents.entries if isinstance(entry, Note))
    assert any(told.startswith(note) for told in again.console.shown)


@pytest.mark.parametrize("clock_of", [ManualClock, Machine])
@pytest.mark.parametrize("after_ms", [0, 40, 200, 250, 290, 298, 302, 306, 310, 330, 410, 900])
def test_no_stimulus_sounds_after_the_end_and_one_before_it_is_answered(
    protocol: Protocol, tmp_path: Path, after_ms: int, clock_of: Callable[[int], ManualClock]
) -> None:
    clock = clock_of(START_NS)
    one = real_time("c", clock)
    ends_ns = START_NS + 200 * 10**9 + after_ms * 10**6
    landed, sounded = one.actuator.landed, []

    def at(contact_ns: int) -> None:
        sounded.append(clock.now_ns())
        landed(contact_ns)

    one.actuator.landed = at  # type: ignore[method-assign]
    short = lasting(protocol, after_ms / 1e3)
    footer = one.run(short, header("virtual"), tmp_path)
    over = f"the session has reached the protocol's limit of {short.exposure.session_min:g} min"
    assert footer == Footer(reason="paused", detail=over, answered=len(sounded), silent=True)
    assert all(sound_ns <= ends_ns for sound_ns in sounded)
    # The contact is known after 300 ms, and 5 are left for the actuator.
    assert len(sounded) == (after_ms > 305)
    broken = [entry for entry in entries(tmp_path, "virtual") if isinstance(entry, BrokenOff)]
    assert [(entry.reason, entry.felt) for entry in broken] == ([] if sounded else [(over, False)])


@pytest.mark.parametrize(("after_ms", "asked"), [(230, False), (260, False), (290, False), (900, True)])
def test_no_onset_is_asked_for_after_the_end_though_it_could_still_be_taken_back(
    protocol: Protocol, tmp_path: Path, after_ms: int, asked: bool
) -> None:
    """The next read may come too late to take it back."""
    one = real_time("c", Machine())
    one.actuator.lead_ns = 10_000_000
    one.run(lasting(protocol, after_ms / 1e3), header("virtual"), tmp_path)
    ends_ns = START_NS + 200 * 10**9 + after_ms * 10**6
    onsets = [onset_ns for stimulus in one.actuator.aimed for onset_ns in stimulus]
    assert bool(onsets) == asked
    assert all(onset_ns <= ends_ns for onset_ns in onsets)


def test_nothing_is_armed_when_the_end_comes_at_a_prompt(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("c")
    one.console.instead[Place] = lambda: one.clock.sleep_ns(HOUR_NS)
    footer = one.run(lasting(protocol, 60), header("real"), tmp_path)
    assert (footer.reason, footer.answered) == ("paused", 0)
    assert one.console.armed == []
    assert not any(isinstance(entry, Armed | BrokenOff | FootStep) for entry in entries(tmp_path, "real"))


def test_a_tracker_that_is_gone_is_waited_for_until_the_session_is_over(
    protocol: Protocol, tmp_path: Path, approved: SnapshotAssertion
) -> None:
    one = bench("c")
    one.tracker.drains.append(TrackerStopped("the port has gone"))

    def stays_away(timeout_s: float) -> None:
        one.clock.sleep_ns(round(timeout_s * 1e9) + 1)
        raise TrackerStopped(f"not back within {timeout_s:g} s")

    one.tracker.reconnect = stays_away  # type: ignore[method-assign]
    short = lasting(protocol, 59.5)
    footer = one.run(short, header("real"), tmp_path)
    over = f"the session has reached the protocol's limit of {short.exposure.session_min:g} min"
    assert footer == Footer(reason="paused", detail=over, answered=0)
    assert one.console.shown[1:] == approved


def test_a_session_in_real_time_tells_its_exposure_and_simulated_time_does_not(
    protocol: Protocol, tmp_path: Path
) -> None:
    real_time("cp", Machine()).run(lasting(protocol, 5.0), header("virtual"), tmp_path / "real")
    real_time("cp", ManualClock(START_NS)).run(lasting(protocol, 5.0), header("virtual"), tmp_path / "simulated")
    assert not any(isinstance(entry, Exposure) for entry in entries(tmp_path / "simulated", "virtual"))
    written = entries(tmp_path / "real", "virtual")
    assert isinstance(written[0], Header)
    # Ages are known from the first moment on.
    assert isinstance(written[1], Exposure)
    done = progress(journal.read(storage.journal_path(tmp_path / "real", "01", "virtual")).entries)
    assert done.stimuli == 2
    assert done.vibration_s == pytest.approx(1.0)
    said = transcript.text(journal.read(storage.journal_path(tmp_path / "real", "01", "virtual")))
    assert said.count("so far") == 1


def test_a_disk_that_takes_no_frames_leaves_the_attempt_to_the_next_runner(
    protocol: Protocol, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refuses: Refuses
) -> None:
    def full(*_: object) -> None:
        raise JournalError("the frames cannot be written")

    with monkeypatch.context() as patched:
        patched.setattr(SessionLog, "keep", full)
        with refuses(JournalError):
            bench("c").run(protocol, header("virtual"), tmp_path)
    *_, footer = entries(tmp_path, "virtual")
    assert isinstance(footer, Footer)
    assert footer.reason == "error"
    assert footer.detail.endswith("cannot be written")
    assert bench("cpt").run(protocol, header("virtual"), tmp_path).reason == "complete"
    (redone,) = [entry for entry in entries(tmp_path, "virtual") if isinstance(entry, Redo)]
    assert (redone.trial, redone.attempt, redone.put_off) == (1, 1, True)


def test_a_screen_that_is_gone_pauses_the_session(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("c")

    def gone() -> None:
        raise ScreenGone("the terminal was closed (Broken pipe)")

    one.console = ScriptedConsole(one.clock, "c", before_ask=gone)
    footer = one.run(protocol, header("virtual"), tmp_path)
    assert (footer.reason, footer.answered, footer.silent) == ("paused", 0, True)
    assert footer.detail.endswith("(Broken pipe)")
    assert bench("cpt").run(protocol, header("virtual"), tmp_path).reason == "complete"


@settings(max_examples=60)
@given(lasted_ns=st.integers(0, 200 * 10**9), killed=st.booleans())
def test_a_session_that_was_killed_counts_all_of_its_time(lasted_ns: int, killed: bool) -> None:
    clock = Machine()
    log = Lines(clock)
    log.write(header("virtual"))
    exposed, _, _ = watched(clock, log)
    exposed.look()
    looking(exposed, clock, lasted_ns)
    if not killed:
        log.write(Footer(reason="paused", answered=0))
    assert 0 <= spent_ns(log.contents) - lasted_ns <= (KILLED_NS if killed else 0)


@pytest.mark.parametrize(
    ("why", "told"),
    [
        ("by the experimenter", "Nothing more will be felt: paused by the experimenter."),
        ("the protocol's 60 min are over", "Nothing more will be felt: the protocol's 60 min are over."),
    ],
)
def test_that_nothing_more_is_felt_is_told_in_a_whole_sentence(why: str, told: str) -> None:
    assert nothing_more(why) == told
