"""The console itself: draws the newest view, and turns keys and clicks into commands."""

from __future__ import annotations

import asyncio
import signal
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from textual import events
from textual.app import App, ComposeResult
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.message import Message
from textual.widget import Widget
from textual.widgets import Digits

from experiment.clock import wall_ns
from experiment.desk.console import forms, picture
from experiment.desk.console.panes import STYLE, Blanks, Pane, Places
from experiment.desk.console.picture import COMMANDS, PRESSES, keycap
from experiment.desk.console.presses import MOUSE, Presses
from experiment.desk.link import Line, connected
from experiment.desk.linked import ENTER, ESCAPE
from experiment.desk.messages import (
    Choice,
    Choose,
    Deed,
    Ended,
    Hello,
    Pause,
    Prompt,
    Question,
    Reply,
    Typed,
    View,
)
from experiment.errors import LinkError

PAUSE, LEAVE = "f7", "f9"

SAME = {"ctrl+c": PAUSE, "ctrl+q": LEAVE}
"""Other keys for the same."""

FORMS = {"f2": "note", "f3": "correct", "f4": "repeat", "f6": "break", "f8": "stop", LEAVE: "leave"}

WIDE, TALL = 110, 30
"""From so many columns and rows on there is room for more words."""

SIDE, WIDE_SIDE = 29, 44
"""The columns of what is measured."""

GONE = Question(
    number=-1,
    kind="continue",
    text="The session's process is gone. Nothing that was confirmed is lost: every answer is on disk before the next "
    "trial is armed. A trial that was under way is done again.",
    choices=(Choice(key=ENTER, words="start the session again"), Choice(key=LEAVE, words="leave")),
)

WRITES = (Choice(key=ENTER, words="write down the answer, or that there is none"),)
"""What may be pressed at a question that is answered with a line of text."""

TYPED = {ENTER: "\n", ESCAPE: "\x1b"}
"""Keys that are no characters, as they go on record when they answered nothing."""


@dataclass(frozen=True)
class Left:
    """Why a console was left.

    The session ended, and told how (`ended`); its process was gone, and should run `again` or not; or the experimenter
    left a session that goes on.
    """

    why: Literal["ended", "gone", "left"]
    ended: Ended | None = None
    again: bool = False


def attend(path: Path, hello: Hello) -> Left:
    """Show the console of the session that listens at `path` until it is left, and return why.

    Raises `LinkError` if no session listens there, or if it speaks another version's messages.
    """
    with connected(path, hello) as line:
        console = Console(line)
        # A terminal that is closed ends the console at once: there is nothing to restore, and nothing to save.
        before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
        try:
            left = console.run()
        finally:
            signal.signal(signal.SIGHUP, before)
    if console.misunderstood is not None:
        raise console.misunderstood
    return left if left is not None else Left("left")


class Heard(Message):
    """The session said something."""

    def __init__(self, said: View | Reply) -> None:
        super().__init__()
        self.said = said


class Lost(Message):
    """The session says nothing more; `error` if it could not be understood."""

    def __init__(self, error: LinkError | None) -> None:
        super().__init__()
        self.error = error


class Console(App[Left]):
    """Draws views of a session and sends what the experimenter asks for."""

    CSS = STYLE
    ENABLE_COMMAND_PALETTE = False
    AUTO_FOCUS = None

    def __init__(self, line: Line) -> None:
        """Show the session at the other end of `line`.

        `view_now` is the newest view, and `misunderstood` why the session could not be understood, if so.
        """
        super().__init__()
        self.misunderstood: LinkError | None = None
        self._line = line
        self.view_now = View()
        self._lost = False
        self._presses = Presses()
        self._form: forms.Form | None = None
        self._sent: dict[int, Deed] = {}
        self._filled: int | None = None

    def compose(self) -> ComposeResult:
        yield Pane(id="heading")
        yield Pane(id="visit")
        with Horizontal(id="top"):
            yield Digits("", id="trial")
            yield Pane(id="counted")
            yield Places()
        with Horizontal(id="body"):
            with Vertical(id="main"):
                yield Pane(id="notice")
                with VerticalScroll(id="text", can_focus=False):
                    yield Pane(id="asked")
                with VerticalScroll(id="keys", can_focus=False):
                    yield Pane(id="offered")
                yield Blanks()
                with VerticalScroll(id="told", can_focus=False):
                    yield Pane(id="lines")
            with VerticalScroll(id="side", can_focus=False):
                yield Pane(id="left")
                yield Pane(id="trace")
                yield Pane(id="gauges")
                yield Pane(id="recent")
        yield Pane(id="commands")

    def on_mount(self) -> None:
        threading.Thread(target=self._listen, name="link", daemon=True).start()
        self.query_one("#told").anchor()
        self.set_interval(1.0, self._draw)
        self._draw()

    def on_resize(self) -> None:
        self._draw()

    def _listen(self) -> None:
        error = None
        try:
            for said in self._line.messages():
                if not isinstance(said, Prompt):
                    self.post_message(Heard(said))
        except LinkError as misunderstood:
            error = misunderstood
        self.post_message(Lost(error))

    # What the session says.

    def on_heard(self, message: Heard) -> None:
        said = message.said
        if isinstance(said, Reply):
            self._replied(said)
            return
        before, self.view_now = self._question, said
        if self._question != before:
            if said.ended is not None:
                self._say("")
            self._presses.drawn(None, time.monotonic())
        self._draw()

    def on_lost(self, message: Lost) -> None:
        self._lost = True
        if message.error is not None:
            self.misunderstood = message.error
            self.exit()
            return
        self._presses.drawn(None, time.monotonic())
        self._close()

    def _replied(self, reply: Reply) -> None:
        deed = self._sent.pop(reply.id, None)
        filled = reply.id == self._filled
        if filled:
            self._filled = None
        if not reply.taken:
            self._say(reply.words, "refused")
        elif not isinstance(deed, Typed):
            if reply.words:
                self._say(reply.words, "done")
            if filled:
                self._close()

    @property
    def _question(self) -> Question | None:
        view = self.view_now
        if view.ended is not None:
            choices = (Choice(key=ENTER, words="close the console"),)
            return Question(number=-2, kind="continue", text=view.ended.words, choices=choices)
        if self._lost:
            return GONE
        asked = view.question
        return asked if asked is None or asked.kind != "write" else asked.model_copy(update={"choices": WRITES})

    # What the experimenter presses.

    async def on_event(self, event: events.Event) -> None:
        """Look at every key before anything else does: no widget has a key that this one did not let through."""
        if isinstance(event, events.Key) and not event.is_forwarded:
            if event.key == ENTER and self.focused is not None:
                await _through(self.focused)
            if self._takes_key(event):
                return
        elif isinstance(event, events.Paste) and not event.is_forwarded and self._form is None:
            self._ignore(event.text, "What was pasted answered nothing. Press the key of an answer.")
            return
        await super().on_event(event)

    def on_mouse_down(self, event: events.MouseDown) -> None:
        key = event.style.meta.get(PRESSES)
        if event.button != 1 or key is None:
            return
        if self._presses.held(MOUSE, event.time):
            self._say("That click came right after another one. Only the first one counts.", "ignored")
        else:
            self._press(key, event.time)

    def _takes_key(self, event: events.Key) -> bool:
        """Return whether a key was dealt with; what is typed into a form goes on to it."""
        shown = event.character is not None and event.character.isprintable()
        key = event.character if shown and event.character is not None else event.key
        key = SAME.get(key, key)
        held = self._presses.held(key, event.time)
        if self._form is not None:
            self.query_one(Blanks).take_keys()
            if key not in (ENTER, ESCAPE, *COMMANDS):
                return False
        if held:
            self._say(f"{keycap(key)} was held down, or pressed again at once. It counts only once.", "ignored")
        else:
            self._press(key, event.time)
        return True

    def _press(self, key: str, at_s: float) -> None:
        """Do what a key is for."""
        if key == PAUSE:
            self._send(Pause())
        elif self._form is not None:
            self._press_in_form(key)
        elif key in FORMS and not (self._lost or self.view_now.ended):
            self._open(forms.opened(FORMS[key], self.view_now))
        elif key in ("pageup", "pagedown", "up", "down"):
            self._scroll(key)
        else:
            self._answer(key, at_s)

    def _press_in_form(self, key: str) -> None:
        """Do what a key, or a click, is for while a form is open."""
        if key == ESCAPE:
            self._say("")
            self._close()
        elif key == ENTER:
            self._fill_in()
        else:
            self._say("Press Enter or Esc to finish with this first.", "refused")

    def _answer(self, key: str, at_s: float) -> None:
        question, seen = self._question, self._presses.seen(at_s)
        keys = {choice.key for choice in question.choices} if question is not None else set()
        key = key.lower() if key not in keys and len(key) == 1 else key
        if len(key) > 1 and key not in keys | TYPED.keys():
            return
        if question is None:
            self._ignore(TYPED.get(key, key), f"Nothing is asked. {keycap(key)} was ignored.")
        elif question.number != seen:
            words = f"{keycap(key)} was pressed before the question was on the screen, and answered nothing."
            self._ignore(TYPED.get(key, key), f"{words} Press it again.")
        elif question.kind == "write" and key == ENTER:
            self._open(forms.answering(question))
        elif question.number >= 0:
            self._say("")
            self._send(Choose(question=question.number, key=key))
        elif key in keys:
            ended = self.view_now.ended
            self.exit(Left("ended", ended=ended) if ended is not None else Left("gone", again=key == ENTER))

    def _ignore(self, typed: str, words: str) -> None:
        self._say(words, "ignored")
        if typed and not self._lost:
            self._send(Typed(keys=typed[:200]))

    def _send(self, deed: Deed) -> int | None:
        try:
            sent = self._line.send(deed)
        except LinkError:
            # The end of its messages, which the other thread meets, says the same.
            return None
        self._sent[sent] = deed
        return sent

    def _scroll(self, key: str) -> None:
        for part in ("#text", "#keys"):
            scrolled = self.query_one(part, VerticalScroll)
            lines = max(1, scrolled.size.height - 1) if key.startswith("page") else 1
            scrolled.scroll_relative(y=-lines if key.endswith("up") else lines, animate=False)

    # Forms.

    def _open(self, form: forms.Form) -> None:
        self._form = form
        self._presses.drawn(None, time.monotonic())
        self._say("")
        self.query_one(Blanks).open(form)
        self._draw()

    def _close(self) -> None:
        self._form = self._filled = None
        if self._stands:
            self.query_one(Blanks).close()
            self._draw()

    def _fill_in(self) -> None:
        blanks = self.query_one(Blanks)
        if self._form is None or self._filled is not None or blanks.goes_to_next():
            return
        if self._form.name == "leave":
            self.exit(Left("left"))
            return
        try:
            self._filled = self._send(forms.filled(self._form, blanks.texts))
        except forms.NotFilledIn as missing:
            self._say(str(missing), "refused")

    # What is drawn.

    def _say(self, words: str, how: Literal["done", "ignored", "refused"] = "done") -> None:
        """Show words right above what is asked."""
        if self._stands:
            self._pane("notice").set_classes(how if words else "")
            self._pane("notice").show(picture.notice, words)
            self.call_after_refresh(self._fit)

    @property
    def _stands(self) -> bool:
        """Whether all parts of the screen are there: not before they are put up, nor while they are taken down."""
        return bool(self.query("#heading")) and bool(self.query("#commands"))

    def _draw(self) -> None:
        if not self._stands:
            return
        view, question = self.view_now, self._question
        standing = view.standing
        now = picture.GONE if question is GONE else picture.phase(view)
        wide, roomy = self.size.width >= WIDE, self.size.height >= TALL
        side = WIDE_SIDE if wide else SIDE
        self._pane("heading").show(picture.heading, view.label, view.study, view.participant, standing.task)
        self._pane("visit").show(picture.visit, view.step, view.steps)
        self._pane("visit").display = bool(view.step)
        self._count_down()
        self.query_one(Places).light(now)
        self.query_one("#text").display = self.query_one("#keys").display = self._form is None
        self._pane("asked").show(picture.asked, question, now, view.lay_out)
        self._pane("offered").show(picture.offered, question.choices if question is not None else (), roomy)
        self._pane("lines").show(picture.lines, view.lines)
        self._pane("commands").show(picture.commands, wide)
        self._pane("recent").show(picture.recent, standing.recent)
        self._pane("recent").set_class(roomy, "roomy")
        self.query_one("#side").styles.width = side
        measured = view.gauges is not None and not self._lost
        for name in ("left", "trace", "gauges"):
            self._pane(name).display = measured
        if (gauges := view.gauges) is not None:
            self._pane("left").show(picture.left, picture.time_left(gauges.left_s))
            self._pane("trace").show(picture.trace, gauges.trace, gauges.trace_unit, side - 4, 4 if roomy else 2)
            self._pane("gauges").show(picture.gauges, gauges.model_copy(update={"trace": (), "left_s": 0.0}), roomy)
        self.call_after_refresh(self._fit)
        if question is not None and self._form is None:
            self.call_after_refresh(self._drawn, question.number)

    def _pane(self, name: str) -> Pane:
        return self.query_one(f"#{name}", Pane)

    def _drawn(self, number: int) -> None:
        question = self._question
        if question is not None and question.number == number and self._form is None:
            self._presses.drawn(number, time.monotonic())

    def _fit(self) -> None:
        """Let a long text scroll, so that the keys below it stay on the screen."""
        if not self._stands:
            return
        width = self.query_one("#main").content_size.width
        room = self.query_one("#main").content_size.height - self._pane("notice").size.height
        keys = self._pane("offered").lines(width)
        self.query_one("#text").styles.max_height = max(3, room - keys - 1)
        self.query_one("#keys").styles.max_height = max(3, room - min(3, self._pane("asked").lines(width)))

    def _count_down(self) -> None:
        """Show the trial's number, or what is left of a break."""
        view = self.view_now
        digits, counted = self.query_one("#trial", Digits), self._pane("counted")
        if view.pause_until_ns is not None:
            left_s = (view.pause_until_ns - wall_ns()) / 1e9
            shown = picture.countdown(left_s)
            counted.show(picture.break_left, left_s > 0)
        else:
            shown = "" if view.trial is None else str(view.trial)
            counted.show(picture.counted, view.trial, view.standing.trials, view.standing.remaining, view.attempt)
        if shown != digits.value:
            digits.update(shown)


async def _through(field: Widget) -> None:
    """Wait until a field is through with what was typed into it before now."""
    done = asyncio.Event()
    field.call_later(done.set)
    await done.wait()
