"""A simulated person behind the console's port, at the keys of a simulated experimenter."""

from collections.abc import Callable
from dataclasses import dataclass
from queue import SimpleQueue

import numpy as np

from palpate.experiment.clock import Clock
from palpate.experiment.desk import questions
from palpate.experiment.desk.questions import Arm, Attended, Console, Event, Level, Notice, Pressed, Question, Reply
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.protocol.rules import HEARD_KEY, LOUDER_KEY, PROBE_KEY
from palpate.experiment.rehearsal.wires.serial_line import SimulatedButtons

Tick = Callable[[], None]
"""Called after each confirmed answer."""

MASKED_DB_A = 60.0
"""Level from which on a simulated participant no longer hears what the masker is to hide."""

PRESSED_S = 10.0
"""A press of a simulated participant has come through its port within so long, s."""

LISTENS_NS = 600_000_000
"""A simulated participant listens to each level for so long, ns."""


@dataclass(kw_only=True)
class SimulatedPerson(Console):
    """Implements `Console`, but for what a kind of trial asks of a participant: `says`.

    `who` are the ids of participant and task, `entropy` names the random draws by seed, participant and task. Thinking
    and speaking take `clock`'s time. `tick` follows each confirmed answer; `screen` shows what the experimenter would
    see. `box` are the participant's buttons, if any.
    """

    protocol: Protocol
    who: tuple[str, str]
    entropy: tuple[int, int, int]
    clock: Clock
    tick: Tick
    screen: Console | None
    box: SimulatedButtons | None = None

    def __post_init__(self) -> None:
        self._probed = False
        self._session: Attended | None = None
        self._presses: SimpleQueue[Pressed] = SimpleQueue()

    def attend(self, session: Attended | None) -> None:
        self._session = session

    def stimuli(self) -> int | None:
        """Return how many stimuli of the session are on record; None without a session under way."""
        gauges = None if self._session is None else self._session.gauges()
        return None if gauges is None else gauges.stimuli

    def _rng(self, *keys: int) -> np.random.Generator:
        return np.random.default_rng([*self.entropy, *keys])

    def _own_rng(self, *keys: int) -> np.random.Generator:
        """Return what the participant's own touch is drawn from: the same in all tasks, as in the first."""
        seed, participant, _ = self.entropy
        return np.random.default_rng([seed, participant, 0, 0, *keys])

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
            case questions.Answered(training=training):
                if not training:
                    self.tick()
                if self.screen is not None:
                    self.screen.tell(event)
            case questions.Stopped():
                self.show(questions.STOPPED)
            case Pressed():
                self._presses.put(event)

    def ask(self, question: Question | Arm) -> Reply:
        match question:
            case Arm():
                if self.screen is not None:
                    self.screen.ask(question)
                return Reply()
            case questions.Familiarise(instruction=instruction, min_s=min_s, max_s=max_s):
                self.show(f"Familiarization: {instruction}")
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
                return self._answer(question, self.says(trial)[0])
            case questions.Say():
                return Reply(questions.WITHOUT)
            case questions.GoOn():
                return Reply(questions.STOP)
        return Reply(question.choices[0].key if question.choices else "")

    def _answer(self, question: questions.TrialAnswer, key: str) -> Reply:
        """Return the reply with this key, which speaks through the port of the participant's buttons, if any."""
        if key not in question.answers or self.box is None:
            return Reply(key, by=question.by if key in question.answers else "experimenter")
        self.box.press(key)
        press = self._presses.get(timeout=PRESSED_S)
        return Reply(press.key, ago_ns=press.ago_ns, by=press.by, device_us=press.device_us, error_s=press.error_s)

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
