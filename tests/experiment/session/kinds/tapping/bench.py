"""A session of comparisons with a scripted experimenter, and what it wrote."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.desk.questions import Arm, Place, Question, Remark, Reply
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Footer, Header, PlannedTrial
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.session import attempt, runner
from palpate.experiment.session.kinds.tapping.trials import ComparisonDevices
from tests.experiment.session.bench import HEADER
from tests.experiment.session.scripted import START_NS, ScriptedConsole

PAIRS = (("felt", "tin"), ("cork", "cork"), ("tin", "cork"))
ORDER = tuple(PlannedTrial(trial=n, presented=pair) for n, pair in enumerate(PAIRS, start=1))
OWN = {"task": "live", "task_kind": "tapping", "design": "comparison"}
ASKED = HEADER.model_copy(update={**OWN, "order": ORDER, "block_trials": len(ORDER)})


class LayingConsole(ScriptedConsole):
    """Takes two seconds to lay out a pair."""

    def ask(self, question: Question | Arm) -> Reply:
        if isinstance(question, Place):
            self._clock.sleep_ns(2 * 10**9)
        return super().ask(question)


def console(keys: Iterable[str | Remark], clock: ManualClock | None = None) -> LayingConsole:
    return LayingConsole(clock or ManualClock(START_NS), keys)


def run(protocol: Protocol, desk: LayingConsole, dataset: Path, asked: Header = ASKED) -> Footer:
    devices = attempt.Devices(kind=ComparisonDevices(), console=desk, clock=desk._clock, masker=None, reconnect_s=300.0)
    rig_file = shipped("rigs/rehearsal.toml")
    return runner.run(protocol=protocol, header=asked, devices=devices, rig_file=rig_file, dataset=dataset)


def contents(dataset: Path) -> journal.Contents:
    return journal.read(storage.journal_path(dataset, "01", "live"))
