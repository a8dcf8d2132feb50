"""Parts of a session that stand still: each process is stopped, and each call for a file hangs, at each step.

`python -m tests.faults.stalls WORD...` runs by itself each case whose name has all of the words, such as `console taps
question pause servo`, and prints its figures; without a word it prints the names of all cases.
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
import traceback
from collections import defaultdict
from collections.abc import Iterable, Iterator
from contextlib import closing, suppress
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from statistics import median
from typing import Any

import pytest

from palpate.experiment.protocol.files import shipped
from palpate.experiment.records.entries import Answer
from tests.faults import standing
from tests.faults.campaign import Count, Size
from tests.faults.standing import AtDesk, OnLines, Session
from tests.rig import visited

LABORATORIES = {Size.WHOLE: 2, Size.SUBSET: 1}
"""At a time: one a core, and of the subset one, for a session has some eight processes, and no case is tried again."""

LIMITS_S = {"silent": 0.2, "at rest": 0.6, "shown": 1.0, "disk shown": 3.0}
"""After the end, a pause or a stop: sound that lasts has ended, nothing pushes the hand any more, and the screen says
so; and the screen says that the disk does not answer.
"""

SLACK_S = {"silent": 0.05, "at rest": 0.05}
"""A block, its way to the ear, and this machine's turns, s."""

LASTS_S = 13.0
"""A session that is to end meanwhile lasts so long, s; twice and three times as long where a step was not reached."""

BEFORE_S = 1.0
"""The part stands still for so long before the session's end, or before anything is asked of it, s."""

MOST_S = 180
"""A case that takes longer is broken off, and is not survived, s."""

ACTUATOR = 2
"""Its channel comes after the headphones', from 0."""

CALLS = ("fsync", "write", "open", "rename", "stat")

STEPS = {
    "steps": ("familiarise", "masker", "armed", "question", "confirm"),
    "taps": ("familiarise", "masker", "question"),
}
"""Of each kind of trial."""

FACES: dict[str, type[Session]] = {"console": AtDesk, "lines": OnLines}

EVENTS = {
    "end": "the session's end comes",
    "pause": "a pause is asked for",
    "stop": "a stop is asked for",
    "escape": "the participant stops",
    "pedal": "the participant presses the pedal",
}
"""On lines the participant has no key."""


@dataclass(frozen=True)
class Case:
    """What stands still, a process of `standing` or one of `CALLS`, at which step, and what the session is asked
    meanwhile, one of `EVENTS`, at one of the `FACES`.
    """

    face: str
    kind: str
    step: str
    event: str
    what: str

    @property
    def name(self) -> str:
        return " ".join((self.face, self.kind, self.step, self.event, self.what))

    @property
    def hangs(self) -> bool:
        """Whether it is the disk that stands still."""
        return self.what in CALLS

    @property
    def row(self) -> str:
        what = f"a disk whose {self.what} hangs" if self.hangs else f"the {self.what} stopped"
        return f"{what}, and {EVENTS[self.event]}"


def every(steps: int | None = None) -> Iterator[Case]:
    """Yield every case that can be, or of all but the session so many steps for each combination of the rest, in turn.

    A session that is stopped is asked for nothing, and its end comes all the same.
    """
    for face, (kind, all_steps) in product(FACES, STEPS.items()):
        parts = [one for one in standing.PROGRAMS if kind == "taps" or one not in ("force device", "servo")]
        whats = (*CALLS, *parts, *standing.PEERS) if face == "console" else (*CALLS[:2], *parts)
        events = [one for one in EVENTS if face == "console" or one != "escape"]
        for (place, event), (number, what) in product(enumerate(events), enumerate(whats)):
            if (event, what) == ("escape", "screen"):
                continue
            taken = len(all_steps) if steps is None else 1 if event in ("escape", "pedal") else steps
            for n in range(taken):
                yield Case(face, kind, all_steps[(2 * place + number + n) % len(all_steps)], event, what)
        for step in all_steps:
            yield Case(face, kind, step, "end", "session")


WHOLE = tuple(every(2))
"""Each combination of face, kind, event and what stands still, at two steps of it, and the session at all."""

SUBSET = (
    Case("console", "taps", "question", "end", "session"),
    Case("console", "steps", "question", "escape", "fsync"),
    Case("console", "taps", "question", "stop", "servo"),
    Case("lines", "taps", "question", "pedal", "fsync"),
)


PEDAL = '[pedal]\nport = "rehearsal"\nbaud = 9600\ntried_on = 2026-11-27\ntried_days = 30\n'


def write_study(folder: Path, kind: str, *, lasts_s: float, pedal: bool) -> tuple[Path, Path]:
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
    rig = rig.replace("format = 2", "format = 3")
    (folder / "rig.toml").write_text(f"{rig}\n[audio]{audio}\n{PEDAL if pedal else ''}", "utf-8")
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

    def tell(self, case: Case) -> dict[str, Any]:
        """Return what came of a case, in JSON; whatever is wrong with the campaign itself is wrong with the case."""
        told: dict[str, Any] = {"row": case.row, "name": case.name, "tried": False, "lost": 0, "figures": {}}
        for times in (1, 2, 3):
            signal.signal(signal.SIGALRM, _break_off)
            signal.alarm(MOST_S)
            try:
                told |= self.run(case, times * LASTS_S)
            except Exception:
                told |= {"tried": True, "wrong": [f"the campaign failed: {traceback.format_exc(limit=-3)}"]}
            finally:
                signal.alarm(0)
                self._go_on()
            if told["tried"]:
                break
        return told

    def run(self, case: Case, lasts_s: float) -> dict[str, Any]:
        """Return whether the step was reached, the figures, what was wrong, and how many answers were lost."""
        self._number += 1
        ends = case.event == "end"
        folder, most_s = self._folder / f"study-{self._number}", lasts_s if ends else 600.0
        study, rig = write_study(folder, case.kind, lasts_s=most_s, pedal=case.event == "pedal")
        place = self._folder / "below" / str(self._number)
        with closing(FACES[case.face](place, study, rig, taps=case.kind == "taps")) as one:
            if not one.reach(case.step, lasts_s if ends else visited.PATIENCE_S):
                return {"wrong": [f"{case.step} was not reached: {one.said[-1:]}"[-400:]]}
            if case.kind == "taps" and not one.pushes(2 * standing.STAYS_S):
                return {"wrong": [f"the hand was not pushed: {one.said[-1][1][-300:]}"]}
            if not case.hangs and not one.part(case.what):
                return {"wrong": [f"there is no {case.what}"]}
            figures, wrong = self._attack(case, one, one.begun_s + lasts_s)
            lost, unknown = _lost(one)
            return {"tried": True, "lost": lost, "wrong": [*wrong, *unknown], "figures": figures}

    def _attack(self, case: Case, one: Session, ends_s: float) -> tuple[dict[str, float], list[str]]:
        ends = case.event == "end"
        if ends:
            _sleep_until(ends_s - BEFORE_S)
        begun_s = time.monotonic()
        stopped = [] if case.hangs else one.part(case.what)
        for pid in stopped:
            os.kill(pid, signal.SIGSTOP)
        if case.hangs:
            (self._hang / case.what).touch()
        if case.what != "session":
            # An entry is written, and what the question asks is done.
            one.note()
            one.key()
        _sleep_until(ends_s if ends else begun_s + BEFORE_S)
        # The answer may come before the call is over.
        asked_s = ends_s if ends else time.monotonic()
        if case.event == "pedal":
            one.pedal.press()
        elif not ends:
            one.ask(case.event)
        _sleep_until(asked_s + (1.2 * LIMITS_S["disk shown"] if case.hangs else 1.5 * LIMITS_S["shown"]))
        figures = _felt(case, one, begun_s, asked_s) | _shown(case, one, begun_s, asked_s)
        wrong = [*_beyond(figures), *_begun(case, one, asked_s)]
        for pid in stopped:
            # A session that ended has ended its parts.
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)
        self._go_on()
        # Nothing may come afterwards, from whatever waited.
        time.sleep(1.0)
        late = [] if wrong else [*_beyond(_felt(case, one, begun_s, asked_s)), *_begun(case, one, asked_s)]
        return figures, wrong + [f"{text}, when it went on" for text in late]

    def _go_on(self) -> None:
        for call in CALLS:
            (self._hang / call).unlink(missing_ok=True)


def _felt(case: Case, one: Session, begun_s: float, asked_s: float) -> dict[str, float]:
    """Return how long something was heard, or pushed the hand, that may not be any more."""
    last_s = max(one.ear.last_s.values(), default=0.0) if one.ear is not None else 0.0
    figures = {"silent": max(last_s - asked_s, 0.0)}
    if case.kind == "taps" and case.what != "force device":
        # Of a session that is stopped the last heartbeat was before.
        since_s = begun_s if case.what == "session" else asked_s
        figures["at rest"] = max(one.pushed_until_s() - since_s, 0.0)
    return figures


def _begun(case: Case, one: Session, asked_s: float) -> Iterator[str]:
    """Yield what began when nothing may be felt any more."""
    began = [at_s for channel, at_s in one.ear.began_s if channel == ACTUATOR] if one.ear is not None else []
    most_s = LIMITS_S["silent"] + SLACK_S["silent"]
    if case.what != "session" and any(at_s > asked_s + most_s for at_s in began):
        yield f"a stimulus began {began[-1] - asked_s:.2f} s after the {case.event}"


def _shown(case: Case, one: Session, begun_s: float, asked_s: float) -> dict[str, float]:
    """Return after how long what has to be on the screen was there."""
    figures: dict[str, float] = {}
    if case.what != "session" and case.event != "end":
        figures["shown"] = one.shown_s(r"\bpause", asked_s)
    if case.hangs:
        # On lines no note can be taken, and what is asked for may be the first that is written.
        waits_s = begun_s if case.face == "console" else asked_s
        figures["disk shown"] = max(one.shown_s(r"\bdisk\b", begun_s) + begun_s - waits_s, 0.0)
    return figures


def _beyond(figures: dict[str, float]) -> Iterator[str]:
    for name, found_s in figures.items():
        if found_s > LIMITS_S[name] + SLACK_S.get(name, 0.0):
            yield f"{name} after {found_s:.2f} s"


def _lost(one: Session) -> tuple[int, list[str]]:
    """Return how many answers that the screen confirmed are not on disk, and what else the journal shows is wrong."""
    lines = one.entries()
    lost = max(one.answered - sum(isinstance(line.entry, Answer) for line in lines), 0)
    wall_s = lines[0].t_ns / 1e9 - one.begun_s if lines else 0.0
    armed = [
        (line.t_ns / 1e9 - wall_s, line.entry.kind)
        for line in lines
        if line.entry.kind in ("armed", "step", "broken-off", "redo", "answer", "probed", "pair")
    ]
    wrong = []
    for channel, at_s in one.ear.began_s if one.ear is not None else []:
        before = [kind for t_s, kind in armed if t_s <= at_s + SLACK_S["silent"]][-1:]
        if channel == ACTUATOR and before in ([], ["broken-off"], ["redo"], ["answer"]):
            wrong.append(f"a stimulus after {before or 'nothing'}")
    return lost, wrong


def _sleep_until(t_s: float) -> None:
    time.sleep(max(t_s - time.monotonic(), 0.0))


def _break_off(*_: object) -> None:
    raise TimeoutError(f"not done after {MOST_S} s")


def attacks(size: Size) -> Iterator[Count]:
    """Run laboratories beside one another, and add up their cases: a row says median and worst of each figure."""
    rows: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for one in results(WHOLE if size is Size.WHOLE else SUBSET, LABORATORIES[size]):
        rows[one["row"]].append(one)
    for row, found in sorted(rows.items()):
        # A step that was never reached is a failure of the row, and no try.
        tried = [one for one in found if one["tried"]]
        good = sum(not one["wrong"] and not one["lost"] for one in tried)
        failures = tuple(f"{one['name']}: {'; '.join(one['wrong'])}" for one in found if one["wrong"])
        lost = sum(one["lost"] for one in found)
        yield Count(f"{row}{_summary([one['figures'] for one in tried])}", len(tried), good, lost, failures)


def _summary(cases: list[dict[str, float]]) -> str:
    """Return median and worst of each figure in words."""
    told = ""
    for name in LIMITS_S:
        if found := [one[name] for one in cases if name in one]:
            told += f"; {name} after {median(found):.2f} s, worst {max(found):.2f} s"
    return told


def results(cases: Iterable[Case], laboratories: int = 1) -> Iterator[dict[str, Any]]:
    """Yield what comes of each case, as the laboratories tell it."""
    if shutil.which("gcc") is None or shutil.which("jackd") is None:
        pytest.skip("needs gcc and JACK 2 (package jackd2)")
    chosen = [case.name for case in cases]
    with tempfile.TemporaryDirectory(prefix="palpate-stalls-", ignore_cleanup_errors=True) as folder:
        library, source = Path(folder) / "fault.so", Path(__file__).with_name("fault.c")
        subprocess.run(["gcc", "-O1", "-shared", "-fPIC", "-o", str(library), str(source), "-ldl"], check=True)
        runs = [
            subprocess.Popen(
                [sys.executable, "-m", "tests.faults.stalls", "--laboratory", f"{folder}/{number}", str(library)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
            )
            for number in range(min(laboratories, len(chosen)))
        ]
        for number, run in enumerate(runs):
            if run.stdin is not None:
                run.stdin.write("\n".join(chosen[number::laboratories]))
                run.stdin.close()
        done = 0
        for run in runs:
            with run:
                for line in run.stdout or ():
                    done += 1
                    yield json.loads(line)
        if done != len(chosen):
            yield {"row": "a laboratory that failed", "name": "", "tried": True, "lost": 0, "figures": {}} | {
                "wrong": [f"{len(chosen) - done} cases were not run; see standard error"]
            }


def main() -> None:
    words = sys.argv[1:]
    if words[:1] == ["--laboratory"]:
        names = {case.name: case for case in every()}
        laboratory = Laboratory(Path(words[1]), Path(words[2]))
        for name in sys.stdin.read().split("\n"):
            sys.stdout.write(json.dumps(laboratory.tell(names[name])) + "\n")
            sys.stdout.flush()
        return
    exactly = [case for case in every() if case.name == " ".join(words)]
    chosen = exactly or [one for one in every() if words and all(f" {word} " in f" {one.name} " for word in words)]
    if not words:
        sys.stdout.write("".join(f"{case.name}\n" for case in every()))
    for told in results(chosen) if chosen else ():
        figures = ", ".join(f"{name} after {found_s:.2f} s" for name, found_s in told["figures"].items())
        good = told["tried"] and not told["wrong"] and not told["lost"]
        sys.stdout.write(f"{'survived' if good else 'NOT'}: {told['name']}: {figures} {told['wrong'] or ''}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
