"""The desk's first page: a study's progress and the next session, as concealed as in `palpate status`."""

import threading
from collections import Counter
from collections.abc import Callable, Iterator

from rich.align import Align
from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text
from textual import events
from textual.app import App, ComposeResult
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.message import Message
from textual.widgets import Digits, Static

from palpate.experiment.dataset.status import STATES, Person, State, Status
from palpate.experiment.desk.console.picture import BAD, BLUE, DIM, GOOD, PLAIN, PRESSES, UNKNOWN, YELLOW, keycap
from palpate.experiment.errors import PalpateError

AGAIN_S = 5.0
"""The study is read again after so long, s."""

KEYS = {"enter": "begin or resume", "f": "flow of participants", "r": "refresh", "f9": "leave"}

SIGNS: dict[State, tuple[str, str]] = {
    "done": ("●", GOOD),
    "under way": ("◐", YELLOW),
    "to begin": ("○", BLUE),
    "withdrawn": ("–", UNKNOWN),
    "doubted": ("▲", BAD),
}
"""By the state of a participant: its sign, which tells it without the colour too, and the colour."""


class Found(Message):
    """The study was read, or why it could not be."""

    def __init__(self, found: Status | PalpateError | OSError) -> None:
        super().__init__()
        self.found = found


class StudyPage(App[str]):
    """Shows a study; ends with the label of the participant whose session is to begin, or with None.

    `read` gives the study or raises `PalpateError`; `refuses` says why no session can begin, empty where one can.
    """

    CSS_PATH = "study.tcss"
    ENABLE_COMMAND_PALETTE = False
    AUTO_FOCUS = None

    def __init__(self, read: Callable[[], Status], *, refuses: str) -> None:
        super().__init__()
        self._read, self._refuses = read, refuses
        self._reading = threading.Lock()
        self._status: Status | None = None
        self._chosen: str | None = None

    def compose(self) -> ComposeResult:
        yield Static("Reading the study ...", id="heading", markup=False)
        with Horizontal(id="top"):
            yield Digits("", id="done")
            yield Static(id="counts", markup=False)
        with Horizontal(id="body"):
            with VerticalScroll(id="people", can_focus=False):
                yield Static(id="rows", markup=False)
            with VerticalScroll(id="told", can_focus=False):
                yield Static(id="sentences", markup=False)
        with VerticalScroll(id="flow", can_focus=False):
            yield Static(id="figure", markup=False)
        with Vertical(id="foot"):
            yield Static(id="notice", markup=False)
            yield Static(keys(), id="keys", markup=False)

    def on_mount(self) -> None:
        self._look()
        self.set_interval(AGAIN_S, self._look)

    def on_key(self, event: events.Key) -> None:
        self._press({"ctrl+c": "f9", "ctrl+q": "f9", "q": "f9"}.get(event.key, event.key))

    def on_click(self, event: events.Click) -> None:
        if (key := event.style.meta.get(PRESSES)) is not None:
            self._press(key)

    def on_found(self, message: Found) -> None:
        if isinstance(message.found, Exception):
            self._say(str(message.found))
            return
        self._status = message.found
        labels = [one.participant for one in message.found.people]
        if self._chosen not in labels:
            self._chosen = next(
                (one.participant for state in ("under way", "to begin") for one in message.found.those(state)), None
            )
        self._draw()

    def _look(self) -> None:
        """Read the study in a thread of its own, unless one reads it already."""
        if self._reading.acquire(blocking=False):
            threading.Thread(target=self._look_now, name="study", daemon=True).start()

    def _look_now(self) -> None:
        try:
            found: Status | PalpateError | OSError = self._read()
        except (PalpateError, OSError) as error:
            found = error
        finally:
            self._reading.release()
        self.post_message(Found(found))

    def _press(self, key: str) -> None:
        if key == "f9":
            self.exit()
        elif key == "r":
            self._say("")
            self._look()
        elif key == "f":
            body, flow = self.query_one("#body"), self.query_one("#flow")
            body.display, flow.display = flow.display, body.display
        elif key in ("up", "down"):
            self._choose(-1 if key == "up" else 1)
        elif key in ("pageup", "pagedown"):
            for part in self.query(VerticalScroll):
                part.scroll_page_up(animate=False) if key == "pageup" else part.scroll_page_down(animate=False)
        elif key == "enter":
            self._begin()
        elif self._status is not None and key in {one.participant for one in self._status.people}:
            self._chosen = key
            self._draw()

    def _choose(self, step: int) -> None:
        labels = [one.participant for one in self._status.people] if self._status is not None else []
        if labels:
            at = labels.index(self._chosen) + step if self._chosen in labels else 0
            self._chosen = labels[max(0, min(at, len(labels) - 1))]
            self._draw()

    def _begin(self) -> None:
        """End with the chosen participant, or say why no session of theirs can be begun."""
        people = {one.participant: one for one in self._status.people} if self._status is not None else {}
        one = people.get(self._chosen or "")
        if one is None:
            self._say("No participant is chosen. Choose a participant with Up and Down.")
        elif one.state not in ("to begin", "under way"):
            self._say(f"Participant {one.participant}: {one.state}. There is no session for this participant to begin.")
        elif self._refuses:
            self._say(self._refuses)
        else:
            self.exit(one.participant)

    def _say(self, words: str) -> None:
        self.query_one("#notice", Static).update(words)

    def _draw(self) -> None:
        status = self._status
        if status is None:
            return
        heading = Text(f"{status.heading} · {status.title}", overflow="ellipsis", no_wrap=True)
        self.query_one("#heading", Static).update(heading)
        self.query_one("#done", Digits).update(f"{len(status.those('done'))}")
        self.query_one("#counts", Static).update(counts(status))
        self.query_one("#rows", Static).update(rows(status, self._chosen))
        self.query_one("#sentences", Static).update(sentences(status))
        self.query_one("#figure", Static).update(figure(status))
        at = [one.participant for one in status.people].index(self._chosen) if self._chosen else 0
        people = self.query_one("#people", VerticalScroll)
        if not people.scroll_y <= at < people.scroll_y + people.size.height:
            people.scroll_to(y=max(0, at - people.size.height // 2), animate=False)


def keys() -> Text:
    """Return the keys of the page, each of which may be clicked."""
    text = Text()
    for key, does in KEYS.items():
        text.append(" " if text else "")
        text.append(f" {keycap(key)} ", style=f"bold #000000 on {DIM}").append(f" {does} ", style=PLAIN)
        text.apply_meta({PRESSES: key}, -len(keycap(key)) - len(does) - 4)
    return text


def counts(status: Status) -> Text:
    """Return, in three lines beside the number of those done, how many are in each state, and the approval."""
    found = Counter(one.state for one in status.people)
    told = Text(f"done of {status.planned} planned, {len(status.people)} enrolled\n")
    states = [state for state in STATES[1:] if found[state] or state != "doubted"]
    for state in states:
        sign, colour = SIGNS[state]
        told.append("  " if state != states[0] else "").append(f"{sign} ", style=f"bold {colour}")
        told.append(f"{found[state]} {state}")
    left_out = "not known" if status.excluded is None else f"{len(status.excluded)}"
    return told.append(f", {left_out} excluded\n").append(status.seal, style=DIM)


def rows(status: Status, chosen: str | None) -> RenderableType:
    """Return the participants, each in a row that may be clicked, the chosen one marked."""
    if not status.people:
        return Text("Nobody is enrolled.", style=DIM)
    told = []
    for one in status.people:
        sign, colour = SIGNS[one.state]
        row = Text(overflow="ellipsis", no_wrap=True)
        mine = f"bold #000000 on {PLAIN}" if one.participant == chosen else f"bold {PLAIN}"
        row.append(f" {one.participant} ", style=mine).append(f" {sign} ", style=f"bold {colour}").append(where(one))
        row.apply_meta({PRESSES: one.participant})
        told.append(row)
    return Group(*told)


def where(one: Person) -> str:
    """Return where a participant stands, in few words."""
    if one.state != "under way":
        return one.state
    return f"{one.place}, {len(one.task.remaining)} to do" if one.task else f"{one.place} comes"


def sentences(status: Status) -> Text:
    """Return what speaks against the evidence, who comes next, and what is to be done."""
    told = Text()
    for name, style, lines in _report_lines(status):
        told.append("\n\n" if told else "").append(name, style=style)
        for line in lines:
            told.append(f"\n{line}")
    return told if told else Text("There is nothing to do.", style=DIM)


def _report_lines(status: Status) -> Iterator[tuple[str, str, list[str]]]:
    due, under_way = status.those("to begin"), status.those("under way")
    if status.doubts:
        yield "PROBLEMS IN THE DATA", f"bold {BAD}", [one.sentence(status.root) for one in status.doubts]
    if under_way:
        yield "Under way", f"bold {YELLOW}", [one.standing for one in under_way]
    come = [f"{due[0].participant}, {due[0].place}; the order of their tasks is concealed."] if due else []
    come += [f"{status.enrolment.sentence()}."] if status.enrolment else []
    if come:
        yield "Next", f"bold {GOOD}", come
    if status.reminders:
        yield "To do", "bold", [one.sentence(status.root) for one in status.reminders]
    if status.revealed:
        yield "Revealed before a session", "bold", [f"{who}, on {day}." for who, day in status.revealed.items()]


def figure(status: Status) -> RenderableType:
    """Return the flow of participants, stage below stage."""
    aside, stages = status.flow()
    parts: list[RenderableType] = []
    for name, boxes in stages:
        if parts:
            parts.append(Align.center(Text("│\n▼", style=DIM)))
        if len(parts) == 2:
            parts[1] = Align.center(_row([Panel(aside, title="not begun", border_style=DIM)]))
            parts.append(Align.center(Text("▼", style=DIM)))
        parts.append(Align.center(_row([Panel(box, title=name, title_align="left") for box in boxes])))
    return Group(*parts)


def _row(panels: list[Panel]) -> Table:
    grid = Table.grid(padding=(0, 1))
    grid.add_row(*panels)
    return grid
