"""Notes, corrections and keys that were typed too early: what of them is on record, and what the table takes."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment import storage
from palpate.experiment.dataset import build
from palpate.experiment.dataset.kinds.footstep import DATASET
from palpate.experiment.desk.link.standing import standing
from palpate.experiment.desk.link.wire import Standing
from palpate.experiment.desk.messages import Correct, Gauges, Repeat, Reveal, TakeNote
from palpate.experiment.desk.questions import (
    REVEALED,
    Arm,
    Attended,
    Debrief,
    Place,
    Question,
    Remark,
    Reply,
    Report,
    TrialAnswer,
)
from palpate.experiment.errors import ScreenGone
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import journal, transcript
from palpate.experiment.records.entries import (
    Answer,
    Commanded,
    Correction,
    Footer,
    Ignored,
    Note,
    Redo,
    Visited,
    Withdrawal,
)
from palpate.experiment.records.kinds.footstep import FootStep
from palpate.experiment.records.progress import progress
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.session import exposure, remarks
from palpate.experiment.session.remarks import Attendance, Remarks
from tests.experiment.session.bench import Bench, bench, entries, header
from tests.experiment.session.scripted import ScriptedConsole
from tests.experiment.session.test_exposure import Machine, real_time


def run(protocol: Protocol, folder: Path, *keys: str | Remark, remarks: tuple[Remark, ...] = ()) -> ScriptedConsole:
    one = bench("cpt")
    one.console = ScriptedConsole(one.clock, keys)
    one.console.remarks.extend(remarks)
    one.console.confirm_ns = 2 * 10**9
    one.run(protocol, header("real"), folder)
    return one.console


def test_a_note_belongs_to_the_trial_at_which_it_was_made(protocol: Protocol, tmp_path: Path) -> None:
    run(
        protocol,
        tmp_path,
        "c",
        TakeNote(text="A door slammed.", trial=2),
        "p",
        "t",
        remarks=(TakeNote(text="Felt every one."),),
    )
    found = [e for e in entries(tmp_path, "real") if isinstance(e, Note)]
    assert found == [Note(trial=2, text="A door slammed."), Note(trial=None, text="Felt every one.")]


@pytest.mark.parametrize("trial", [0, -1, 4, 2**63, 10**4000])
def test_a_note_on_a_trial_that_the_session_has_not_is_refused(protocol: Protocol, tmp_path: Path, trial: int) -> None:
    note = TakeNote(text="A door slammed.", trial=trial)
    replies: list[bool] = []
    one = bench("cpt")
    one.console = Attentive(one.clock, "cpt", lambda session, *_: replies.append(session.remark(note)[0]))
    one.run(protocol, header("real"), tmp_path)
    paused = remarks.paused(tmp_path, "01", (), "real", one.clock)
    assert paused is not None
    replies.append(paused.remark(note)[0])
    assert set(replies) == {False}
    assert not any(isinstance(entry, Note) for entry in entries(tmp_path, "real"))


@pytest.mark.parametrize("late", [False, True], ids=["at the next question", "after the last trial"])
@pytest.mark.parametrize(("key", "material"), [("t", "typing paper"), ("n", None)])
def test_the_table_takes_the_correction_and_the_journal_holds_both(
    protocol: Protocol, tmp_path: Path, late: bool, key: str, material: str | None
) -> None:
    correction = Correct(trial=2, key=key, reason="misheard")
    keys = ["c", "p", "t"] if late else ["c", "p", correction, "t"]
    console = run(protocol, tmp_path, *keys, remarks=(correction,) if late else ())
    found = entries(tmp_path, "real")
    assert [e.answered for e in found if isinstance(e, Answer)] == ["copy paper", "polypropylene", "typing paper"]
    expected = Correction(trial=2, attempt=1, answered=material, key=key, reason="misheard")
    assert [e for e in found if isinstance(e, Correction)] == [expected]
    (shown,) = [line for line in console.shown if line.startswith("Trial 2: ")]
    assert f" {material or 'no answer'}." in shown
    path = storage.journal_path(tmp_path, "01", "real")
    rows = build.event_rows(DATASET, path, journal.read(path), "PARTICIPANT")
    assert [row["answered"] for row in rows] == ["copy paper", material or "(none)", "typing paper"]
    assert [row.get("corrected_from", "n/a") for row in rows] == ["n/a", "polypropylene", "n/a"]
    assert f" corrected to {material or 'no answer'}: misheard" in transcript.text(journal.read(path))


def test_the_last_of_several_corrections_counts(protocol: Protocol, tmp_path: Path) -> None:
    slips = Correct(trial=1, key="t", reason="misheard"), Correct(trial=1, key="p", reason="a slip of the hand")
    run(protocol, tmp_path, "c", "p", "t", remarks=slips)
    path = storage.journal_path(tmp_path, "01", "real")
    (row, *_) = build.event_rows(DATASET, path, journal.read(path), "PARTICIPANT")
    assert (row["answered"], row["corrected_from"]) == ("polypropylene", "copy paper")


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        (
            Correct(trial=3, key="c", reason="not answered yet"),
            "Trial 3 has no answer that counts; nothing was changed.",
        ),
        (
            Correct(trial=1, key="c", reason="misheard"),
            "The answer to trial 1 is already copy paper. Nothing was corrected.",
        ),
        (
            Correct(trial=99, key="c", reason="no such trial"),
            "Trial 99 has no answer that counts; nothing was changed.",
        ),
        (
            Correct(trial=1, key="q", reason="no answer"),
            "'q' is not the key of an answer; type one of c a p t n. Nothing was corrected.",
        ),
    ],
)
def test_what_cannot_be_corrected_is_refused_in_words(
    protocol: Protocol, tmp_path: Path, wrong: Correct, told: str
) -> None:
    console = run(protocol, tmp_path, "c", wrong, "p", "t")
    assert told in console.shown
    assert not any(isinstance(e, Correction) for e in entries(tmp_path, "real"))


def test_an_answer_that_was_corrected_and_then_done_again_is_the_new_one(protocol: Protocol, tmp_path: Path) -> None:
    """A correction is of the attempt that was answered: it does not reach a later one."""
    run(protocol, tmp_path, "c", "p", "t", remarks=(Correct(trial=1, key="t", reason="misheard"),))
    path = storage.journal_path(tmp_path, "01", "real")
    contents = journal.read(path)
    first = [e for e in contents.entries if isinstance(e, FootStep | Answer) and e.trial == 1]
    again = [e.model_copy(update={"attempt": 2}) for e in first]
    again[-1] = again[-1].model_copy(update={"answered": "polypropylene"})
    redo = Redo(trial=1, attempt=1, reason="asked to", put_off=False)
    lines = tuple(replace(contents.lines[-1], entry=entry) for entry in (redo, *again))
    rows = build.event_rows(DATASET, path, replace(contents, lines=contents.lines + lines), "PARTICIPANT")
    found = [(row["attempt"], row["counted"], row["answered"], row.get("corrected_from")) for row in rows]
    assert found[0] == (1, False, "typing paper", "copy paper")
    assert found[-1] == (2, True, "polypropylene", None)
    assert [row["answered"] for row in rows if row["trial"] == 1 and row["counted"]] == ["polypropylene"]


def test_what_was_corrected_before_a_pause_stays_and_what_was_not_answered_is_not_corrected(
    protocol: Protocol, tmp_path: Path
) -> None:
    one = bench("cpt")
    one.console = ScriptedConsole(one.clock, ["c", Correct(trial=1, key="t", reason="misheard"), "q"])
    assert one.run(protocol, header("real"), tmp_path).reason == "paused"
    second = bench("cpt")
    second.console = ScriptedConsole(second.clock, ["p", Correct(trial=2, key="c", reason="not yet"), "t"])
    assert second.run(protocol, header("real"), tmp_path).reason == "complete"
    found = entries(tmp_path, "real")
    assert [(e.trial, e.attempt, e.answered) for e in found if isinstance(e, Correction)] == [(1, 1, "typing paper")]


def test_response_time_ends_at_the_choice_and_not_at_the_confirmation(protocol: Protocol, tmp_path: Path) -> None:
    run(protocol, tmp_path, "c", "p", "t")
    answers = [e for e in entries(tmp_path, "real") if isinstance(e, Answer)]
    assert [(e.confirmed_s or 0.0) - e.response_time_s for e in answers] == pytest.approx([2.0] * 3)


def test_a_choice_that_is_not_confirmed_is_no_answer(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("cpt")
    one.console = ScriptedConsole(one.clock, ["c", "p", "q", "p", "t"])
    one.console.confirms.extend([False, True, False])
    one.run(protocol, header("real"), tmp_path)
    found = entries(tmp_path, "real")
    assert [e.key for e in found if isinstance(e, Answer)] == ["p", "p", "t"]
    assert not any(isinstance(e, Redo) for e in found)


def test_what_was_typed_too_early_is_on_record_and_answers_nothing(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("cpt")
    one.console.early.extend(["\n", "", "pp"])
    one.run(protocol, header("real"), tmp_path)
    found = entries(tmp_path, "real")
    # Before the first trial, and after the first question.
    ignored = [e for e in found if isinstance(e, Ignored)]
    assert ignored == [Ignored(trial=None, typed="\n"), Ignored(trial=1, typed="pp")]
    assert isinstance(found[-1], Footer)


@pytest.mark.parametrize(
    "ended", [KeyboardInterrupt(), ScreenGone("the terminal was closed")], ids=["Ctrl-C", "no screen"]
)
@pytest.mark.parametrize("prompt", [TrialAnswer, Place, Debrief])
def test_what_was_typed_before_the_question_that_ended_the_session_is_on_record(
    protocol: Protocol, tmp_path: Path, prompt: type, ended: BaseException
) -> None:
    one = bench("cpt")

    def end() -> None:
        one.console.early.append("p\n")
        raise ended

    one.console.instead[prompt] = end
    assert one.run(protocol, header("real"), tmp_path).reason == "paused"
    *_, ignored, footer = entries(tmp_path, "real")
    assert ignored == Ignored(trial=None if prompt is Debrief else 1, typed="p\n")
    assert isinstance(footer, Footer)


def test_an_answered_trial_is_done_again_and_its_answer_no_longer_counts(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("ccccc")
    one.console = ScriptedConsole(one.clock, ["c", Repeat(trial=1, reason="a door slammed"), "p", "a", "t"])
    assert one.run(protocol, header("real"), tmp_path).reason == "complete"
    found = entries(tmp_path, "real")
    redone = Redo(trial=1, attempt=1, reason="a door slammed", put_off=True)
    assert [e for e in found if isinstance(e, Redo)] == [redone]
    assert [(e.trial, e.attempt) for e in found if isinstance(e, Answer)] == [(1, 1), (2, 1), (3, 1), (1, 2)]
    path = storage.journal_path(tmp_path, "01", "real")
    rows = build.event_rows(DATASET, path, journal.read(path), "PARTICIPANT")
    assert [(row["trial"], row["counted"]) for row in rows] == [(1, 0), (2, 1), (3, 1), (1, 1)]


def test_the_trial_at_its_question_is_repeated_without_an_answer(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("cccc")
    one.console = ScriptedConsole(one.clock, [Repeat(trial=1, reason="coughed"), "p", "t", "c"])
    assert one.run(protocol, header("real"), tmp_path).reason == "complete"
    found = entries(tmp_path, "real")
    assert [(e.trial, e.attempt, e.reason) for e in found if isinstance(e, Redo)] == [(1, 1, "coughed")]
    assert [e.trial for e in found if isinstance(e, Answer)] == [2, 3, 1]


def test_a_trial_that_is_repeated_at_the_end_reopens_the_session(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("cccc")
    one.console = ScriptedConsole(one.clock, ["c", "p", "t", "a"])
    one.console.remarks.append(Repeat(trial=2, reason="was distracted"))
    assert one.run(protocol, header("real"), tmp_path).answered == 3
    assert [e.trial for e in entries(tmp_path, "real") if isinstance(e, Answer)] == [1, 2, 3, 2]


class Attentive(ScriptedConsole):
    """Asks something of the session whenever a trial is armed."""

    def __init__(
        self, clock: ManualClock, keys: Iterable[str | Remark], ask: Callable[[Attended, int, int], None]
    ) -> None:
        super().__init__(clock, keys)
        self._asks = ask

    def ask(self, question: Question | Arm) -> Reply:
        reply = super().ask(question)
        if isinstance(question, Arm) and not question.broken_off:
            session = self.attended[-1]
            assert session is not None
            self._asks(session, question.trial, question.attempt)
        return reply


def test_a_pause_while_a_trial_is_armed_lets_nothing_be_felt(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("cpt")
    one.console = Attentive(one.clock, "", lambda session, *_: session.pause("by the experimenter"))
    footer = one.run(protocol, header("virtual"), tmp_path)
    assert (footer.reason, footer.detail) == ("paused", "by the experimenter")
    assert not [e for e in entries(tmp_path, "virtual") if isinstance(e, FootStep)]
    assert one.console.attended[-1] is None
    again = bench("cpt")
    assert again.run(protocol, header("virtual"), tmp_path).reason == "complete"


def test_a_trial_that_is_repeated_for_two_reasons_is_repeated_once_and_nothing_pauses(
    protocol: Protocol, tmp_path: Path
) -> None:
    one = bench("cptc", lost=(30, 0, 0, 0))
    seen: list[int] = []

    def ask(session: Attended, trial: int, _: int) -> None:
        if not seen:
            # While the foot falls: nothing looks before it has landed.
            at_its_contact(one, session, trial)
        seen.append(trial)

    one.console = Attentive(one.clock, "ptc", ask)
    assert one.run(protocol, header("virtual"), tmp_path).reason == "complete"
    (redo,) = [e for e in entries(tmp_path, "virtual") if isinstance(e, Redo)]
    assert redo.trial == 1
    assert redo.reason.startswith("lost frames: ")
    assert redo.reason.endswith("; a door slammed")
    assert seen == [1, 2, 3, 1]


def at_its_contact(one: Bench, session: Attended, trial: int) -> None:
    """Have the trial repeated at the moment at which its stimulus sounds."""
    landed = one.actuator.landed

    def repeat(contact_ns: int) -> None:
        one.actuator.landed = landed  # type: ignore[method-assign]
        assert session.remark(Repeat(trial=trial, reason="a door slammed"))[0]
        landed(contact_ns)

    one.actuator.landed = repeat  # type: ignore[method-assign]


def test_what_is_noted_at_the_end_of_a_visit_is_of_no_trial(protocol: Protocol, tmp_path: Path) -> None:
    """The questions at a visit's end come before the debriefing, and after the last trial."""
    one = bench("cpt")
    told: list[int | None] = []
    one.console.instead[Report] = lambda: told.append(remarks_of(one).trial)
    one.last = True
    one.run(protocol, header("real"), tmp_path)
    assert told == [None, None]


def remarks_of(one: Bench) -> Remarks:
    attended = one.console.attended[-1]
    assert isinstance(attended, Attendance)
    return attended.remarks


def test_the_desk_is_told_which_answers_were_corrected(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("cpt")
    told: list[Standing] = []
    keys: list[str | Remark] = ["c", Correct(trial=1, key="t", reason="misheard"), "p", "t"]
    one.console = Attentive(one.clock, keys, lambda session, *_: told.append(standing(session.done())))
    one.run(protocol, header("virtual"), tmp_path)
    recent = [(answer.trial, answer.words, answer.corrected) for answer in told[-1].recent]
    assert recent == [(1, "typing paper", True), (2, "polypropylene", False)]


def test_response_time_ends_when_the_key_was_pressed_and_not_when_it_was_on_record(
    protocol: Protocol, tmp_path: Path
) -> None:
    seconds = {}
    for ago_ns in (0, 400_000_000):
        one = real_time("cp", Machine())
        one.console.chosen_before_ns = ago_ns
        one.run(protocol, header("real"), tmp_path / str(ago_ns))
        found = [e for e in entries(tmp_path / str(ago_ns), "real") if isinstance(e, Answer)]
        seconds[ago_ns] = [(e.confirmed_s or 0.0) - e.response_time_s for e in found]
    assert seconds[0] == pytest.approx([0.0] * 2)
    assert seconds[400_000_000] == pytest.approx([0.4] * 2)


def test_what_is_asked_for_after_a_sessions_end_is_refused(
    protocol: Protocol, tmp_path: Path, approved: SnapshotAssertion
) -> None:
    one = bench("cpt")
    one.run(protocol, header("real"), tmp_path)
    session = next(session for session in one.console.attended if session is not None)
    before = entries(tmp_path, "real")
    assert session.remark(TakeNote(text="too late")) == approved
    session.commanded(by="test", command="note", taken=False, words="")
    assert entries(tmp_path, "real") == before


def test_a_desk_is_told_how_far_the_session_is_and_never_what_was_presented(protocol: Protocol, tmp_path: Path) -> None:
    told: list[tuple[Gauges, Standing]] = []
    one = bench("cnt")

    def looks(session: Attended, *_: int) -> None:
        gauges = session.gauges()
        assert gauges is not None
        told.append((gauges, standing(session.done())))

    one.console = Attentive(one.clock, "cnt", looks)
    one.run(protocol, header("virtual"), tmp_path)
    assert [standing.remaining for _, standing in told] == [3, 2, 1]
    assert [(answer.trial, answer.words) for answer in told[-1][1].recent] == [(1, "copy paper"), (2, "no answer")]
    assert [gauges.stimuli for gauges, _ in told] == [0, 1, 2]
    assert all(gauges.left_s > 0 and gauges.masker_db_a is None for gauges, _ in told)
    assert {lamp.name for lamp in told[-1][0].lamps} >= {"tracker", "disk"}


@pytest.mark.parametrize("allowed", [True, False])
def test_answers_by_material_are_told_where_the_protocol_allows_it_and_that_goes_on_record(
    protocol: Protocol, tmp_path: Path, allowed: bool
) -> None:
    allows = protocol.model_copy(update={"answers": protocol.answers.model_copy(update={"reveal": allowed})})
    told: list[Standing] = []
    one = bench("cpt")
    keys: list[str | Remark] = ["c", Reveal(), "p", Reveal(), "t"]
    one.console = Attentive(one.clock, keys, lambda session, *_: told.append(standing(session.done())))
    one.run(allows, header("real"), tmp_path)
    revealed = [e for e in entries(tmp_path, "real") if isinstance(e, Visited) and e.step == REVEALED]
    assert len(revealed) == allowed
    assert not told[0].tallies
    assert [one.revealed for one in told] == [False, False, *[allowed] * (len(told) - 2)]
    presented = [planned.track for planned in header("real").order]
    counts = {one.presented: one.answers for one in told[-1].tallies}
    expected = {presented[0]: (("copy paper", 1),), presented[1]: (("polypropylene", 1),)} if allowed else {}
    assert counts == expected
    assert len(told[-1].responses_s) == 2
    steps = [e.speed_mm_s for e in entries(tmp_path, "real") if isinstance(e, FootStep)]
    assert told[-1].speeds_mm_s == tuple(steps[:-1])
    # Whoever resumes it finds it shown.
    paused = remarks.paused(tmp_path, "01", ("real",), "real", one.clock)
    assert paused is not None
    assert standing(paused.done()).revealed == allowed


@pytest.mark.parametrize(("keys", "reason"), [("cq", "paused"), ("cpt", "complete")])
def test_a_note_in_a_pause_goes_on_record_and_changes_nothing_else(
    protocol: Protocol, tmp_path: Path, keys: str, reason: str
) -> None:
    one = bench(keys)
    assert remarks.paused(tmp_path, "01", ("virtual", "real"), "real", one.clock) is None
    one.run(protocol, header("real"), tmp_path)
    path = storage.journal_path(tmp_path, "01", "real")
    before = journal.read(path)
    one.clock.sleep_ns(60 * 10**9)
    session = remarks.paused(tmp_path, "01", ("virtual", "real"), "virtual", one.clock)
    assert session is not None
    assert session.remark(TakeNote(text="They tire."))[0]
    session.commanded(by="lab", command="note", taken=True, words="done")
    assert not session.remark(Correct(trial=1, key="t", reason="misheard"))[0]
    after = journal.read(path)
    assert after.entries[len(before.entries) :] == (
        Note(trial=None, text="They tire."),
        Commanded(by="lab", command="note", taken=True, reply="done"),
    )
    done = progress(after.entries)
    assert done == progress(before.entries)
    assert done.footer is not None
    assert done.footer.reason == reason
    assert exposure.spent_ns(after) == exposure.spent_ns(before)
    assert exposure.since_ended_ns(after, one.clock) == one.clock.now_ns() - before.lines[-1].t_ns
    assert standing(session.done()).answered == len(done.answered)


def test_a_session_whose_participant_withdrew_in_the_pause_takes_no_note(
    protocol: Protocol, tmp_path: Path, approved: SnapshotAssertion
) -> None:
    one = bench("cq")
    one.run(protocol, header("real"), tmp_path)
    path = storage.journal_path(tmp_path, "01", "real")
    session = remarks.paused(tmp_path, "01", (), "real", one.clock)
    assert session is not None
    with closing(journal.Journal(path, one.clock, journal.read(path))) as opened:
        opened.append(Withdrawal(reason="asked to stop", torn=""))
    before = path.read_bytes()
    taken, words = session.remark(TakeNote(text="They look tired."))
    assert not taken
    assert words == approved
    session.commanded(by="lab", command="note", taken=False, words=words)
    assert path.read_bytes() == before


def test_a_session_goes_on_after_a_note_in_its_pause(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("cq")
    one.run(protocol, header("real"), tmp_path)
    session = remarks.paused(tmp_path, "01", (), "real", one.clock)
    assert session is not None
    session.remark(TakeNote(text="They look tired."))
    assert bench("pt").run(protocol, header("real"), tmp_path).reason == "complete"
