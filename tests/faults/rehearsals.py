"""`kill -9` at random moments of a rehearsal: nothing confirmed is lost or doubled; only what was put off moves."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from palpate.experiment import storage
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Answer, Entry, Footer, PlannedTrial, Redo
from palpate.experiment.study import schedule
from palpate.experiment.study.schedule import allocate
from tests.faults.campaign import Count, Size
from tests.faults.killer import PARTICIPANTS
from tests.faults.ledger import Wrong

SEED = 20


def attacks(size: Size) -> Iterator[Count]:
    """Kill rehearsals, each until it is complete, and check what each left."""
    kills = size.of(40, 200)
    with tempfile.TemporaryDirectory() as folder:
        killed = subprocess.run(
            [sys.executable, "-m", "tests.faults.killer", folder, str(kills), str(SEED)],
            stdout=subprocess.PIPE,
            check=True,
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        )
        rehearsed: list[dict[str, Any]] = json.loads(killed.stdout)
        wrong = [(one, list(_wrong(one))) for one in rehearsed]
    tried = sum(one["kills"] for one in rehearsed)
    yield Count(
        "SIGKILL at any moment of a rehearsal",
        tried,
        tried - sum(one["kills"] for one, found in wrong if found),
        sum(one.lost for _, found in wrong for one in found),
        tuple(one.text for _, found in wrong for one in found),
    )


def _wrong(one: dict[str, Any]) -> Iterator[Wrong]:
    """Yield what does not hold of a rehearsal that was killed again and again, and is complete."""
    protocol = files.load(shipped("okamoto2012.toml"))
    confirmed = {tuple(c[:3]): c[3] for c in one["confirmed"]}
    if twice := len(one["confirmed"]) - len(confirmed):
        yield Wrong(f"{twice} answers were confirmed twice", twice)
    answered: dict[tuple[str, str, int], str | None] = {}
    for who in allocate(protocol, one["seed"])[:PARTICIPANTS]:
        for task in who.tasks:
            entries = journal.read(storage.journal_path(Path(one["out"]), who.participant, task)).entries
            order = schedule.schedule(protocol=protocol, participant=who.participant, task_id=task, seed=one["seed"])
            for text in _broken(entries, order, schedule.block_trials(protocol, task)):
                yield Wrong(f"{one['out']}, {who.participant}, {task}: {text}")
            answered |= {(who.participant, task, e.trial): e.answered for e in entries if isinstance(e, Answer)}
    if lost := len(confirmed.items() - answered.items()):
        yield Wrong(f"{lost} answers were confirmed, and are not on disk", lost)
    if len(answered) - len(confirmed) > one["kills"]:
        yield Wrong(f"{len(answered)} answers are on disk; {len(confirmed)} were confirmed in {one['kills']} lives")


def _broken(entries: tuple[Entry, ...], order: tuple[PlannedTrial, ...], size: int) -> Iterator[str]:
    """Yield what is broken in the journal of a task that was planned in this order, in blocks of this size."""
    redone = {(e.trial, e.attempt) for e in entries if isinstance(e, Redo)}
    counted = [e for e in entries if isinstance(e, Answer)]
    if redone & {(e.trial, e.attempt) for e in counted}:
        yield "an attempt that is done again counts"
    answers = {e.trial: e.presented for e in counted}
    if len(answers) != len(counted):
        yield "a trial was answered twice"
    if answers != {planned.trial: planned.presented for planned in order}:
        yield "other trials were answered than were planned"
    # Whatever was armed when it was killed may have been felt, and comes at the end of its block.
    put_off = {e.trial for e in entries if isinstance(e, Redo) and e.put_off}
    kept = [planned.trial for planned in order if planned.trial not in put_off]
    if [e.trial for e in counted if e.trial not in put_off] != kept:
        yield "a trial that was not put off has moved"
    blocks = [(e.trial - 1) // size for e in counted]
    if blocks != sorted(blocks):
        yield "a trial was put off beyond its block"
    last = entries[-1]
    if not isinstance(last, Footer) or last.reason != "complete":
        yield "the journal does not end as complete"
