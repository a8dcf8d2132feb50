"""The desk's first page: what can be done for a study now, and what prevents the rest."""

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from rich.console import Group
from rich.text import Text
from textual import events
from textual.app import App, ComposeResult
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.message import Message
from textual.widgets import Input, Static

from palpate.experiment.dataset.status import Status
from palpate.experiment.desk.console import study
from palpate.experiment.desk.console.forms import Blank, Form, NotFilledIn
from palpate.experiment.desk.console.panes import Blanks
from palpate.experiment.desk.console.picture import BAD, DIM, GOOD, PLAIN, PRESSES, YELLOW, keycap
from palpate.experiment.errors import Finding, PalpateError, cause
from palpate.experiment.findings import shown

WIDE = 120
"""From so many columns on, the study stands beside what can be done."""

TALL = 42
"""From so many lines on, parts of the list stand apart."""

KEYS = {"up": "", "down": "choose", "enter": "run", "f5": "refresh", "f9": "leave"}
CAPS = {"up": "↑", "down": "↓"}

YES, NO = "yes", "no"


@dataclass(frozen=True)
class Field:
    """What a command needs: its name in the form, its option (empty: an argument), and what stands there at first.

    What is not `wanted` may stay empty, and is then left out. A `flag` is given where the text is yes. `check` raises
    `PalpateError` for a text that the command would refuse.
    """

    name: str
    option: str
    text: str = ""
    wanted: bool = True
    flag: bool = False
    check: Callable[[str], object] = str

    def arguments(self, typed: str) -> tuple[str, ...]:
        """Return the part of the command line for a text. Raises `NotFilledIn`, and `PalpateError` as `check`."""
        if self.flag:
            if typed.lower() not in (YES, NO):
                raise NotFilledIn(f"{self.name}: type {YES} or {NO}.")
            return (self.option,) if typed.lower() == YES else ()
        if not typed:
            if self.wanted:
                raise NotFilledIn(f"{self.name} is empty. Fill it in, or press Escape to close this form.")
            return ()
        self.check(typed)
        return (self.option, typed) if self.option else (typed,)


@dataclass(frozen=True)
class Deed:
    """One thing to do: its name, what it does, the command's arguments, and what that asks for.

    `refuses` prevents it now, and `first` names the deed that leads to it.
    """

    name: str
    does: str
    command: tuple[str, ...]
    fields: tuple[Field, ...] = ()
    hint: str = ""
    refuses: tuple[Finding, ...] = ()
    first: str = ""

    def line(self, typed: tuple[str, ...]) -> tuple[str, ...]:
        """Return the arguments of the command with what was typed. Raises as `Field.arguments`."""
        parts = (field.arguments(text.strip()) for field, text in zip(self.fields, typed, strict=True))
        return (*self.command, *(word for part in parts for word in part))

    @property
    def form(self) -> Form:
        """The form that asks for what the command needs."""
        blanks = tuple(Blank(field.name, field.text) for field in self.fields)
        return Form(self.name, self.does, "runs it", blanks, self.hint)


@dataclass(frozen=True)
class Scene:
    """What the desk shows: which study, facts by name, everything that can be done, and what comes `next`.

    `parts` names the deeds above which a line is left free where there is room.
    """

    heading: str
    facts: tuple[tuple[str, str], ...]
    deeds: tuple[Deed, ...]
    next: str
    status: Status | None = None
    parts: tuple[str, ...] = ("rig", "pilot", "practice", "amend", "status")

    def deed(self, name: str) -> Deed:
        """Return what can be done by its name."""
        return next(one for one in self.deeds if one.name == name)


@dataclass(frozen=True)
class Chosen:
    """What was chosen: the deed's name, and the arguments of its command."""

    name: str
    arguments: tuple[str, ...]


class Found(Message):
    """The study was read, or why it could not be."""

    def __init__(self, found: Scene | Exception) -> None:
        super().__init__()
        self.found = found


class HomePage(App[Chosen]):
    """Shows what can be done; ends with what was chosen, or with None. `read` gives the scene or raises."""

    CSS_PATH = "home.tcss"
    ENABLE_COMMAND_PALETTE = False
    AUTO_FOCUS = None

    def __init__(self, read: Callable[[], Scene], said: str = "") -> None:
        super().__init__()
        self._read, self._said = read, said
        self._reading = threading.Lock()
        self._scene: Scene | None = None
        self._at = ""
        self._form: Deed | None = None
        self._blanks = Blanks()

    def compose(self) -> ComposeResult:
        yield Static("Reading the study ...", id="heading", markup=False)
        yield Static(id="facts", markup=False)
        with Horizontal(id="body"):
            with Vertical(id="left"):
                with VerticalScroll(id="list", can_focus=False):
                    yield Static(id="deeds", markup=False)
                yield self._blanks
                with VerticalScroll(id="below", can_focus=False):
                    yield Static(id="notice", markup=False)
                    yield Static(id="detail", markup=False)
            with VerticalScroll(id="study", can_focus=False):
                yield Static(id="people", markup=False)
                yield Static(id="sentences", markup=False)
        yield Static(_keys(), id="keys", markup=False)

    def on_mount(self) -> None:
        self._say(self._said)
        self._look()
        self.set_interval(study.AGAIN_S, self._look)

    def on_resize(self) -> None:
        self._draw()

    def on_key(self, event: events.Key) -> None:
        if self._form is None:
            # The key that opens a form is not typed into it.
            event.prevent_default()
        self._press({"ctrl+c": "f9", "ctrl+q": "f9"}.get(event.key, event.key))

    def on_click(self, event: events.Click) -> None:
        if (pressed := event.style.meta.get(PRESSES)) is not None:
            self._press(pressed)

    def on_input_submitted(self, event: Input.Submitted) -> None:
        event.stop()
        if not self._blanks.goes_to_next():
            self._fill_in()

    def on_found(self, message: Found) -> None:
        if isinstance(message.found, Exception):
            ours = isinstance(message.found, PalpateError | OSError)
            self._say(str(message.found) if ours else f"an error in palpate itself: {message.found!r}")
            return
        self._scene = message.found
        if self._at not in [one.name for one in self._scene.deeds]:
            self._at = self._scene.next
        self._draw()

    def _look(self) -> None:
        """Read the study in a thread of its own, unless one reads it already."""
        if self._reading.acquire(blocking=False):
            threading.Thread(target=self._look_now, name="study", daemon=True).start()

    def _look_now(self) -> None:
        try:
            found: Scene | Exception = self._read()
        except Exception as error:
            found = error
        finally:
            self._reading.release()
        self.post_message(Found(found))

    def _press(self, key: str) -> None:
        """Do what a key, or a click on its name, is for."""
        if self._form is not None:
            if key in ("escape", "f9"):
                self._close()
            elif key == "enter":
                self._fill_in()
        elif key == "f9":
            self.exit()
        elif key == "f5":
            self._say("")
            self._look()
        elif self._scene is not None:
            self._press_in_list(self._scene, key)

    def _press_in_list(self, scene: Scene, key: str) -> None:
        names = [one.name for one in scene.deeds]
        at = names.index(self._at)
        if key == "enter" or key == self._at:
            self._do(scene.deed(self._at))
            return
        if key in ("up", "down"):
            self._at = names[max(0, min(at + (1 if key == "down" else -1), len(names) - 1))]
        elif key in names:
            self._at = key
        elif len(key) == 1:
            # The next one that begins with this letter.
            self._at = next((name for name in names[at + 1 :] + names[: at + 1] if name.startswith(key)), self._at)
        self._say("")
        self._draw()

    def _do(self, deed: Deed) -> None:
        """Ask for what a deed needs, or end with it; from one that is refused, go to the one that leads to it."""
        if deed.refuses:
            if deed.first:
                self._at = deed.first
                self._draw()
        elif deed.fields:
            self._form = deed
            self._blanks.open(deed.form)
            self._say("")
            self._draw()
        else:
            self.exit(Chosen(deed.name, deed.command))

    def _fill_in(self) -> None:
        if self._form is None:
            return
        try:
            self.exit(Chosen(self._form.name, self._form.line(self._blanks.texts)))
        except (NotFilledIn, PalpateError) as error:
            self._say(cause(error))

    def _close(self) -> None:
        self._form = None
        self._blanks.close()
        self._say("")
        self._draw()

    def _say(self, words: str) -> None:
        notice = self.query_one("#notice", Static)
        notice.update(words)
        notice.display = bool(words)

    def _draw(self) -> None:
        scene = self._scene
        if scene is None:
            return
        deed, wide = scene.deed(self._at), self.size.width >= WIDE
        self.query_one("#heading", Static).update(Text(scene.heading, overflow="ellipsis", no_wrap=True))
        self.query_one("#facts", Static).update(_facts(scene))
        self.query_one("#deeds", Static).update(Group(*_rows(scene, self._at, apart=self.size.height >= TALL)))
        self.query_one("#left").set_class(self._form is not None or self.size.height < TALL, "below-fixed")
        self.query_one("#detail").display = self._form is None
        self.query_one("#detail", Static).update(_detail(deed))
        self.query_one("#study").display = wide and scene.status is not None
        if wide and scene.status is not None:
            people = Text.assemble((f"Participants: {_counted(scene.status)}\n", "bold"))
            self.query_one("#people", Static).update(Group(people, study.rows(scene.status, None)))
            self.query_one("#sentences", Static).update(study.sentences(scene.status))
        self.call_after_refresh(self._follow)

    def _follow(self) -> None:
        """Keep the row that is chosen in sight."""
        listed, names = (
            self.query_one("#list", VerticalScroll),
            [one.name for one in self._scene.deeds] if self._scene else [],
        )
        at = names.index(self._at) if self._at in names else 0
        if self.size.height < TALL and not listed.scroll_y <= at < listed.scroll_y + listed.size.height:
            listed.scroll_to(y=max(0, at - listed.size.height // 2), animate=False)


def _counted(status: Status) -> str:
    return f"{len(status.those('done'))} done of {status.planned} planned, {len(status.people)} enrolled"


def _facts(scene: Scene) -> Group:
    lines = (Text.assemble((f"{name:<10}", DIM), text, overflow="ellipsis", no_wrap=True) for name, text in scene.facts)
    return Group(*lines)


def _rows(scene: Scene, chosen: str, *, apart: bool) -> Iterator[Text]:
    """Return a row for each deed: what it does, or, in grey, why it cannot be done now."""
    for deed in scene.deeds:
        if apart and deed.name in scene.parts:
            yield Text()
        row = Text(overflow="ellipsis", no_wrap=True)
        sign, colour = ("–", DIM) if deed.refuses else ("●", GOOD)
        mine = f"bold #000000 on {PLAIN}" if deed.name == chosen else f"bold {DIM if deed.refuses else PLAIN}"
        row.append(f"{'▸' if deed.name == chosen else ' '}{sign} ", style=colour).append(f" {deed.name:<9}", style=mine)
        row.append(
            f" {deed.refuses[0].observation() if deed.refuses else deed.does}", style=DIM if deed.refuses else PLAIN
        )
        row.apply_meta({PRESSES: deed.name})
        yield row


def _detail(deed: Deed) -> Text:
    """Return what prevents a deed and the way to it, or the command that it runs."""
    if not deed.refuses:
        text = Text(deed.does, style=PLAIN)
        if deed.command[:1] and deed.command[0].startswith("palpate"):
            text.append(f"\n{shown(deed.command)}", style=DIM)
        return text
    text = Text(f"First: {deed.first}. Enter opens it." if deed.first else "", style=f"bold {YELLOW}")
    for one in deed.refuses:
        text.append("\n" if text else "").append("✗ ", style=f"bold {BAD}").append(one.sentence(), style=PLAIN)
    return text


def _keys() -> Text:
    """Return the keys of the page, each of which may be clicked."""
    text = Text()
    for key, does in KEYS.items():
        cap, words = f" {CAPS.get(key, keycap(key))} ", f" {does}  " if does else " "
        text.append(cap, style=f"bold #000000 on {DIM}").append(words, style=PLAIN)
        text.apply_meta({PRESSES: key}, -len(cap) - len(words))
    return text.append(" letters jump", style=DIM)
