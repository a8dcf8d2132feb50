"""Fuzzed inputs of 16 kinds through the command's own door, what is no file in a file's place, Ctrl-C.

Inputs are mutated from valid ones, each named by its kind and number alone, so that every run tries the same.
`python -m tests.faults.inputs FOLDER FIRST STEP LAST` is a worker: it tries every STEP-th input from FIRST on in a
copy of the bench in FOLDER, and writes one line for each. An input that hangs ends its worker, by an alarm.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import random
import re
import resource
import shutil
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import IO
from unittest import mock

from palpate.experiment.records import chain
from tests.faults.campaign import Count, Size
from tests.faults.valid_inputs import LVM, make_bench, with_hash

HANG_S = 20
"""The longest that a command may compute; on a machine that is busy with other things, that takes longer."""

BLOCKED_S = 120
"""The longest that a command may take."""

MEMORY = 2 * 2**30
"""What an input may take beyond what the modules take, bytes."""

CODES = (0, 1, 2, 130)
ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Kind:
    """Files of the bench, of which each input changes one, and the command that reads them; `cwd` is the bench."""

    name: str
    files: tuple[str, ...]
    command: tuple[str, ...]

    def reading(self, file: str) -> list[str]:
        """Return the command that reads one of its files."""
        return [file if part is FILE else part for part in self.command]


FILE = "FILE"
"""Stands in a command for the file that was changed."""

SPECTRUM = ("spectrum", FILE, "--plot", "no.suffix")
DATA = "data/sourcedata/sub-01/sub-01_task-virtual_journal"
EVENTS = "tables/sub-01/beh/sub-01_task-virtual_events"
KINDS = (
    Kind("protocol", ("study.toml",), ("check", "study.toml")),
    Kind("rig", ("rig.toml", "audio.toml"), ("rehearse", "study.toml", "--rig", FILE, "--out", "junk")),
    Kind(
        "seal",
        ("study.seal.toml",),
        ("seal", "study.toml", "--approval-number", "1", "--approved-on", "2020-01-01", "--expires-on", "2030-01-01"),
    ),
    Kind("printed numbers", ("printed.toml",), ("audit", "printed.toml")),
    Kind("choice model", ("model.toml",), ("power", "study.toml", "--model", "model.toml", "--studies", "0")),
    Kind("recordings manifest", ("takes/manifest.toml",), ("validate", "takes", "--fresh", "takes")),
    Kind("WAV", ("take.wav", "pcm.wav"), SPECTRUM),
    Kind("LVM or text recording", ("take.lvm", "take.csv"), SPECTRUM),
    Kind("response table", ("response.csv",), ("rehearse", "study.toml", "--rig", "rig.toml", "--out", "junk")),
    Kind("journal or its head", (f"{DATA}.jsonl", f"{DATA}.head"), ("journal", f"{DATA}.jsonl")),
    Kind(
        "roster or seed",
        ("study/sourcedata/roster.jsonl", "study/sourcedata/seed.json"),
        ("enrol", "study.toml", "--participant", "02", "--dataset", "study"),
    ),
    Kind("events", (f"{EVENTS}.tsv",), ("export", "tables", "--out", "out")),
    Kind(
        "participants, description or sidecar",
        ("tables/participants.tsv", "tables/dataset_description.json", f"{EVENTS}.json"),
        ("export", "tables", "--out", "out"),
    ),
    Kind(
        "counts",
        ("counts.csv",),
        ("import-counts", "--task", "t=counts.csv", "--study", "s", "--source", "p", "--out", "out"),
    ),
    Kind(
        "dissimilarities",
        ("alike.csv",),
        ("analyse", "tables", "--no-figures", "--dissimilarities", "alike.csv", "--out", "out"),
    ),
    Kind("arguments", (), ()),
)


TOKENS = (
    *(b"2012-04-01", b"2012-04-01T07:32:00", b"2012-04-01T07:32:00Z", b"07:32:00", b"nan", b"inf", b"-inf"),
    *(b"NaN", b"-Infinity", b"1e400", b"-1e400", b"1e-400", b"1" * 400, b"9" * 5000, b"-" + b"9" * 5000),
    *(b"0x" + b"f" * 6000, b"9223372036854775808", b"18446744073709551616", b"2147483648", b"4294967296", b"-1"),
    *(b"0", b"-0.0", b"00", b"1_000", b"1e308", b"5e-324", b"[" * 30, b"[" * 2000, b"]" * 9),
    *(b"[" * 40 + b"]" * 40, b"[" * 450 + b"]" * 450, b'{"a":' * 2000, b"{a=" * 400 + b"1" + b"}" * 400),
    *(b"a." * 300 + b"a=1\n", b"[[a]]\n", b"[a]\n", b"true", b"null", b"[]", b"{}", b'""', b'"a"', b"''"),
    *(b'["a", 1]', b"\t", b"\r", b"\r\n", b"\n", b"\0", b"\x1b[31m", b"\x7f", b"\xc2\x85", b"\xe2\x80\xa8"),
    *(b"\xe2\x80\xae", b"\xef\xbb\xbf", b"\xff", b"\xed\xa0\x80", b'"\\ud800"', b'"\\u0000"', b'"\\u001b[2J"'),
    *(b"\\", b'"', b"'", b'"""', b"#", b",", b";", b"=", b":", b"$x_{", b"$\\frac{$", b"%s%n", b"{0}", b"../.."),
    *(b"/dev/zero", b"a" * 70_000, b"a" * 200_000, b"n/a", b"\xf0\x9f\x92\xa9", b"-", b"--"),
)
_VALUE = re.compile(rb'(?<=[=:\t,])[ ]*("(?:[^"\\\n]|\\.)*"|[-+0-9.eE]+|true|false|null|\[[^\]\n]*\]|[^\t,\n=:]+)')


def mutated(data: bytes, draws: random.Random) -> bytes:
    """The bytes of a valid input after one to three changes."""
    for _ in range(draws.choice((1, 1, 2, 3))):
        at = draws.randrange(len(data) + 1)
        token = draws.choice(TOKENS)
        lines = data.splitlines(keepends=True) or [b""]
        i, j = draws.randrange(len(lines)), draws.randrange(len(lines))
        values = list(_VALUE.finditer(data))
        match draws.randrange(14):
            case 0:
                data = b"".join(
                    bytes([one ^ 1 << draws.randrange(8)]) if place in {at - 1, at // 2} else data[place : place + 1]
                    for place, one in enumerate(data)
                )
            case 1:
                data = data[:at]
            case 2:
                data = data[:at] + data[at + draws.randrange(1, 40) :]
            case 3:
                lines[i], lines[j] = lines[j], lines[i]
                data = b"".join(lines)
            case 4:
                data = b"".join([*lines[:i], *[lines[i]] * draws.choice((2, 3, 300)), *lines[i + 1 :]])
            case 5:
                data = draws.choice(
                    (data.decode("latin-1").encode("utf-16"), b"\xef\xbb\xbf" + data, data.replace(b"\n", b"\r\n"), b"")
                )
            case 6 | 7:
                data = data[:at] + token + data[at:]
            case 8 if values:
                one, other = draws.choice(values), draws.choice(values)
                data = data[: one.start(1)] + other[1] + data[one.end(1) :]
            case _ if values:
                one = draws.choice(values)
                data = data[: one.start(1)] + token + data[one.end(1) :]
            case _:
                data += token
    return data


def rechained(journal: bytes, head: Path, draws: random.Random) -> bytes:
    """A journal with changed values under a chain and a head that fit, as a forger would leave it."""
    last, lines = "0" * 64, []
    changed = draws.randrange(journal.count(b"\n"))
    for number, line in enumerate(journal.splitlines()):
        document = json.loads(line)
        entry = json.dumps(document["entry"], separators=(",", ":")).encode()
        if number == changed:
            one = draws.choice(list(_VALUE.finditer(entry)))
            entry = entry[: one.start(1)] + draws.choice(TOKENS).replace(b"\n", b"") + entry[one.end(1) :]
        t_ns = draws.choice((document["t_ns"], -1, 2**62)) if number == changed else document["t_ns"]
        lines.append(b'{"n":%d,"t_ns":%d,"prev":"%s","entry":%s}' % (number, t_ns, last.encode(), entry))
        last = hashlib.sha256(lines[-1]).hexdigest()
    head.write_text(f"{len(lines):012d} {last}\n", "ascii")
    return b"\n".join(lines) + b"\n"


COMMANDS = (
    *("check", "power", "plan", "rehearse", "seal", "doctor", "calibrate", "record", "validate", "spectrum"),
    *("enrol", "consent", "schedule", "run", "journal", "withdraw", "build", "analyse", "export", "audit"),
    *("anchor", "verify", "import-counts", "numerics", "devices", "new", "screen", "status", "tap", "x", ""),
    "import-trials",
)
OPTIONS = (
    *("--participant", "--seed", "--dataset", "--out", "--json", "--rig", "--task", "--recordings", "--studies"),
    *("--jobs", "--participants", "--alpha", "--target", "--model", "--speeds", "--takes", "--channel", "--plot"),
    *("--points", "--days", "--probes", "--peak", "--reason", "--consent-on", "--approved-on", "--study"),
    *("--source", "--against", "--fresh", "--no-such", "--", "-p", "-h", "--version", "--replace", "--protocol"),
    *("--control", "--dissimilarities", "--quick="),
)
VALUES = (
    *("", " ", "0", "-1", "01", "1e400", "nan", "9" * 400, "9" * 5000, "5-4", "1,2,,", "t=", "=", "t=counts.csv"),
    *("2020-01-01", "2020-13-45", "9999-12-31", "\udcff", "\udcff.toml", "\u202e", "\x1b[31m", "a\tb", "a\nb"),
    *("x" * 300, "x" * 5000, "../..", ".", "/dev/null", "/dev/zero", "/dev/full", "/proc/self/mem", "junk"),
    *("study.toml", "no-such.toml", "take.wav", "printed.toml", "tables", "takes", "\U0001f4a9", "$x_{"),
    *("[bold]", "%s", "{0}", "silence", "okamoto2012", "wellman1995"),
)


SLOW = ("numerics", "devices", "rehearse", "record", "plan", "validate", "doctor", "calibrate", "run", "new")


def arguments(draws: random.Random) -> list[str]:
    """A command line that starts nothing long: the slow commands are given an option that nobody has.

    It comes twice, for an option before it that lacks its value would take the first.
    """
    command = draws.choice(COMMANDS)
    some = [draws.choice(draws.choice((OPTIONS, VALUES))) for _ in range(draws.randrange(6))]
    if command in SLOW:
        some += ["--no-such-option"] * 2
    if command == "power":
        some += ["--studies", "0"]
    return [command, *some]


def tried(kind: Kind, number: int, bench: Path) -> tuple[list[str], dict[str, bytes]]:
    """Write one input into the bench; return its command line, and the files to put back."""
    draws = random.Random(f"{kind.name} {number}")
    if not kind.files:
        return arguments(draws), {}
    file = kind.files[number % len(kind.files)]
    kept = {name: (bench / name).read_bytes() for name in kind.files}
    if file.endswith(".jsonl") and number % 4 == 0:
        content = rechained(kept[file], chain.head_path(bench / file), draws)
    else:
        content = mutated(kept[file], draws)
    (bench / file).write_bytes(content)
    if kind.name == "response table":
        kept["rig.toml"] = (bench / "rig.toml").read_bytes()
        (bench / "rig.toml").write_text(with_hash(kept["rig.toml"].decode(), content), "utf-8")
    command = kind.reading(file)
    if kind.name in ("protocol", "journal or its head") and number % 3 == 0:
        command.append("--json")
    if kind.name == "protocol" and number % 3 == 1:
        command += ["--html", "page.html"]
    return command, kept


def told(code: object, out: str, err: str) -> str:
    """What is wrong with how a command ended, or nothing."""
    lines = err.splitlines()
    if code not in CODES or "Traceback" in err:
        return f"exit {code}: {' | '.join(lines[-3:])[-300:]}"
    if code == 2 and not lines and not out:
        return "exit 2 without a word"
    return ""


def run_here(command: Sequence[str]) -> str:
    """Run one command in this process through the door of the real one; return what is wrong, or nothing."""
    from palpate.experiment.cli.app import main

    out = io.TextIOWrapper(io.BytesIO(), "utf-8")
    err = io.TextIOWrapper(io.BytesIO(), "utf-8", errors="backslashreplace")
    code: object = 0
    sys.argv = ["palpate", *command]
    with redirect_stdout(out), redirect_stderr(err):
        try:
            main()
            out.flush()
        except SystemExit as end:
            code = end.code or 0
        except KeyboardInterrupt:
            code = 130
        except BaseException as error:
            code = f"{type(error).__name__}: {error}"
    wrong = told(code, _said(out), _said(err))
    for report in Path(tempfile.gettempdir()).glob("palpate-*.txt"):
        wrong += f" [{' | '.join(report.read_text('utf-8').splitlines()[-5:])[-400:]}]"
        report.unlink()
    return wrong


def _said(stream: io.TextIOWrapper) -> str:
    if stream.closed:
        return ""
    stream.flush()
    stream.seek(0)
    return stream.read()


def work(folder: Path, first: int, step: int, last: int) -> None:
    """Try every `step`-th input from `first` on in a bench of one's own."""
    bench = folder / f"worker-{first % step}"
    if not bench.exists():
        shutil.copytree(folder / "bench", bench)
    temporary = folder / f"temporary-{first % step}"
    temporary.mkdir(exist_ok=True)
    os.chdir(bench)
    tempfile.tempdir = str(temporary)
    # What is read back need not outlive a power cut.
    mock.patch.object(os, "fsync", new=bool).start()
    sys.stdin = Path(os.devnull).open(encoding="utf-8")  # noqa: SIM115
    run_here(["spectrum", "take.wav"])
    held = int(Path("/proc/self/statm").read_text("ascii").split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (held + MEMORY, held + MEMORY))
    with (folder / f"told-{first % step}").open("a", encoding="utf-8") as ledger:
        for number in range(first, last, step):
            kind = KINDS[number % len(KINDS)]
            command, kept = tried(kind, number // len(KINDS), Path())
            signal.setitimer(signal.ITIMER_REAL, BLOCKED_S)
            signal.setitimer(signal.ITIMER_PROF, HANG_S)
            wrong = run_here(command)
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.setitimer(signal.ITIMER_PROF, 0)
            for name, content in kept.items():
                Path(name).write_bytes(content)
            shutil.rmtree("out", ignore_errors=True)
            if kind.name == "roster or seed":
                shutil.rmtree("study")
                shutil.copytree(folder / "bench" / "study", "study")
            ledger.write(f"{number}\t{ascii(wrong) if wrong else ''}\n")
            ledger.flush()


def fuzzed(folder: Path, count: int) -> dict[str, list[str]]:
    """Try `count` inputs, on every core; return what went wrong by kind."""
    cores = os.cpu_count() or 1

    def share(first: int) -> None:
        ledger, at = folder / f"told-{first}", first
        while at < count:
            with (folder / f"stderr-{first}").open("wb") as said:
                ended = _worker(folder, at, cores, count, said)
            tried = [int(line.partition("\t")[0]) for line in ledger.read_text("utf-8").splitlines()]
            at = max(tried, default=first - cores) + cores
            if at < count:
                why = "hung" if ended in (-signal.SIGALRM, -signal.SIGPROF) else f"ended its process ({ended})"
                with ledger.open("a", encoding="utf-8") as file:
                    file.write(f"{at}\t{why}\n")
                at += cores

    with ThreadPoolExecutor(cores) as pool:
        list(pool.map(share, range(cores)))
    wrong: dict[str, list[str]] = {kind.name: [] for kind in KINDS}
    for ledger in sorted(folder.glob("told-*")):
        for line in ledger.read_text("utf-8").splitlines():
            number, _, what = line.partition("\t")
            if what:
                wrong[KINDS[int(number) % len(KINDS)].name].append(f"input {number}: {what}")
    return wrong


def _worker(folder: Path, first: int, step: int, last: int, said: IO[bytes]) -> int:
    command = [sys.executable, "-m", "tests.faults.inputs", str(folder), str(first), str(step), str(last)]
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    return subprocess.run(command, cwd=ROOT, env=environment, stdout=said, stderr=said, check=False).returncode


def palpate(command: Sequence[str], cwd: Path) -> str:
    """Run one command as a process of its own; return what is wrong, or nothing."""
    with subprocess.Popen(
        [sys.executable, "-m", "palpate.experiment", *command],
        cwd=cwd,
        env=os.environ | {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as begun:
        resource.prlimit(begun.pid, resource.RLIMIT_CPU, (HANG_S, HANG_S))
        try:
            out, err = begun.communicate(timeout=BLOCKED_S)
        except subprocess.TimeoutExpired:
            begun.kill()
            return f"hung: {list(command)}"
    wrong = told(begun.returncode, out.decode("utf-8", "replace"), err.decode("utf-8", "replace"))
    return f"{wrong}: {list(command)}" if wrong else ""


def alone(folder: Path, count: int) -> list[str]:
    """Inputs as before, each to a process of its own; returns what went wrong."""

    def one(place: int) -> str:
        # Seven is prime to the number of kinds, so all of them come.
        number = 1_000_000 + 7 * place
        bench = Path(shutil.copytree(folder / "bench", folder / f"alone-{place}"))
        kind = KINDS[number % len(KINDS)]
        command, _ = tried(kind, number // len(KINDS), bench)
        said = palpate([part for part in command if "\0" not in part], bench)
        shutil.rmtree(bench)
        return said

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return [said for said in pool.map(one, range(count)) if said]


def _odd(path: Path, what: str) -> None:
    """Put something that is no file, or no file of any sense, where a file stood."""
    path.unlink()
    match what:
        case "/dev/zero" | "/dev/stdin" | "/dev/tty" | "/dev/random" | "/proc/self/mem" | "/nowhere":
            path.symlink_to(what)
        case "pipe":
            os.mkfifo(path)
        case "socket":
            # The name of a socket is short, wherever the bench stands.
            os.chdir(path.parent)
            with socket.socket(socket.AF_UNIX) as made:
                made.bind(path.name)
            os.chdir(ROOT)
        case "folder":
            path.mkdir()
        case "10 GB":
            with path.open("wb") as file:
                file.truncate(10 * 2**30)
        case "10 GB with a head":
            with path.open("wb") as file:
                file.write(b"RIFF\xff\xff\xff\xffWAVEfmt ")
                file.truncate(10 * 2**30)
        case "a header of 10 GB":
            path.write_bytes(
                struct.pack(
                    "<4sI4s4sIHHIIHH4sI",
                    b"RIFF",
                    2**32 - 1,
                    b"WAVE",
                    b"fmt ",
                    16,
                    3,
                    65535,
                    2**31,
                    2**31,
                    4,
                    32,
                    b"data",
                    2**32 - 1,
                )
            )
        case "LVM of 2^31 channels":
            path.write_text(LVM.replace("Channels\t1", f"Channels\t{2**31}"), "utf-8")
        case "one line":
            path.write_bytes(b"LabVIEW Measurement\t" + b"a\t" * 2_000_000)
        case "many lines":
            path.write_bytes(b"a = 1\n" + b"".join(b"a%d = 1\n" % n for n in range(90_000)))


ODD = (
    *("/dev/zero", "/dev/stdin", "/dev/tty", "/dev/random", "/proc/self/mem", "/nowhere", "pipe", "socket"),
    *("folder", "10 GB", "10 GB with a head", "a header of 10 GB", "LVM of 2^31 channels", "one line"),
    *("many lines",),
)


def odd_files(folder: Path, whole: bool) -> tuple[int, list[str]]:
    """Put each odd thing in the place of each file, and run its command; return how many, and what went wrong."""
    cases = [(kind, file, what) for kind in KINDS for file in kind.files for what in ODD]
    cases = cases if whole else cases[:: len(cases) // 3]

    def one(place: int) -> str:
        kind, file, what = cases[place]
        bench = Path(shutil.copytree(folder / "bench", folder / f"odd-{place}"))
        _odd(bench / file, what)
        said = palpate(kind.reading(file), bench)
        shutil.rmtree(bench)
        return f"{file}: {what}: {said}" if said else ""

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return len(cases), [said for said in pool.map(one, range(len(cases))) if said]


CORRECTED = ("--correct", "--reason", "the letter says so")
TRIALS = ("--presented", "shown", "--answered", "said", "--participant", "who")
STARTED = (
    ("--help",),
    ("check", "study.toml"),
    ("power", "study.toml", "--model", "model.toml", "--studies", "20"),
    ("plan", "study.toml"),
    ("rehearse", "study.toml", "--rig", "rig.toml", "--out", "out"),
    ("schema", "protocol"),
    ("docs", "rigs"),
    ("preregister", "study.toml"),
    ("seal", "study.toml", "--approval-number", "1", "--approved-on", "2020-01-01", "--expires-on", "2030-01-01"),
    ("devices",),
    ("calibrate", "actuator", "--rig", "rig.toml"),
    ("doctor", "study.toml", "--rig", "rig.toml"),
    ("record", "study.toml", "--simulated", "--out", "out"),
    ("validate", "takes", "--no-figures", "--out", "out"),
    ("spectrum", "take.wav", "--plot", "plot.svg"),
    ("enrol", "study.toml", "--participant", "02", "--dataset", "study"),
    (*("consent", "study.toml", "--participant", "01", "--consent-on", "2020-05-05", "--dataset", "study"), *CORRECTED),
    ("schedule", "study.toml", "--participant", "01"),
    ("run", "study.toml", "--participant", "01", "--task", "virtual", "--rig", "rig.toml", "--dataset", "study"),
    ("journal", f"{DATA}.jsonl"),
    ("withdraw", "study.toml", "--participant", "01", "--reason", "asked", "--dataset", "study"),
    ("build", "data"),
    ("anchor", "data"),
    ("verify", "data"),
    ("status", "data"),
    ("analyse", "tables", "--no-figures", "--out", "out"),
    ("export", "tables", "--out", "out"),
    ("audit", "okamoto2012"),
    ("import-counts", "--task", "t=counts.csv", "--study", "s", "--source", "p", "--out", "out"),
    ("numerics", "takes"),
    ("new", "new.toml", "--id", "another", "--yes"),
    ("person", "study.toml", "--participant", "01", "--show", "--dataset", "study"),
    ("facts", "study.toml", "--participant", "01", "--fact", "age=34", "--dataset", "study"),
    ("desk", "study"),
    ("answers", "review", "data", "--list"),
    ("tap", "fit", "take.wav"),
    ("tap", "contact", "--stiffness", "2500", "--damping", "1", "--mass", "0.1", "--speed", "0.1"),
    ("import-trials", "trials.csv", *TRIALS, "--study", "s", "--out", "out"),
    ("share", "study", "copy"),
    ("incident", "study.toml", "--adverse", "a fall", "--done", "ended", "--dataset", "study"),
    ("amend", "study.toml", "--suspended-on", "2020-06-01", "--reason", "letter", "--dataset", "study"),
)
"""Every command, with arguments with which it runs or refuses; but for `screen`, which waits for its session."""


STARTS = """
import atexit, os, signal, sys
from palpate.experiment.__main__ import main
after_s = float(sys.argv.pop(1))
# Python gives signals back to the system while it ends, and an alarm would end it then.
atexit.register(signal.setitimer, signal.ITIMER_REAL, 0)
signal.signal(signal.SIGALRM, lambda *_: signal.raise_signal(signal.SIGINT))
class Arguments(list):
    def __getitem__(self, place):
        # Plain from here on: processes that the command starts get a copy.
        sys.argv = list(self)
        os.write(1, b".")
        signal.setitimer(signal.ITIMER_REAL, after_s)
        return list.__getitem__(self, place)
sys.argv = Arguments(sys.argv)
main()
"""
"""The command, interrupted so many seconds after it has begun, by its first argument (0: never).

A sign tells that Python has begun and that it is palpate that answers: it looks at its arguments. The time runs in its
own process, as some commands are done before a signal from another would arrive.
"""


PROGRESS = re.compile(r"\d+/\d+ \d+:\d\d:\d\d")


@dataclass(frozen=True)
class Ended:
    """How a command ended: its exit code, None where it did not; standard error; and how long it took, s."""

    code: int | None
    lines: tuple[str, ...]
    lasted_s: float

    @property
    def clean(self) -> bool:
        return not any("Traceback" in line or "Exception" in line for line in self.lines)

    def interrupted(self, alone: Ended) -> bool:
        """Whether it ended as it promises for Ctrl-C: by its code, with one line.

        What it also shows when it is `alone`, and a bar of progress, are no lines about the interrupt.
        """
        own = [line for line in self.lines if line not in alone.lines and not PROGRESS.search(line)]
        return self.code == 130 and len(own) == 1 and own[0].startswith("palpate: ") and "interrupted" in own[0]


def started(folder: Path, name: str, command: Sequence[str], after_s: float | None) -> Ended:
    """Run a command in a bench of its own, with SIGINT some time after its first sign, or without (None)."""
    bench = Path(shutil.copytree(folder / "bench", folder / name))
    with subprocess.Popen(
        [sys.executable, "-c", STARTS, str(after_s or 0), *command],
        cwd=bench,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as begun:
        assert begun.stdout is not None
        begun.stdout.read(1)
        since_s = time.monotonic()
        try:
            _, said = begun.communicate(timeout=BLOCKED_S)
        except subprocess.TimeoutExpired:
            begun.kill()
            return Ended(None, (), BLOCKED_S)
    shutil.rmtree(bench)
    lines = tuple(said.decode("utf-8", "replace").splitlines())
    return Ended(begun.returncode, lines, time.monotonic() - since_s)


DRAWS = 16
"""So often a moment is drawn for a try, each time half as late, until the command is interrupted by it."""

SOONEST_S = 1e-6
"""The earliest moment that a timer can be set to."""


def interrupted(folder: Path, count: int) -> list[str]:
    """Send SIGINT at moments of the time that a command takes by itself; return what went wrong.

    A command that was done before its moment is no try, and one that never ends by Ctrl-C is wrong.
    """
    commands = STARTED[:count]

    def own(place: int) -> Ended:
        return started(folder, f"alone-{place}", commands[place], None)

    def one(place: int) -> str:
        command, alone = commands[place % len(commands)], by_itself[place % len(commands)]
        if alone.code not in (0, 1, 2) or not alone.clean:
            return f"{command} without an interrupt: {alone.code}: {alone.lines[-3:]}"
        after_s = alone.lasted_s * (place + 0.5) / count
        for _ in range(DRAWS):
            ended = started(folder, f"interrupted-{place}", command, after_s)
            if ended.interrupted(alone):
                return ""
            if ended.code is None or ended.code != alone.code or not ended.clean:
                return f"{command} after {after_s:.3f} s: {ended.code}: {ended.lines[-3:]}"
            after_s = max(after_s / 2, SOONEST_S)
        return f"{command} was not ended by any of {DRAWS} interrupts within {alone.lasted_s:.3f} s"

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        by_itself = list(pool.map(own, range(len(commands))))
        return [said for said in pool.map(one, range(count)) if said]


def attacks(size: Size) -> Iterator[Count]:
    """Every input that is fuzzed, odd or interrupted."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        make_bench(folder / "bench")
        each = size.of(2, 3125)
        for kind, wrong in fuzzed(folder, each * len(KINDS)).items():
            yield Count(f"fuzzed input: {kind}", each, each - len(wrong), failures=tuple(wrong))
        count = size.of(1, 240)
        wrong = alone(folder, count)
        yield Count("fuzzed input, in a process of its own", count, count - len(wrong), failures=tuple(wrong))
        count, wrong = odd_files(folder, size is Size.WHOLE)
        yield Count("device, pipe, folder, 10 GB in place of a file", count, count - len(wrong), failures=tuple(wrong))
        count = size.of(2, 180)
        wrong = interrupted(folder, count)
        yield Count("Ctrl-C while a command runs", count, count - len(wrong), failures=tuple(wrong))


if __name__ == "__main__":
    work(Path(sys.argv[1]), *map(int, sys.argv[2:]))
