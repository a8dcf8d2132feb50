"""The masker's level: chosen, journaled on every change, within its limit, and summed over the day."""

from __future__ import annotations

import threading
import time
from collections import deque
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from syrupy.assertion import SnapshotAssertion

from palpate.experiment import storage
from palpate.experiment.apparatus.ports import MaskerExposure
from palpate.experiment.desk.messages import ENTER, Repeat
from palpate.experiment.desk.questions import NO, YES, Agree, Debrief, Level, Reply
from palpate.experiment.errors import DoseUsedUp
from palpate.experiment.protocol.models import Probe, Protocol
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Footer, MaskerSet, Note
from palpate.experiment.records.kinds.footstep import Probed
from palpate.experiment.records.progress import progress
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.session.masker import FIRST_DB_A, STEP_DB, Masking
from tests.experiment.session.bench import Bench, bench, header
from tests.experiment.session.scripted import START_NS, ScriptedConsole


class ScriptedMasker:
    """Implements `Masker` on a clock: a dose of 1 is 1000 s of noise at any level."""

    def __init__(self, clock: ManualClock, limit_db_a: float = 60.0) -> None:
        self.level_db_a: float | None = None
        self.limit_db_a = limit_db_a
        self._clock = clock
        self._begun_ns = clock.now_ns()

    def start(self, level_db_a: float) -> float:
        self._begun_ns = self._clock.now_ns()
        return self._set(level_db_a)

    def set_level(self, level_db_a: float) -> float:
        assert self.level_db_a is not None
        return self._set(level_db_a)

    def stop(self) -> None:
        self.level_db_a = None

    def exposure(self) -> MaskerExposure:
        dose = (self._clock.now_ns() - self._begun_ns) / 1e12
        return MaskerExposure(self.level_db_a, dose, None, None)

    def _set(self, level_db_a: float) -> float:
        self.level_db_a = min(level_db_a, self.limit_db_a)
        return self.level_db_a


def masked(one: Bench, levels: str, limit_db_a: float = 60.0) -> Bench:
    one.masker = ScriptedMasker(one.clock, limit_db_a)
    one.console.levels = deque(levels)
    return one


def levels(dataset: Path) -> list[float | None]:
    entries = journal.read(storage.journal_path(dataset, "01", "real")).entries
    return [entry.level_db_a for entry in entries if isinstance(entry, MaskerSet)]


def test_the_level_is_chosen_before_the_first_trial_and_every_change_is_journaled(
    protocol: Protocol, tmp_path: Path
) -> None:
    one = masked(bench("c+p-t"), "++-.")
    assert one.run(protocol, header("real"), tmp_path) == Footer(reason="complete", answered=3)
    chosen = FIRST_DB_A + STEP_DB
    assert levels(tmp_path) == [
        *(FIRST_DB_A + n * STEP_DB for n in (0, 1, 2, 1)),
        chosen + STEP_DB,
        chosen,
        None,
    ]
    assert one.console.armed[0] == (1, 1)
    kinds = [entry.kind for entry in journal.read(storage.journal_path(tmp_path, "01", "real")).entries]
    assert kinds.index("masker") < kinds.index("step")
    assert kinds[-2:] == ["masker", "footer"]


def test_no_key_goes_above_the_limit(protocol: Protocol, tmp_path: Path, approved: SnapshotAssertion) -> None:
    one = masked(bench("cpt"), "+++++.", limit_db_a=55.0)
    one.run(protocol, header("real"), tmp_path)
    assert [level for level in levels(tmp_path) if level is not None] == [50, 52, 54, 55, 55, 55]
    assert one.console.shown[-1] == approved


@pytest.mark.parametrize(("goes_on", "noted"), [(True, 1), (False, 0)])
def test_what_is_still_heard_at_the_limit_goes_on_record(
    protocol: Protocol, tmp_path: Path, goes_on: bool, noted: int
) -> None:
    one = masked(bench("cpt"), "++h" if goes_on else "++h.", limit_db_a=54.0)
    one.console.instead[Agree] = lambda: Reply(YES if goes_on else NO)
    assert one.run(protocol, header("real"), tmp_path) == Footer(reason="complete", answered=3)
    assert not one.console.levels
    told = "The participant can still hear the sound to be masked at the limit of 54 dB(A)."
    entries = journal.read(storage.journal_path(tmp_path, "01", "real")).entries
    assert [(one.trial, one.text) for one in entries if isinstance(one, Note)] == [(None, told)] * noted


def test_nothing_can_be_still_heard_below_the_limit(protocol: Protocol, tmp_path: Path) -> None:
    one = masked(bench("cpt"), "h")
    with pytest.raises(AssertionError, match="h is not offered"):
        one.run(protocol, header("real"), tmp_path)


def test_the_masker_is_silent_in_the_debriefing_and_chosen_anew_for_what_is_done_again(
    protocol: Protocol, tmp_path: Path
) -> None:
    one = masked(bench("cptc"), "+.+.")
    assert one.masker is not None
    playing: list[float | None] = []
    said = iter([Repeat(trial=1, reason="it coughed"), None, None])

    def debriefed() -> Reply:
        assert one.masker is not None
        playing.append(one.masker.level_db_a)
        # Its dose is on disk.
        assert levels(tmp_path)[-1] is None
        return Reply(remark=next(said))

    one.console.instead[Debrief] = debriefed
    assert one.run(protocol, header("real"), tmp_path) == Footer(reason="complete", answered=3)
    assert playing == [None, None]
    assert levels(tmp_path) == [50, 52, None, 52, 54, None]
    assert not one.console.levels


def test_a_resumed_session_begins_at_the_level_that_was_chosen(protocol: Protocol, tmp_path: Path) -> None:
    masked(bench("cq"), "++.").run(protocol, header("real"), tmp_path)
    masked(bench("pt"), ".").run(protocol, header("real"), tmp_path)
    assert levels(tmp_path) == [50, 52, 54, None, 54, None]


def test_a_session_that_ends_early_leaves_silence(protocol: Protocol, tmp_path: Path) -> None:
    one = masked(bench(""), ".")
    one.tracker._steps.clear()
    one.run(protocol, header("real"), tmp_path)
    assert one.masker is not None
    assert one.masker.level_db_a is None
    assert levels(tmp_path) == [50, None]


@pytest.mark.parametrize(("presses", "keys", "answered"), [(0, "", 0), (1, "", 0), (4, "c+-p", 2)])
def test_a_level_that_the_dose_does_not_allow_pauses_the_session(
    protocol: Protocol, tmp_path: Path, presses: int, keys: str, answered: int, approved: SnapshotAssertion
) -> None:
    """The dose is used up as the masker starts, as the first level is chosen, or at the question of trial 2."""
    one = masked(bench(f"{keys}t"), "++-.")
    masker = one.masker
    assert isinstance(masker, ScriptedMasker)
    begun, left = masker._set, [presses]

    def until_used_up(level_db_a: float) -> float:
        left[0] -= 1
        if left[0] < 0:
            masker.stop()
            raise DoseUsedUp("masker: got a dose of 1.00 in 24 hours")
        return begun(level_db_a)

    masker._set = until_used_up  # type: ignore[method-assign]
    footer = one.run(protocol, header("real"), tmp_path)
    assert (footer.reason, footer.answered) == ("paused", answered)
    assert levels(tmp_path)[-1] is None
    assert [footer.detail, *one.console.shown[1:][-1:]] == approved


def test_a_dose_that_is_used_up_between_trials_pauses_the_session(
    protocol: Protocol, tmp_path: Path, approved: SnapshotAssertion
) -> None:
    one = masked(bench("cpta"), ".")
    assert one.masker is not None
    begun = one.masker.exposure

    def spent() -> MaskerExposure:
        answered = sum(
            entry.kind == "answer" for entry in journal.read(storage.journal_path(tmp_path, "01", "real")).entries
        )
        return replace(begun(), dose=1.0) if answered == 2 else begun()

    one.masker.exposure = spent  # type: ignore[method-assign]
    footer = one.run(protocol, header("real"), tmp_path)
    assert (footer.reason, footer.answered) == ("paused", 2)
    assert footer.detail == approved


def probed(protocol: Protocol) -> Protocol:
    probe = Probe(material="aluminum foil", speed_mm_s=210.0)
    return protocol.model_copy(update={"masker": protocol.masker.model_copy(update={"probe": probe})})


def test_a_probe_is_on_record_before_it_sounds_and_counts_as_a_stimulus(
    protocol: Protocol, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = masked(bench("cpc"), "+pp.")
    path = storage.journal_path(tmp_path, "01", "virtual")
    sounded, on_record = one.actuator.landed, []

    def landed(contact_ns: int) -> None:
        on_record.append(journal.read(path).entries[-1].kind)
        sounded(contact_ns)

    monkeypatch.setattr(one.actuator, "landed", landed)
    footer = one.run(probed(protocol), header("virtual"), tmp_path)
    assert footer.reason == "complete"
    assert on_record[:2] == ["probed", "probed"]
    assert one.rendered[:2] == [("aluminum foil", 210.0)] * 2
    entries = journal.read(path).entries
    probes = [entry for entry in entries if isinstance(entry, Probed)]
    assert [(entry.material, entry.stimulus.samples) for entry in probes] == [("aluminum foil", 2500)] * 2
    done = progress(entries)
    assert (done.stimuli, done.vibration_s) == (2 + 3, 5 * 2500 / one.actuator.rate_hz)


@pytest.mark.parametrize(("stated", "task"), [(False, "virtual"), (True, "real")])
def test_there_is_no_probe_without_the_protocols_word_or_an_actuator(
    protocol: Protocol, tmp_path: Path, stated: bool, task: str
) -> None:
    one = masked(bench("cpc"), "p.")
    with pytest.raises(AssertionError, match="p is not offered"):
        one.run(probed(protocol) if stated else protocol, header(task), tmp_path)


def test_no_probe_is_felt_once_the_time_is_over(protocol: Protocol, tmp_path: Path) -> None:
    one = masked(bench("cpc"), "")
    pressed = iter("p.")

    def late() -> Reply:
        one.clock.sleep_ns(2 * 3600 * 10**9)
        return Reply(next(pressed).replace(".", ENTER))

    one.console.instead[Level] = late
    footer = one.run(probed(protocol), header("virtual"), tmp_path)
    assert footer.reason == "paused"
    entries = journal.read(storage.journal_path(tmp_path, "01", "virtual")).entries
    assert not [entry for entry in entries if isinstance(entry, Probed)]


def test_other_keys_are_not_the_maskers() -> None:
    clock = ManualClock(START_NS)
    masker = ScriptedMasker(clock)
    written: list[MaskerSet | Note] = []
    one = Masking(masker, ScriptedConsole(clock, ""), written.append, clock)
    assert one.change("+")
    assert (masker.level_db_a, written) == (None, []), "it stays silent"
    masker.start(50.0)
    assert not one.change("c")
    assert one.change("-")
    assert [entry.level_db_a for entry in written if isinstance(entry, MaskerSet)] == [48.0]


def test_a_disk_that_stands_still_holds_up_neither_silence_nor_the_dose() -> None:
    """The first write hangs until it is let go; what came meanwhile goes on record afterwards, in its order."""
    clock = ManualClock(START_NS)
    masker, written = ScriptedMasker(clock), list[MaskerSet | Note]()
    hangs, goes_on = threading.Event(), threading.Event()

    def write(entry: MaskerSet | Note) -> None:
        hangs.set()
        assert goes_on.wait(10)
        written.append(entry)

    one = Masking(masker, ScriptedConsole(clock, ""), write, clock)
    masker.start(50.0)
    writer = threading.Thread(target=one.change, args=("-",))
    writer.start()
    try:
        assert hangs.wait(60)
        # Each of these would not return.
        assert (one.exposure.level_db_a, one.spent()) == (48.0, "")
        one.end()
        assert masker.level_db_a is None
        masker.start(50.0)
        one.silence()
        assert (masker.level_db_a, written) == (None, [])
    finally:
        goes_on.set()
        writer.join(60)
    one.record()
    assert [entry.level_db_a for entry in written if isinstance(entry, MaskerSet)] == [48.0, None]


@given(st.lists(st.tuples(st.sampled_from("++++--."), st.floats(0, 0.4)), max_size=60))
def test_the_level_rises_no_faster_than_the_ear_follows_and_one_press_is_remembered(
    presses: list[tuple[str, float]],
) -> None:
    """2 dB in half a second, however fast whichever keys come, and whoever keeps up meanwhile (`.`): one step up that
    came too soon follows, unless a softer came, which counts at once.
    """
    clock = ManualClock(START_NS)
    masker = ScriptedMasker(clock, limit_db_a=80.0)
    written = list[MaskerSet | Note]()
    one = Masking(masker, ScriptedConsole(clock, ""), written.append, clock)
    level_db_a, now_s, remembered, rises_s, rises = masker.start(54.0), 0.0, False, 0.0, 0
    for key, after_s in presses:
        clock.sleep_ns(round(after_s * 1e9))
        now_s += round(after_s * 1e9) / 1e9
        for wanted in (remembered and key != "-", key == "+"):
            if wanted and now_s > rises_s - 1e-6:
                level_db_a, rises_s, rises, remembered = min(level_db_a + 2, 80.0), now_s + 0.5, rises + 1, False
            elif wanted:
                remembered = True
        if key == "-":
            level_db_a, remembered = level_db_a - 2, False
        if key == ".":
            one.keep_up()
        else:
            assert one.change(key)
        assert masker.level_db_a == level_db_a
    assert len(written) == rises + sum(key == "-" for key, _ in presses)


@pytest.mark.parametrize("drops", ["-", "pause", "keep"])
def test_a_press_that_is_remembered_is_dropped_by_softer_by_a_pause_and_by_keeping_the_level(drops: str) -> None:
    clock = ManualClock(START_NS)
    masker = ScriptedMasker(clock)
    console = ScriptedConsole(clock, "")
    one = Masking(masker, console, lambda _: None, clock)
    masker.start(50.0)
    for _ in range(3):
        assert one.change("+")
    assert masker.level_db_a == 52.0
    if drops == "-":
        one.change("-")
    elif drops == "pause":
        one.silence()
    else:
        one.drop()
    clock.sleep_ns(10**9)
    assert one.keep_up() == ""
    assert masker.level_db_a == {"-": 50.0, "pause": None, "keep": 52.0}[drops]


def test_softer_counts_while_the_disk_holds_up_a_step_up() -> None:
    """The step up that was under way is not taken any more, and what is on record last is what is heard."""
    clock = ManualClock(START_NS)
    masker, written = ScriptedMasker(clock), list[MaskerSet | Note]()
    hangs, goes_on = threading.Event(), threading.Event()

    def write(entry: MaskerSet | Note) -> None:
        if not written:
            hangs.set()
            assert goes_on.wait(10)
        written.append(entry)

    one = Masking(masker, ScriptedConsole(clock, ""), write, clock)
    masker.start(50.0)
    rising = threading.Thread(target=one.change, args=("+",))
    rising.start()
    assert hangs.wait(60)
    falling = threading.Thread(target=one.change, args=("-",))
    falling.start()
    ends_s = time.monotonic() + 10
    while masker.level_db_a != 48.0 and time.monotonic() < ends_s:
        time.sleep(0.001)
    goes_on.set()
    rising.join(60)
    falling.join(60)
    assert masker.level_db_a == 48.0
    assert [entry.level_db_a for entry in written if isinstance(entry, MaskerSet)] == [52.0, 48.0]


def test_the_level_that_is_asked_about_is_the_one_that_is_kept(protocol: Protocol) -> None:
    """A key pressed within half a second of the one before is carried out before the level is asked about again."""
    clock, asked = ManualClock(START_NS), list[float]()

    class AtOnce(ScriptedConsole):
        def ask(self, question: object) -> Reply:
            assert isinstance(question, Level)
            asked.append(question.level_db_a)
            return Reply(key=("+", "+", "-", "+", ENTER)[len(asked) - 1])

    masker = ScriptedMasker(clock)
    one = Masking(masker, AtOnce(clock, ""), lambda _: None, clock)
    one.choose(protocol.masker, None, None)
    assert asked == [50.0, 52.0, 54.0, 52.0, 54.0]
    assert masker.level_db_a == 54.0
    assert clock.now_ns() - START_NS >= 10**9
