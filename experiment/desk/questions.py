"""What a session asks and tells its experimenter, as values, and the port of whoever answers; each console is one file.

A question is waited for, and has its text and keys here alone. An event is told, from any thread, and waits for
nothing. Neither leaves the session's process: a console gets the text and the keys, the participant's screen a prompt.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Protocol

from palpate.experiment.clock import minutes
from palpate.experiment.desk import messages
from palpate.experiment.desk.messages import ENTER, ESCAPE, By, Choice, Kind
from palpate.experiment.protocol.rules import HEARD_KEY, LOUDER_KEY, PROBE_KEY, SOFTER_KEY, Mode
from palpate.experiment.records.progress import Progress

YES, NO = "y", "n"
"""The keys that say whether something is so: not Enter, which most questions take, and which ends a pasted command."""

WITHOUT, STOP = "x", "s"
"""The keys that go on without a microphone, and that end the process of a session that paused."""

MASKER = {LOUDER_KEY: "masker louder", SOFTER_KEY: "masker softer"}
"""Keys that change the masker's level, while it is chosen and at every answer."""

STEP = "step"
"""What the participant may do once a footstep is armed; their screen has words of its own for that."""

DEBRIEFING = "debriefing"
"""The last step of a visit."""

BY_EXPERIMENTER, BY_PARTICIPANT = "by the experimenter", "by the participant"
INTERRUPTED = "interrupted at the keyboard"
"""Why a session pauses: it was asked to, or its process was sent a signal, by Ctrl-C as a rule."""

STOPPED = "The participant stopped the session. It pauses now."
"""What is shown then, and is on record of the pedal."""

NO_ANSWER = "no answer"
"""What the key stands for that says that the participant said nothing."""

REVEALED = "revealed"
"""The step on record once the experimenter has results shown."""

Remark = messages.TakeNote | messages.Correct | messages.Repeat | messages.Reveal | messages.TellIncident
"""What the experimenter may say instead of answering a question."""


def keyed(keys: Mapping[str, str], *, answer: bool = False, by: By = "experimenter") -> tuple[Choice, ...]:
    """Return choices by their keys and words; `answer` and `by` as in `Choice`."""
    return tuple(Choice(key=key, words=words, answer=answer, by=by) for key, words in keys.items())


class Question(Protocol):
    """What is asked. It is answered by the key of a choice, or without choices by a line of text or by time."""

    @property
    def kind(self) -> Kind:
        """What a console and the participant's screen have to know of it."""

    @property
    def text(self) -> str:
        """What is asked, in words."""

    @property
    def choices(self) -> tuple[Choice, ...]:
        """The keys that may be pressed; whoever has no opinion presses the first."""


@dataclass(frozen=True)
class Agree:
    """Whether it is `yes` or `no` to what the text says."""

    kind: ClassVar[Kind] = "agree"
    text: str
    yes: str
    no: str

    @property
    def choices(self) -> tuple[Choice, ...]:
        return keyed({YES: self.yes, NO: self.no})


@dataclass(frozen=True)
class Asking:
    """A question that is its text and its keys: what a console asks by itself."""

    kind: Kind
    text: str
    choices: tuple[Choice, ...]


@dataclass(frozen=True)
class Report:
    """What is written down as the text asks for; it may be nothing."""

    kind: ClassVar[Kind] = "write"
    text: str
    choices = ()


@dataclass(frozen=True)
class Break:
    """A break, which ends by itself `left_s` from now."""

    kind: ClassVar[Kind] = "break"
    text: str
    left_s: float
    choices = ()


@dataclass(frozen=True)
class GoOn:
    """Whether the program goes on after a pause, of which the text says why; with the session, if one had `begun`."""

    kind: ClassVar[Kind] = "continue"
    text: str
    begun: bool

    @property
    def choices(self) -> tuple[Choice, ...]:
        return keyed({ENTER: "continue the session" if self.begun else "continue", STOP: "end for today"})


@dataclass(frozen=True)
class Familiarise:
    """Whether the participant knows the materials, which takes `min_s` to `max_s` from now.

    The keys of `handled` count a material that was handled or, if the session `plays` it, play it once. While some are
    `unfelt` they are played first, and while it is `early` nothing else is offered.
    """

    kind: ClassVar[Kind] = "familiarise"
    instruction: str
    min_s: float
    max_s: float
    handled: Mapping[str, str]
    early: bool = False
    plays: bool = False
    unfelt: bool = False

    @property
    def text(self) -> str:
        lasts = f"Familiarization, {minutes(self.min_s) if self.min_s > 0 else 'up'} to {minutes(self.max_s)}."
        if self.max_s <= 0:
            lasts = "Familiarization: the longest allowed time is over."
        does = "plays a material and counts it" if self.plays else "counts how often a material was handled"
        counts = f" Each key {does}." if self.handled else ""
        ends = " Enter works once the countdown is over." if self.early and not self.unfelt else ""
        return f"{lasts}{counts}{ends} {self.instruction}"

    @property
    def choices(self) -> tuple[Choice, ...]:
        ends = {} if self.early else {ENTER: "the participant is familiar with the materials"}
        ends = {ENTER: "play each material not yet felt"} if self.unfelt else ends
        return keyed({**ends, **self.handled})


@dataclass(frozen=True)
class Level:
    """Whether the masker's level stays, because `criterion` holds; with a `probe` there is something to hide.

    It is chosen `by` one person alone, but for softer, which is everybody's.
    """

    kind: ClassVar[Kind] = "level"
    level_db_a: float
    limit_db_a: float
    criterion: str
    probe: bool
    by: By

    @property
    def text(self) -> str:
        return f"Masker at {self.level_db_a:.0f} dB(A), at most {self.limit_db_a:.0f}. {self.criterion}"

    @property
    def choices(self) -> tuple[Choice, ...]:
        keys = MASKER | ({PROBE_KEY: "play the probe"} if self.probe else {})
        keys |= {HEARD_KEY: "still audible at the limit"} if self.level_db_a >= self.limit_db_a else {}
        chosen = keyed(keys | {ENTER: "keep the level"}, by=self.by)
        softer = {"by": "experimenter" if self.by == "experimenter" else "either"}
        return tuple(one.model_copy(update=softer) if one.key == SOFTER_KEY else one for one in chosen)


@dataclass(frozen=True)
class Say:
    """Whether the participant now says `words`, as take `take` of `takes`; `why` the one before was not used."""

    kind: ClassVar[Kind] = "say"
    words: str
    take: int
    takes: int
    why: str
    choices = keyed({ENTER: "listen now", WITHOUT: "continue without the microphone"})

    @property
    def text(self) -> str:
        asked = f"Recording {self.take} of {self.takes}: the participant will say '{self.words}'."
        return f"{self.why} {asked} Press the key, then ask for the answer.".strip()


@dataclass(frozen=True)
class Rest:
    """Whether the foot rests on the bare panel, so that the tracker can be zeroed; `why` it is asked again."""

    kind: ClassVar[Kind] = "rest"
    why: str
    choices = keyed({ENTER: "the foot is resting on the bare panel"})

    @property
    def text(self) -> str:
        asked = "To zero the tracker, have the participant rest the foot still on the bare panel."
        return f"{self.why[:1].upper()}{self.why[1:]}. {asked}" if self.why else asked


@dataclass(frozen=True)
class Place:
    """Whether the real object is laid out or, of a pair, both."""

    kind: ClassVar[Kind] = "place"
    trial: int
    presented: tuple[str, ...]
    choices = keyed({ENTER: "it is laid out"})

    @property
    def objects(self) -> str:
        """What is to be laid out: one object, or a pair with the place of each."""
        one, *others = self.presented
        return f"{one} as the first and {others[0]} as the second" if others else one

    @property
    def text(self) -> str:
        return f"Trial {self.trial}. Lay out {self.objects}."


ANSWERED_BY: Mapping[Mode, By] = {"oral": "experimenter", "keys": "buttons", "screen": "participant"}
"""Who chooses an answer, by how a protocol has participants answer."""


@dataclass(frozen=True)
class Play:
    """Whether what a trial presents begins now, which is `by` one person alone."""

    kind: ClassVar[Kind] = "play"
    trial: int
    by: By

    @property
    def text(self) -> str:
        return f"Trial {self.trial}. Press the key to start the stimulus."

    @property
    def choices(self) -> tuple[Choice, ...]:
        return keyed({ENTER: "present it"}, by=self.by)


@dataclass(frozen=True)
class TrialAnswer:
    """What the participant said: a key of `answers`, or `none` for no answer; `others` do something else.

    It is answered `by` the participant alone where they have keys of their own.
    """

    kind: ClassVar[Kind] = "answer"
    trial: int
    answers: Mapping[str, str]
    none: str
    others: Mapping[str, str]
    by: By = "experimenter"

    @property
    def text(self) -> str:
        where = {"participant": "at their screen", "buttons": "with their buttons"}.get(self.by)
        return f"The participant answers {where}." if where else "What did the participant say?"

    @property
    def choices(self) -> tuple[Choice, ...]:
        return (*keyed(self.answers, answer=True, by=self.by), *keyed({self.none: NO_ANSWER, **self.others}))


@dataclass(frozen=True)
class Confirm:
    """Whether the `key` that was chosen is meant."""

    kind: ClassVar[Kind] = "confirm"
    key: str
    text: str
    choices = keyed({ENTER: "confirm", ESCAPE: "choose again"})


@dataclass(frozen=True)
class Debrief:
    """What is left to note once all trials are answered; `after` the `task` comes another, or the debriefing."""

    kind: ClassVar[Kind] = "debrief"
    task: str = ""
    after: str = DEBRIEFING

    @property
    def text(self) -> str:
        said = "All trials have been answered. Add any remaining notes."
        return said if self.after == DEBRIEFING else f"Task {self.task} is done. {said} Task {self.after} comes next."

    @property
    def choices(self) -> tuple[Choice, ...]:
        return keyed({ENTER: "end" if self.after == DEBRIEFING else f"end task {self.task}"})


@dataclass(frozen=True)
class Arm:
    """That an attempt is armed, which waits for somebody at a console; no key answers it.

    `broken_off` is why the step before it did not count, and `may` what the participant may do now. `trials` are those
    of its task, or at most of its `training`.
    """

    trial: int
    attempt: int
    trials: int
    broken_off: str = ""
    may: str = "begin"
    training: bool = False

    @property
    def text(self) -> str:
        """What lines of text say of it."""
        if self.broken_off:
            return (
                f"Trial {self.trial}, attempt {self.attempt}: {self.broken_off}; nothing was played. It is armed again."
            )
        again = f", attempt {self.attempt}" if self.attempt > 1 else ""
        return f"Trial {self.trial} of {self.trials}{again}. Armed: the participant may {self.may}."


@dataclass(frozen=True)
class Reply:
    """What answers a question: its `key`, a line of `text`, or a `remark`.

    The key was pressed `ago_ns` ago, `by` whom: it may have gone on record since. `waited`: somebody had to be waited
    for. `device_us` is the time of the device that was pressed, and `error_s` the standard error of the press by it, s;
    None where nobody knows.
    """

    key: str = ""
    text: str = ""
    remark: Remark | None = None
    ago_ns: int = 0
    waited: bool = False
    by: By = "experimenter"
    device_us: int | None = None
    error_s: float | None = None


@dataclass(frozen=True)
class Notice:
    """A line for the experimenter; `again`: it is told once more at the program's end, to be copied or acted on."""

    text: str
    again: bool = False


@dataclass(frozen=True)
class At:
    """Where the visit stands: at one of its steps."""

    step: str
    steps: Sequence[str]


@dataclass(frozen=True)
class Instructed:
    """What the participant is told to do, until they have answered a first trial, and what each trial asks them.

    `pictures` are the names of those that follow the instruction.
    """

    instruction: str
    asks: str = ""
    pictures: tuple[str, ...] = ()

    @property
    def words(self) -> str:
        """What the experimenter reads of it, who shows the pictures where there is no screen."""
        return f"{self.instruction} Pictures: {', '.join(self.pictures)}." if self.pictures else self.instruction


@dataclass(frozen=True)
class Silent:
    """That a device is silent, and that no step counts until an attempt is armed."""


@dataclass(frozen=True)
class Playing:
    """That a stimulus of a trial with several begins soon, or plays: the first of them, the second ..."""

    place: int

    @property
    def text(self) -> str:
        """The same for the experimenter."""
        return f"Interval {self.place}."


@dataclass(frozen=True)
class Played:
    """That a stimulus of a trial has been presented: the first of them, the second ..."""

    trial: int
    place: int


@dataclass(frozen=True)
class Proposed:
    """What the microphone seems to have heard, which decides nothing."""

    words: str


@dataclass(frozen=True)
class Answered:
    """That the answer of a trial, or of a training trial, is on disk, None for no answer."""

    trial: int
    answer: str | None
    training: bool = False

    @property
    def text(self) -> str:
        """The same in words."""
        which = "Training trial" if self.training else "Trial"
        return f"{which} {self.trial}: answer saved: {self.answer or NO_ANSWER}."


@dataclass(frozen=True)
class Stopped:
    """That the participant stopped everything with the pedal."""


@dataclass(frozen=True)
class Pressed:
    """That the participant pressed `key`, with their buttons or, where simulated, at their screen; as in `Reply`."""

    key: str
    ago_ns: int = 0
    device_us: int | None = None
    error_s: float | None = None
    by: By = "buttons"


Event = Notice | At | Instructed | Silent | Playing | Played | Proposed | Answered | Stopped | Pressed


class Attended(Protocol):
    """A session under way, or one that paused, as a desk may ask of it at any moment, from any thread."""

    def gauges(self) -> messages.Gauges | None:
        """Return what is measured now; None in a pause."""

    def done(self) -> Progress:
        """Return how far the session is."""

    def remark(self, remark: Remark) -> tuple[bool, str]:
        """Return whether a remark was taken, and in words what was done, or why not."""

    def pause(self, why: str) -> None:
        """Have nothing felt from now on, and the session pause where no question is open, as `why` says."""

    def commanded(self, *, by: str, command: str, taken: bool, words: str) -> None:
        """Put on record what was asked for, by whom, and what was replied."""

    def shown(self, prompt: messages.Prompt, ago_ns: int) -> None:
        """Put on record what the participant's screen shows, and that it has done so for `ago_ns`."""


class Console(Protocol):
    """Whoever answers: they see and key, and do not decide what comes next.

    A console may raise `PauseAsked` from whatever it waits in, and `LinkError` once nobody can reach it.
    """

    def attend(self, session: Attended | None) -> None:
        """Follow the session under way or paused from now on, None for none; all work for the one before has ended."""

    def ask(self, question: Question | Arm) -> Reply:
        """Wait for the reply to a question."""

    def tell(self, event: Event) -> None:
        """Take note of an event, in any thread."""

    def ignored(self) -> str:
        """Return what was typed before it was asked for, since this was called last; it answered nothing."""
