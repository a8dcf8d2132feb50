"""Live sessions that are killed, interrupted and robbed of their parts, at moments of every phase.

`python -m tests.faults.kills FOLDER NUMBER ROWS` is one laboratory, with ROWS in JSON: how often each attack is made.
"""

from __future__ import annotations

import json
import os
import random
import re
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
from io import FileIO
from pathlib import Path
from re import Match
from typing import TYPE_CHECKING

from palpate.experiment.errors import JournalError
from palpate.experiment.records import chain
from palpate.experiment.records.entries import Footer, Ignored
from palpate.experiment.records.progress import progress
from tests.faults.campaign import Count, Size
from tests.faults.ledger import Ledger, Wrong
from tests.faults.live import KEYS, PATIENCE_S, Laboratory, Life, World, palpate, rig_of

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer as Buffer

LABORATORIES = 2
"""At a time, one a core."""

SOUND = 1
"""The number of the laboratory that plays the masker through a sound server, where the machine has one."""


MOST_FRUITLESS = 5
"""So many lives in a row that go wrong before their attack is made end a study: the next would do no better."""

MOST_CALLS = 80
"""A life that dies at a write call does so at one of the first so many: those of some trials."""


@dataclass(frozen=True)
class Moment:
    """When an attack comes: `delay_s` at most after something, drawn anew for each life; 0 is before anything is typed.

    `after` is `fork`, a group of `SCREEN`, `heard` (by the panel), `typed` (the key that confirms an answer), `grown`
    (the journal, after that) or `last` (the answer after which nothing remains). At `written` the session's process
    ends itself, at a write call of its journal or before the fsync of one.
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

    `act` returns whether the experimenter goes on as if nothing had been. `ended` returns what is wrong with how the
    life ended. `piped` has its output lead into a pipe.
    """

    moments: tuple[Moment, ...]
    act: Callable[[Run], bool]
    ended: Callable[[Run], list[Wrong]]
    piped: bool = False


@dataclass
class Run:
    """One life of a session, and what was done to it."""

    there: Laboratory
    ledger: Ledger
    life: Life
    dice: random.Random
    trials: int
    before: int
    """Entries that the journal had."""
    acted: bool = False
    since: int = 0
    """Answers that were confirmed since."""
    wrong: list[Wrong] = field(default_factory=list)

    @property
    def code(self) -> int | None:
        """The exit code, or the signal below 0; None while it lives."""
        return None if self.life.status is None else os.waitstatus_to_exitcode(self.life.status)

    def says(self, codes: tuple[int, ...], *words: str) -> list[Wrong]:
        """Return what is wrong with a life that had to end with one of these codes, and say one of the words."""
        text = self.life.text
        wrong = [
            Wrong(f"it said {text[text.index(word) :][:900]!r}")
            for word in ("FAULT", "Exception ignored", "Traceback", "an error in palpate")
            if word in text
        ]
        if self.code not in codes:
            wrong.append(Wrong(f"it ended with {self.code}: {text[-200:]!r}"))
        if words and not any(word in text for word in words):
            wrong.append(Wrong(f"it did not say {' or '.join(words)}: {text[-200:]!r}"))
        return wrong

    def footed(self, *wanted: str) -> list[Wrong]:
        """Return what is wrong with the journal's end, if this life wrote any of it.

        It must be a footer that matches one of these, as `reason: detail`; an empty one stands for no footer. A session
        in which nothing remains may be complete instead, and no other.
        """
        try:
            entries = self.ledger.entries()
        except JournalError:
            return []  # The ledger says so.
        if len(entries) == self.before:
            return []
        last = entries[-1]
        found = f"{last.reason}: {last.detail}" if isinstance(last, Footer) else ""
        if found == "complete: ":
            good = len(progress(entries).answered) == self.trials
        else:
            good = any(re.fullmatch(one, found) for one in wanted)
        return [] if good else [Wrong(f"the journal ends with {found!r}, not as {wanted}")]

    def completed(self) -> list[Wrong]:
        """Return what is wrong with a life that had to bring the session to its end."""
        return self.says((0,), "The session is complete") + self.footed()


def killed(run: Run) -> bool:
    run.life.kill(signal.SIGKILL)
    return False


def is_dead(run: Run) -> list[Wrong]:
    """It ended by the signal, or before it by itself."""
    return run.footed("") if run.code == -signal.SIGKILL else run.completed()


def dying(calls: int) -> None:
    """Have this process end by SIGKILL at one of the next calls that put a line on disk, without a byte of it, or
    with all of them before they are synchronized.
    """
    left = iter(range(calls, -1, -1))
    write, sync = FileIO.write, os.fsync

    def dies() -> None:
        if next(left, 1) == 0:
            os.kill(os.getpid(), signal.SIGKILL)

    class Struck(FileIO):
        def write(self, content: Buffer, /) -> int:
            dies()
            return write(self, content)

    def synchronized(descriptor: int) -> None:
        dies()
        sync(descriptor)

    chain.FileIO = Struck  # type: ignore[attr-defined]
    os.fsync = synchronized  # type: ignore[assignment]


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


def paused(*signals: int) -> Callable[[Run], list[Wrong]]:
    """Before a session begins, and while tables are built, a signal may end the process as it ends any other."""

    def ended(run: Run) -> list[Wrong]:
        return run.says((0, 130, *(-number for number in signals))) + run.footed(INTERRUPTED)

    return ended


def hung(run: Run) -> list[Wrong]:
    return run.says((0, 2, 130, -signal.SIGHUP)) + run.footed(INTERRUPTED, SCREEN_GONE)


def unheard(run: Run) -> list[Wrong]:
    return run.says((0, 1, 2, 130)) + run.footed(SCREEN_GONE)


def unplugged(run: Run) -> bool:
    run.there.world.do("unplug")
    time.sleep(run.dice.uniform(0.0, 0.3))
    run.there.world.do("replug")
    return True


def goes_on(run: Run) -> list[Wrong]:
    return run.completed()


def hasty(run: Run) -> bool:
    """Type what would be an answer and its confirmation, if it were asked for."""
    key = run.dice.choice(list(KEYS))
    run.life.type(run.dice.choice([f"{key}\n{key}\n", f"{key}\n{key}", key, "\n\n"]))
    return True


def ignored(run: Run) -> list[Wrong]:
    told = sum(isinstance(entry, Ignored) for entry in run.ledger.entries()[run.before :])
    return run.completed() + [Wrong(f"the journal tells {told} times of keys that were ignored")] * (told != 1)


def deafened(run: Run) -> bool:
    run.there.world.do("deaf")
    return True


def hears_again(run: Run) -> list[Wrong]:
    run.there.world.do("hears")
    return run.says((2,), "actuator at") + run.footed("error: actuator at .*")


def moved(run: Run) -> bool:
    run.ledger.dataset.rename(run.ledger.dataset.with_suffix(".moved"))
    return True


def moved_back(run: Run) -> list[Wrong]:
    # Whatever was written where the folder had been stands beside it, and is no part of the dataset.
    shutil.rmtree(run.ledger.dataset, ignore_errors=True)
    run.ledger.dataset.with_suffix(".moved").rename(run.ledger.dataset)
    wrong = run.says((2,), "the file is missing") + run.footed("", "error: .*: the file is missing: .*")
    return wrong + [Wrong(f"{run.since} answers were confirmed without the folder", run.since)] * (run.since > 0)


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
        run.wrong.append(Wrong("a second runner was let in", 1))
        second.kill()
    if "a session with participant" not in second.text:
        run.wrong.append(Wrong(f"the second runner was told {second.text[-200:]!r}"))
    world.close()
    return True


def filled(run: Run) -> bool:
    """The disk takes little more than the journal's next lines, and nothing of a file that is larger."""
    most = _size(run.ledger.journal) + run.dice.randrange(1, 1500)
    resource.prlimit(run.life.pid, resource.RLIMIT_FSIZE, (most, most))
    return True


def in_words(run: Run) -> list[Wrong]:
    return run.says((0, 2), "File too large", "The session is complete") + run.footed("", "error: .*File too large.*")


INTERRUPTED = "paused: interrupted at the keyboard"
SCREEN_GONE = r"paused: (the terminal was closed \(.*\)|the terminal's input ended, so nothing more can be typed)"

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
    "SIGKILL at a write call": Attack((Moment("written", 0.0),), killed, is_dead),
    "SIGTERM": Attack(EVERYWHERE, signalled(signal.SIGTERM), paused(signal.SIGTERM)),
    "SIGHUP": Attack(EVERYWHERE, signalled(signal.SIGHUP), paused(signal.SIGHUP)),
    "terminal closed": Attack(EVERYWHERE[1:], hung_up, hung),
    "Ctrl-C": Attack(EVERYWHERE, control_c, paused()),
    "standard output closed": Attack(EVERYWHERE[1:], closed, unheard, piped=True),
    "keys before the question": Attack(IN_TRIALS[:1], hasty, ignored),
    "tracker unplugged for up to 0.3 s": Attack(IN_TRIALS, unplugged, goes_on),
    "panel off the network": Attack((Moment("armed", 0.0),), deafened, hears_again),
    "dataset moved in mid-session": Attack(IN_TRIALS, moved, moved_back),
    "dataset deleted in mid-session": Attack(IN_TRIALS, deleted, moved_back),
    "lock removed, second runner": Attack((Moment("asked", 0.0), Moment("confirm", 0.0)), doubled, goes_on),
    "disk full": Attack((Moment("fork", 0.4), *IN_TRIALS), filled, in_words),
}
"""By the name of the row. Of an attack's moments the next is taken in turn."""

AT_CALL = "SIGKILL at a write call"
"""A part of its own: see `writes`."""

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

    def run(self, todo: list[str]) -> None:
        """Make each attack of the list once, in this order as far as sessions allow, and bring the last to its end."""
        turns: dict[str, int] = defaultdict(int)
        fruitless = 0
        while (todo or self._session is not None) and fruitless < MOST_FRUITLESS:
            session = self._session or next(self._sessions)
            self._session = session
            virtual = session.task == "virtual"
            row = next((one for one in todo if virtual or one not in VIRTUAL), None)
            attack = ATTACKS[row] if row is not None else None
            moment = attack.moments[turns[row] % len(attack.moments)] if attack and row else None
            run = self._life(session, attack, moment)
            acted, wrong = run.acted, run.wrong
            if row is not None and acted:
                turns[row] += 1
                todo.remove(row)
            fruitless = 0 if acted or not wrong else fruitless + 1
            name = row if acted and row is not None else UNHURT
            if run.code == 0 and "The session is complete" in run.life.text:
                wrong += session.table()
                self._session = None
            if wrong:
                # What went wrong in one session spoils no other.
                self._session, self._sessions = None, self._all()
            tally = self.tallies[name]
            tally.tried += acted or bool(wrong)
            tally.survived += acted and not wrong
            tally.lost += sum(one.lost for one in wrong)
            where = f"{session.journal} {moment}"
            tally.failures += [f"{where}: {one.text}" for one in wrong]

    def _life(self, session: Ledger, attack: Attack | None, moment: Moment | None) -> Run:
        there, dice = self._there, self._dice
        there.world.heard.clear()
        command = there.command(session.dataset, session.participant, session.task)
        trials, before = len(there.protocol.materials), len(session.entries())
        strikes = moment is not None and moment.after == "written"
        calls = dice.randrange(MOST_CALLS) if strikes else None

        def session_run() -> None:
            if calls is not None:
                dying(calls)
            palpate(*command)

        life = Life(there.world, session_run, piped=attack is not None and attack.piped)
        run = Run(there, session, life, dice, trials, before)
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
            struck = due_s <= time.monotonic()
            if struck:
                strike()
            if seen == "late":
                if struck:
                    continue
                if hangs:
                    break
                hangs = True
                life.kill(signal.SIGKILL)
                continue
            heard_s = time.monotonic()
            if seen == "heard":
                came("heard")
            elif isinstance(seen, Match):
                self._react(run, seen, came, lambda: stays)
        there.world.do("ping")
        run.acted |= strikes and run.code == -signal.SIGKILL and not hangs
        if hangs:
            run.wrong.append(Wrong("it hung"))
        elif attack is None or not run.acted:
            run.wrong += run.completed()
        if attack is not None and run.acted:
            run.wrong += attack.ended(run)
        run.wrong += session.wrong(there.world.heard)
        return run

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
            life.type(seen["confirm"] + "\n")
            came("typed")
            ends_s = time.monotonic() + 0.05
            while time.monotonic() < ends_s and _size(ledger.journal) == size:
                pass
            came("grown")
        else:
            life.type("y\n" if seen["agree"] else "\n")


def _size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


WHOLE = {row: 125 for row in ATTACKS if row.startswith("SIGKILL") and row != AT_CALL} | {
    row: 25 for row in ATTACKS if not row.startswith("SIGKILL")
}
SUBSET = dict.fromkeys(WHOLE, 1)


def attacks(size: Size) -> Iterator[Count]:
    """Make each attack."""
    yield from made(WHOLE if size is Size.WHOLE else SUBSET)


def made(rows: dict[str, int]) -> Iterator[Count]:
    """Make attacks as often as rows say: run laboratories beside one another, and add up what came of each row."""
    with tempfile.TemporaryDirectory() as folder:
        shares = [
            {
                row: (count + (place + number) % LABORATORIES) // LABORATORIES
                for place, (row, count) in enumerate(rows.items())
            }
            for number in range(LABORATORIES)
        ]
        # One without a row would start all its parts in vain.
        running = [
            subprocess.Popen(
                [sys.executable, "-m", "tests.faults.kills", f"{folder}/{number}", str(number), json.dumps(share)],
                stdout=subprocess.PIPE,
                env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
            )
            for number, share in enumerate(shares)
            if any(share.values())
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
    folder, number, rows = Path(sys.argv[1]), int(sys.argv[2]), json.loads(sys.argv[3])
    sound = number == SOUND and shutil.which("jackd") is not None
    with Laboratory(folder, repetitions=1, sound=sound) as there:
        study = Study(there, seed=1 + number)
        kills = [row for row, count in rows.items() if row.startswith("SIGKILL") for _ in range(count)]
        random.Random(number).shuffle(kills)
        study.run(kills + [row for row, count in rows.items() if row not in kills for _ in range(count)])
    print(json.dumps({row: vars(tally) for row, tally in study.tallies.items()}))


if __name__ == "__main__":
    main()
