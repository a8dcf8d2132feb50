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
    """No key has two functions."""
    keys = {name: table.get(name, field.default) for name, field in ScreenKeys.model_fields.items()}
    for pair in combinations(keys, 2):
        # The one that the file names is told; the other may be there by default.
        default, named = sorted(pair, key=lambda name: name in table)
        if keys[default] == keys[named]:
            yield Broken((named,), f"a key that differs from `{default}`")


class ScreenKeys(Confined):
    """The participant's keys.

    Attributes:
        louder: louder masker.
        softer: softer masker.
        probe: plays the probe.
        done: accepts the level, or begins the trial.
        stop: silences everything and pauses, at any time.
        back: previous page of a long instruction.
        forth: next page.
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
    """palpate's texts on the screen. Instructions are in the protocol.

    Attributes:
        wait: nothing to do.
        masker: the participant sets the masker's level.
        set_for_you: the experimenter sets it.
        louder: label of the key.
        softer: label of the key.
        probe: label of the key.
        tread: added to both if there is no probe.
        inaudible: label of the key that accepts the level.
        loudest: the level is at its limit.
        audible: label of the louder key at the limit: still insufficient.
        rest: the tracker is zeroed.
        ready: a step is armed.
        coming: another kind of trial is armed.
        begin: label of the key that begins it.
        interval: one of its stimuli plays, if it has several; `{number}` is its number.
        again: armed after a step that did not count.
        answer: waiting for the answer.
        choose: the same, for choices on the screen.
        press: the same, for buttons.
        say: as `answer`, below a design's question.
        option: as `choose`, below the question.
        button: as `press`, below the question.
        feel: before either, for two samples.
        compare: as `answer`, for two samples.
        first: added while the first virtual surface is presented.
        second: the same for the second.
        pause: break, above the time left.
        pause_over: the break is over.
        slow: after a step, if rules limit its speed.
        right: as `slow`; for a hand, with the lamp off.
        fast: as `slow`; for a hand, with the lamp on.
        finished: all trials have been answered.
        headphones: added to `pause`, `finished` and `thanks` after a masker.
        headphones_on: added to `pause_over` after a masker.
        thanks: the session has ended.
        gone: no connection.
    """

    wait: Line = "Please wait."
    masker: Line = "Make the noise louder until you can no longer hear the panel."
    set_for_you: Line = "Say when you can no longer hear the panel."
    louder: Line = "louder"
    softer: Line = "softer"
    probe: Line = "make the panel vibrate"
    tread: Line = "The panel does not vibrate by itself. Touch it as you will in the trials, and listen."
    inaudible: Line = "I can no longer hear it"
    loudest: Line = "This is the loudest setting."
    audible: Line = "I still hear it"
    rest: Line = "Rest your foot on the panel and keep still."
    ready: Line = "You may step now."
    coming: Line = Field("Focus on what you feel.", json_schema_extra={"since": 6})
    begin: Line = Field("I am ready", json_schema_extra={"since": 6})
    interval: Line = Field("Interval {number}", json_schema_extra={"since": 6})
    again: Line = "That step did not count. Lift your foot, then step again."
    answer: Line = "Say aloud what you felt."
    choose: Line = Field("Choose what you felt.", json_schema_extra={"since": 6})
    press: Line = Field("Press the button for what you felt.", json_schema_extra={"since": 6})
    say: Line = Field("Say your answer aloud.", json_schema_extra={"since": 6})
    option: Line = Field("Choose your answer.", json_schema_extra={"since": 6})
    button: Line = Field("Press the button for your answer.", json_schema_extra={"since": 6})
    feel: Line = Field("Feel both as often as you like.", json_schema_extra={"since": 6})
    compare: Line = "Feel both as often as you like. Then say your answer aloud."
    first: Line = "This is the first one. Say when you want the second."
    second: Line = "This is the second one. Say when you want the first."
    pause: Line = "Time for a break."
    pause_over: Line = "The break is over. We will continue when you are ready."
    slow: Line = "too slow"
    right: Line = "good speed"
    fast: Line = "too fast"
    finished: Line = "You have finished this part. Please wait for the experimenter."
    headphones: Line = "You may take off the headphones."
    headphones_on: Line = Field("Please put the headphones back on.", json_schema_extra={"since": 6})
    thanks: Line = "This session is over. Thank you."
    gone: Line = "Please wait. The experimenter will be with you shortly."

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
        font: font file (.ttf, .otf, .ttc); if omitted, palpate searches for one.
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
    str, Field(pattern=r"^[!-\-/-@\[-~]$", description="one ASCII character, but no capital letter, space or period")
]


def _buttons_rules(table: Any) -> Iterator[Broken]:
    """Either `baud` or `codes` is required; each name has its own code."""
    names, codes = table.get("names"), table.get("codes")
    if (table.get("baud") is None) == (codes is None):
        yield Broken(("baud",), "baud for a board on a serial line, or codes for a Linux input device")
    if isinstance(codes, list | tuple) and isinstance(names, list | tuple):
        if len(codes) != len(names):
            yield Broken(("codes",), f"{len(names)} codes, one for each name")
        if len(set(map(str, codes))) < len(codes):
            yield Broken(("codes",), "each code once")


class ButtonsRig(Confined):
    """The participant's answer buttons: a board on a separate serial line, or a Linux input device (HID).

    Attributes:
        port: device path, URL for pyserial, or event file.
        baud: bits per second of a board.
        names: the keys of the answers.
        codes: for an input device: the Linux code for each name.
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
    """The participant's pedal, on a separate serial line; a press silences everything.

    Attributes:
        port: device path, or URL for pyserial.
        baud: bits per second.
        tried_on: date on which a press last silenced everything.
        tried_days: validity period.
    """

    port: Line
    baud: Annotated[int, Field(ge=1200, le=12_000_000)]
    tried_on: date
    tried_days: Annotated[int, Field(ge=1, le=3650)]
