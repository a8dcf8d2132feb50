"""Rehearses in a forked child, kills it with SIGKILL at random moments, and lets the next child go on.

Run as a script of its own, so that the process that forks has no threads:
`python -m tests.faults.killer FOLDER KILLS SEED` prints one JSON document.
"""

from __future__ import annotations

import json
import os
import random
import signal
import sys
import time
from pathlib import Path

from palpate.experiment.desk.questions import Answered, Event
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal import study
from palpate.experiment.rehearsal.kinds.footstep.participant import SimulatedParticipant

PARTICIPANTS = 2

LONGEST_LIFE_S = 0.4
"""In 0.1 to 0.25 s a rehearsal goes on with where it was, and then answers a trial in 8 ms."""


def rehearse(out: Path, seed: int) -> None:
    """The whole rehearsal in this process, as `palpate rehearse --jobs 1` does it."""
    study.rehearse(
        protocol_file=shipped("okamoto2012.toml"),
        rig_file=shipped("rigs/rehearsal.toml"),
        out=out,
        participants=PARTICIPANTS,
        seed=seed,
    )


def tell_confirmations(pipe: int) -> None:
    """Write every confirmation to a pipe, in one write, when the experimenter sees it."""
    tell = SimulatedParticipant.tell

    def told(self: SimulatedParticipant, event: Event) -> None:
        if isinstance(event, Answered):
            line = json.dumps([*self.who, event.trial, event.answer]) + "\n"
            os.write(pipe, line.encode())
        tell(self, event)

    SimulatedParticipant.tell = told  # type: ignore[method-assign, assignment]


def one_life(out: Path, seed: int, after_s: float | None) -> tuple[list[object], bool]:
    """Fork, rehearse, and kill after `after_s`; returns what was confirmed, and whether the child lived to the end."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(read)
        try:
            tell_confirmations(write)
            rehearse(out, seed)
        except BaseException as error:
            os.write(2, f"{type(error).__name__}: {error}\n".encode())
            os._exit(1)
        os._exit(0)
    os.close(write)
    if after_s is not None:
        time.sleep(after_s)
        os.kill(child, signal.SIGKILL)
    with os.fdopen(read) as pipe:
        confirmed = [json.loads(line) for line in pipe]
    _, status = os.waitpid(child, 0)
    if os.WIFEXITED(status) and os.WEXITSTATUS(status) != 0:
        raise SystemExit("the rehearsal failed by itself; see standard error")
    return confirmed, os.WIFEXITED(status)


def main() -> None:
    folder, kills, seed = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    moments = random.Random(seed)
    rehearsals: list[dict[str, object]] = []
    left = kills
    while left > 0:
        number = len(rehearsals)
        out = folder / f"killed-{number}"
        confirmed: list[object] = []
        died = 0
        ended = False
        while not ended:
            told, ended = one_life(out, seed + number, moments.uniform(0.0, LONGEST_LIFE_S) if left > 0 else None)
            confirmed += told
            died += not ended
            left -= not ended
        rehearsals.append({"out": str(out), "seed": seed + number, "kills": died, "confirmed": confirmed})
    print(json.dumps(rehearsals))


if __name__ == "__main__":
    main()
