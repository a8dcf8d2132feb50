"""What many sessions in one process leave behind: nothing.

`attacks` rehearses them, in simulated time, through serial line and sockets. `--minutes` runs `palpate run` in real
time on a live laboratory, with a masker on a sound server, and writes a sample of the process every ten seconds.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from tests.faults.campaign import Count, Size
from tests.faults.live import KEYS, PATIENCE_S, Laboratory, Life, palpate

EACH_S = 10.0
"""Between two samples of the process."""

WARM_SESSIONS = 4
"""Each task twice: from then on everything is imported, and the audio library has its threads."""


SLOWEST_S = 180.0
"""A session that says nothing for longer hangs: as it ends, it writes the tables of all sessions before it."""


@dataclass(frozen=True)
class Sample:
    """What a process holds."""

    at_s: float
    rss_kib: int
    threads: int
    descriptors: int
    children: int

    @classmethod
    def of(cls, pid: int, at_s: float) -> Sample:
        process = Path(f"/proc/{pid}")
        status = dict(line.split(":", 1) for line in (process / "status").read_text().splitlines())
        tasks = list((process / "task").iterdir())
        return cls(
            at_s=round(at_s, 1),
            rss_kib=int(status["VmRSS"].split()[0]),
            threads=len(tasks),
            descriptors=len(list((process / "fd").iterdir())),
            children=sum(len((task / "children").read_text().split()) for task in tasks),
        )


REHEARSED = 25
"""Sessions of one rehearsal of the shipped study, of four trials each; the first rehearsal warms the process up."""

MOST_KIB = 10_000
"""What the process may grow by."""


def attacks(size: Size) -> Iterator[Count]:
    """Rehearse one study after another in a process of its own."""
    sessions = size.of(1, 16) * REHEARSED
    with tempfile.TemporaryDirectory() as folder:
        told = subprocess.run(
            [sys.executable, "-m", "tests.faults.endurance", "--sessions", str(sessions), "--out", f"{folder}/samples"],
            capture_output=True,
            text=True,
            check=False,
        )
        if told.returncode:
            yield Count("sessions in one process", sessions, 0, 0, (told.stderr[-500:],))
            return
        first, *_, last = [Sample(**json.loads(line)) for line in Path(folder, "samples").read_text().splitlines()]
    left = sum(max(getattr(last, name) - getattr(first, name), 0) for name in ("threads", "descriptors", "children"))
    grown_kib = last.rss_kib - first.rss_kib
    survived = sessions if grown_kib <= MOST_KIB and not left else 0
    yield Count(
        "sessions in one process", sessions, survived, left, () if survived else (f"{grown_kib:+} KiB, {left} left",)
    )


def rehearsed(sessions: int, out: Path) -> None:
    """Rehearse so many sessions in this process after those that warm it up, with a sample after each rehearsal."""
    from palpate.experiment.protocol.files import shipped
    from palpate.experiment.rehearsal import study

    with tempfile.TemporaryDirectory() as folder, out.open("w") as file:
        protocol = Path(folder) / "study.toml"
        text = shipped("okamoto2012.toml").read_text("utf-8").replace("repetitions = 10", "repetitions = 1")
        protocol.write_text(text.replace("limit = 36", "limit = 4"), "utf-8")
        for number in range(1 + sessions // REHEARSED):
            at = Path(folder) / f"rehearsal-{number}"
            rig = shipped("rigs/rehearsal.toml")
            study.rehearse(protocol_file=protocol, rig_file=rig, out=at, participants=None, seed=number)
            gc.collect()
            print(json.dumps(asdict(Sample.of(os.getpid(), float(number)))), file=file, flush=True)


def one_after_the_other() -> None:
    """Run the commands that come as lines of JSON on standard input; an empty line is the last."""
    while line := input("[next] "):
        try:
            palpate(*json.loads(line))
            code = 0
        except SystemExit as end:
            code = int(end.code or 0)
        print(f"[ended {code}]", flush=True)
    input("[idle] ")


def real_time(minutes: float, out: Path, *, repetitions: int, pace_s: float) -> str:
    """Run sessions in one process by the wall clock, write samples to a file, and return a line about them.

    The participant steps `pace_s` after the trial was armed.
    """
    begun_s = time.monotonic()
    ends_s, due_s = begun_s + minutes * 60, begun_s
    sessions = answers = 0
    with (
        tempfile.TemporaryDirectory() as folder,
        Laboratory(Path(folder) / "laboratory", repetitions=repetitions, sound=True) as there,
        out.open("w") as file,
    ):
        datasets = there.datasets()
        todo: list[list[str]] = []
        life = Life(there.world, one_after_the_other)
        while "[next] " not in life.text:
            life.next(time.monotonic() + 0.1)
        warm = Sample.of(life.pid, 0.0)

        def sampled(label: str) -> Sample:
            sample = Sample.of(life.pid, time.monotonic() - begun_s)
            state = {"state": label, "sessions": sessions, "answers": answers}
            print(json.dumps(asdict(sample) | state), file=file, flush=True)
            return sample

        sampled("before the first session")
        between: list[Sample] = []
        within: list[Sample] = []
        step_s: float | None = None
        begins = True
        while True:
            if begins:
                begins = False
                if time.monotonic() >= ends_s:
                    break
                if not todo:
                    dataset = next(datasets)
                    for number in range(1, 11):
                        tasks = there.enrol(dataset, f"{number:02d}", seed=1)
                        todo += [there.command(dataset, f"{number:02d}", task) for task in tasks]
                life.type(json.dumps(todo.pop(0)) + "\n")
                heard_s = time.monotonic()
            until_s = min(due_s, step_s or due_s)
            seen = life.next(until_s)
            now_s = time.monotonic()
            if step_s is not None and now_s >= step_s:
                step_s = None
                there.world.begin("step", 200, answers)
            if now_s >= due_s:
                due_s = now_s + EACH_S
                within.append(sampled("in a session"))
            if seen == "end" or now_s - heard_s > SLOWEST_S + pace_s:
                raise RuntimeError(f"the session ended or hangs: {life.text[-500:]}")
            if isinstance(seen, str):
                continue
            heard_s = now_s
            if seen["armed"]:
                step_s = now_s + pace_s
            elif seen["asked"]:
                life.type("q\n" if now_s >= ends_s else list(KEYS)[answers % len(KEYS)] + "\n")
            elif seen["confirm"]:
                life.type(seen["confirm"] + "\n")
            elif seen["trial"]:
                answers += 1
            elif seen["ended"]:
                if seen["ended"] != "[ended 0]":
                    raise RuntimeError(f"a session failed: {life.text[-500:]}")
                sessions += 1
                between.append(sampled("between two sessions"))
                begins = True
            else:
                life.type("y\n" if seen["agree"] else "\n")
        life.type("\n")
        while "[idle] " not in life.text:
            life.next(time.monotonic() + 0.1)
        last = sampled("after the last session")
        life.type("\n")
        while life.next(time.monotonic() + PATIENCE_S) != "end":
            pass
    settled = between[:WARM_SESSIONS][-1]
    later = [sample.rss_kib for sample in within + between if sample.at_s > settled.at_s]
    return (
        f"{minutes:g} min in real time, {sessions} sessions, {answers} answers in one process. Memory: "
        f"{warm.rss_kib / 1024:.1f} MiB before the first session, {settled.rss_kib / 1024:.1f} after {WARM_SESSIONS}, "
        f"{max(later, default=0) / 1024:.1f} at most and {last.rss_kib / 1024:.1f} after the last "
        f"({(last.rss_kib - settled.rss_kib) / 1024:+.1f}). Before the first, after {WARM_SESSIONS} and after the "
        f"last: threads {warm.threads}, {settled.threads}, {last.threads}; files {warm.descriptors}, "
        f"{settled.descriptors}, {last.descriptors}; processes {warm.children}, {settled.children}, {last.children}."
    )


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.faults.endurance", description=__doc__)
    parser.add_argument("--minutes", type=float, default=80.0)
    parser.add_argument("--sessions", type=int, help="rehearse so many sessions instead")
    parser.add_argument("--out", type=Path, required=True, help="file of samples, one JSON line each")
    parser.add_argument("--repetitions", type=int, default=20, help="of each of four materials in a session")
    parser.add_argument("--pace", type=float, default=2.0, help="seconds from arming to the step")
    asked = parser.parse_args()
    if asked.sessions:
        rehearsed(asked.sessions, asked.out)
        return
    sys.stdout.write(real_time(asked.minutes, asked.out, repetitions=asked.repetitions, pace_s=asked.pace) + "\n")


if __name__ == "__main__":
    main()
