"""A kill, EIO and a full disk at every file-changing call of every command that writes, and links that lead outside.

`fault.c` counts the calls below a command's folder and fails one. A process that has imported everything forks a child
for each fault, which runs the command as `palpate` does, and another for the same command once more. This has to
succeed, or to say that it is done. Afterwards every file has the bytes that it has without a fault, and no temporary
file is left.

Run as a script of its own by `attacks`, so that the process that forks has no threads and the library loaded.
"""

from __future__ import annotations

import ctypes
import errno
import hashlib
import json
import mmap
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import date, timedelta
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import pytest

from palpate.analysis.documents import page
from palpate.analysis.numerics import figures, numerics, played
from palpate.analysis.numerics import report as numerics_report
from palpate.analysis.power import report as power_report
from palpate.analysis.power import simulate
from palpate.experiment import __main__ as palpate
from palpate.experiment import storage
from palpate.experiment.cli import analysis
from palpate.experiment.dataset.register import LOG
from tests.experiment.dataset.studies import make_study
from tests.experiment.protocol.small import SMALL
from tests.faults.campaign import Count, Size

FAULTS = {signal.SIGKILL: "SIGKILL", errno.EIO: "EIO", errno.ENOSPC: "ENOSPC, and no room from then on,"}

MOST = 100
"""The whole tries so many calls of a command for each fault at most, and the subset one."""

REDRAWN = 5
"""A rehearsal may make fewer calls than when they were counted: the fault is then put at the last that it made."""

SLOW = ("power", "numerics", "validate")
"""Left out of the subset; they publish as `analyse` and `export` do."""

TODAY = date.today()

TRIALS = [1, 2]
"""Of each session that is rehearsed here."""


@dataclass(frozen=True)
class Case:
    """A command, the folder that it begins with, and what it says where there is nothing left to do.

    `done` is all of that; most say nothing and end with 0. `records` is whether it writes lines of a
    journal or roster, which hold times. The tables of `dataset` have to be what `palpate build` makes of it.
    """

    command: str
    begins: str
    done: str | None = None
    records: bool = False
    dataset: str | None = None


@dataclass(frozen=True)
class Ended:
    """How a command ended: its exit code, or minus the signal; standard error; and its file-changing calls."""

    code: int
    said: str
    calls: int

    def met(self, call: int, fault: int) -> bool:
        """Whether the fault at that call came: who is killed tells no number of calls."""
        return self.code == -fault if fault == signal.SIGKILL else self.calls >= call


ENROL = f"enrol protocol.toml -p 01 --consent-on {TODAY} --dataset study --seed 1"
IMPORT = "import-counts --task one=one.csv --study small --source print --out counts"
STATES = {
    "new": "",
    "sealed": f"seal protocol.toml --approval-number 1 --approved-on {TODAY - timedelta(9)} "
    f"--expires-on {TODAY + timedelta(9)}",
    "without consent": "enrol protocol.toml -p 01 --dataset study --seed 1",
    "enrolled": ENROL,
    "rehearsed": "rehearse protocol.toml --out data --jobs 1 --json",
    "recorded": "record protocol.toml --simulated --out recordings",
}
"""Folders that commands begin with -> what was done there last; each begins with 'new', those from 'enrolled' on too
with the seal."""

CASES = (
    Case(
        STATES["sealed"],
        "new",
        done="palpate: protocol.seal.toml: 1 error\n  seal: got an existing seal; allowed: no seal: this version of "
        "the protocol is already sealed; replace it (--replace), or move it away\n",
    ),
    Case(ENROL, "sealed", done="palpate: participant 01 is already enrolled; the next label is 02\n", records=True),
    Case(
        f"consent protocol.toml -p 01 --consent-on {TODAY} --dataset study",
        "without consent",
        done=f"palpate: participant 01 already consented on {TODAY}; "
        "if the day on record is wrong, add --correct and --reason\n",
        records=True,
    ),
    Case(
        ENROL.replace("01", "02", 1),
        "enrolled",
        done="palpate: participant 02 is already enrolled; the next label is 03\n",
        records=True,
    ),
    Case(
        "withdraw study.toml -p 01 --reason asked --dataset dataset",
        "study",
        records=True,
        dataset="dataset",
    ),
    Case(
        "withdraw study.toml -p 01 --reason asked --erase --yes --dataset dataset",
        "study",
        records=True,
        dataset="dataset",
    ),
    Case("build dataset", "study", dataset="dataset"),
    Case("build data", "rehearsed", dataset="data"),
    Case(STATES["rehearsed"], "new", records=True, dataset="data"),
    Case("analyse data --no-figures", "rehearsed"),
    Case("export data --out tables", "rehearsed"),
    Case("power protocol.toml --model data --studies 20 --participants 2 --jobs 1 --out power", "rehearsed"),
    Case("numerics --quick --out numerics", "new"),
    Case(
        IMPORT,
        "new",
        done="palpate: counts: already exists, and palpate never overwrites a dataset; allowed: a new or empty folder; "
        "choose another, or move it away\n",
    ),
    Case(
        STATES["recorded"],
        "new",
        done="palpate: recordings: already contains recordings; "
        "allowed: a new or empty folder; choose another with --out\n",
    ),
    Case("validate recordings --no-figures --out validation", "recorded"),
)

LIBRARY = ctypes.CDLL(None)


def attacks(size: Size) -> Iterator[Count]:
    """Compile the library, and run this module with it."""
    if shutil.which("gcc") is None:
        pytest.skip("needs gcc")
    # In memory where that can be: what is tried fails before it reaches a disk.
    memory = next(Path("/dev").glob("shm"), None)
    with tempfile.TemporaryDirectory(prefix="palpate-faults-", dir=memory) as folder:
        library = Path(folder) / "fault.so"
        source = Path(__file__).with_name("fault.c")
        strict = ("-std=gnu11", "-O1", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC")
        subprocess.run(["gcc", *strict, "-o", str(library), str(source), "-ldl"], check=True)
        environment = os.environ | {"LD_PRELOAD": str(library), "OPENBLAS_NUM_THREADS": "1", "COLUMNS": "200"}
        runs = [
            subprocess.Popen(
                [sys.executable, "-m", "tests.faults.files", str(Path(folder) / parts[0]), size.value, *parts],
                cwd=Path(__file__).parents[2],
                stdout=subprocess.PIPE,
                env=environment,
            )
            for parts in ([["0", "1", "2", "3"]] if size is Size.SUBSET else [["0"], ["1"], ["2", "3"]])
        ]
        for said in [run.communicate()[0] for run in runs]:
            for line in said.splitlines():
                count = json.loads(line)
                yield Count(**{**count, "failures": tuple(count["failures"])})
        if any(run.returncode for run in runs):
            raise SystemExit("the attack on files failed by itself; see standard error")


def run(folder: Path, command: str, call: int = 0, fault: int = 0) -> Ended:
    """Run `palpate` in a fork, with a fault at one call that changes files in `folder`."""
    calls, said = mmap.mmap(-1, 8), os.memfd_create("said")
    child = os.fork()
    if child == 0:
        code: object = 70
        try:
            signal.alarm(60)
            os.dup2(os.open(os.devnull, os.O_RDWR), 0)
            os.dup2(0, 1)
            os.dup2(said, 2)
            os.chdir(folder)
            LIBRARY.fault_arm(str(folder).encode(), ctypes.c_long(call), fault)
            code = called(command)
        except BaseException:
            traceback.print_exc()
        finally:
            calls.write(LIBRARY.fault_seen().to_bytes(8, "little"))
            sys.stderr.flush()
            os._exit(code if isinstance(code, int) else 1)
    _, status = os.waitpid(child, 0)
    text = Path(f"/proc/self/fd/{said}").read_text("utf-8", "replace")
    os.close(said)
    return Ended(os.waitstatus_to_exitcode(status), text, int.from_bytes(calls[:8], "little"))


def called(command: str) -> object:
    """Return the exit code of `palpate` in this process and the present folder."""
    sys.argv[:] = ["palpate", *command.split()]
    try:
        palpate.main()
    except SystemExit as end:
        return end.code or 0
    return 0


def files(folder: Path, *, records: bool = False) -> dict[str, str]:
    """Every file but locks -> the hash of what it holds; and every link, which has none.

    With `records`, journals, roster and anchors are taken without what time and machine put in: see `held`.
    """
    return {
        str(path.relative_to(folder)): "" if path.is_symlink() else hashlib.sha256(held(path, records)).hexdigest()
        for path in folder.rglob("*")
        if path.is_symlink() or (path.is_file() and not path.name.endswith("lock"))
    }


def held(path: Path, records: bool) -> bytes:
    """What a file holds; a head, which names the hash of the last line, only how many lines there are.

    Of anchors only the last counts, by the lines of each file: what was cut off leaves one more, or a torn one.
    """
    data = path.read_bytes()
    if records and path.name == LOG.name:
        lasts = [json.loads(line)["anchor"]["prefixes"] for line in data.split(b"\n")[:-1][-1:]]
        return json.dumps([(prefix["file"], prefix["lines"]) for last in lasts for prefix in last]).encode()
    if records and path.suffix == ".head":
        # Empty before the first line.
        return b"".join(data.split()[:1])
    if records and path.name == storage.seed_path(path).name:
        # A command that begins a study anew draws another salt.
        return json.dumps(json.loads(data) | {"salt": ""}).encode()
    return timeless(data) if records and path.suffix == ".jsonl" else data


def timeless(lines: bytes) -> bytes:
    """Lines of a journal or roster without times, the hashes of them and of a salt, and a pseudo-terminal's number."""
    *whole, torn = lines.split(b"\n")
    documents = [json.loads(line) for line in whole]
    for document in documents:
        del document["t_ns"], document["prev"]
        for drawn in ("port", "seed_sha256"):
            document["entry"].pop(drawn, None)
    return json.dumps(documents).encode() + torn


def went_on(folder: Path) -> dict[str, list[int]]:
    """Each session that was interrupted and went on, `sub-01_task-one` -> the trials that it has answers of.

    Its steps were made anew and took other times, so that its files are others.
    """
    sessions = {}
    for path in folder.rglob("*_journal.jsonl"):
        entries = [json.loads(line)["entry"] for line in path.read_bytes().split(b"\n")[:-1]]
        if any(entry["kind"] == "resumed" for entry in entries):
            name = path.name.removesuffix("_journal.jsonl")
            sessions[name] = sorted(entry["trial"] for entry in entries if entry["kind"] == "answer")
    return sessions


def temporary(folder: Path) -> list[str]:
    return [path.name for path in folder.rglob(".*") if re.search(r"^\.palpate-|\.partial$", path.name)]


class Laboratory:
    """The folders that commands begin with, and copies of them that are attacked."""

    def __init__(self, root: Path, size: Size) -> None:
        self.cases = [case for case in CASES if size is Size.WHOLE or case.command.split()[0] not in SLOW]
        self.root = root
        self.states = root / "states"
        small = re.sub(r"approved_on.*\nexpires_on.*\n", "", SMALL.replace("    60,\n", ""))
        small = re.sub(r"(?<=participants = )\d", "2", re.sub(r"(?<=repetitions = )\d", "1", small))
        small = re.sub(r"(?<=takes = )\d", "1", small).replace('"felt"', '"copy paper"', 1)
        small = small.replace('id = "cork"', 'id = "typing paper"').replace("rate_hz = 4000", "rate_hz = 5000")
        new = self.states / "new"
        new.mkdir(parents=True)
        (new / "protocol.toml").write_text(small, "utf-8")
        rows = ("1,felt,felt,2", "1,cork,felt,1", "1,cork,cork,1", "2,felt,felt,2", "2,cork,cork,2")
        (new / "one.csv").write_text("\n".join(["participant,presented,answered,count", *rows, ""]), "utf-8")
        for state, command in STATES.items():
            if command:
                begins = "new" if state in ("sealed", "rehearsed", "recorded") else "sealed"
                shutil.copytree(self.states / begins, self.states / state)
                self.prepared(state, partial(called, command))
        make_study(self.states / "study")
        for case in self.cases:
            if case.command.split()[0] in ("analyse", "export", *SLOW):
                # Here once, so that forks have what the command imports and computes.
                self.copy(case.begins)
                self.prepared("../case/inside", partial(called, case.command))

    def prepared(self, state: str, act: Callable[[], object]) -> None:
        """Do something in this process, which so imports all that the command does."""
        before = Path.cwd()
        os.chdir(self.states / state)
        code = act()
        os.chdir(before)
        if code:
            raise SystemExit(f"{state}: ended with {code}")

    def copy(self, state: str) -> Path:
        """Return a fresh copy of a state in a folder of one name, so that paths in files are the same."""
        shutil.rmtree(self.root / "case", ignore_errors=True)
        return Path(shutil.copytree(self.states / state, self.root / "case" / "inside"))

    def calls(self, case: Case) -> tuple[int, dict[str, str]]:
        """Return how many calls of a command change files, and what the folder holds when it ends."""
        folder = self.copy(case.begins)
        ended = run(folder, case.command)
        if ended.code:
            raise SystemExit(f"{case.command}: ended with {ended.code}: {ended.said}")
        return ended.calls, files(folder, records=case.records)

    def attack(self, case: Case, call: int, fault: int, wanted: dict[str, str]) -> tuple[list[str], bool]:
        """Return what went wrong, and whether something was lost."""
        wrong = []
        for _ in range(REDRAWN):
            folder = self.copy(case.begins)
            first = run(folder, case.command, call, fault)
            if first.met(call, fault):
                break
            call = max(first.calls, 1)
        else:
            wrong.append(f"the fault never came, at call {call} at last")
        if not told(first, fault):
            wrong.append(f"ended with {first.code}: {first.said}")
        whole = wanted.items() <= files(folder, records=case.records).items()
        lost = first.code == 0 and not whole
        again = run(folder, case.command)
        if again.code != 0 and not (again.code == 2 and again.said == case.done):
            wrong.append(f"then ended with {again.code}: {again.said}")
        if left := temporary(folder):
            wrong.append(f"left {left}")
        found = files(folder, records=case.records)
        # A session that was killed and goes on has every trial answered once, and its foot trace in two recordings.
        resumed = went_on(folder)
        others = [name for name in dict(found.items() ^ wanted.items()) if not any(one in name for one in resumed)]
        gone = [name for name in wanted.keys() - found.keys() if "_physio" not in name]
        if others or gone or len(resumed) > 1 or any(trials != TRIALS for trials in resumed.values()):
            wrong.append(f"other files: {sorted(others)[:4]}, gone: {gone[:4]}, {resumed}")
        if case.dataset is not None and not wrong:
            before = files(folder)
            built = run(folder, f"build {case.dataset}")
            if built.code or files(folder) != before:
                wrong.append(f"stale tables: {built.said} {sorted(dict(files(folder).items() ^ before.items()))[:4]}")
        return wrong, lost


def told(ended: Ended, fault: int) -> bool:
    """Whether a command ended as it should, and a refusal names, in one line, the fault or the file."""
    if fault == signal.SIGKILL:
        return ended.code == -fault and "Traceback" not in ended.said
    if ended.code == 0:
        return "Traceback" not in ended.said
    return (
        ended.code == 2
        and ended.said.startswith("palpate: ")
        and ended.said.count("\n") == 1
        and os.strerror(fault) in ended.said
    )


def sample(calls: int, few: int, part: float) -> Sequence[int]:
    """Return which calls are tried: all, or a few that lie evenly, `part` of the way from each to the next."""
    return range(1, calls + 1) if calls <= few else [1 + int((place + part) * calls / few) for place in range(few)]


def every_call(laboratory: Laboratory, part: int, size: Size) -> Count:
    """One fault at the calls of every command, or of every third in the subset."""
    fault, name = list(FAULTS.items())[part]
    tried: Counter[str] = Counter()
    failures = []
    for case in laboratory.cases if size is Size.WHOLE else laboratory.cases[part :: len(FAULTS)]:
        calls, wanted = laboratory.calls(case)
        for call in sample(calls, size.of(2, MOST), (part + 0.5) / len(FAULTS)):
            wrong, lost = laboratory.attack(case, call, fault, wanted)
            tried.update(tried=1, survived=not wrong, lost=lost)
            if wrong or lost:
                failures.append(f"{case.command}: call {call} of {calls}: {'; '.join(wrong) or 'lost'}"[:500])
    name = f"{name} at a file-changing call of a command that writes"
    return Count(name, tried["tried"], tried["survived"], tried["lost"], tuple(failures))


TEMPORARY = ".palpate-0123456789abcdef"

LINKS = (
    *((STATES["rehearsed"], "new", link) for link in (".data.partial", ".data.whole", TEMPORARY)),
    *((STATES["recorded"], "new", link) for link in (".recordings.partial", ".recordings.whole", TEMPORARY)),
    *((IMPORT, "new", link) for link in (".counts.partial", TEMPORARY)),
    *(("build data", "rehearsed", f"data/{link}/{TEMPORARY}") for link in (".", "sub-01/beh", "sourcedata")),
    *(("analyse data --no-figures", "analysed", f"data/derivatives/palpate/{link}") for link in ("tables", TEMPORARY)),
    ("export data --out tables", "analysed", f"tables/{TEMPORARY}"),
)
"""A command, the folder that it begins with, and where in that a link stands that leads outside."""

MANIFESTS = (
    "../../outside/precious.csv",
    "{}/precious.csv",
    "tables/../../../outside/precious.csv",
    "link/precious.csv",
)
"""What a forged manifest says that an earlier export wrote."""


def outside(laboratory: Laboratory) -> Count:
    """Links that lead outside, and manifests that name files there."""
    shutil.copytree(laboratory.states / "rehearsed", laboratory.states / "analysed")
    for command in "analyse data --no-figures", "export data --out tables":
        run(laboratory.states / "analysed", command)
    attacked = [*LINKS, *(("export data --out tables", "analysed", manifest) for manifest in MANIFESTS)]
    failures = []
    for command, begins, where in attacked:
        folder = laboratory.copy(begins)
        precious = folder.parent / "outside"
        (precious / "deep").mkdir(parents=True)
        for file in precious / "precious.csv", precious / "deep" / "precious.csv":
            file.write_text("mine", "utf-8")
        before = files(precious)
        if where in MANIFESTS:
            (folder / "tables" / "link").symlink_to(precious)
            path = folder / "tables" / "manifest.json"
            manifest = json.loads(path.read_text("utf-8"))
            manifest["palpate"][where.format(precious)] = [before["precious.csv"]]
            path.write_text(json.dumps(manifest), "utf-8")
        else:
            shutil.rmtree(folder / where, ignore_errors=True)
            (folder / where).symlink_to(precious)
        ended = run(folder, command)
        if ended.code not in (0, 2) or "Traceback" in ended.said or files(precious) != before:
            failures.append(f"{command}: {where}: ended with {ended.code}, {sorted(files(precious))}: {ended.said}")
    name = "a link or a manifest that leads outside a command's folder"
    return Count(name, len(attacked), len(attacked) - len(failures), len(failures), tuple(failures))


def remembered(compute: Callable[..., object]) -> Callable[..., object]:
    """A function that computes once in the process that forks, whatever it is given."""
    results: list[object] = []

    def result(*given: object, **named: object) -> object:
        if not results:
            results.append(compute(*given, **named))
        return results[0]

    return result


def quickened() -> None:
    """What is computed from the same files is the same, and a rehearsal's tables are published as any others are."""
    quick = replace(
        numerics.QUICK, lengths=(250,), table_sizes=(8, 30), noise_s=(0.1,), budget_s=0.001, least_repeats=1, places=20
    )
    mock.patch.object(numerics, "QUICK", quick).start()
    drawn = (figures, ("numerics", "diagrams", "budget")), (numerics_report, ("svg", "png"))
    for module, names in (simulate, ("run",)), (numerics, ("run",)), (played, ("arrays",)), *drawn:
        for name in names:
            mock.patch.object(module, name, remembered(vars(module)[name])).start()
    drawings, analysed = remembered(page.drawings), analysis.analysed
    mock.patch.object(page, "drawings", lambda sheets: drawings(sheets) if sheets else {}).start()
    mock.patch.object(power_report, "plot", remembered(power_report.plot)).start()

    def as_published(*given: Any, **named: Any) -> object:
        return "" if sys.argv[1] == "rehearse" else analysed(*given, **named)

    mock.patch.object(analysis, "analysed", as_published).start()


def main() -> None:
    folder, size, parts = Path(sys.argv[1]), Size(sys.argv[2]), [int(part) for part in sys.argv[3:]]
    said = os.dup(1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    quickened()
    laboratory = Laboratory(folder, size)
    for part in parts:
        count = every_call(laboratory, part, size) if part < len(FAULTS) else outside(laboratory)
        os.write(said, (json.dumps(asdict(count)) + "\n").encode())


if __name__ == "__main__":
    main()
