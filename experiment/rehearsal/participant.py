"""A simulated person behind the console's port, at the keys of a simulated or practicing experimenter."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from palpate.experiment.clock import Clock
from palpate.experiment.desk.port import Attended, Console, Remark, laid_out
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.protocol.rules import HEARD_KEY, LOUDER_KEY, PROBE_KEY

Tick = Callable[[], None]
"""Called after each confirmed answer."""

MASKED_DB_A = 60.0
"""Level from which on a simulated participant no longer hears what the masker is to hide."""

LISTENS_NS = 600_000_000
"""A simulated participant listens to each level for so long, ns."""


@dataclass(kw_only=True)
class SimulatedPerson(Console):
    """Implements `Console`, but for what a kind of trial asks of a participant: `says`.

    `who` are the ids of participant and task, `entropy` names the random draws. Thinking and speaking take `clock`'s
    time. `tick` follows each confirmed answer; `screen` shows what the experimenter would see.
    """

    protocol: Protocol
    who: tuple[str, str]
    entropy: tuple[int, ...]
    clock: Clock
    tick: Tick
    screen: Console | None

    def __post_init__(self) -> None:
        self._probed = False
        self._session: Attended | None = None

    def attend(self, session: Attended | None) -> None:
        self._session = session

    def stimuli(self) -> int | None:
        """Return how many stimuli of the session are on record; None without a session under way."""
        gauges = None if self._session is None else self._session.gauges()
        return None if gauges is None else gauges.stimuli

    def _rng(self, *keys: int) -> np.random.Generator:
        return np.random.default_rng([*self.entropy, *keys])

    def says(self, trial: int) -> tuple[str, str]:
        """Return the key of the participant's answer, and the words for it, once these are spoken."""
        raise NotImplementedError

    def agree(self, *, text: str, yes: str, no: str) -> bool:  # noqa: ARG002
        return True

    def write(self, *, text: str) -> str:  # noqa: ARG002
        return ""

    def wait(self, *, why: str, until_ns: int, clock: Clock) -> None:  # noqa: ARG002
        clock.sleep_ns(until_ns - clock.now_ns())

    def show(self, text: str) -> None:
        if self.screen is not None:
            self.screen.show(f"REHEARSAL  {text}")

    def familiarise(self, *, instruction: str, min_s: float, max_s: float, handled: dict[str, str]) -> str:  # noqa: ARG002
        self.show(f"Familiarisation: {instruction}")
        self.clock.sleep_ns(int(self._rng(0, 2).uniform(min_s, max(max_s, min_s)) * 1e9))
        return ""

    def level(self, *, level_db_a: float, limit_db_a: float, criterion: str, keys: dict[str, str]) -> str:
        self.show(f"Masker at {level_db_a:.0f} dB(A), at most {limit_db_a:.0f}. {criterion}")
        self.clock.sleep_ns(LISTENS_NS)
        return self.wishes(level_db_a, keys)

    def wishes(self, level_db_a: float, keys: dict[str, str]) -> str:
        """Return the key that is wished for at a level of the masker; nothing where the level is right."""
        if PROBE_KEY in keys and not self._probed:
            self._probed = True
            return PROBE_KEY
        if level_db_a >= MASKED_DB_A:
            return ""
        return HEARD_KEY if HEARD_KEY in keys else LOUDER_KEY

    def say(self, *, words: str, take: int, takes: int, why: str) -> bool:  # noqa: ARG002
        return False

    def place(self, *, trial: int, presented: tuple[str, ...]) -> None:
        self.show(f"Trial {trial}: {laid_out(presented)} laid out")

    def arm(self, *, trial: int, attempt: int, trials: int) -> bool:
        if self.screen is not None:
            self.screen.arm(trial=trial, attempt=attempt, trials=trials)
        return False

    def rearm(self, *, trial: int, attempt: int, reason: str) -> bool:
        if self.screen is not None:
            self.screen.rearm(trial=trial, attempt=attempt, reason=reason)
        return False

    def ask(self, *, trial: int, answers: dict[str, str], others: dict[str, str]) -> str:  # noqa: ARG002
        key, _ = self.says(trial)
        return key

    def confirm(self, *, key: str, meaning: str) -> bool:  # noqa: ARG002
        return True

    def debrief(self) -> None:
        return None

    def ignored(self) -> str:
        return ""

    def confirmed(self, *, trial: int, answer: str | None) -> None:
        self.tick()
        if self.screen is not None:
            self.screen.confirmed(trial=trial, answer=answer)


@dataclass(kw_only=True)
class Practised:
    """Implements `Console`: an experimenter practises at `desk`, which tells what the simulated participant says."""

    desk: Console
    participant: SimulatedPerson

    def __post_init__(self) -> None:
        self._said = self._wished = self._proposed = ""
        # In these the participant takes no part.
        desk = self.desk
        self.attend, self.at, self.show, self.instruct = desk.attend, desk.at, desk.show, desk.instruct
        self.agree, self.write, self.wait, self.goes_on = desk.agree, desk.write, desk.wait, desk.goes_on
        self.familiarise, self.waiting, self.debrief = desk.familiarise, desk.waiting, desk.debrief
        self.chosen_ago_ns, self.ignored = desk.chosen_ago_ns, desk.ignored
        self.confirm, self.confirmed, self.stopped = desk.confirm, desk.confirmed, desk.stopped

    def heard(self, *, words: str) -> None:
        self._proposed = words
        self._tell()

    def _tell(self) -> None:
        """Show beside the question what the participant says, and what the microphone proposes."""
        said = f"The participant says: {self._said}." if self._said else ""
        self.desk.heard(words=f"{said} {self._proposed}".strip())

    def level(self, *, level_db_a: float, limit_db_a: float, criterion: str, keys: dict[str, str]) -> str:
        said = {LOUDER_KEY: "louder", PROBE_KEY: "let me feel it", HEARD_KEY: "I still hear it"}
        words = said.get(self.participant.wishes(level_db_a, keys), "I no longer hear it")
        self.desk.show(f"The participant says: {words}.")
        return self.desk.level(level_db_a=level_db_a, limit_db_a=limit_db_a, criterion=criterion, keys=keys)

    def say(self, *, words: str, take: int, takes: int, why: str) -> bool:
        said = self.desk.say(words=words, take=take, takes=takes, why=why)
        return said and self.participant.say(words=words, take=take, takes=takes, why=why)

    def rest(self, *, why: str) -> None:
        self.desk.rest(why=why)
        self.participant.rest(why=why)

    def place(self, *, trial: int, presented: tuple[str, ...]) -> None:
        self._said = self._proposed = ""
        self.desk.place(trial=trial, presented=presented)
        self.participant.place(trial=trial, presented=presented)

    def arm(self, *, trial: int, attempt: int, trials: int) -> bool:
        self._said = self._proposed = ""
        self.desk.arm(trial=trial, attempt=attempt, trials=trials)
        # The participant steps only now: nothing was felt while the desk was waited for.
        return self.participant.arm(trial=trial, attempt=attempt, trials=trials)

    def rearm(self, *, trial: int, attempt: int, reason: str) -> bool:
        self.desk.rearm(trial=trial, attempt=attempt, reason=reason)
        return self.participant.rearm(trial=trial, attempt=attempt, reason=reason)

    def ask(self, *, trial: int, answers: dict[str, str], others: dict[str, str]) -> str | Remark:
        if not self._said:
            self._wished, self._said = self.participant.says(trial)
        self._tell()
        said = self.desk.ask(trial=trial, answers=answers, others=others)
        if said == self._wished and said in others:
            # What the participant wished for has been done; they go on from there.
            self._said = ""
        return said
