"""Training before the trials that count: drawn apart, told right or wrong, on record alone, and whole after a kill."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from palpate.experiment import storage
from palpate.experiment.dataset import build, checks
from palpate.experiment.dataset.status import status
from palpate.experiment.dataset.verify import verify
from palpate.experiment.desk.messages import ENTER, TakeNote
from palpate.experiment.desk.questions import Play, Remark, Reply, TrialAnswer
from palpate.experiment.protocol.files import ProtocolFile
from palpate.experiment.protocol.models import Picture, Protocol
from palpate.experiment.records import journal, transcript
from palpate.experiment.records.entries import (
    Answer,
    Armed,
    Footer,
    Ignored,
    Note,
    Redo,
    Resumed,
    Trained,
    TrainingEnded,
)
from palpate.experiment.records.kinds.footstep import FootStep
from palpate.experiment.records.kinds.presented import Presentation
from palpate.experiment.records.progress import progress
from palpate.experiment.session.answering.training import drawn
from palpate.experiment.study.schedule import schedule
from tests.experiment.dataset.studies import DAY, MadeStudy, make_study
from tests.experiment.protocol import detection
from tests.experiment.protocol.presented import presenting
from tests.experiment.protocol.small import changed
from tests.experiment.session.kinds.presented.test_trials import PRESENTED, Bench, header
from tests.experiment.session.scripted import ScriptedConsole

KEYS = {"felt": "f", "cork": "k"}
OTHER = {"felt": "k", "cork": "f"}
CRITERION = {"right": 3, "of": 4, "unmet": "go on"}
TABLE = '[tasks.training]\ntrials = 6\nfeedback = true\ncriterion = { right = 3, of = 4, unmet = "end" }\n\n'


def trained(trials: int = 6, feedback: bool = True, criterion: dict[str, Any] | None = None) -> Protocol:
    """The small study of presented stimuli with a training."""
    table = {"trials": trials, "feedback": feedback} | ({"criterion": criterion} if criterion else {})
    return ProtocolFile.model_validate(changed(presenting(), ("tasks", 0, "training"), table))


def presented(study: Protocol) -> list[str]:
    """What the training of participant 01 presents, in order."""
    (task,) = study.tasks
    assert task.training is not None
    return [one.presented[0] for one in drawn(study, task.training, header(PRESENTED[:2]))]


def answering(study: Protocol, right: str) -> list[str]:
    """The keys of a session in whose training `right` says which answers are right: `+` or `-`."""
    each = zip(right, presented(study), strict=False)
    return [*((KEYS if one == "+" else OTHER)[name] for one, name in each), "f", "k"]


def begin(folder: Path, study: Protocol, right: str, keys: Iterable[str | Remark] = ()) -> Bench:
    """A session of two trials that count, with such answers in its training, or these keys in all."""
    bench = Bench(folder, study, PRESENTED[:2], "")
    bench.console = ScriptedConsole(bench.clock, keys or answering(study, right))
    bench.console.instead[Play] = bench.press
    return bench


def ended(bench: Bench) -> list[tuple[int, int, bool | None]]:
    return [(one.answered, one.right, one.reached) for one in bench.of(TrainingEnded)]


@pytest.mark.parametrize("trials", [1, 5, 40])
def test_its_trials_are_drawn_apart_from_those_that_count(trials: int) -> None:
    study = trained(trials)
    (task,) = study.tasks
    assert task.training is not None
    bare = ProtocolFile.model_validate(presenting())
    orders = []
    for participant in ("01", "02"):
        asked = {"participant": participant, "task_id": "one", "seed": 7}
        assert schedule(protocol=study, **asked) == schedule(protocol=bare, **asked)  # type: ignore[arg-type]
        own = header(PRESENTED[:2]).model_copy(update={"participant": participant})
        order = drawn(study, task.training, own)
        assert order == drawn(study, task.training, own)
        assert [one.trial for one in order] == [*range(1, trials + 1)]
        blocks = [{one.presented for one in order[at : at + 2]} for at in range(0, trials - trials % 2, 2)]
        assert blocks == [{("felt",), ("cork",)}] * (trials // 2)
        orders.append(order)
    assert (orders[0] != orders[1]) or trials < 40


def test_what_has_no_right_answer_is_in_no_training_and_pairs_come_in_either_order() -> None:
    table = {"trials": 60, "feedback": True}
    study = ProtocolFile.model_validate(changed(detection.detecting(2), ("tasks", 0, "training"), table))
    (task,) = study.tasks
    assert task.training is not None
    shown = {one.presented for one in drawn(study, task.training, header(PRESENTED[:2]))}
    signals = {one.id for one in study.materials[:-1]}
    assert shown == {pair for one in signals for pair in ((one, study.materials[-1].id), (study.materials[-1].id, one))}


@pytest.mark.parametrize(
    ("right", "criterion", "end"),
    [
        ("+++", CRITERION, (3, 3, True)),
        ("+-++", CRITERION, (4, 3, True)),
        ("--+-++", CRITERION, (6, 3, True)),
        ("--+--+", CRITERION, (6, 2, False)),
        ("-+-+-+", None, (6, 3, None)),
    ],
)
def test_it_ends_by_its_criterion_or_its_trials_and_those_that_count_follow(
    tmp_path: Path, right: str, criterion: dict[str, Any] | None, end: tuple[int, int, bool | None]
) -> None:
    bench = begin(tmp_path, trained(criterion=criterion), right)
    assert bench.run().reason == "complete"
    assert ended(bench) == [end]
    told = [one.right for one in bench.of(Trained) if one.right is not None]
    assert told == [one == "+" for one in right]
    assert [one.presented for one in bench.of(Presentation)] == [*PRESENTED[:2]]
    assert [one.answered for one in bench.of(Answer)] == ["felt", "cork"]
    assert bench.console.trained == [6] * len(right) + [None] * 2
    done = progress(bench.entries)
    assert (done.answered, done.trained, done.stimuli) == ((1, 2), tuple(told), len(right) + 2)
    kept = journal.read(storage.journal_path(tmp_path, "01", "one"))
    rows = list(build.kind_of(bench.study.tasks[0]).cells(tmp_path, kept))
    assert [outcome.trial for outcome, _ in rows] == [1, 2]
    assert len(transcript.text(kept).splitlines()) > len(kept.lines)


def test_what_is_told_follows_each_answer_and_nothing_is_where_the_protocol_has_none(tmp_path: Path) -> None:
    silent = begin(tmp_path / "silent", trained(feedback=False, criterion=CRITERION), "+-++")
    silent.run()
    bench = begin(tmp_path / "told", trained(criterion=CRITERION), "+-++")
    bench.run()
    (task,) = bench.study.tasks
    assert task.training is not None
    told = [task.training.told_right if one == "+" else task.training.told_wrong for one in "+-++"]
    assert bench.console.instructed == [task.instruction, *told, task.instruction]
    assert silent.console.instructed == [task.instruction] * 2


def test_the_pictures_of_a_task_stand_beside_its_instruction_again_once_the_training_is_over(tmp_path: Path) -> None:
    study = trained(criterion=CRITERION)
    pictures = (Picture(file="tap.png", sha256="0" * 64),)
    task = study.tasks[0].model_copy(update={"pictures": pictures})
    bench = begin(tmp_path, study.model_copy(update={"tasks": (task,)}), "+-++")
    bench.run()
    shown = zip(bench.console.instructed, bench.console.pictured, strict=True)
    assert [names for told, names in shown if told == task.instruction] == [("tap.png",)] * 2


def test_a_session_ends_without_the_criterion_where_the_protocol_says_so_and_begins_no_trial(tmp_path: Path) -> None:
    bench = begin(tmp_path, trained(criterion=CRITERION | {"unmet": "end"}), "-" * 6)
    for _ in range(2):
        footer = bench.run()
        assert (footer.reason, footer.answered) == ("complete", 0)
        assert ended(bench) == [(6, 0, False)]
        assert bench.of(Armed) == []
        assert progress(bench.entries).remaining == ()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.parametrize("question", [Play, TrialAnswer])
@pytest.mark.parametrize("at", [1, 3])
def test_a_kill_in_a_training_costs_the_trial_under_way(tmp_path: Path, question: type, at: int) -> None:
    bench = begin(tmp_path, trained(criterion=CRITERION), "--+-++")
    if (child := os.fork()) == 0:
        asked = 0

        def kill() -> Reply | None:
            nonlocal asked
            asked += 1
            if asked == at:
                os.kill(os.getpid(), signal.SIGKILL)
            return Reply(ENTER) if question is Play else None

        bench.console.instead[question] = kill
        bench.run()
        os._exit(1)
    assert os.WTERMSIG(os.waitpid(child, 0)[1]) == signal.SIGKILL
    before = [one.right for one in bench.of(Trained) if one.right is not None]
    assert before == [False, False][: at - 1]
    names = presented(bench.study)
    left = [*names[at:], names[at - 1]]
    again = begin(tmp_path, bench.study, "", [*(KEYS[name] for name in left[:3]), "f", "k"])
    assert again.run().reason == "complete"
    assert ended(again) == [(at + 2, 3, True)]
    (cut,) = [one.entry for one in again.of(Trained) if isinstance(one.entry, Redo)]
    assert (cut.trial, cut.put_off) == (at, True)
    assert len(again.of(Resumed)) == 1


def test_a_trial_of_it_that_is_done_again_comes_at_its_end(tmp_path: Path) -> None:
    study = trained(trials=3)
    names = presented(study)
    bench = begin(tmp_path, study, "", ["/", *(KEYS[name] for name in (*names[1:], names[0])), "f", "k"])
    assert bench.run().reason == "complete"
    answers = [one.entry for one in bench.of(Trained) if isinstance(one.entry, Answer)]
    assert [(one.trial, one.attempt) for one in answers] == [(2, 1), (3, 1), (1, 2)]
    assert bench.of(Redo) == []


def test_what_is_noted_meanwhile_is_of_no_trial_that_counts(tmp_path: Path) -> None:
    study = trained(trials=1)
    keys: list[str | Remark] = [TakeNote(trial=1, text="they laughed"), *answering(study, "+")]
    bench = begin(tmp_path, study, "", keys)
    bench.console.early.extend(["", "x"])
    assert bench.run().reason == "complete"
    assert [one.trial for one in (*bench.of(Note), *bench.of(Ignored))] == [None, None]


@pytest.fixture(scope="module")
def steps(tmp_path_factory: pytest.TempPathFactory) -> MadeStudy:
    real = '[[tasks]]\nid = "real"'
    further = {"format = 4": "format = 7", real: TABLE + real}
    return make_study(tmp_path_factory.mktemp("training") / "study", sessions=0, enrolled=2, further=further)


def step_keys(made: MadeStudy, participant: str) -> list[str]:
    """The right answers of a participant's training of footsteps."""
    task, keys = made.protocol.task("virtual"), {one.id: str(one.key) for one in made.protocol.materials}
    assert task.training is not None
    order = drawn(made.protocol, task.training, made.header(participant, "virtual"))
    return [keys[one.presented[0]] for one in order]


def test_footsteps_of_a_training_are_on_record_and_in_no_table_or_trace(steps: MadeStudy) -> None:
    asked = steps.header("01", "virtual")
    keys = step_keys(steps, "01")
    # Paused in the training, so that no trial that counts has a step.
    steps.run(asked, [*keys[:2], steps.protocol.answers.pause_key])
    build.build(steps.root)
    assert verify(steps.root).refused == 0
    told = status(steps.root, DAY).as_dict()["sessions"]
    assert isinstance(told, list)
    assert [(one["trained"], one["training"]) for one in told] == [(2, None)]
    steps.run(asked, [keys[3], *"capt"])
    build.build(steps.root)
    assert verify(steps.root).refused == 0
    path = storage.journal_path(steps.root, "01", "virtual")
    kept = journal.read(path).entries
    felt = [one.entry for one in kept if isinstance(one, Trained) and isinstance(one.entry, FootStep)]
    assert len(felt) == 4
    assert len([one for one in kept if isinstance(one, FootStep)]) == 4
    assert all(one.frames is not None for one in kept if isinstance(one, Trained) and isinstance(one.entry, FootStep))
    assert isinstance(kept[-1], Footer)
    rows = checks.table_rows(steps.root / "sub-01" / "beh" / "sub-01_task-virtual_events.tsv")
    assert [row["trial"] for row in rows[:-1]] == ["1", "2", "3", "4"]
