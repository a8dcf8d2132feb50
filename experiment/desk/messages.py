"""Typed messages between a session and its consoles, each one line of JSON.

A session sends its whole `View` at every change, so that a later console is up to date; it answers every command by a
`Reply`. The participant's screen gets a `Prompt`, without what is presented.
"""

import time
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from palpate.experiment.protocol.rules import SOFTER_KEY, Mode

LONGEST = 65_536
"""No message is longer, bytes."""

RECENT = 5
"""So many answers are shown, the newest last."""

LINES = 50
"""So many lines are shown, the newest last."""

TRACE_S = 3.0
"""The trace goes back so far, s."""

ENTER = "enter"
"""The key that goes on where nothing else is to be chosen, and that confirms."""

ESCAPE = "escape"
"""The key that takes a choice back."""

TYPED = {ENTER: "\n", ESCAPE: "\x1b"}
"""Keys that are no characters, as they go on record when they answered nothing."""

SAFE = frozenset({SOFTER_KEY})
"""Keys of which every press counts, held or not, at whatever question offers them."""

CLOSED = "That question is no longer asked; the key answered nothing."


class Message(BaseModel):
    """Base of every message and its parts."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


By = Literal["experimenter", "participant", "buttons", "either"]
"""Who may make a choice: the participant at their screen, or with their `buttons`."""


class Choice(Message):
    """A key that may be pressed, `by` whom, and what it stands for; of an `answer` what the participant says."""

    key: str
    words: str
    answer: bool = False
    by: By = "experimenter"


Kind = Literal[
    "agree",
    "write",
    "familiarise",
    "level",
    "say",
    "rest",
    "place",
    "play",
    "answer",
    "confirm",
    "debrief",
    "break",
    "continue",
]
"""What may be asked."""


class Asked(Message):
    """What is asked now, with a unique `number`; answers to another are refused.

    Kind `answer` is asked until a key is chosen, then `confirm`, which `confirms` the key of that question; `write` is
    answered by `Write`, a line or nothing.
    """

    number: int
    kind: Kind
    text: str
    choices: tuple[Choice, ...]
    confirms: int | None = None


class Lamp(Message):
    """The health of one part: good, not good, or not known; `words` say it."""

    name: str
    good: bool | None
    words: str


Pace = Literal["slow", "right", "fast"]
"""How a step's speed lies to the range that the protocol asks for."""


class Measured(Message):
    """What a kind of trial measures all the time.

    `trace` is the movement of the last seconds in `trace_unit`, oldest first; `moving`: a trial is under way;
    `stepped`: its step counts and its question comes; `last` and `pace` are of the one before. `too_fast` is None
    without a lamp. `delivered` is the stimulus before: as intended, not, or not measured. `hand_mm` is the hand's
    height above a virtual block, and `second` whether that is the second of its pair, None without one.
    """

    trace: tuple[float, ...] = ()
    trace_unit: str = ""
    moving: bool = False
    stepped: bool = False
    last: str = ""
    pace: Pace | None = None
    too_fast: bool | None = None
    hand_mm: float | None = None
    second: bool | None = None
    delivered: bool | None = None
    lamps: tuple[Lamp, ...] = ()


class Gauges(Measured):
    """What is measured all the time, by the session too.

    `left_s` is left of the session, s. `masker_db_a` is dB(A), None in silence, at most `masker_limit_db_a`, None
    without sound; `dose` is that of 24 hours, of 1. `stimuli` were felt, `vibration_s` together, s.
    """

    left_s: float
    masker_db_a: float | None = None
    masker_limit_db_a: float | None = None
    dose: float | None = None
    stimuli: int = 0
    vibration_s: float = 0.0


class Told(Message):
    """One answer that counts: of a trial, in words. It never says what was presented."""

    trial: int
    words: str
    corrected: bool = False


class Standing(Message):
    """A session's progress and purpose: answered and remaining `trials`, and `recent` answers, oldest first."""

    task: str = ""
    purpose: str = ""
    trials: int = 0
    answered: int = 0
    remaining: int = 0
    recent: tuple[Told, ...] = ()


class Ended(Message):
    """How the session's process ended: in words, and with which exit code."""

    words: str
    exit_code: int


class View(Message):
    """All that a console shows. `label` is PRACTICE or PILOT, empty in a study. What is presented is felt `at_will`.

    `step` is where the visit is, one of `steps`. `trial` and `attempt` are under way, with real objects to `lay_out`;
    once it is armed the participant `may` do this. `interval` is which of several stimuli plays, and a trial `asks`
    this, where its design has words for that.
    `instruction` is the participant's: of the familiarization, then of the task until a first answer. `heard` is the
    microphone's proposal. `again` says why the step before did not count. `answers` are this task's, once asked for.
    `masked`: headphones played a masker in this task. `mode` is the protocol's of answers, and whether the
    participant sees their `progress`.
    `pause_until_ns` ends a break or a familiarization, ns of the system's clock.
    """

    kind: Literal["view"] = "view"
    label: str = ""
    study: str = ""
    at_will: bool = False
    mode: Mode = "oral"
    progress: bool = False
    participant: str = ""
    step: str = ""
    steps: tuple[str, ...] = ()
    state: Literal["preparing", "familiarising", "armed", "answering", "waiting", "paused", "ended"] = "preparing"
    trial: int | None = None
    attempt: int = 1
    may: str = ""
    interval: int | None = None
    asks: str = ""
    lay_out: str = ""
    instruction: str = ""
    answers: tuple[Choice, ...] = ()
    heard: str = ""
    again: str = ""
    masked: bool = False
    standing: Standing = Standing()
    question: Asked | None = None
    pause_until_ns: int | None = None
    gauges: Gauges | None = None
    lines: tuple[str, ...] = ()
    ended: Ended | None = None


Label = Literal["", "PRACTICE", "PILOT", "REHEARSAL"]
"""What every screen says that shows no session of a study."""

Show = Literal[
    "wait", "instructions", "masker", "rest", "ready", "coming", "answer", "compare", "break", "finished", "thanks"
]
"""What the participant's screen may show: a closed list, so that nothing else can reach it."""


class Prompt(Message):
    """What the participant's screen shows. Nothing in it depends on what is presented. `number` is unique to its look.
    `text` is the protocol's instruction, `again`: the step before did not count, `interval`: which of several stimuli
    plays, `unplayed`: nothing plays what a masker hides, `asks`: what a trial asks, `answers` are allowed in any trial,
    and given as `mode` says. `keys` answer `question`: those of `answers` in their order where they are chosen here.
    `pace` is of the last step; `lamp` says too fast, None for no lamp. `second`: the second of two virtual surfaces is
    there, None without. `hand_mm` is the hand's height above the block, None for no picture. `unmasked`: a masker has
    stopped. A break lasts until `until_ns`, ns of the system's clock. `progress` is answered trials and all, where the
    protocol shows it. `label` is PRACTICE or PILOT, empty in a study.
    """

    kind: Literal["prompt"] = "prompt"
    number: int = 0
    show: Show = "wait"
    interval: int | None = None
    text: str = ""
    again: bool = False
    unplayed: bool = False
    answers: tuple[str, ...] = ()
    asks: str = ""
    mode: Mode = "oral"
    question: int | None = None
    keys: tuple[str, ...] = ()
    pace: Pace | None = None
    lamp: bool | None = None
    second: bool | None = None
    hand_mm: float | None = None
    unmasked: bool = False
    until_ns: int | None = None
    progress: tuple[int, int] | None = None
    label: Label = ""

    @property
    def on_record(self) -> str:
        """What goes on record of what is shown."""
        return self.show if self.interval is None else f"interval {self.interval}"


class Hello(Message):
    """The first message of whoever connects: as what, and who gives the commands."""

    kind: Literal["hello"] = "hello"
    role: Literal["console", "screen"]
    by: Annotated[str, Field(min_length=1, max_length=60)]


class Choose(Message):
    """A key for the question with this number, pressed at `t_ns` of the system's monotonic clock.

    `device_us` is the time of the device that was pressed, and `error_s` the standard error of the press by it, s; None
    where nobody knows.
    """

    do: Literal["choose"] = "choose"
    question: int
    key: str
    t_ns: int = Field(default_factory=time.monotonic_ns)
    device_us: int | None = None
    error_s: Annotated[float, Field(ge=0)] | None = None


class Write(Message):
    """A line of text, or nothing, for the question with this number."""

    do: Literal["write"] = "write"
    question: int
    text: str


class TakeNote(Message):
    """A note, at any moment of a session; `trial` was under way when it was begun, None outside of trials."""

    do: Literal["note"] = "note"
    text: str
    trial: int | None = None


class Correct(Message):
    """Another answer for a trial of this session, with a reason."""

    do: Literal["correct"] = "correct"
    trial: int
    key: str
    reason: str


class Repeat(Message):
    """A trial is to be done again at the end of its block: the one under way, or one that was answered."""

    do: Literal["repeat"] = "repeat"
    trial: int
    reason: str


class TellIncident(Message):
    """An adverse event, or a deviation: what happened today and what was done; `trial` as in a note."""

    do: Literal["incident"] = "incident"
    sort: Literal["adverse event", "deviation"]
    text: str
    done: str
    trial: int | None = None


class Pause(Message):
    """The session pauses as soon as it safely can; after `minutes`, if given, it is told that the break is over."""

    do: Literal["pause"] = "pause"
    minutes: Annotated[float, Field(gt=0, le=240)] | None = None


class Stop(Message):
    """The session pauses as soon as it safely can, and its process ends."""

    do: Literal["stop"] = "stop"


class Typed(Message):
    """What was typed when nothing was asked; it answers nothing."""

    do: Literal["typed"] = "typed"
    keys: Annotated[str, Field(min_length=1, max_length=200)]


class Shown(Message):
    """The participant's screen shows this prompt since `t_ns`, in nanoseconds of the system's monotonic clock."""

    do: Literal["shown"] = "shown"
    number: int
    t_ns: int


Deed = Annotated[
    Choose | Write | TakeNote | Correct | Repeat | TellIncident | Pause | Stop | Typed | Shown,
    Field(discriminator="do"),
]
"""What a command asks for."""


class Command(Message):
    """One command; `id` comes back in its reply."""

    kind: Literal["command"] = "command"
    id: int
    deed: Deed


class Reply(Message):
    """What became of a command: whether it was taken, and in words what was done or why it was refused."""

    kind: Literal["reply"] = "reply"
    id: int
    taken: bool
    words: str


def line(message: Message) -> bytes:
    """Return a message as its line."""
    return message.model_dump_json().encode() + b"\n"
