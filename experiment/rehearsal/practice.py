"""PRACTICE: an experimenter at a desk, a simulated participant, and in a first session a guide.

The guide explains each step once. In that session the participant also does what participants do: hesitates, changes
an answer, asks for a break, and does not want to go on.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from threading import Timer

from palpate.experiment.desk import questions
from palpate.experiment.desk.messages import ENTER, By
from palpate.experiment.desk.questions import Arm, Console, Event, Level, Notice, Pressed, Question, Reply
from palpate.experiment.protocol.rules import HEARD_KEY, LOUDER_KEY, PROBE_KEY
from palpate.experiment.rehearsal.participant import SimulatedPerson

PRESSES_S, HESITATES_S = 0.6, 5.0
"""A simulated participant presses so long after the question, s, and answers so long after it if they hesitate."""

HESITATES_AT, CHANGES_AT, RESTS_AT, LEAVES_AT = 2, 3, 4, 5
"""From which trial on a participant hesitates, changes an answer, asks for a break, and does not want to go on."""

ARMED, ANSWERED = "armed", "answered"
"""Steps of a trial in which the experimenter presses nothing."""

LESSONS: Mapping[str, str] = {
    "agree": "Read the question before you press a key. Your reply is recorded.",
    "familiarise": "The participant is getting to know the materials. The label next to each key shows what it does.",
    "level": "Listen to the participant, and press the key for what they want. Enter confirms the level.",
    "say": "Press the key, then ask for the word. The microphone starts listening when you press the key.",
    "rest": "The tracker is about to be zeroed. Press Enter once the foot is resting still on the bare panel.",
    "place": "Only you can see which material to lay out. Lay it out, then press Enter.",
    ARMED: "The trial is armed. Do not press anything until a question appears.",
    "play": "Make sure that the participant is ready, then press Enter to start the stimulus.",
    "answer": "Press the key for the participant's answer. Do not repeat the answer or react to it.",
    ANSWERED: "The participant answers without your help. Do not press anything unless they ask you for something.",
    "confirm": "Compare the answer on the screen with what you heard, then confirm it. It is saved only then.",
    "break": "The break ends by itself. Ask whether the headphones are comfortable.",
    "continue": "The session is paused, and every answer is saved. The participant decides whether to continue.",
    "debrief": "All trials have been answered. Add any notes and corrections now.",
    "write": "Use the participant's own words, without any name. You can leave the line blank.",
}
"""What the guide explains at each step, by the kind of its question."""

HESITATES = "The participant is hesitating. Wait, and do not help."
RESTS = "The participant asks for a break. Press F6. With --lines, press the pause key at the next answer."
LEAVES = (
    "The participant does not want to continue today. Do not ask why. Press F8 (with --lines: Ctrl-C) to end the "
    "session. All answers are saved."
)
DIFFERS = (
    "You confirmed '{confirmed}', but the participant's answer is '{said}'. To correct trial {trial}, press F3. With "
    "--lines, type at the next answer: correct {trial} {key} misheard"
)


class Guided:
    """Implements `Console`: a desk where a guide explains each step once, if this is the `first` session."""

    def __init__(self, desk: Console, *, first: bool) -> None:
        self._desk, self._first = desk, first
        self._known: set[str] = set()
        self.attend, self.ignored, self.tell = desk.attend, desk.ignored, desk.tell

    def once(self, what: str) -> bool:
        """Return whether something is to happen now: in a first session, and not again."""
        fresh = self._first and what not in self._known
        self._known.add(what)
        return fresh

    def ask(self, question: Question | Arm) -> Reply:
        step = ARMED if isinstance(question, Arm) else question.kind
        if isinstance(question, questions.TrialAnswer) and question.by != "experimenter":
            step = ANSWERED
        if step in LESSONS and self.once(step):
            self.tell(Notice(f"GUIDE  {LESSONS[step]}"))
        return self._desk.ask(question)


@dataclass(kw_only=True)
class Practiced:
    """Implements `Console`: an experimenter practices at `desk`, which tells what the simulated participant says."""

    desk: Guided
    participant: SimulatedPerson

    def __post_init__(self) -> None:
        self._said = self._wished = self._proposed = ""
        self._asked: questions.TrialAnswer | None = None
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
                said = {PROBE_KEY: "let me feel it", **dict.fromkeys((LOUDER_KEY, HEARD_KEY), "I can still hear it")}
                words = said.get(self.participant.wishes(question), "I can no longer hear it")
                self.desk.tell(Notice(f"The participant says: {words}."))
                # Whoever practices has the participant's keys as well.
                return self.desk.ask(replace(question, by="either"))
            case questions.TrialAnswer():
                return self._ask(question)
            case questions.Confirm():
                return self._confirm(question)
            case questions.Play(by="participant"):
                return self.participant.ask(question)
            case Arm(trial=trial) | questions.Place(trial=trial):
                self._said = self._proposed = ""
                self._turn(trial)
        reply = self.desk.ask(question)
        # The participant steps only now: nothing was felt while the desk was waited for.
        theirs = isinstance(question, Arm | questions.Place | questions.Rest | questions.Say)
        return self.participant.ask(question) if theirs and reply.key != questions.WITHOUT else reply

    def _turn(self, trial: int) -> None:
        """Have the participant ask for what they want before a trial."""
        for told, at in ((RESTS, RESTS_AT), (LEAVES, LEAVES_AT)):
            if trial >= at and self.desk.once(told):
                self.desk.tell(Notice(told))

    def _press(self, key: str, by: By) -> None:
        if self.participant.box is not None:
            self.participant.box.press(key)
        else:
            self.desk.tell(Pressed(key, by=by))

    def _ask(self, question: questions.TrialAnswer) -> Reply:
        self._asked = question
        if not self._said:
            self._wished, self._said = self.participant.says(question.trial)
        if question.by != "experimenter" and self._wished in question.answers:
            # Nobody says an answer: it is pressed, once it is asked for.
            return self._ask_until(PRESSES_S, lambda: self._press(self._wished, question.by), question)
        if question.trial >= HESITATES_AT and self.desk.once(HESITATES):
            self.desk.tell(Notice(HESITATES))
            return self._ask_until(HESITATES_S, self._propose, question)
        self._propose()
        reply = self.desk.ask(question)
        if reply.key == self._wished and reply.key in question.others:
            # What the participant wished for has been done; they go on from there.
            self._said = ""
        return reply

    def _ask_until(self, after_s: float, does: Callable[[], None], question: questions.TrialAnswer) -> Reply:
        """Ask, and have the participant do something so long after, s, unless there is a reply before."""
        timer = Timer(after_s, does)
        timer.start()
        try:
            return self.desk.ask(question)
        finally:
            timer.cancel()

    def _confirm(self, question: questions.Confirm) -> Reply:
        """Ask, of an answer that the participant may take back, and report one that they did not give."""
        asked = self._asked
        if asked is None or question.key not in asked.answers:
            return self.desk.ask(question)
        others = [key for key in asked.answers if key != question.key]
        if question.key == self._wished and others and asked.trial >= CHANGES_AT and self.desk.once("change"):
            self._wished, self._said = others[0], asked.answers[others[0]]
            self._propose()
        reply = self.desk.ask(question)
        if reply.key == ENTER and question.key != self._wished:
            facts = {"confirmed": question.text, "said": self._said, "key": self._wished}
            self.desk.tell(Notice(DIFFERS.format(trial=asked.trial, **facts)))
        return reply
