"""What a session and its consoles say to each other, in parts: `link.wire` has what goes over the link whole."""

from typing import Literal

from pydantic import BaseModel, ConfigDict

from palpate.experiment.protocol.rules import Mode

TRACE_S = 3.0
"""The trace goes back so far, s."""

ENTER = "enter"
"""The key that goes on where nothing else is to be chosen, and that confirms."""

ESCAPE = "escape"
"""The key that takes a choice back."""


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


Label = Literal["", "PRACTICE", "PILOT", "REHEARSAL"]
"""What every screen says that shows no session of a study."""

Show = Literal[
    "wait", "instructions", "masker", "rest", "ready", "coming", "answer", "compare", "break", "finished", "thanks"
]
"""What the participant's screen may show: a closed list, so that nothing else can reach it."""


class Prompt(Message):
    """What the participant's screen shows. Nothing in it depends on what is presented. `number` is unique to its look.
    `text` is the protocol's instruction, which `pictures` follow,
    `again`: the step before did not count, `interval`: which of several stimuli
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
    pictures: tuple[str, ...] = ()
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


class Reveal(Message):
    """Levels of tracks and answers by material are shown from now on, if the protocol allows it."""

    do: Literal["reveal"] = "reveal"


class TellIncident(Message):
    """An adverse event, or a deviation: what happened today and what was done; `trial` as in a note."""

    do: Literal["incident"] = "incident"
    sort: Literal["adverse event", "deviation"]
    text: str
    done: str
    trial: int | None = None
