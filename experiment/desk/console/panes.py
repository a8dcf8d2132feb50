"""The console's parts on the screen, each of which is drawn anew only where what it shows has changed."""

from __future__ import annotations

from collections.abc import Callable
from io import StringIO
from typing import ParamSpec

from rich.console import Console, RenderableType
from rich.text import Text
from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical
from textual.widgets import Input, Label, Static

from experiment.desk.console import picture
from experiment.desk.console.forms import MOST_CHARACTERS, Form
from experiment.desk.console.picture import PLACES, Phase

STYLE = """
Screen { background: #0e1418; color: #e8edf0; overflow: hidden; scrollbar-size-vertical: 1; }
VerticalScroll { scrollbar-background: #1c252c; scrollbar-color: #5d6a74; scrollbar-color-hover: #9aa4ad; }
#heading, #visit { height: auto; padding: 0 1; }
#heading { background: #1c252c; text-style: bold; }
#top { height: 3; }
#trial { width: auto; min-width: 6; padding: 0 0 0 1; text-style: bold; }
#counted { width: 13; height: 3; padding: 0 1; }
Places { width: 1fr; height: 3; }
Places Static { width: 1fr; height: 3; content-align: center middle; background: #1c252c; color: #5d6a74; }
Places .lit { text-style: bold; }
#body { height: 1fr; }
#main { width: 1fr; height: 1fr; padding: 0 1; }
#notice { height: auto; min-height: 2; max-height: 5; }
#notice.refused { background: #8f1d16; color: #ffffff; text-style: bold; }
#notice.ignored { background: #7a5b00; color: #ffffff; text-style: bold; }
#notice.done { color: #4cc27a; }
#text, #keys { height: auto; scrollbar-size-vertical: 1; }
#asked, #offered, #lines { height: auto; }
#offered { padding: 0 0 1 0; }
#told { height: 1fr; min-height: 0; border-top: solid #2b363f; scrollbar-size-vertical: 1; }
Blanks { height: auto; display: none; border-left: thick #f2c230; padding: 0 1; }
Blanks Horizontal { height: 1; }
Blanks Label { width: 9; }
Blanks Input { width: 1fr; height: 1; border: none; padding: 0; background: #26323a; }
Blanks Input:focus { border: none; background: #3a4a55; }
Blanks Static { height: auto; }
#side { height: 1fr; padding: 0 1; border-left: solid #2b363f; scrollbar-size-vertical: 1; }
#left, #trace, #gauges, #recent { height: auto; }
#left { text-style: bold; }
#recent.roomy { padding: 1 0 0 0; }
#commands { height: auto; background: #1c252c; }
"""

_P = ParamSpec("_P")

_MEASURE = Console(file=StringIO(), width=80, color_system=None)


class Pane(Static):
    """Shows what a function of `picture` draws."""

    def __init__(self, *, id: str) -> None:  # noqa: A002
        super().__init__(id=id, markup=False)
        self._drawn_of: tuple[object, ...] | None = None
        self._shows: RenderableType = ""

    def show(self, draw: Callable[_P, RenderableType], *of: _P.args, **no: _P.kwargs) -> None:
        """Show what `draw` makes of its arguments, unless that is what is shown."""
        if (draw, *of) != self._drawn_of:
            self._drawn_of = (draw, *of)
            self._shows = draw(*of, **no)
            self.update(self._shows)

    def lines(self, width: int) -> int:
        """Return how many lines are shown at a width in columns."""
        return len(_MEASURE.render_lines(self._shows, _MEASURE.options.update(width=max(1, width))))


class Places(Horizontal):
    """The strip of places, of which the one of what happens now is lit and says it."""

    def compose(self) -> ComposeResult:
        for word in PLACES:
            yield Static(word.lower(), markup=False)

    def light(self, now: Phase) -> None:
        """Light one place."""
        for place, (cell, word) in enumerate(zip(self.query(Static), PLACES, strict=True)):
            lit = place == now.place
            said = now.word if lit else word.lower()
            if (said, lit) == (str(cell.content), cell.has_class("lit")) and (
                not lit or cell.styles.background.hex.lower() == now.colour
            ):
                continue
            cell.set_class(lit, "lit")
            cell.styles.background = now.colour if lit else picture.OFF
            cell.styles.color = now.ink if lit else picture.UNLIT
            cell.update(said)


class Blanks(Vertical):
    """The one form that is open, or none; it is there from the beginning, so that no key falls between."""

    MOST = 3

    def compose(self) -> ComposeResult:
        yield Static(markup=False, id="title")
        for number in range(self.MOST):
            with Horizontal():
                yield Label(markup=False)
                yield Input(max_length=MOST_CHARACTERS, id=f"blank{number}")
        yield Static(markup=False, id="hint")

    def open(self, form: Form) -> None:
        """Show a form's fields as they are at first."""
        self.query_one("#title", Static).update(Text(form.title, style="bold"))
        self.query_one("#hint", Static).update(picture.hint(form.hint, form.does))
        for number, row in enumerate(self.query(Horizontal)):
            row.display = number < len(form.blanks)
            if row.display:
                row.query_one(Label).update(form.blanks[number].name)
                row.query_one(Input).value = form.blanks[number].text
        self.display = True
        empty = [field for field in self._shown if not field.value]
        self._focus(next(iter(empty or self._shown), None))

    def close(self) -> None:
        """Show no form."""
        self.display = False
        self._focus(None)

    def take_keys(self) -> None:
        """Have what is typed go to a field, if a click elsewhere took it away."""
        if self.screen.focused is None:
            self._focus(next(iter(self._shown), None))

    def goes_to_next(self) -> bool:
        """Go on to the next field that is empty; return False if there is none behind the one that is typed into."""
        fields = self._shown
        at = next((number for number, field in enumerate(fields) if field.has_focus), -1)
        onward = [field for field in fields[at + 1 :] if not field.value]
        if at >= 0 and fields[at].value and onward:
            self._focus(onward[0])
            return True
        return False

    @property
    def texts(self) -> tuple[str, ...]:
        """What stands in the fields."""
        return tuple(field.value for field in self._shown)

    @property
    def _shown(self) -> list[Input]:
        return [row.query_one(Input) for row in self.query(Horizontal) if row.display]

    def _focus(self, field: Input | None) -> None:
        self.screen.set_focus(field)
        if field is not None:
            field.cursor_position = len(field.value)
