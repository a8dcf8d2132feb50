"""Comparisons in a session: what is laid out, what may be answered, and what goes on record."""

from __future__ import annotations

from pathlib import Path
from typing import cast

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.desk.messages import Correct, Measured, Repeat
from palpate.experiment.protocol.designs import Meaning
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import transcript
from palpate.experiment.records.entries import Answer, Armed, Correction, Redo
from palpate.experiment.records.kinds.tapping import PairLaidOut
from palpate.experiment.records.progress import progress
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.session.kind import Lent, Log
from palpate.experiment.session.kinds.tapping.trials import Comparisons
from tests.approved import Refuses
from tests.experiment.protocol.tapping import protocol
from tests.experiment.session.kinds.tapping.bench import ASKED, ORDER, console, contents, run
from tests.experiment.session.scripted import START_NS, Endless, ScriptedConsole


def kind(study: Protocol) -> Comparisons:
    clock, unused = ManualClock(START_NS), cast("Log", None)
    desk = ScriptedConsole(clock, ())
    return Comparisons(Lent(protocol=study, header=ASKED, console=desk, clock=clock, log=unused, limits=Endless()))


def test_both_samples_are_laid_out_then_the_question_is_asked(tmp_path: Path) -> None:
    desk = console("121")
    assert run(protocol(), desk, tmp_path).reason == "complete"
    assert desk.placed == [(1, "felt | tin"), (2, "cork | cork"), (3, "tin | cork")]
    assert (desk.armed, desk.confirmations) == ([], [(1, "first"), (2, "second"), (3, "first")])


def test_what_is_on_record_of_a_trial_and_from_when_its_answer_is_timed(tmp_path: Path) -> None:
    run(protocol(), console("121"), tmp_path)
    lines = contents(tmp_path).lines
    kinds = [line.entry.kind for line in lines if line.entry.kind in ("armed", "pair", "answer")]
    assert kinds == ["armed", "pair", "answer"] * 3
    laid = [line.entry for line in lines if isinstance(line.entry, PairLaidOut)]
    # 100 s of familiarisation, 2 s of laying out, 1 s until the key, and so on.
    assert [(one.laid_ns - START_NS) / 1e9 for one in laid] == [102.0, 105.0, 108.0]
    answers = [line.entry for line in lines if isinstance(line.entry, Answer)]
    assert [(one.presented, one.answered, one.key, one.response_time_s) for one in answers] == [
        (("felt", "tin"), "first", "1", 1.0),
        (("cork", "cork"), "second", "2", 1.0),
        (("tin", "cork"), "first", "1", 1.0),
    ]
    assert isinstance(next(line.entry for line in lines if line.entry.kind == "armed"), Armed)


def test_a_key_means_a_place_and_says_which_sample_lies_there() -> None:
    assert kind(protocol()).lent.answers(ORDER[0]) == {
        "1": Meaning("first", "the first (felt)"),
        "2": Meaning("second", "the second (tin)"),
    }
    assert kind(protocol(tie_key="3")).lent.answers(ORDER[0])["3"] == Meaning("tie", "neither")


def test_nothing_is_measured_and_no_device_waited_for() -> None:
    pairs = kind(protocol())
    assert (pairs.measured(), pairs.probe) == (Measured(), None)
    pairs.reconnect(1.0)


def test_a_pair_is_not_watched_before_it_lies_there(refuses: Refuses) -> None:
    with refuses(RuntimeError):
        kind(protocol()).watch(lambda: pytest.fail("nothing is waited for"))


@pytest.mark.parametrize("again", ["/", Repeat(trial=1, reason="a sample fell down")])
def test_a_trial_that_is_put_off_is_laid_out_again_at_the_end(tmp_path: Path, again: str | Repeat) -> None:
    desk = console([again, "2", "1", "1"])
    run(protocol(), desk, tmp_path)
    assert [trial for trial, _ in desk.placed] == [1, 2, 3, 1]
    (redo,) = (one for one in contents(tmp_path).entries if isinstance(one, Redo))
    assert (redo.trial, redo.put_off) == (1, True)


def test_no_answer_is_an_answer_and_a_tie_is_one_where_it_is_allowed(tmp_path: Path) -> None:
    run(protocol(tie_key="3"), console("301"), tmp_path)
    assert progress(contents(tmp_path).entries).said == ((1, "tie"), (2, None), (3, "first"))


def test_an_answer_is_corrected_by_its_key(tmp_path: Path) -> None:
    desk = console(["1", Correct(trial=1, key="2", reason="misheard"), "2", "1"])
    run(protocol(), desk, tmp_path)
    (correction,) = (one for one in contents(tmp_path).entries if isinstance(one, Correction))
    assert (correction.trial, correction.answered) == (1, "second")
    assert progress(contents(tmp_path).entries).said[0] == (1, "second")


def test_a_session_that_pauses_goes_on_with_the_pair_that_had_no_answer(tmp_path: Path) -> None:
    paused = run(protocol(), console("1="), tmp_path)
    assert (paused.reason, paused.answered) == ("paused", 1)
    desk = console("12", ManualClock(START_NS + 10**12))
    assert run(protocol(), desk, tmp_path).reason == "complete"
    assert [trial for trial, _ in desk.placed] == [3, 2]


def test_an_interruption_before_the_answer_puts_the_pair_off(tmp_path: Path) -> None:
    class Killed(BaseException):
        pass

    def kill() -> None:
        raise Killed

    desk = console("")
    desk._before_ask = kill
    with pytest.raises(Killed):
        run(protocol(), desk, tmp_path)
    assert progress(contents(tmp_path).entries).unanswered == (1, 1)
    desk = console("121", ManualClock(START_NS + 10**12))
    run(protocol(), desk, tmp_path)
    assert [trial for trial, _ in desk.placed] == [2, 3, 1]


def test_the_transcript_tells_it_in_words(tmp_path: Path, approved: SnapshotAssertion) -> None:
    run(protocol(), console("121"), tmp_path)
    told = transcript.text(contents(tmp_path))
    assert told == approved
