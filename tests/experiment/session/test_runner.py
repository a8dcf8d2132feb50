"""The runner from familiarisation to the footer, with scripted devices."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from syrupy.assertion import SnapshotAssertion

from palpate.experiment import storage
from palpate.experiment.apparatus.tracker.frames import Samples
from palpate.experiment.clock import day
from palpate.experiment.desk.questions import NO, YES, Agree, Answered, Arm, Event, Place, Question, Reply
from palpate.experiment.errors import JournalError, PalpateError, PauseAsked, RigError
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import chain, journal, transcript
from palpate.experiment.records.entries import (
    Answer,
    Armed,
    Footer,
    Header,
    Note,
    Phase,
    Redo,
    Resumed,
    TrackerOpened,
    Withdrawal,
)
from palpate.experiment.records.kinds.footstep import FootStep
from palpate.experiment.records.stimulus import Stimulus
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.session.kinds.footstep.watch import BrokenStep, WatchedStep, watch
from palpate.experiment.study.roster import Roster
from tests.approved import Refuses
from tests.experiment.records.test_journal import chained
from tests.experiment.session.bench import COMPUTED, ORDER, as_read, bench, entries, header
from tests.experiment.session.scripted import START_NS, ScriptedConsole, ScriptedTracker, step_samples


def test_a_virtual_session_renders_at_the_foots_speed_and_journals_every_step(
    protocol: Protocol, tmp_path: Path
) -> None:
    one = bench("cpn")
    footer = one.run(protocol, header("virtual"), tmp_path)
    assert footer == Footer(reason="complete", answered=3, silent=True)
    assert [material for material, _ in one.rendered] == list(ORDER)
    assert [speed for _, speed in one.rendered] == pytest.approx([100.0, 200.0, 300.0], rel=1e-9)
    assert len(one.actuator.played) == 3
    assert one.console.armed == [(1, 1), (2, 1), (3, 1)]
    assert one.console.placed == []
    assert one.console.confirmations == [(1, "copy paper"), (2, "polypropylene"), (3, None)]
    kinds = [type(entry) for entry in entries(tmp_path, "virtual")]
    assert kinds == [
        Header,
        Phase,
        Phase,
        Armed,
        TrackerOpened,
        FootStep,
        Answer,
        *[Armed, FootStep, Answer] * 2,
        Footer,
    ]
    step = entries(tmp_path, "virtual")[5]
    assert isinstance(step, FootStep)
    assert step.contact_us == pytest.approx(2_000_000 + 300_000, abs=1)
    assert step.stimulus is not None
    assert (step.stimulus.samples, step.stimulus.floored_bins, step.stimulus.handed_peak) == (2500, 3, 1.5)
    assert step.stimulus.computed == COMPUTED


def test_every_stimulus_on_record_says_how_it_was_computed(protocol: Protocol, tmp_path: Path) -> None:
    bench("cpn").run(protocol, header("virtual"), tmp_path)
    step = next(e for e in entries(tmp_path, "virtual") if isinstance(e, FootStep))
    assert step.stimulus is not None
    told = step.stimulus.model_dump()
    for wrong in (told | {"computed": None}, {name: told[name] for name in told if name != "computed"}):
        with pytest.raises(ValidationError, match="computed"):
            Stimulus.model_validate(wrong)


def test_the_priority_of_a_session_is_journaled_each_time_it_runs(protocol: Protocol, tmp_path: Path) -> None:
    one, two = bench("cq"), bench("pn")
    one.priority, two.priority = "real time", "ordinary"
    one.run(protocol, header("virtual"), tmp_path)
    two.run(protocol, header("virtual"), tmp_path)
    said = [e.detail for e in entries(tmp_path, "virtual") if isinstance(e, Phase) and e.state == "ready"]
    assert said == ["priority: real time", "priority: ordinary"]


def test_a_real_session_names_the_object_to_lay_out_and_plays_nothing(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("cpt")
    one.run(protocol, header("real"), tmp_path)
    assert one.console.placed == list(enumerate(ORDER, start=1))
    assert one.actuator.played == []
    assert all(e.stimulus is None for e in entries(tmp_path, "real") if isinstance(e, FootStep))


def test_familiarisation_lasts_as_long_as_the_protocol_asks(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("cpt")
    one.run(protocol, header("real"), tmp_path)
    assert one.console.familiarised == 2, "100 s a time, 180 s wanted"
    # Once, before the first trial.
    assert one.console.instructed == [protocol.task("real").instruction]
    early = "It is too early to continue; the protocol requires 180 s of familiarization; 100 s have passed."
    assert one.console.shown.count(early) == 1


def test_how_often_each_material_was_handled_is_counted_and_on_record(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("cpt")
    keys = {material.key: material.id for material in protocol.materials if material.key}
    first, second, *_ = keys
    one.console.handles.extend([first, second, first])
    one.run(protocol, header("real"), tmp_path)
    assert one.console.counts[0] == {key: f"{name} (0)" for key, name in keys.items()}
    assert one.console.counts[2] == one.console.counts[0] | {key: f"{keys[key]} (1)" for key in (first, second)}
    said = [e.detail for e in entries(tmp_path, "real") if isinstance(e, Phase) and e.state == "familiarised"]
    assert said == [f"200.0 s; handled: {keys[first]} 2, {keys[second]} 1"]


@pytest.mark.parametrize("keys", ["cq", "cpt"], ids=["paused", "complete"])
def test_nobody_who_withdrew_is_resumed(protocol: Protocol, tmp_path: Path, keys: str, refuses: Refuses) -> None:
    bench(keys).run(protocol, header("real"), tmp_path)
    path = storage.journal_path(tmp_path, "01", "real")
    with closing(journal.Journal(path, ManualClock(START_NS), journal.read(path))) as opened:
        opened.append(Withdrawal(reason="asked to stop", torn=""))
    before = path.read_bytes()
    with refuses(JournalError):
        bench("ptt").run(protocol, header("real"), tmp_path)
    assert path.read_bytes() == before


def test_nobody_begins_who_withdrew_by_the_roster(protocol: Protocol, tmp_path: Path, refuses: Refuses) -> None:
    path = storage.roster_path(tmp_path)
    path.parent.mkdir()
    known = Roster.load(path)
    known.enrol("01", None)
    known.withdraw("01", "asked to stop")
    with refuses(JournalError):
        bench("cpt").run(protocol, header("real"), tmp_path)
    assert not storage.journal_path(tmp_path, "01", "real").exists()


def test_response_time_runs_from_contact_in_device_time(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("cpt")
    one.run(protocol, header("real"), tmp_path)
    first = next(e for e in entries(tmp_path, "real") if isinstance(e, Answer))
    assert first.response_time_s == pytest.approx(1.0 - 0.3, abs=1e-6)


def test_the_raw_frames_of_every_step_are_kept_up_to_the_end_of_the_tail(protocol: Protocol, tmp_path: Path) -> None:
    bench("cpt").run(protocol, header("real"), tmp_path)
    path = storage.foot_path(storage.journal_path(tmp_path, "01", "real"))
    steps = [e for e in entries(tmp_path, "real") if isinstance(e, FootStep)]
    # One byte a sample at 1 kHz: 30 mm at 100, 200, 300 mm/s, then 100 ms of tail; the scripted foot rests for 200.
    landed_us = np.array([step.contact_us - 2_000_000 * n for n, step in enumerate(steps, start=1)])
    assert landed_us == pytest.approx([300_000, 150_000, 100_000], abs=0.1)
    # Each lands on a sample; rounding decides on which side of it.
    lengths = [step.trace.length for step in steps]
    assert lengths == (np.ceil((landed_us + 100_000) / 1000) + 1).tolist()
    assert [step.link.received for step in steps] == (np.floor(landed_us / 1000) + 1).tolist()
    assert [step.trace.offset for step in steps] == [0, lengths[0], sum(lengths[:2])]
    assert path.stat().st_size == sum(lengths)


class Going(ManualClock):
    """Passes for a clock of the machine."""

    simulated = False


class SlowConsole(ScriptedConsole):
    """Takes a second to lay out an object, 3 ms to show an answer, and 2 ms to show a trial."""

    def tell(self, event: Event) -> None:
        super().tell(event)
        if isinstance(event, Answered):
            self._clock.sleep_ns(3_000_000)

    def ask(self, question: Question | Arm) -> Reply:
        if isinstance(question, Place):
            self._clock.sleep_ns(1_000_000_000)
        if isinstance(question, Arm):
            self._clock.sleep_ns(2_000_000)
        return super().ask(question)


@pytest.mark.parametrize("task", ["real", "virtual"])
def test_the_dead_time_after_an_answer_is_journaled_without_the_laying_out(
    protocol: Protocol, tmp_path: Path, task: str
) -> None:
    clock = Going(START_NS)
    one = bench("crpt")
    one.clock, one.console = clock, SlowConsole(clock, "crpt")
    one.tracker = ScriptedTracker(as_read(4, 150.0), clock=clock)
    one.run(protocol, header(task), tmp_path)
    steps = [e for e in entries(tmp_path, task) if isinstance(e, FootStep)]
    assert [(step.trial, step.attempt) for step in steps] == [(1, 1), (2, 1), (3, 1), (2, 2)]
    # None came before the first, and what came before the third was no answer.
    assert [step.dead_time_ms for step in steps] == [None, 5.0, None, 5.0]
    said = transcript.text(journal.read(storage.journal_path(tmp_path, "01", task)))
    assert " ".join(said.split()).count("; armed 5.0 ms after") == 2


def test_simulated_time_knows_no_dead_time(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("cpt")
    one.console = SlowConsole(one.clock, "cpt")
    one.run(protocol, header("real"), tmp_path)
    assert [e.dead_time_ms for e in entries(tmp_path, "real") if isinstance(e, FootStep)] == [None, None, None]


def test_redo_is_a_new_entry_and_a_new_attempt(protocol: Protocol, tmp_path: Path, approved: SnapshotAssertion) -> None:
    one = bench("crpt")
    one.run(protocol, header("real"), tmp_path)
    assert one.console.armed == [(1, 1), (2, 1), (3, 1), (2, 2)]
    redone = [e for e in entries(tmp_path, "real") if isinstance(e, Redo)]
    ((trial, attempt, put_off),) = [(e.trial, e.attempt, e.put_off) for e in redone]
    assert (trial, attempt, put_off) == (2, 1, True)
    assert redone[0].reason == approved


def test_the_protocols_rule_repeats_a_step_that_lost_frames(protocol: Protocol, tmp_path: Path) -> None:
    steps: list[Samples | PalpateError] = [step_samples(2_000_000 * n, 150.0) for n in range(1, 5)]
    one = bench("cpt", steps, lost=(21, 20, 0, 0))
    one.run(protocol, header("real"), tmp_path)
    assert one.console.armed == [(1, 1), (2, 1), (3, 1), (1, 2)]
    reason = "lost frames: too much of the foot's movement is missing for its speed to be trusted"
    redone = [e for e in entries(tmp_path, "real") if isinstance(e, Redo)]
    assert redone == [Redo(trial=1, attempt=1, reason=reason, put_off=True)]


def test_pause_ends_the_runner_and_the_next_one_goes_on_with_the_same_trial(
    protocol: Protocol, tmp_path: Path, approved: SnapshotAssertion
) -> None:
    first = bench("cq")
    assert first.run(protocol, header("real"), tmp_path).reason == "paused"
    assert first.console.shown[1:] == approved
    second = bench("pt")
    assert second.run(protocol, header("real"), tmp_path).reason == "complete"
    # What was felt comes again at the end of its block, whatever kept it from its answer.
    assert second.console.armed == [(3, 1), (2, 2)]
    assert second.console.familiarised == 0
    (told,) = second.console.shown
    assert told.replace(str(day(START_NS)), "DAY") == approved
    assert [e.remaining for e in entries(tmp_path, "real") if isinstance(e, Resumed)] == [(3, 2)]


def test_a_pause_that_is_asked_for_at_the_question_says_that_the_trial_comes_again(
    protocol: Protocol, tmp_path: Path, approved: SnapshotAssertion
) -> None:
    def paused() -> None:
        raise PauseAsked("by the experimenter")

    one = bench("c")
    one.console = ScriptedConsole(one.clock, "", before_ask=paused)
    assert one.run(protocol, header("real"), tmp_path).detail == "by the experimenter"
    assert one.console.shown[1:] == approved


def test_noise_that_the_rig_cannot_play_is_confirmed_before_the_first_trial(
    protocol: Protocol, tmp_path: Path, approved: SnapshotAssertion
) -> None:
    class Asked(ScriptedConsole):
        def ask(self, question: Question | Arm) -> Reply:
            if not isinstance(question, Agree):
                return super().ask(question)
            asked.append((question.text, len(self.armed)))
            return Reply(YES if len(asked) > 1 else NO)

    asked: list[tuple[str, int]] = []
    for reason in ("paused", "complete"):
        one = bench("cpt")
        one.noise = "Pink noise is played by other means."
        one.console = Asked(one.clock, "cpt")
        assert one.run(protocol, header("real"), tmp_path).reason == reason
    assert [armed for _, armed in asked] == [0, 0]
    assert [text for text, _ in asked] == approved
    notes = [e.text for e in entries(tmp_path, "real") if isinstance(e, Note)]
    assert notes == approved


def test_who_is_familiar_with_the_materials_is_not_made_so_again(protocol: Protocol, tmp_path: Path) -> None:
    """A session that was left before its first trial was armed goes on with that trial."""

    def interrupt() -> None:
        raise KeyboardInterrupt

    one = bench("c")
    one.console.instead[Place] = interrupt
    assert one.run(protocol, header("real"), tmp_path).reason == "paused"
    assert one.console.familiarised > 0
    second = bench("cpt")
    assert second.run(protocol, header("real"), tmp_path).reason == "complete"
    assert second.console.familiarised == 0


def test_an_interrupt_at_the_keyboard_pauses(protocol: Protocol, tmp_path: Path, approved: SnapshotAssertion) -> None:
    one = bench("c")

    def interrupt() -> None:
        raise KeyboardInterrupt

    one.console = ScriptedConsole(one.clock, "c", before_ask=interrupt)
    assert one.run(protocol, header("real"), tmp_path).detail.endswith("at the keyboard")
    assert bench("cpt").run(protocol, header("real"), tmp_path).reason == "complete"
    assert [e.reason for e in entries(tmp_path, "real") if isinstance(e, Redo)] == approved


def test_an_interrupt_before_the_header_leaves_nothing_behind(
    protocol: Protocol, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object) -> int:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(journal.Journal, "append", interrupt)
        assert bench("c").run(protocol, header("real"), tmp_path).reason == "paused"
    assert bench("cpt").run(protocol, header("real"), tmp_path).reason == "complete"


def test_the_protocols_longest_session_counts_over_pauses(
    protocol: Protocol, tmp_path: Path, approved: SnapshotAssertion
) -> None:
    limit = protocol.exposure.model_copy(update={"session_min": 3.375})
    short = protocol.model_copy(update={"exposure": limit})
    # 202.5 s in all: 200 s of familiarisation and 1 s an answer; the pause between the two runners does not count.
    assert bench("cq").run(short, header("real"), tmp_path).detail == "by the experimenter"
    second = bench("pt")
    second.clock.sleep_ns(3600 * 10**9)
    footer = second.run(short, header("real"), tmp_path)
    assert (footer.reason, footer.answered) == ("paused", 2)
    assert footer.detail == approved


def test_a_trial_that_no_step_satisfies_does_not_go_on_for_ever(
    protocol: Protocol, tmp_path: Path, approved: SnapshotAssertion
) -> None:
    one = bench("", [step_samples(300_000 * n, 700.0) for n in range(1, 40)])
    footer = one.run(protocol, header("real"), tmp_path)
    assert footer.detail == approved
    assert len(one.console.armed) == 30


def test_a_complete_session_is_left_as_it_is(protocol: Protocol, tmp_path: Path) -> None:
    bench("cpt").run(protocol, header("real"), tmp_path)
    path = storage.journal_path(tmp_path, "01", "real")
    before = path.read_bytes()
    again = bench("")
    assert again.run(protocol, header("real"), tmp_path).reason == "complete"
    assert path.read_bytes() == before
    assert again.console.armed == []


def test_the_head_that_a_kill_left_a_line_behind_a_complete_session_is_brought_up(
    protocol: Protocol, tmp_path: Path
) -> None:
    bench("cpt").run(protocol, header("real"), tmp_path)
    path = storage.journal_path(tmp_path, "01", "real")
    head = chain.head_path(path)
    whole, links = head.read_bytes(), chain.read(path, JournalError).links
    head.write_text(f"{len(links) - 1:012d} {links[-2].sha256}\n", "ascii")
    assert bench("").run(protocol, header("real"), tmp_path).reason == "complete"
    assert head.read_bytes() == whole


@pytest.mark.parametrize(
    ("change", "named"),
    [({"protocol_sha256": "f" * 64}, "protocol_sha256"), ({"seed": 2}, "seed"), ({"order": ()}, "order")],
)
def test_a_session_goes_on_only_as_it_was_begun(
    protocol: Protocol, tmp_path: Path, change: dict[str, object], named: str
) -> None:
    bench("cq").run(protocol, header("real"), tmp_path)
    with pytest.raises(JournalError, match=f"started with a different {named}"):
        bench("pt").run(protocol, header("real").model_copy(update=change), tmp_path)


def test_a_rig_that_was_calibrated_since_is_another_one_and_the_first_is_named(
    protocol: Protocol, tmp_path: Path
) -> None:
    bench("cq").run(protocol, header("real"), tmp_path)
    with pytest.raises(JournalError) as refused:
        bench("pt").run(protocol, header("real").model_copy(update={"rig_sha256": "2" * 64}), tmp_path)
    remedy = refused.value.finding.remedy
    assert str(storage.rig_path(storage.journal_path(tmp_path, "01", "real"))) in str(remedy)


def test_a_session_with_an_entry_that_cannot_be_read_does_not_go_on(protocol: Protocol, tmp_path: Path) -> None:
    bench("cpq").run(protocol, header("real"), tmp_path)
    path = storage.journal_path(tmp_path, "01", "real")
    chained(path, 3, b'{"kind":"note","trial":%d,"text":"a door"}' % 2**63)
    before = path.read_bytes()
    with pytest.raises(JournalError, match=r"line 4 .* 1 copy paper"):
        bench("pt").run(protocol, header("real"), tmp_path)
    assert path.read_bytes() == before


def test_a_torn_line_is_reported_on_screen_and_in_the_journal(
    protocol: Protocol, tmp_path: Path, approved: SnapshotAssertion
) -> None:
    bench("cq").run(protocol, header("real"), tmp_path)
    path = storage.journal_path(tmp_path, "01", "real")
    path.write_bytes(path.read_bytes() + b'{"n":9,"t_')
    second = bench("pt")
    second.run(protocol, header("real"), tmp_path)
    assert second.console.shown[:-1] == approved
    assert [e.torn for e in entries(tmp_path, "real") if isinstance(e, Resumed)] == ['{"n":9,"t_']


def test_a_resumed_session_goes_on_with_the_files_that_its_rig_named(
    protocol: Protocol, tmp_path: Path, refuses: Refuses
) -> None:
    assert bench("cq").run(protocol, header("virtual"), tmp_path).reason == "paused"
    (table,) = tmp_path.rglob("rehearsal-response.csv")
    table.write_text(table.read_text("utf-8").replace("0.", "1.", 1), "utf-8")
    with refuses(RigError):
        bench("pt").run(protocol, header("virtual"), tmp_path)


def test_an_attempt_is_on_disk_before_a_sound_of_it_is_possible(
    protocol: Protocol, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    known: list[object] = []

    def seen(*parts: Any) -> WatchedStep | BrokenStep:
        known.append(entries(tmp_path, "virtual")[-1])
        return watch(*parts)

    monkeypatch.setattr("palpate.experiment.session.kinds.footstep.trials.watch", seen)
    asked = header("virtual")
    bench("cpn").run(protocol, asked, tmp_path)
    assert known == [Armed(trial=one.trial, attempt=1, presented=one.presented) for one in asked.order]


def test_an_attempt_of_whose_end_nothing_is_known_is_put_off(protocol: Protocol, tmp_path: Path) -> None:
    asked = header("real")
    killed = journal.Journal(storage.journal_path(tmp_path, "01", "real"), ManualClock(START_NS), journal.Contents(()))
    killed.append(asked)
    killed.append(Armed(trial=1, attempt=1, presented=asked.order[0].presented))
    killed.close()
    one = bench("cpt")
    assert one.run(protocol, asked, tmp_path).reason == "complete"
    (redone,) = [e for e in entries(tmp_path, "real") if isinstance(e, Redo)]
    assert (redone.trial, redone.attempt, redone.put_off) == (1, 1, True)
    assert one.console.armed == [(2, 1), (3, 1), (1, 2)]
