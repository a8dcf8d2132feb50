"""The participant's screen and pedal in a rig file: display, keys, the screen's own sentences, and the pedal's port."""

from collections.abc import Iterator
from datetime import date
from itertools import combinations
from typing import Annotated, Any, ClassVar

from pydantic import Field

from palpate.experiment.settings.load import ONE_LINE, Broken, Confined, Line, Rules

Pixels = Annotated[int, Field(ge=320, le=16_384)]
KeyName = Annotated[
    str,
    Field(
        pattern=r"^[a-z0-9_]{1,20}$",
        description="a key as PsychoPy names it: up, down, left, right, return, space, num_add, a, 1",
    ),
    ONE_LINE,
]


def _key_rules(table: Any) -> Iterator[Broken]:
    """No key is there for two things."""
    keys = {name: table.get(name, field.default) for name, field in ScreenKeys.model_fields.items()}
    for pair in combinations(keys, 2):
        # The one that the file names is told; the other may be there by default.
        default, named = sorted(pair, key=lambda name: name in table)
        if keys[default] == keys[named]:
            yield Broken((named,), f"another key than that of `{default}`")


class ScreenKeys(Confined):
    """The keys or buttons that the participant has.

    Attributes:
        louder: makes the masker louder.
        softer: makes it softer.
        probe: plays what the masker is to hide, where the protocol has a probe.
        done: says that the masker is loud enough.
        stop: silences everything at once, and pauses the session, at any moment.
    """

    RULES: ClassVar[Rules] = _key_rules

    louder: KeyName = "up"
    softer: KeyName = "down"
    probe: KeyName = "right"
    done: KeyName = "return"
    stop: KeyName = Field("escape", json_schema_extra={"since": 2})


class ScreenWords(Confined):
    """What the screen says in its own words, in the participant's language. Instructions are the protocol's.

    Attributes:
        wait: while there is nothing to do.
        masker: while the participant sets the masker's level.
        set_for_you: while the experimenter does.
        louder: what the key does.
        softer: what the key does.
        probe: what the key does.
        tread: added to both, where no probe is played.
        inaudible: that the level is right.
        loudest: that it is at its limit.
        audible: that it does not hide everything even there; the key that makes it louder says it then.
        rest: while the tracker is zeroed.
        ready: a trial is armed.
        again: the same, after a step that did not count.
        answer: the answer is waited for.
        compare: the same, while two samples are there to be tried.
        first: added to it while the first of two virtual surfaces can be tapped.
        second: while the second can.
        pause: during a break, above the time that is left.
        pause_over: once that time is over.
        slow: of the last step, where the protocol has rules about its speed.
        right: as `slow`; on a lamp that is not lit, where a hand taps.
        fast: as `slow`; on that lamp, lit.
        finished: when all trials of a task are answered, while the experimenter writes down what is left.
        headphones: added to `finished` and `thanks`, where a masker was played.
        thanks: once the session has ended.
        gone: while there is no connection with the session.
    """

    wait: Line = "Please wait."
    masker: Line = "The noise hides the sound of the panel. Make it louder until you no longer hear the panel."
    set_for_you: Line = "The noise hides the sound of the panel. Say when you no longer hear the panel."
    louder: Line = "louder"
    softer: Line = "softer"
    probe: Line = "let the panel vibrate"
    tread: Line = "Nothing vibrates by itself: touch the panel as you will in the trials, and listen."
    inaudible: Line = "I no longer hear it"
    loudest: Line = "It is as loud as it may be."
    audible: Line = "I still hear it"
    rest: Line = "Rest your foot still on the panel."
    ready: Line = "You may step."
    again: Line = "That step did not count. Lift your foot, then step once more."
    answer: Line = "Say aloud what you felt."
    compare: Line = "Feel both, as often as you wish. Then say your answer aloud."
    first: Line = "The first is there now. Say so when you want the second."
    second: Line = "The second is there now. Say so when you want the first."
    pause: Line = "Time for a break."
    pause_over: Line = "The break is over. We go on when you are ready."
    slow: Line = "too slow"
    right: Line = "good speed"
    fast: Line = "too fast"
    finished: Line = "You have answered all of this part. Please wait for the experimenter."
    headphones: Line = "You may take the headphones off."
    thanks: Line = "This session is over. Thank you."
    gone: Line = "Please wait a moment. The experimenter will be with you."

    @property
    def own(self) -> dict[str, str]:
        """The sentences that are not palpate's own, by their keys."""
        return self.model_dump(exclude_defaults=True)


class ScreenRig(Confined):
    """The participant's screen, a process of its own that `palpate run` starts.

    Attributes:
        display: which display of the machine, from 0.
        fullscreen: whether it covers the whole display.
        width_px: of a screen that does not.
        height_px: of a screen that does not.
        font: a font file (.ttf, .otf, .ttc) that holds every letter of the texts; without it one is searched for.
        keys: the keys that the participant has.
        words: what the screen says.
    """

    display: Annotated[int, Field(ge=0, le=15)] = 0
    fullscreen: bool = True
    width_px: Pixels = 1280
    height_px: Pixels = 800
    font: Line | None = None
    keys: ScreenKeys | None = None
    words: ScreenWords | None = None

    @property
    def stop(self) -> str:
        """The key with which the participant stops everything."""
        return (self.keys or ScreenKeys()).stop


class PedalRig(Confined):
    """The participant's pedal, or button, on a serial line of its own: pressed, it silences everything at once.

    Attributes:
        port: a device path, or a URL that pyserial opens.
        baud: the speed of the line, bits a second.
        tried_on: when it was pressed last, and everything fell silent.
        tried_days: for how many days that holds.
    """

    port: Line
    baud: Annotated[int, Field(ge=1200, le=12_000_000)]
    tried_on: date
    tried_days: Annotated[int, Field(ge=1, le=3650)]
