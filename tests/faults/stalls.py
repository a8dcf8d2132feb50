"""Parts of a session that stand still: each process is stopped, and each call for a file hangs, at each step.

`python -m tests.faults.stalls FOLDER NUMBER SIZE` runs the cases of one laboratory, and prints one JSON line a case.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import closing, suppress
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import pytest

from palpate.experiment.protocol.files import shipped
from palpate.experiment.records.entries import Answer
from tests.faults import standing
from tests.faults.campaign import Count, Size
from tests.faults.standing import AtDesk, OnLines, Session
from tests.rig import visited

LABORATORIES = 2
"""At a time, one a core."""

SILENT_S = 0.2
"""After the end, a pause or a stop nothing is heard for longer, s."""

STILL_S = 0.6
"""After the last heartbeat nothing pushes for longer, s."""

SHOWN_S, DISK_S = 1.0, 3.0
"""A pause or stop is on the screen, and the disk that does not answer, after so long at most, s."""

SLACK_S = 0.05
"""A block, its way to the ear, and this machine's turns, s."""

LASTS_S = 13.0
"""A session that is to end meanwhile lasts so long, s; twice and three times as long where a step was not reached."""

BEFORE_S = 1.0
"""The part stands still for so long before anything is asked of the session, s."""

ACTUATOR = 2
"""Its channel comes after the headphones', from 0."""

CALLS = ("fsync", "write", "open", "rename", "stat")
EVENTS = ("end", "pause", "stop")


STEPS = {
    "steps": ("familiarise", "masker", "armed", "question", "confirm"),
    "taps": ("familiarise", "masker", "question"),
}
"""Of each kind of trial."""

FACES: dict[str, type[Session]] = {"console": AtDesk, "lines": OnLines}


@dataclass(frozen=True)
class Case:
    """What stands still, `part` (a process of `standing.PROGRAMS`, or "session") or `call`, at which step, and what the
    session is asked meanwhile, one of `EVENTS`, at one of the `FACES`.
    """

    face: str
    kind: str
    step: str
    event: str
    part: str = ""
    call: str = ""

    @property
    def row(self) -> str:
        what = f"the {self.part} stopped" if self.part else f"a disk whose {self.call} hangs"
        when = {"end": "the session's end comes", "pause": "a pause is asked for", "stop": "a stop is asked for"}
        return f"{what}, and {when[self.event]} ({self.kind}, {self.face})"


def cases() -> Iterator[Case]:
    """Yield every case that can be: a session that is stopped is asked for nothing, and its end comes all the same."""
    for face, (kind, steps) in product(FACES, STEPS.items()):
        for step, event in product(steps, EVENTS):
            for call in CALLS if face == "console" else CALLS[:2]:
                yield Case(face, kind, step, event, call=call)
            for part in standing.PROGRAMS:
                if kind == "taps" or part not in ("force device", "servo"):
                    yield Case(face, kind, step, event, part=part)
            if event == "end":
                yield Case(face, kind, step, event, part="session")


SUBSET = (
    Case("console", "taps", "question", "end", part="session"),
    Case("lines", "taps", "question", "end", call="fsync"),
    Case("console", "steps", "question", "pause", call="fsync"),
    Case("console", "taps", "question", "stop", part="servo"),
    Case("console", "steps", "armed", "stop", call="write"),
)


def write_study(folder: Path, kind: str, *, lasts_s: float) -> tuple[Path, Path]:
    """Write a study with sound and its rig into a folder, and return both files."""
    folder.mkdir()
    audio = shipped("rigs/headless.toml").read_text("utf-8").partition("\n[audio]")[2]
    delay_ms = round(standing.BLOCK / 48, 3)
    audio = audio.replace("block = 128", f"block = {standing.BLOCK}")
    audio = audio.replace("put_ms = 2.667", f"put_ms = {delay_ms}")
    # A busy machine may be late; what is measured here is when it falls silent.
    audio = re.sub(r"(onset_ms|contact_ms) = \S+", r"\1 = 100.0", audio)
    if kind == "taps":
        study = shipped("wellman1995.toml").read_text("utf-8")
        live, virtual = (study.index(f'[[tasks]]\nid = "{task}"') for task in ("live", "virtual"))
        study = (study[:live] + study[virtual:]).replace('["live", "virtual"]', '["virtual"]')
        rig = shipped("rigs/tapping.toml").read_text("utf-8").replace('"pcm-tcp"\naddress = "rehearsal"', '"audio"\n')
        rig = rig.replace("rate_hz = 16000", "rate_hz = 48000")
    else:
        study = shipped("okamoto2012.toml").read_text("utf-8")
        rig = shipped("rigs/headless.toml").read_text("utf-8").partition("\n# One device for a whole")[0]
    for pattern, new in (
        (r"^session_min = \d+", f"session_min = {lasts_s / 60:.4f}"),
        (r"^min_s = \d+", "min_s = 0"),
        (r"^max_s = \d+", "max_s = 12"),
    ):
        study = re.sub(pattern, new, study, flags=re.MULTILINE)
    (folder / "study.toml").write_text(study, "utf-8")
    (folder / "rig.toml").write_text(f"{rig}\n[audio]{audio}", "utf-8")
    shutil.copy(shipped("rigs/rehearsal-response.csv"), folder)
    return folder / "study.toml", folder / "rig.toml"


class Laboratory:
    """Runs one case after another, in folders of its own."""

    def __init__(self, folder: Path, library: Path) -> None:
        self._folder = folder
        self._hang = folder / "hang"
        self._hang.mkdir(parents=True)
        (folder / "below").mkdir()
        standing.with_faults(library, folder / "below", self._hang)
        self._number = 0

    def run(self, case: Case, lasts_s: float = LASTS_S) -> tuple[bool, int, list[str]]:
        """Return whether the step was reached, how many answers were lost, and what was wrong."""
        self._number += 1
        study, rig = write_study(
            self._folder / f"study-{self._number}", case.kind, lasts_s=lasts_s if case.event == "end" else 600.0
        )
        place = self._folder / "below" / str(self._number)
        with closing(FACES[case.face](place, study, rig, taps=case.kind == "taps")) as one:
            if not one.reach(case.step, lasts_s if case.event == "end" else visited.PATIENCE_S):
                return False, 0, [f"{case.step} was not reached: {one.said[-3:]}"]
            if case.kind == "taps" and not one.pushes(2 * standing.STAYS_S):
                return False, 0, [f"the hand was not pushed: {one.said[-1][1][-300:]}"]
            try:
                wrong = self._attack(case, one, one.begun_s + lasts_s)
            finally:
                self._go_on()
            return True, *_lost(one, wrong)

    def _attack(self, case: Case, one: Session, ends_s: float) -> list[str]:
        begun_s = time.monotonic()
        stopped = one.processes(standing.PROGRAMS.get(case.part, "")) if case.part else []
        for pid in stopped:
            os.kill(pid, signal.SIGSTOP)
        if case.call:
            (self._hang / case.call).touch()
        if case.part != "session":
            # An entry is written, and what the question asks is done.
            one.note()
            one.key()
        if case.event == "end":
            _sleep_until(ends_s)
        else:
            _sleep_until(begun_s + BEFORE_S)
            one.ask(case.event)
        asked_s = ends_s if case.event == "end" else time.monotonic()
        _sleep_until(asked_s + max(1.5 * SHOWN_S, 1.2 * DISK_S if case.call else 0.0))
        wrong = [*_felt(case, one, begun_s, asked_s), *_unshown(case, one, begun_s, asked_s)]
        for pid in stopped:
            # A session that ended has ended its parts.
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)
        self._go_on()
        # Nothing may come afterwards, from whatever waited.
        time.sleep(1.0)
        return wrong or [f"{late}, when it went on" for late in _felt(case, one, begun_s, asked_s)]

    def _go_on(self) -> None:
        for call in CALLS:
            (self._hang / call).unlink(missing_ok=True)


def _felt(case: Case, one: Session, begun_s: float, asked_s: float) -> Iterator[str]:
    """Yield what was heard or felt when nothing may be any more."""
    last_s = max(one.ear.last_s.values(), default=0.0) if one.ear is not None else 0.0
    if last_s > asked_s + SILENT_S + SLACK_S:
        yield f"heard until {last_s - asked_s:.2f} s after the {case.event}"
    began = [at_s for channel, at_s in one.ear.began_s if channel == ACTUATOR] if one.ear is not None else []
    if case.part != "session" and any(at_s > asked_s + SILENT_S + SLACK_S for at_s in began):
        yield f"a stimulus began {began[-1] - asked_s:.2f} s after the {case.event}"
    if case.kind != "taps" or case.part == "force device":
        return
    # Of a session that is stopped the last heartbeat was before.
    since_s, what = (begun_s, "last heartbeat") if case.part == "session" else (asked_s, case.event)
    if (pushed_s := one.pushed_until_s() - since_s) > STILL_S + SLACK_S:
        yield f"pushed until {pushed_s:.2f} s after the {what}"


def _unshown(case: Case, one: Session, begun_s: float, asked_s: float) -> Iterator[str]:
    """Yield what is not on the screen in time."""
    if case.part == "session":
        return
    if case.event != "end" and (shown_s := one.shown_s(r"\bpause", asked_s)) > SHOWN_S:
        yield f"the {case.event} was on the screen after {shown_s:.2f} s"
    # On lines no note can be taken, and what is asked for may be the first that is written.
    waits_s = begun_s if case.face == "console" else asked_s
    if case.call and (told_s := one.shown_s(r"\bdisk\b", begun_s) + begun_s - waits_s) > DISK_S:
        yield f"the disk was on the screen after {told_s:.2f} s"


def _lost(one: Session, wrong: list[str]) -> tuple[int, list[str]]:
    """Return how many answers that the screen confirmed are not on disk, with what else the journal shows is wrong."""
    lines = one.entries()
    lost = max(one.answered - sum(isinstance(line.entry, Answer) for line in lines), 0)
    wall_s = lines[0].t_ns / 1e9 - one.begun_s if lines else 0.0
    armed = [
        (line.t_ns / 1e9 - wall_s, line.entry.kind)
        for line in lines
        if line.entry.kind in ("armed", "step", "broken_off", "redo", "answer", "probed", "pair")
    ]
    for channel, at_s in one.ear.began_s if one.ear is not None else []:
        before = [kind for t_s, kind in armed if t_s <= at_s + SLACK_S][-1:]
        if channel == ACTUATOR and before in ([], ["broken_off"], ["redo"], ["answer"]):
            wrong.append(f"a stimulus after {before or 'nothing'}")
    return lost, wrong


def _sleep_until(t_s: float) -> None:
    time.sleep(max(t_s - time.monotonic(), 0.0))


def attacks(size: Size) -> Iterator[Count]:
    """Run laboratories beside one another, and add up their cases."""
    if shutil.which("gcc") is None or shutil.which("jackd") is None:
        pytest.skip("needs gcc and JACK 2 (package jackd2)")
    with tempfile.TemporaryDirectory(prefix="palpate-stalls-") as folder:
        library, source = Path(folder) / "fault.so", Path(__file__).with_name("fault.c")
        subprocess.run(["gcc", "-O1", "-shared", "-fPIC", "-o", str(library), str(source), "-ldl"], check=True)
        runs = [
            subprocess.Popen(
                [sys.executable, "-m", "tests.faults.stalls", f"{folder}/{number}", str(number), size.value, library],
                stdout=subprocess.PIPE,
                env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
            )
            for number in range(LABORATORIES)
        ]
        told = [json.loads(line) for run in runs for line in run.communicate()[0].splitlines()]
        if any(run.returncode for run in runs):
            raise SystemExit("the stalls failed by themselves; see standard error")
    rows: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for one in told:
        rows[one["row"]].append(one)
    for row, found in rows.items():
        # A step that was never reached is a failure of the row, and no try.
        tried = [one for one in found if one["tried"]]
        good = sum(not one["wrong"] and not one["lost"] for one in tried)
        failures = tuple(f"{one['step']}: {'; '.join(one['wrong'])}" for one in found if one["wrong"])
        yield Count(row, len(tried), good, sum(one["lost"] for one in found), failures)


def main() -> None:
    folder, number, size, library = Path(sys.argv[1]), int(sys.argv[2]), Size(sys.argv[3]), Path(sys.argv[4])
    every = list(cases()) if size is Size.WHOLE else SUBSET
    laboratory = Laboratory(folder, library)
    for case in every[number::LABORATORIES]:
        for times in (1, 2, 3):
            tried, lost, wrong = laboratory.run(case, times * LASTS_S)
            if tried:
                break
        told = {"row": case.row, "step": case.step, "tried": tried, "lost": lost, "wrong": wrong}
        sys.stdout.write(json.dumps(told) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
