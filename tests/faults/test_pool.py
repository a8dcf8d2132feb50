"""`kill -9` and Ctrl-C of a rehearsal with several processes: no worker outlives it, and the same command goes on."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from palpate.experiment.records import journal
from palpate.experiment.records.progress import progress
from tests.faults.signalled import HALT

ANSWERS, TRIALS = 40, 160


def command(out: Path) -> list[str]:
    return ["rehearse", "--participants", "2", "--jobs", "2", "--out", str(out), "--json"]


def answered(out: Path) -> int:
    found = out.glob("sourcedata/sub-*/*_journal.jsonl")
    return sum(len(progress(e).answered) for path in found if (e := journal.read(path).entries))


def processes_of(out: Path) -> list[int]:
    """Processes that hold a file of the rehearsal open."""
    holding = []
    for folder in Path("/proc").glob("[0-9]*/fd"):
        try:
            if any(link.readlink().is_relative_to(out) for link in folder.iterdir()):
                holding.append(int(folder.parent.name))
        except OSError:
            continue
    return holding


@pytest.mark.parametrize(("number", "code"), [(signal.SIGKILL, -signal.SIGKILL), (signal.SIGINT, 130)])
def test_no_worker_outlives_its_parent_and_the_same_command_goes_on(
    tmp_path: Path, repository_root: Path, number: signal.Signals, code: int
) -> None:
    out = tmp_path / "rehearsal"
    signalled = [sys.executable, "-m", "tests.faults.signalled", str(int(number)), str(ANSWERS), *command(out)]
    ended = subprocess.run(signalled, cwd=repository_root, capture_output=True, timeout=120, check=False)
    assert ended.returncode == code, ended.stderr
    assert b"Traceback" not in ended.stderr
    deadline = time.monotonic() + 60
    while processes_of(out) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert processes_of(out) == []
    assert ANSWERS <= answered(out) <= 2 * HALT
    palpate = Path(sys.executable).with_name("palpate")
    done = subprocess.run(
        [palpate, *command(out)], cwd=repository_root, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    assert answered(out) == TRIALS


def has_forked(parent: int) -> bool:
    """Whether the process that is going to analyse has begun, which is the first one."""
    return bool(Path(f"/proc/{parent}/task/{parent}/children").read_text("ascii").split())


@pytest.mark.parametrize("after_s", [0.0, 0.3, 0.7, 1.0])
def test_ctrl_c_at_a_terminal_which_every_process_hears_ends_it_in_words(
    tmp_path: Path, repository_root: Path, after_s: float
) -> None:
    """From the beginning of the first process on, and while those of the participants begin."""
    out = tmp_path / "rehearsal"
    palpate = Path(sys.executable).with_name("palpate")
    with subprocess.Popen(
        [palpate, *command(out)], cwd=repository_root, stderr=subprocess.PIPE, start_new_session=True
    ) as begun:
        while not has_forked(begun.pid):
            assert begun.poll() is None
            time.sleep(0.005)
        time.sleep(after_s)
        os.killpg(begun.pid, signal.SIGINT)
        _, said = begun.communicate(timeout=120)
    assert begun.returncode == 130, said
    assert b"Traceback" not in said
    assert processes_of(out) == []
