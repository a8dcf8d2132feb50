"""`kill -9` of a rehearsal with several processes: no worker outlives it, and the same command goes on."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from experiment.session import journal
from experiment.session.resume import progress


def command(out: Path) -> list[str]:
    palpate = Path(sys.executable).with_name("palpate")
    return [str(palpate), "rehearse", "--participants", "6", "--jobs", "2", "--out", str(out), "--json"]


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
    begun = subprocess.Popen(command(out), cwd=repository_root, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    deadline = time.monotonic() + 60
    while answered(out) < 40 and time.monotonic() < deadline:
        time.sleep(0.02)
    begun.send_signal(number)
    _, err = begun.communicate(timeout=60)
    assert begun.returncode == code
    assert b"Traceback" not in err
    while processes_of(out) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert processes_of(out) == []
    before = answered(out)
    assert 40 <= before < 480
    done = subprocess.run(command(out), cwd=repository_root, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert answered(out) == 480
