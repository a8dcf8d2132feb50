"""Typed messages between a session and its consoles, each one line of JSON.

A session sends its whole `View` at every change, so that a later console is up to date; it answers every command by a
`Reply`. The participant's screen gets a `Prompt`, without what is presented.
"""

import time
from typing import Annotated, Literal

from pydantic import Field

from palpate.experiment.desk.messages import (
    ENTER,
    ESCAPE,
    Choice,
    Correct,
    Gauges,
    Kind,
    Message,
    Repeat,
    Reveal,
    TakeNote,
    TellIncident,
)
from palpate.experiment.protocol.rules import SOFTER_KEY, Mode

LONGEST = 65_536
"""No message is longer, bytes."""

RECENT = 5
"""So many answers are shown, the newest last."""

SERIES = 24
"""So many values of a series are shown, the newest last."""

TALLIES = 20
"""Answers are shown for so many materials, or pairs, at most."""

LINES = 50
"""So many lines are shown, the newest last."""

TYPED = {ENTER: "\n", ESCAPE: "\x1b"}
"""Keys that are no characters, as they go on record when they answered nothing."""

SAFE = frozenset({SOFTER_KEY})
"""Keys of which every press counts, held or not, at whatever question offers them."""

CLOSED = "That question is closed, so the key was ignored."


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


class Told(Message):
    """One answer that counts: of a trial, in words. It never says what was presented."""

    trial: int
    words: str
    corrected: bool = False


class Track(Message):
    """The levels of a track's newest answered trials, oldest first."""

    name: str
    levels: tuple[float, ...]


class Tally(Message):
    """How often each answer was given to what was presented."""

    presented: str
    answers: tuple[tuple[str, int], ...]


class Standing(Message):
    """A session's progress and purpose: answered and remaining `trials`, and `recent` answers, oldest first.

    `responses_s` are of the newest answered trials, and `speeds_mm_s` of the newest steps, oldest first.
    `tracks`, the newest first, and `tallies` are empty until the results were `revealed`.
    """

    task: str = ""
    purpose: str = ""
    trials: int = 0
    answered: int = 0
    remaining: int = 0
    recent: tuple[Told, ...] = ()
    responses_s: tuple[float, ...] = ()
    speeds_mm_s: tuple[float, ...] = ()
    revealed: bool = False
    tracks: tuple[Track, ...] = ()
    tallies: tuple[Tally, ...] = ()


class Ended(Message):
    """How the session's process ended: in words, and with which exit code."""

    words: str
    exit_code: int


class View(Message):
    """All that a console shows. `label` is PRACTICE or PILOT, empty in a study. What is presented is felt `at_will`.

    `step` is where the visit is, one of `steps`. `trial` and `attempt` are under way, of a `training` of so many
    trials at most, None of those that count, with real objects to `lay_out`;
    once it is armed the participant `may` do this. `interval` is which of several stimuli plays, and a trial `asks`
    this, where its design has words for that.
    `instruction` is the participant's: of the familiarization, then of the task, which has `pictures`, until a first
    answer. `heard` is the microphone's proposal.
    `again` says why the step before did not count. `answers` are this task's, once asked for.
    `masked`: headphones played a masker in this task. `mode` is the protocol's of answers, and whether the
    participant sees their `progress`; results may be revealed (`reveals`) where the protocol allows it.
    `pause_until_ns` ends a break or a familiarization, ns of the system's clock.
    """

    kind: Literal["view"] = "view"
    label: str = ""
    study: str = ""
    at_will: bool = False
    mode: Mode = "oral"
    progress: bool = False
    reveals: bool = False
    participant: str = ""
    step: str = ""
    steps: tuple[str, ...] = ()
    state: Literal["preparing", "familiarising", "armed", "answering", "waiting", "paused", "ended"] = "preparing"
    trial: int | None = None
    attempt: int = 1
    training: int | None = None
    may: str = ""
    interval: int | None = None
    asks: str = ""
    lay_out: str = ""
    instruction: str = ""
    pictures: tuple[str, ...] = ()
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
    Choose | Write | TakeNote | Correct | Repeat | Reveal | TellIncident | Pause | Stop | Typed | Shown,
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
