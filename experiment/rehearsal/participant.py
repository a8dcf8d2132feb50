"""A simulated person behind the console's port, at the keys of a simulated or practicing experimenter."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from palpate.experiment.clock import Clock
from palpate.experiment.desk import questions
from palpate.experiment.desk.questions import Arm, Attended, Console, Event, Level, Notice, Question, Reply
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

    def show(self, text: str) -> None:
        """Show a line of a rehearsal."""
        if self.screen is not None:
            self.screen.tell(Notice(f"REHEARSAL  {text}"))

    def tell(self, event: Event) -> None:
        match event:
            case Notice(text=text) | questions.Proposed(words=text):
                self.show(text)
            case questions.Answered():
                self.tick()
                if self.screen is not None:
                    self.screen.tell(event)
            case questions.Stopped():
                self.show(questions.STOPPED)

    def ask(self, question: Question | Arm) -> Reply:
        match question:
            case Arm():
                if self.screen is not None:
                    self.screen.ask(question)
                return Reply()
            case questions.Familiarise(instruction=instruction, min_s=min_s, max_s=max_s):
                self.show(f"Familiarisation: {instruction}")
                self.clock.sleep_ns(int(self._rng(0, 2).uniform(min_s, max(max_s, min_s)) * 1e9))
            case questions.Break(left_s=left_s):
                self.clock.sleep_ns(int(left_s * 1e9))
            case Level():
                self.show(question.text)
                self.clock.sleep_ns(LISTENS_NS)
                return Reply(self.wishes(question))
            case questions.Place(trial=trial, objects=objects):
                self.show(f"Trial {trial}: {objects} laid out")
            case questions.TrialAnswer(trial=trial):
                return Reply(self.says(trial)[0])
            case questions.Say():
                return Reply(questions.WITHOUT)
            case questions.GoOn():
                return Reply(questions.STOP)
        return Reply(question.choices[0].key if question.choices else "")

    def wishes(self, question: Level) -> str:
        """Return the key that is wished for at a level of the masker."""
        if question.probe and not self._probed:
            self._probed = True
            return PROBE_KEY
        if question.level_db_a >= MASKED_DB_A:
            return question.choices[-1].key
        return HEARD_KEY if question.level_db_a >= question.limit_db_a else LOUDER_KEY

    def ignored(self) -> str:
        return ""


@dataclass(kw_only=True)
class Practised:
    """Implements `Console`: an experimenter practises at `desk`, which tells what the simulated participant says."""

    desk: Console
    participant: SimulatedPerson

    def __post_init__(self) -> None:
        self._said = self._wished = self._proposed = ""
        self.attend, self.ignored = self.desk.attend, self.desk.ignored

    def tell(self, event: Event) -> None:
        if isinstance(event, questions.Proposed):
            self._proposed = event.words
            self._propose()
        else:
            self.desk.tell(event)
            if isinstance(event, questions.Played):
                self.participant.tell(event)

    def _propose(self) -> None:
        """Show beside the question what the participant says, and what the microphone proposes."""
        said = f"The participant says: {self._said}." if self._said else ""
        self.desk.tell(questions.Proposed(f"{said} {self._proposed}".strip()))

    def ask(self, question: Question | Arm) -> Reply:
        match question:
            case Level():
                said = {LOUDER_KEY: "louder", PROBE_KEY: "let me feel it", HEARD_KEY: "I still hear it"}
                words = said.get(self.participant.wishes(question), "I no longer hear it")
                self.desk.tell(Notice(f"The participant says: {words}."))
                # Whoever practises has the participant's keys as well.
                return self.desk.ask(replace(question, by="either"))
            case questions.TrialAnswer():
                return self._ask(question)
            case questions.Play(by="participant"):
                return self.participant.ask(question)
            case Arm() | questions.Place():
                self._said = self._proposed = ""
        reply = self.desk.ask(question)
        # The participant steps only now: nothing was felt while the desk was waited for.
        theirs = isinstance(question, Arm | questions.Place | questions.Rest | questions.Say)
        return self.participant.ask(question) if theirs and reply.key != questions.WITHOUT else reply

    def _ask(self, question: questions.TrialAnswer) -> Reply:
        if not self._said:
            self._wished, self._said = self.participant.says(question.trial)
        self._propose()
        reply = self.desk.ask(question)
        if reply.key == self._wished and reply.key in question.others:
            # What the participant wished for has been done; they go on from there.
            self._said = ""
        return reply
