"""The console itself: draws the newest view, and turns keys and clicks into commands."""

import asyncio
import signal
import threading
import time
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from textual import events
from textual.app import App, ComposeResult
from textual.message import Message
from textual.screen import Screen
from textual.widget import Widget

from palpate.experiment.apparatus import host
from palpate.experiment.desk import messages
from palpate.experiment.desk.console import forms, picture
from palpate.experiment.desk.console.panes import Board
from palpate.experiment.desk.console.picture import COMMANDS, PRESSES, REVEAL, keycap
from palpate.experiment.desk.console.presses import MOUSE, Chosen, Presses
from palpate.experiment.desk.link import Line, wire
from palpate.experiment.errors import LinkError

PAUSE, LEAVE = "f7", "f9"

SAME = {"ctrl+c": PAUSE, "ctrl+q": LEAVE}
"""Other keys for the same."""

FORMS = {"f2": "note", "f3": "correct", "f4": "repeat", "f5": "incident", "f6": "break", "f8": "stop", LEAVE: "leave"}

FIELDS = {"tab": Screen.focus_next, "shift+tab": Screen.focus_previous}
"""Keys that change between a form's fields."""

SCROLLS = ("pageup", "pagedown", "up", "down")
"""Keys that scroll, as often as they are pressed."""

GONE = wire.Asked(
    number=-1,
    kind="continue",
    text="The session's process has ended. Every confirmed answer is saved: each is on disk before the next trial is "
    "armed. A trial that was in progress will be repeated.",
    choices=(
        messages.Choice(key=messages.ENTER, words="start the session again"),
        messages.Choice(key=LEAVE, words="leave"),
    ),
)

STANDS_S = 2.0
"""A session that says nothing for so long stands still, s: it speaks every `link.BEAT_S`. Ours."""

WRITES = (messages.Choice(key=messages.ENTER, words="type the answer, or leave it blank"),)
"""What may be pressed at a question that is answered with a line of text."""


@dataclass(frozen=True)
class Left:
    """Why a console was left: the session `ended`, its process was lost, to be run `again` or not, or it goes on."""

    why: Literal["ended", "gone", "left"]
    ended: wire.Ended | None = None
    again: bool = False


def attend(path: Path, hello: wire.Hello) -> Left:
    """Show the console of the session that listens at `path` until it is left, and return why.

    Raises `LinkError` if none listens or it is of another version, and a fault of the console; the session goes on.
    """
    host.favour()
    with closing(Line(path, hello)) as line:
        console = Console(line)
        # A terminal that is closed ends the console at once: there is nothing to restore, and nothing to save.
        before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
        try:
            left = console.run()
        finally:
            signal.signal(signal.SIGHUP, before)
    if (failed := console.misunderstood or console.failed) is not None:
        raise failed
    return left if left is not None else Left("left")


class Heard(Message):
    """The session said something."""

    def __init__(self, said: wire.View | wire.Reply) -> None:
        super().__init__()
        self.said = said


class Lost(Message):
    """The session says nothing more; `error` if it could not be understood."""

    def __init__(self, error: LinkError | None) -> None:
        super().__init__()
        self.error = error


class Console(App[Left]):
    """Draws views of a session and sends what the experimenter asks for."""

    CSS_PATH = "app.tcss"
    ENABLE_COMMAND_PALETTE = False
    AUTO_FOCUS = None

    def __init__(self, line: Line) -> None:
        """Show the session at the other end of `line`.

        `view_now` is the newest view, `misunderstood` the link's fault, and `failed` the console's own.
        """
        super().__init__()
        self.misunderstood: LinkError | None = None
        self.failed: Exception | None = None
        self._line = line
        self.view_now = wire.View()
        self._lost = self._stands = False
        self._heard_s = time.monotonic()
        self._presses = Presses()
        self._chosen: Chosen | None = None
        self._form: forms.Form | None = None
        self._sent: dict[int, wire.Deed] = {}
        self._filled: int | None = None
        self._board = Board()
        # Whether what is told above the question was told, or has stood, beside one already.
        self._beside = False

    def compose(self) -> ComposeResult:
        yield self._board

    def on_mount(self) -> None:
        threading.Thread(target=self._listen, name="link", daemon=True).start()
        self.set_interval(1.0, self._draw)
        self.set_interval(0.25, self._watch)

    def on_resize(self) -> None:
        self._draw()

    def _handle_exception(self, error: Exception) -> None:
        """Leave the screen as it was; whoever shows the console tells of its fault."""
        if self.is_headless:
            super()._handle_exception(error)
        else:
            self.failed = error
            self.exit(return_code=1)

    def _listen(self) -> None:
        error = None
        try:
            for said in self._line.messages():
                self._heard_s = time.monotonic()
                if not isinstance(said, messages.Prompt):
                    self.post_message(Heard(said))
        except LinkError as misunderstood:
            error = misunderstood
        self.post_message(Lost(error))

    def _watch(self) -> None:
        """Say so while the session's process stands still, and once it goes on."""
        silent_s = time.monotonic() - self._heard_s
        if silent_s > STANDS_S and not self._lost and self.view_now.ended is None:
            self._stands = True
            self._say(
                f"The session has not responded for {silent_s:.0f} s. All forces and sounds stop within 0.6 s. Your "
                "key presses will be handled when it responds again.",
                "refused",
            )
        elif self._stands:
            self._stands = False
            self._say("" if self._lost else "The session is responding again.")

    # What the session says.

    def on_heard(self, message: Heard) -> None:
        said = message.said
        if isinstance(said, wire.Reply):
            self._replied(said)
            return
        before, state = self._question, self.view_now.state
        self.view_now = said
        came = said.ended is not None or (said.state == "paused" and self._board.says == "done")
        back = state == "waiting" and said.state != state
        if self._question != before:
            # A key that was ignored is told beside the one question that comes after it.
            over = self._form is None and (self._beside or self._board.says == "refused")
            if self._board.says and (came or over):
                self._say("")
            self._beside = self._question is not None
            self._presses.drawn(None, time.monotonic())
        elif back and self._form is None:
            self._say("")
        self._draw()
        self._follow()

    def on_lost(self, message: Lost) -> None:
        self._lost = True
        if message.error is not None:
            self.misunderstood = message.error
            self.exit()
            return
        self._presses.drawn(None, time.monotonic())
        self._close()

    def _replied(self, reply: wire.Reply) -> None:
        deed = self._sent.pop(reply.id, None)
        if self._chosen is not None and self._chosen.sent == reply.id:
            self._chosen.taken = reply.taken
            self._follow()
        filled = reply.id == self._filled
        if filled:
            self._filled = None
        if not reply.taken:
            self._say(reply.words, "ignored" if reply.words == wire.CLOSED else "refused")
        elif not isinstance(deed, wire.Typed):
            if reply.words:
                self._say(reply.words, "done")
            if filled:
                self._close()

    @property
    def _question(self) -> wire.Asked | None:
        view = self.view_now
        if view.ended is not None:
            choices = (messages.Choice(key=messages.ENTER, words="close the console"),)
            return wire.Asked(number=-2, kind="continue", text=view.ended.words, choices=choices)
        if self._lost:
            return GONE
        asked = view.question
        return asked if asked is None or asked.kind != "write" else asked.model_copy(update={"choices": WRITES})

    # What the experimenter presses.

    async def on_event(self, event: events.Event) -> None:
        """Look at every key before anything else does: no widget has a key that this one did not let through."""
        if isinstance(event, events.Key) and not event.is_forwarded:
            if event.key in (messages.ENTER, *FIELDS) and self.focused is not None:
                await _through(self.focused)
            if self._takes_key(event):
                return
        elif isinstance(event, events.Paste) and not event.is_forwarded and self._form is None:
            self._ignore(event.text, "The pasted text was ignored.")
            return
        await super().on_event(event)

    def on_mouse_down(self, event: events.MouseDown) -> None:
        key = event.style.meta.get(PRESSES)
        if event.button != 1 or key is None:
            return
        if self._presses.continues(MOUSE, event.time):
            self._say("That click came right after another click and does not count. Click again.", "ignored")
        else:
            self._press(key, event.time)

    def _takes_key(self, event: events.Key) -> bool:
        """Return whether a key was dealt with; what is typed into a form goes on to it."""
        shown = event.character is not None and event.character.isprintable()
        key = event.character if shown and event.character is not None else event.key
        key = SAME.get(key, key)
        held = self._presses.continues(key, event.time)
        if self._form is not None:
            self._board.blanks.take_keys()
            if key in FIELDS:
                FIELDS[key](self.screen)
                return True
            if key not in (messages.ENTER, messages.ESCAPE, *COMMANDS):
                return self._board.blanks.edit(key)
        if held and key not in (*wire.SAFE, *SCROLLS):
            pressed = f"{keycap(key)} was held down or pressed twice, so the second press does not count."
            self._say(f"{pressed} If you mean it, wait a second and press it again.", "ignored")
        else:
            self._press(key, event.time)
        return True

    def _press(self, key: str, at_s: float) -> None:
        """Do what a key is for."""
        if key != messages.ENTER:
            self._forget()
        if key in (PAUSE, LEAVE) and self.view_now.ended is not None:
            self.exit(Left("ended", ended=self.view_now.ended))
        elif key == PAUSE and self._lost:
            self.exit(Left("gone", again=False))
        elif key == PAUSE:
            self._send(wire.Pause())
        elif self._form is not None:
            self._press_in_form(key)
        elif key in FORMS and not (self._lost or self.view_now.ended):
            self._open(forms.opened(FORMS[key], self.view_now))
        elif key == REVEAL and self.view_now.reveals:
            self._show_results()
        elif key in SCROLLS:
            self._board.scroll(key)
        elif key != messages.ENTER or not self._enters(at_s):
            self._answer(key, at_s)

    def _show_results(self) -> None:
        """Show results, or no longer; they are asked for once."""
        self._board.results = not self._board.results
        if not self.view_now.standing.revealed:
            self._board.results = True
            self._send(messages.Reveal())
        self._draw()

    def _enters(self, at_s: float) -> bool:
        """Return whether Enter belongs to the key that was pressed last; then it confirms that."""
        if self._chosen is None or not self._chosen.owns(self._question, self._presses.seen(at_s)):
            return False
        self._chosen.entered = True
        self._follow()
        return True

    def _press_in_form(self, key: str) -> None:
        """Do what a key, or a click, is for while a form is open."""
        if key == messages.ESCAPE:
            self._say("")
            self._close()
        elif key == messages.ENTER:
            self._fill_in()
        else:
            self._say("Finish this form first: press Enter or Esc.", "refused")

    def _answer(self, key: str, at_s: float) -> None:
        question, seen = self._question, self._presses.seen(at_s)
        keys = {choice.key for choice in question.choices} if question is not None else set()
        key = key.lower() if key not in keys and len(key) == 1 else key
        if len(key) > 1 and key not in keys | wire.TYPED.keys():
            return
        if question is None:
            self._ignore(
                wire.TYPED.get(key, key), f"{keycap(key)} was pressed when there was no question, and was ignored."
            )
        elif question.number != seen and key not in wire.SAFE & keys:
            again = " If you meant it, press it again." if key in keys else ""
            words = f"{keycap(key)} was pressed before the question appeared, and was ignored.{again}"
            self._ignore(wire.TYPED.get(key, key), words)
        elif question.kind == "write" and key == messages.ENTER:
            self._open(forms.answering(question))
        elif question.number >= 0:
            self._say("")
            sent = self._send(wire.Choose(question=question.number, key=key))
            if sent is not None and question.kind == "answer":
                self._chosen = Chosen(question.number, sent)
        elif key in keys:
            ended = self.view_now.ended
            self.exit(Left("ended", ended=ended) if ended is not None else Left("gone", again=key == messages.ENTER))

    def _follow(self) -> None:
        """Have Enter confirm the key that it belongs to, once that is asked; what else is asked ends that."""
        chosen, question = self._chosen, self._question
        confirmed = None if chosen is None else chosen.confirmed_by(question)
        if chosen is None or confirmed is None:
            return
        if not confirmed:
            self._forget()
        elif chosen.entered and question is not None:
            self._chosen = None
            self._send(wire.Choose(question=question.number, key=messages.ENTER))

    def _forget(self) -> None:
        """Let no Enter belong to the last key any more; one that was waiting for it answered nothing."""
        chosen, self._chosen = self._chosen, None
        if chosen is not None and chosen.entered:
            self._ignore(wire.TYPED[messages.ENTER], "Enter had nothing to confirm, and was ignored.")

    def _ignore(self, typed: str, words: str) -> None:
        self._say(words, "ignored")
        if typed and not self._lost:
            self._send(wire.Typed(keys=typed[:200]))

    def _send(self, deed: wire.Deed) -> int | None:
        try:
            sent = self._line.send(deed)
        except LinkError:
            # The end of its messages, which the other thread meets, says the same.
            return None
        self._sent[sent] = deed
        return sent

    # Forms.

    def _open(self, form: forms.Form) -> None:
        self._form = form
        self._presses.drawn(None, time.monotonic())
        self._say("")
        self._board.blanks.open(form)
        self._draw()

    def _close(self) -> None:
        self._form = self._filled = None
        self._board.blanks.close()
        self._draw()

    def _fill_in(self) -> None:
        blanks = self._board.blanks
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
        self._board.say(words, how)
        self._beside = self._question is not None

    def _draw(self) -> None:
        question = self._question
        now = picture.GONE if question is GONE else picture.phase(self.view_now)
        self._board.show(self.view_now, question, now, form=self._form is not None)
        if question is not None and self._form is None and question.number != self._presses.question:
            self.call_after_refresh(self._drawn, question.number)

    def _drawn(self, number: int) -> None:
        question = self._question
        if question is not None and question.number == number and self._form is None:
            self._presses.drawn(number, time.monotonic())


async def _through(field: Widget) -> None:
    """Wait until a field is through with what was typed into it before now."""
    done = asyncio.Event()
    field.call_later(done.set)
    await done.wait()
