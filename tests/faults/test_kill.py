"""`kill -9` at 200 random moments of a rehearsal: nothing confirmed is lost or doubled; only what was put off moves."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from palpate.experiment import storage
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Answer, Footer, Redo
from palpate.experiment.study import schedule
from palpate.experiment.study.schedule import allocate

KILLS = 200


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory, repository_root: Path) -> list[dict[str, Any]]:
    folder = tmp_path_factory.mktemp("kill")
    run = subprocess.run(
        [sys.executable, "-m", "tests.faults.killer", str(folder), str(KILLS), "20"],
        cwd=repository_root,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
    )
    assert run.returncode == 0, run.stderr
    studies: list[dict[str, Any]] = json.loads(run.stdout)
    return studies


def test_it_was_killed_as_often_as_asked(killed: list[dict[str, Any]]) -> None:
    assert sum(one["kills"] for one in killed) == KILLS


def test_every_confirmed_answer_is_on_disk_once_and_every_order_is_the_planned_one(
    killed: list[dict[str, Any]],
) -> None:
    protocol = files.load(shipped("okamoto2012.toml"))
    for one in killed:
        confirmed = {tuple(c[:3]): c[3] for c in one["confirmed"]}
        assert len(confirmed) == len(one["confirmed"]), "an answer was confirmed twice"
        answered: dict[tuple[str, str, int], str | None] = {}
        for who in allocate(protocol, one["seed"])[:2]:
            for task in who.tasks:
                entries = journal.read(storage.journal_path(Path(one["out"]), who.participant, task)).entries
                redone = {(e.trial, e.attempt) for e in entries if isinstance(e, Redo)}
                counted = [e for e in entries if isinstance(e, Answer)]
                assert not redone & {(e.trial, e.attempt) for e in counted}
                order = schedule.schedule(
                    protocol=protocol, participant=who.participant, task_id=task, seed=one["seed"]
                )
                # Whatever was armed when it was killed may have been felt, and comes at the end of its block.
                put_off = {e.trial for e in entries if isinstance(e, Redo) and e.put_off}
                size = schedule.block_trials(protocol, task)
                answers = {e.trial: e.presented for e in counted}
                assert len(answers) == len(counted)
                assert answers == {p.trial: p.presented for p in order}
                kept = [p.trial for p in order if p.trial not in put_off]
                assert [e.trial for e in counted if e.trial not in put_off] == kept
                blocks = [(e.trial - 1) // size for e in counted]
                assert blocks == sorted(blocks)
                assert isinstance(entries[-1], Footer)
                assert entries[-1].reason == "complete"
                answered |= {(who.participant, task, e.trial): e.answered for e in counted}
        assert confirmed.items() <= answered.items()
        assert len(answered) - len(confirmed) <= one["kills"]
