"""Live sessions that are killed, interrupted and robbed of their parts, at moments of every phase.

`python -m tests.faults.kills FOLDER SEED ROWS` is one laboratory, with ROWS in JSON: how often each attack is made.
"""

from __future__ import annotations

import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from re import Match

from tests.faults.campaign import Count, Size
from tests.faults.ledger import Ledger
from tests.faults.live import KEYS, PATIENCE_S, Laboratory, Life, World, palpate, rig_of

LABORATORIES = 2
"""At a time, one a core."""


@dataclass(frozen=True)
class Moment:
    """When an attack comes: `delay_s` at most after something, drawn anew for each life; 0 is before anything is typed.

    `after` is `fork`, a group of `SCREEN`, `heard` (by the panel), `typed` (the Enter that confirms an answer), `grown`
    (the journal, after that) or `last` (the answer after which nothing remains).
    """

    after: str
    delay_s: float


@dataclass
class Tally:
    """What came of one row."""

    tried: int = 0
    survived: int = 0
    lost: int = 0
    failures: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Attack:
    """What is done at one of some moments, and what must be seen then.

    `act` returns whether the experimenter goes on as if nothing had been. `prepared` is done in the new process before
    the command. `ended` returns what is wrong with how the life ended. `piped` has its output lead into a pipe.
    """

    moments: tuple[Moment, ...]
    act: Callable[[Run], bool]
    ended: Callable[[Run], list[str]]
    prepared: Callable[[Run], None] = lambda run: None
    piped: bool = False


@dataclass
class Run:
    """One life of a session, and what was done to it."""

    there: Laboratory
    ledger: Ledger
    life: Life
    dice: random.Random
    trials: int
    acted: bool = False
    since: int = 0
    """Answers that were confirmed since."""
    wrong: list[str] = field(default_factory=list)
    """What the attack itself found wrong."""

    def says(self, *words: str) -> list[str]:
        """Return what is wrong with a life that had to end in words."""
        text, status = self.life.text, self.life.status
        wrong = [f"it said {word!r}" for word in ("FAULT", "Traceback", "a fault in palpate") if word in text]
        # Before a session begins, and while tables are built, a signal may end the process as it ends any other.
        if status is None or (os.waitstatus_to_exitcode(status) not in (0, 1, 2, 130, -signal.SIGTERM, -signal.SIGHUP)):
            wrong.append(f"it ended with status {status}")
        if words and not any(word in text for word in words):
            wrong.append(f"it did not say {' or '.join(words)}: {text[-200:]!r}")
        return wrong

    def footed(self) -> list[str]:
        """Return what is wrong with a journal whose session had to pause."""
        begun = self.ledger.journal.exists() and self.ledger.journal.stat().st_size
        return ["the journal has no footer"] if begun and not self.ledger.footer() else []


def killed(run: Run) -> bool:
    run.life.kill(signal.SIGKILL)
    return False


def is_dead(run: Run) -> list[str]:
    return []


def signalled(number: int) -> Callable[[Run], bool]:
    def act(run: Run) -> bool:
        run.life.kill(number)
        return False

    return act


def control_c(run: Run) -> bool:
    run.life.type("\x03")
    return False


def hung_up(run: Run) -> bool:
    run.life.hang_up()
    return False


def closed(run: Run) -> bool:
    run.life.close_out()
    # Blind, so that whoever waits for a line or a step goes on.
    run.life.type("\n\n")
    run.there.world.begin("step", 250, 1)
    return False


def paused(run: Run) -> list[str]:
    return run.says() + run.footed()


def unplugged(run: Run) -> bool:
    run.there.world.do("unplug")
    time.sleep(run.dice.uniform(0.0, 0.3))
    run.there.world.do("replug")
    return True


def goes_on(run: Run) -> list[str]:
    return run.says("The session is complete") + run.footed()


def deafened(run: Run) -> bool:
    run.there.world.do("deaf")
    return True


def hears_again(run: Run) -> list[str]:
    run.there.world.do("hears")
    return run.says("actuator at") + run.footed()


def moved(run: Run) -> bool:
    run.ledger.dataset.rename(run.ledger.dataset.with_suffix(".moved"))
    return True


def moved_back(run: Run) -> list[str]:
    # Whatever was written where the folder had been stands beside it, and is no part of the dataset.
    shutil.rmtree(run.ledger.dataset, ignore_errors=True)
    run.ledger.dataset.with_suffix(".moved").rename(run.ledger.dataset)
    return run.says() + [f"{run.since} answers were confirmed without the folder"] * (run.since > 0)


def deleted(run: Run) -> bool:
    shutil.copytree(run.ledger.dataset, run.ledger.dataset.with_suffix(".moved"))
    shutil.rmtree(run.ledger.dataset)
    return True


def doubled(run: Run) -> bool:
    """Remove every lock, and have a second runner begin on devices of its own."""
    for lock in run.ledger.dataset.rglob("*.lock"):
        lock.unlink()
    folder = run.there.folder / f"second-{time.monotonic_ns()}"
    folder.mkdir()
    world = World(folder, sound=False)
    rig = rig_of(world, folder)
    command = run.there.command(run.ledger.dataset, run.ledger.participant, run.ledger.task, rig)
    second = Life(world, lambda: palpate(*command))
    while second.next(time.monotonic() + PATIENCE_S) != "end":
        run.wrong.append("a second runner was let in")
        second.kill()
    if "by another runner" not in second.text:
        run.wrong.append(f"the second runner it refused was told {second.text[-200:]!r}")
    world.close()
    return True


def crowded(run: Run) -> None:
    """No file may grow by more than a few lines: the disk is full."""
    held = [path.stat().st_size for path in run.ledger.journal.parent.glob("*") if path.is_file()]
    most = max(held, default=0) + run.dice.randrange(1, 6000)
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))


def as_it_was(run: Run) -> bool:
    return True


def in_words(run: Run) -> list[str]:
    return run.says()


EVERYWHERE = (
    Moment("fork", 0.4),
    Moment("armed", 0.6),
    Moment("asked", 0.02),
    Moment("confirm", 0.02),
    Moment("typed", 0.005),
    Moment("trial", 0.03),
    Moment("last", 0.2),
)
IN_TRIALS = (Moment("armed", 0.25), Moment("asked", 0.0), Moment("confirm", 0.0))

ATTACKS = {
    "SIGKILL while a session starts": Attack((Moment("fork", 0.5), Moment("familiar", 0.01)), killed, is_dead),
    "SIGKILL as a trial is armed": Attack((Moment("armed", 0.03), Moment("lay", 0.03)), killed, is_dead),
    "SIGKILL while the foot steps": Attack((Moment("armed", 0.6),), killed, is_dead),
    "SIGKILL as the panel sounds": Attack((Moment("heard", 0.0), Moment("heard", 0.15)), killed, is_dead),
    "SIGKILL at the question": Attack((Moment("asked", 0.02), Moment("confirm", 0.0)), killed, is_dead),
    "SIGKILL as an answer is written": Attack((Moment("typed", 0.008), Moment("grown", 0.001)), killed, is_dead),
    "SIGKILL after an answer is confirmed": Attack((Moment("trial", 0.0), Moment("trial", 0.03)), killed, is_dead),
    "SIGKILL as footer and tables are written": Attack((Moment("last", 0.25),), killed, is_dead),
    "SIGTERM": Attack(EVERYWHERE, signalled(signal.SIGTERM), paused),
    "SIGHUP": Attack(EVERYWHERE, signalled(signal.SIGHUP), paused),
    "terminal closed": Attack(EVERYWHERE[1:], hung_up, paused),
    "Ctrl-C": Attack(EVERYWHERE, control_c, paused),
    "standard output closed": Attack(EVERYWHERE[1:], closed, paused, piped=True),
    "tracker unplugged for up to 0.3 s": Attack(IN_TRIALS, unplugged, goes_on),
    "panel off the network": Attack((Moment("armed", 0.0),), deafened, hears_again),
    "dataset moved in mid-session": Attack(IN_TRIALS, moved, moved_back),
    "dataset deleted in mid-session": Attack(IN_TRIALS, deleted, moved_back),
    "lock removed, second runner": Attack((Moment("asked", 0.0), Moment("confirm", 0.0)), doubled, goes_on),
    "disk full": Attack((Moment("fork", 0.0),), as_it_was, in_words, crowded),
}
"""By the name of the row. Of an attack's moments the next is taken in turn."""

VIRTUAL = ("SIGKILL as the panel sounds", "panel off the network")
"""These need a stimulus, and come in sessions that have one."""

UNHURT = "a life without an attack"
"""A row of its own, of those lives alone in which something went wrong."""


class Study:
    """Sessions of one laboratory after another, each to its end, however many lives that takes."""

    def __init__(self, there: Laboratory, seed: int) -> None:
        self._there = there
        self._dice = random.Random(seed)
        self._seed = seed
        self._datasets = enumerate(there.datasets())
        self._sessions = self._all()
        self._session: Ledger | None = None
        self.tallies: dict[str, Tally] = defaultdict(Tally)

    def _all(self) -> Iterator[Ledger]:
        for number, dataset in self._datasets:
            for participant in ("01", "02"):
                tasks = self._there.enrol(dataset, participant, self._seed + number)
                for task in tasks:
                    yield Ledger(dataset, participant, task)

    def _begin_anew(self) -> None:
        """What went wrong in one session spoils no other."""
        self._session, self._sessions = None, self._all()

    def run(self, todo: list[str]) -> None:
        """Make each attack of the list once, in this order as far as the sessions allow."""
        turns: dict[str, int] = defaultdict(int)
        self._begin_anew()
        while todo:
            session = self._session or next(self._sessions)
            self._session = session
            virtual = session.task == "virtual"
            row = next((one for one in todo if virtual or one not in VIRTUAL), None)
            attack = ATTACKS[row] if row is not None else None
            moment = attack.moments[turns[row] % len(attack.moments)] if attack and row else None
            acted, wrong = self._life(session, attack, moment)
            if row is not None and acted:
                turns[row] += 1
                todo.remove(row)
            name = row if acted and row is not None else UNHURT
            if session.footer() == "complete" and not acted:
                wrong += session.table()
                self._session = None
            if wrong:
                self._begin_anew()
            tally = self.tallies[name]
            tally.tried += acted or bool(wrong)
            tally.survived += acted and not wrong
            tally.lost += sum("it " not in one for one in wrong)
            where = f"{session.journal} {moment}"
            tally.failures += [f"{where}: {one}" for one in wrong]

    def _life(self, session: Ledger, attack: Attack | None, moment: Moment | None) -> tuple[bool, list[str]]:
        there, dice = self._there, self._dice
        there.world.heard.clear()
        command = there.command(session.dataset, session.participant, session.task)
        trials = len(there.protocol.materials)
        run: Run | None = None
        state = dice.getstate()

        def begin() -> None:
            if attack is not None:
                copied = random.Random()
                copied.setstate(state)
                attack.prepared(Run(there, session, life=None, dice=copied, trials=trials))  # type: ignore[arg-type]
            palpate(*command)

        life = Life(there.world, begin, piped=attack is not None and attack.piped)
        run = Run(there, session, life, dice, trials)
        delay_s = dice.uniform(0.0, moment.delay_s) if moment else 0.0
        due_s = time.monotonic() + delay_s if moment and moment.after == "fork" else float("inf")
        heard_s = time.monotonic()
        stays, hangs = True, False

        def strike() -> None:
            nonlocal due_s, stays
            due_s = float("inf")
            if attack is not None:
                run.acted = True
                stays = attack.act(run)

        def came(what: str) -> None:
            nonlocal due_s
            if moment is None or moment.after != what or run.acted or due_s < float("inf"):
                return
            due_s = time.monotonic() + delay_s
            if moment.delay_s == 0:
                strike()

        while True:
            seen = life.next(min(due_s, heard_s + PATIENCE_S))
            if seen == "end":
                break
            if seen == "late":
                if due_s <= time.monotonic():
                    strike()
                elif hangs:
                    break
                else:
                    hangs = True
                    life.kill(signal.SIGKILL)
                continue
            heard_s = time.monotonic()
            if seen == "heard":
                came("heard")
            elif isinstance(seen, Match):
                self._react(run, seen, came, lambda: stays)
        there.world.do("ping")
        wrong = ["it hung"] if hangs else []
        if attack is not None and run.acted:
            wrong += run.wrong + attack.ended(run)
        elif not hangs:
            wrong += run.says()
        return run.acted, wrong + session.wrong(there.world.heard)

    def _react(self, run: Run, seen: Match[str], came: Callable[[str], None], stays: Callable[[], bool]) -> None:
        """Do what the experimenter and the participant do; the dead are not answered, but what they said counts."""
        ledger, life = run.ledger, run.life
        if seen["trial"]:
            ledger.confirmed(int(seen["trial"]), seen["answer"])
            run.since += run.acted
            came("trial")
            if ledger.answered == run.trials:
                came("last")
            return
        if stays():
            came(seen.lastgroup or "")
        if not stays():
            return
        if seen["armed"]:
            run.there.world.begin("step", run.dice.choice([150, 250, 350]), run.dice.randrange(10**6))
        elif seen["asked"]:
            key = run.dice.choice(list(KEYS))
            ledger.asked(int(seen["asked"]), key)
            life.type(key + "\n")
        elif seen["confirm"]:
            size = _size(ledger.journal)
            life.type("\n")
            came("typed")
            ends_s = time.monotonic() + 0.05
            while time.monotonic() < ends_s and _size(ledger.journal) == size:
                pass
            came("grown")
        else:
            life.type("\n")


def _size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


WHOLE = {row: 125 for row in ATTACKS if row.startswith("SIGKILL")} | {
    row: 50 for row in ATTACKS if not row.startswith("SIGKILL")
}
SUBSET = dict.fromkeys(ATTACKS, 1)


def attacks(size: Size) -> Iterator[Count]:
    """Run laboratories beside one another, and add up their rows."""
    rows = WHOLE if size is Size.WHOLE else SUBSET
    with tempfile.TemporaryDirectory() as folder:
        shares = [
            {
                row: (count + (place + number) % LABORATORIES) // LABORATORIES
                for place, (row, count) in enumerate(rows.items())
            }
            for number in range(LABORATORIES)
        ]
        running = [
            subprocess.Popen(
                [sys.executable, "-m", "tests.faults.kills", f"{folder}/{number}", str(1 + number), json.dumps(share)],
                stdout=subprocess.PIPE,
                env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
            )
            for number, share in enumerate(shares)
        ]
        told = [json.loads(one.communicate()[0]) for one in running]
    for row in [*rows, UNHURT]:
        found = [Tally(**one[row]) for one in told if row in one]
        if row == UNHURT and not any(one.tried for one in found):
            continue
        failures = tuple(failure for one in found for failure in one.failures)
        yield Count(
            f"{row} (live session)",
            sum(one.tried for one in found),
            sum(one.survived for one in found),
            sum(one.lost for one in found),
            failures,
        )


def main() -> None:
    folder, seed, rows = Path(sys.argv[1]), int(sys.argv[2]), json.loads(sys.argv[3])
    with Laboratory(folder, repetitions=1) as there:
        study = Study(there, seed)
        kills = [row for row, count in rows.items() if row.startswith("SIGKILL") for _ in range(count)]
        random.Random(seed).shuffle(kills)
        study.run(kills)
        for row, count in rows.items():
            if count and not row.startswith("SIGKILL"):
                study.run([row] * count)
    print(json.dumps({row: vars(tally) for row, tally in study.tallies.items()}))


if __name__ == "__main__":
    main()
