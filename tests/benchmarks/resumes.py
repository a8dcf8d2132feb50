"""Adaptive sessions that are killed: run `python -m tests.benchmarks.resumes [KILLS]`.

A session of detection with two tracks, by a staircase or by QUEST+, runs in a process that is killed by SIGKILL at a
random moment, again and again until a process comes to the end. SIMULATED answers depend on track and block alone.
Printed is how many kills fell into a session, and after how many of them each level and each answer was that of the
same session without a kill. Not a test: it asserts nothing.
"""

from __future__ import annotations

import os
import random
import signal
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from palpate.experiment import storage
from palpate.experiment.desk.questions import Arm, Question, Reply, TrialAnswer
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Footer, Header
from palpate.experiment.records.progress import progress
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.session import attempt, runner
from palpate.experiment.session.kinds.presented.stimuli import rendered
from palpate.experiment.session.kinds.presented.trials import PresentedDevices
from palpate.experiment.study.schedule import block_trials, schedule
from tests.experiment.protocol.detection import UP_DOWN, protocol
from tests.experiment.session.bench import HEADER
from tests.experiment.session.scripted import START_NS, ScriptedActuator, ScriptedConsole

QUEST: dict[str, Any] = {
    "method": "quest-plus",
    "grid": UP_DOWN["grid"],
    "thresholds": UP_DOWN["grid"],
    "spreads_db": (2.0, 4.0),
    "lapses": (0.0, 0.04),
    "guess": 0.5,
}
RIGHT = 0.75
"""The share of right answers."""

Session = dict[int, tuple[float, str | None]]
"""Level and answer of each trial."""


class Answering(ScriptedConsole):
    """Answers each trial of a block by its track."""

    def __init__(self, header: Header, blank: str, seed: int) -> None:
        super().__init__(ManualClock(START_NS), "")
        self._header, self._blank, self._seed = header, blank, seed

    def ask(self, question: Question | Arm) -> Reply:
        if not isinstance(question, TrialAnswer):
            return super().ask(question)
        planned = self._header.order[question.trial - 1]
        (track,) = {*planned.presented} - {self._blank}
        block = (question.trial - 1) // self._header.block_trials
        is_right = random.Random(f"{self._seed} {track} {block}").random() < RIGHT
        return Reply("1" if (planned.presented[0] == track) == is_right else "2")


def study(seed: int) -> Protocol:
    levels = UP_DOWN | {"reversals": 40} if seed % 2 else QUEST
    return protocol(2, levels, repetitions=20, signal_trials=1)


def run(folder: Path, seed: int) -> None:
    of = study(seed)
    (task,) = of.tasks
    order = schedule(protocol=of, participant="01", task_id=task.id, seed=seed)
    own = {"task": task.id, "task_kind": "presented", "design": "detection", "order": order, "seed": seed}
    header = HEADER.model_copy(update=own | {"block_trials": block_trials(of, task.id)})
    actuator = ScriptedActuator()
    console = Answering(header, of.materials[-1].id, seed)
    devices = attempt.Devices(
        kind=PresentedDevices({None: actuator}, rendered(of, actuator.rate_hz)),
        console=console,
        clock=console._clock,
        masker=None,
        reconnect_s=300.0,
    )
    runner.run(protocol=of, header=header, devices=devices, rig_file=shipped("rigs/presented.toml"), dataset=folder)


def killed(folder: Path, seed: int, after_s: float) -> bool:
    """Run in a process of its own, which is killed after a while; return whether the kill came before its end."""
    child = os.fork()
    if child == 0:
        try:
            run(folder, seed)
            os._exit(0)
        finally:
            os._exit(1)
    ends_s = time.monotonic() + after_s
    while time.monotonic() < ends_s:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            if status:
                raise RuntimeError(f"a session with seed {seed} failed")
            return False
        time.sleep(0.001)
    os.kill(child, signal.SIGKILL)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL


def session(folder: Path, task: str) -> tuple[Session, bool]:
    """Return the levels and answers that count on record, and whether the session is complete."""
    path = storage.journal_path(folder, "01", task)
    entries = journal.read_if_begun(path).entries
    if not entries:
        return {}, False
    done, last = progress(entries), entries[-1]
    answered = {trial: (done.levels[trial], said) for trial, said in done.said}
    return answered, isinstance(last, Footer) and last.reason == "complete"


def main(kills: int) -> None:
    counted = alike = seed = 0
    draws, begun_s = random.Random(1), time.monotonic()
    while counted < kills:
        seed += 1
        task = study(seed).tasks[0].id
        with tempfile.TemporaryDirectory() as folder:
            whole, again = Path(folder, "whole"), Path(folder, "again")
            began_s = time.monotonic()
            run(whole, seed)
            lasts_s = time.monotonic() - began_s
            wanted, _ = session(whole, task)
            own = 0
            while not session(again, task)[1]:
                if killed(again, seed, draws.uniform(0, lasts_s)):
                    found, is_complete = session(again, task)
                    own += bool(found) and not is_complete
            counted += own
            alike += own if session(again, task)[0] == wanted else 0
    took_s = time.monotonic() - begun_s
    print(f"SIMULATED: {alike} of {counted} kills, in {seed} sessions, went on as without a kill ({took_s:.0f} s)")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 300)
