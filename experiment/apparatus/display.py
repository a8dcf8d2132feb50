"""The participant's screen, buttons and pedal in a rig file: display, keys, the screen's own sentences, and ports."""

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
    """The participant's keys.

    Attributes:
        louder: louder masker.
        softer: softer masker.
        probe: plays the probe.
        done: loud enough; or the trial may begin.
        stop: silences everything and pauses, any time.
        back: a page back in a long instruction.
        forth: a page on.
    """

    RULES: ClassVar[Rules] = _key_rules

    louder: KeyName = "up"
    softer: KeyName = "down"
    probe: KeyName = "right"
    done: KeyName = "return"
    stop: KeyName = Field("escape", json_schema_extra={"since": 2})
    back: KeyName = Field("pageup", json_schema_extra={"since": 6})
    forth: KeyName = Field("pagedown", json_schema_extra={"since": 6})


class ScreenWords(Confined):
    """The screen's own words. Instructions are the protocol's.

    Attributes:
        wait: nothing to do.
        masker: setting the level.
        set_for_you: the experimenter sets it.
        louder: label of the key.
        softer: label of the key.
        probe: label of the key.
        tread: added to both while there is no probe.
        inaudible: the level is right.
        loudest: at the limit.
        audible: not enough even there (louder key).
        rest: the tracker is zeroed.
        ready: a step is armed.
        coming: another trial is.
        begin: label of the key that sets it off.
        interval: one of its stimuli plays, if it has several; `{number}` stands for which.
        again: armed after a step that did not count.
        answer: the answer is awaited.
        choose: same, chosen on the screen.
        press: same, with buttons.
        say: as `answer`, below what a design asks.
        option: as `choose`, below that.
        button: as `press`, below that.
        feel: before either, two samples.
        compare: as `answer`, two samples.
        first: added while the first virtual surface is there.
        second: added for the second.
        pause: break, above the time left.
        pause_over: break over.
        slow: the last step, if rules judge its speed.
        right: as `slow`; of a hand, the lamp unlit.
        fast: as `slow`; of a hand, the lamp lit.
        finished: all trials answered.
        headphones: added to `pause`, `finished` and `thanks` after a masker.
        headphones_on: added to `pause_over` after one.
        thanks: session ended.
        gone: no connection.
    """

    wait: Line = "Please wait."
    masker: Line = "Make the noise louder until you no longer hear the panel."
    set_for_you: Line = "Say when you no longer hear the panel."
    louder: Line = "louder"
    softer: Line = "softer"
    probe: Line = "let the panel vibrate"
    tread: Line = "Nothing vibrates by itself: touch the panel as you will in the trials, and listen."
    inaudible: Line = "I no longer hear it"
    loudest: Line = "It is as loud as it may be."
    audible: Line = "I still hear it"
    rest: Line = "Rest your foot still on the panel."
    ready: Line = "You may step."
    coming: Line = Field("Feel what comes.", json_schema_extra={"since": 6})
    begin: Line = Field("I am ready", json_schema_extra={"since": 6})
    interval: Line = Field("Interval {number}", json_schema_extra={"since": 6})
    again: Line = "That step did not count. Lift your foot, then step once more."
    answer: Line = "Say aloud what you felt."
    choose: Line = Field("Choose what you felt.", json_schema_extra={"since": 6})
    press: Line = Field("Press the button for what you felt.", json_schema_extra={"since": 6})
    say: Line = Field("Say your answer aloud.", json_schema_extra={"since": 6})
    option: Line = Field("Choose your answer.", json_schema_extra={"since": 6})
    button: Line = Field("Press the button of your answer.", json_schema_extra={"since": 6})
    feel: Line = Field("Feel both, as often as you wish.", json_schema_extra={"since": 6})
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
    headphones_on: Line = Field("Put the headphones on again.", json_schema_extra={"since": 6})
    thanks: Line = "This session is over. Thank you."
    gone: Line = "Please wait a moment. The experimenter will be with you."

    @property
    def own(self) -> dict[str, str]:
        """The sentences that are not palpate's own, by their keys."""
        return self.model_dump(exclude_defaults=True)


class ScreenRig(Confined):
    """The participant's screen.

    Attributes:
        display: number of the display, from 0.
        fullscreen: covers the display.
        width_px: width of a window.
        height_px: height of a window.
        font: font file (.ttf, .otf, .ttc); else one is searched for.
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


ButtonName = Annotated[
    str, Field(pattern=r"^[!-\-/-@\[-~]$", description="one ASCII character, neither a capital letter, a blank nor .")
]


def _buttons_rules(table: Any) -> Iterator[Broken]:
    """Either `baud` or `codes` is there; each name has its own code."""
    names, codes = table.get("names"), table.get("codes")
    if (table.get("baud") is None) == (codes is None):
        yield Broken(("baud",), "baud for a board on a serial line, or codes for an input device of Linux")
    if isinstance(codes, list | tuple) and isinstance(names, list | tuple):
        if len(codes) != len(names):
            yield Broken(("codes",), f"{len(names)} codes, one for each name")
        if len(set(map(str, codes))) < len(codes):
            yield Broken(("codes",), "each code once")


class ButtonsRig(Confined):
    """The participant's buttons for answers: a board on its own serial line, or an input device (HID) of Linux.

    Attributes:
        port: device path, URL for pyserial, or event file.
        baud: bits a second of a board.
        names: the keys of the answers.
        codes: of an input device: Linux's of each name.
    """

    RULES: ClassVar[Rules] = _buttons_rules

    port: Line
    baud: Annotated[int, Field(ge=1200, le=12_000_000)] | None = None
    names: Annotated[tuple[ButtonName, ...], Field(min_length=2)]
    codes: tuple[Annotated[int, Field(ge=1, le=767)], ...] | None = None

    @property
    def named(self) -> dict[int, str]:
        """The names of an input device's buttons by their codes; none of a board."""
        return dict(zip(self.codes or (), self.names, strict=False))


class PedalRig(Confined):
    """The participant's pedal on its own serial line: pressed, it silences everything.

    Attributes:
        port: device path, or URL for pyserial.
        baud: bits a second.
        tried_on: day it was last pressed and silenced everything.
        tried_days: validity.
    """

    port: Line
    baud: Annotated[int, Field(ge=1200, le=12_000_000)]
    tried_on: date
    tried_days: Annotated[int, Field(ge=1, le=3650)]
