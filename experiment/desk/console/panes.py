"""The console's parts on the screen, each of which is drawn anew only where what it shows has changed."""

import math
from collections.abc import Callable
from io import StringIO
from typing import ParamSpec

from rich.console import Console, RenderableType
from rich.text import Text
from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.widgets import Digits, Input, Label, Static

from palpate.experiment.clock import wall_ns
from palpate.experiment.desk.console import picture
from palpate.experiment.desk.console.forms import MOST_CHARACTERS, Form
from palpate.experiment.desk.console.picture import STIMULI, Phase
from palpate.experiment.desk.link.wire import Asked, View
from palpate.experiment.desk.messages import Choice

WIDE, TALL = 110, 30
"""From so many columns and rows on there is room for more words."""

LARGE, LINE = 120, 40
"""From so many columns on, keys are three rows high, and what is asked is bold, in lines of so many characters."""

HIGH, ABOVE_KEYS = 4, 15
"""Rows of a high key with the blank one below; and of all else above and below keys that is to stay on the screen."""

SIDE, WIDE_SIDE = 29, 44
"""The columns of what is measured."""

PANES = (
    "heading",
    "visit",
    "counted",
    "notice",
    "asked",
    "offered",
    "lines",
    "left",
    "trace",
    "gauges",
    "strip",
    "recent",
    "results",
    "commands",
)

FIXED = ("counted",)
"""Those of them that are as high as they are, whatever they show."""

_P = ParamSpec("_P")

_MEASURE = Console(file=StringIO(), width=80, color_system=None)


class Pane(Static):
    """Shows what a function of `picture` draws."""

    def __init__(self, *, id: str) -> None:  # noqa: A002
        super().__init__(id=id, markup=False)
        self._fixed = id in FIXED
        self._drawn_of: tuple[object, ...] | None = None
        self._shows: RenderableType = ""
        self._heights: dict[int, int] = {}

    def show(self, draw: Callable[_P, RenderableType], *of: _P.args, **no: _P.kwargs) -> bool:
        """Show what `draw` makes of its arguments; return False if that is what is shown already."""
        if (draw, *of) == self._drawn_of:
            return False
        self._drawn_of = (draw, *of)
        self._shows = draw(*of, **no)
        self._heights = {}
        # Where it needs no more lines than before, nothing else has to move: a layout takes longer than all else.
        moves = not self._fixed and self.lines(self.content_size.width) != self.content_size.height
        self.update(self._shows, layout=moves)
        return True

    def lines(self, width: int) -> int:
        """Return how many lines are shown at a width in columns."""
        if width not in self._heights:
            options = _MEASURE.options.update(width=max(1, width))
            self._heights[width] = len(_MEASURE.render_lines(self._shows, options))
        return self._heights[width]


class Places(Horizontal):
    """The strip of places, of which the one of what happens now is lit and says it."""

    def __init__(self) -> None:
        super().__init__()
        self._cells = [Static(markup=False) for _ in STIMULI]
        self._lit: tuple[Phase, tuple[str, ...]] | None = None

    def compose(self) -> ComposeResult:
        yield from self._cells

    def light(self, now: Phase, places: tuple[str, ...]) -> None:
        """Light one of these places, or the first."""
        if (now, places) == self._lit:
            return
        self._lit = (now, places)
        at = now.place if now.place in places else ""
        for number, cell in enumerate(self._cells):
            cell.display = number < len(places)
            word = places[number] if cell.display else ""
            lit = word == at
            cell.set_class(lit, "lit")
            cell.styles.background = now.colour if lit else picture.OFF
            cell.styles.color = now.ink if lit else picture.UNLIT
            cell.update(now.word if lit else word.lower(), layout=False)


EDITS = {
    "backspace": "delete_left",
    "delete": "delete_right",
    "left": "cursor_left",
    "right": "cursor_right",
    "home": "home",
    "end": "end",
}
"""What a field does at a key that types nothing."""


class Blanks(Vertical):
    """The one form that is open, or none; it is there from the beginning, so that no key falls between."""

    MOST = 8
    """Fields of a form: those of an incident at the desk."""

    def compose(self) -> ComposeResult:
        yield Static(markup=False, id="title")
        for number in range(self.MOST):
            with Horizontal():
                yield Static(markup=False, classes="at")
                yield Label(markup=False)
                yield Input(max_length=MOST_CHARACTERS, id=f"blank{number}")
        yield Static(markup=False, id="hint")

    def open(self, form: Form) -> None:
        """Show a form's fields as they are at first; what is typed goes to the first that is empty."""
        self.query_one("#title", Static).update(Text(form.title, style="bold"))
        self.query_one("#hint", Static).update(picture.hint(form.hint, form.does, fields=len(form.blanks)))
        wide = 1 + max((len(blank.name) for blank in form.blanks), default=0)
        for number, row in enumerate(self.query(Horizontal)):
            row.display = number < len(form.blanks)
            if row.display:
                blank, field, name = form.blanks[number], row.query_one(Input), row.query_one(Label)
                name.update(blank.name)
                name.styles.width = wide
                field.restrict = blank.takes
                field.value = blank.text
        self.display = True
        self._begin()

    def close(self) -> None:
        """Show no form."""
        self.display = False
        self._focus(None)

    def edit(self, key: str) -> bool:
        """Change the field as a key does that types nothing, after what was typed before; return whether it is one."""
        field = self.screen.focused
        if key not in EDITS or not isinstance(field, Input):
            return False
        # Its own binding would come after what is typed next, where both arrive at once.
        field.call_later(getattr(field, f"action_{EDITS[key]}"))
        return True

    def on_descendant_focus(self) -> None:
        """Show at a field that what is typed goes there."""
        for row in self.query(Horizontal):
            row.query_one(".at", Static).update(">" if row.query_one(Input).has_focus else "")

    def take_keys(self) -> None:
        """Have what is typed go to a field, if a click elsewhere took it away."""
        if self.screen.focused is None:
            self._begin()

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

    def _begin(self) -> None:
        fields = self._shown
        self._focus(next((field for field in fields if not field.value), fields[0] if fields else None))

    def _focus(self, field: Input | None) -> None:
        # What stands in a field is selected there: typing replaces it, and Enter keeps it.
        self.screen.set_focus(field)


class Board(Vertical):
    """All that is on the screen: who and where above, what is asked at the left, what is measured at the right."""

    def __init__(self) -> None:
        super().__init__()
        self._panes = {name: Pane(id=name) for name in PANES}
        self._trial = Digits("", id="trial")
        self._places = Places()
        self._main = Vertical(id="main")
        self._text = VerticalScroll(id="text", can_focus=False)
        self._keys = VerticalScroll(id="keys", can_focus=False)
        self._told = VerticalScroll(id="told", can_focus=False)
        self._told.border_title = "PageUp shows earlier messages"
        self._side = VerticalScroll(id="side", can_focus=False)
        self._fitted: tuple[object, ...] = ()
        self.says = ""
        self.results = False
        """Whether results are shown, once they are revealed, in the place of what takes most room beside them."""
        self.blanks = Blanks()

    def compose(self) -> ComposeResult:
        pane = self._panes
        yield pane["heading"]
        yield pane["visit"]
        with Horizontal(id="top"):
            yield self._trial
            yield pane["counted"]
            yield self._places
        with Horizontal(id="body"):
            with self._main:
                yield pane["notice"]
                with self._text:
                    yield pane["asked"]
                with self._keys:
                    yield pane["offered"]
                yield self.blanks
                with self._told:
                    yield pane["lines"]
            with self._side:
                for name in ("left", "trace", "gauges", "strip", "recent", "results"):
                    yield pane[name]
        yield pane["commands"]

    def say(self, words: str, how: str) -> None:
        """Show words right above what is asked: `done`, `ignored` or `refused`, which `says` tells afterwards."""
        notice, how = self._panes["notice"], how if words else ""
        # Styles are worked out anew whenever classes are set.
        if how != self.says:
            notice.set_classes(how)
        self.says = how
        if notice.show(Text, words):
            self.call_after_refresh(self._fit)

    def scroll(self, key: str) -> None:
        """Scroll what is asked by a line or a page, or, if it is all on the screen, what was told before."""
        asked = [part for part in (self._text, self._keys) if part.max_scroll_y]
        for part in asked or [self._told]:
            lines = max(1, part.size.height - 1) if key.startswith("page") else 1
            part.scroll_relative(y=-lines if key.endswith("up") else lines, animate=False)

    def show(self, view: View, question: Asked | None, now: Phase, *, form: bool) -> None:
        """Show a view, what is asked, and what happens now; while a form is open it stands where the question does."""
        pane, standing, gauges = self._panes, view.standing, view.gauges
        wide, roomy = self.app.size.width >= WIDE, self.app.size.height >= TALL
        side = WIDE_SIDE if wide else SIDE
        pane["heading"].show(picture.heading, view.label, view.study, view.participant, standing.task)
        pane["visit"].show(picture.visit, view.step, view.steps)
        pane["visit"].display = bool(view.step)
        self._count(view)
        self._places.light(now, picture.strip(view))
        self._text.display = self._keys.display = not form
        choices = question.choices if question is not None else ()
        large = self.app.size.width >= LARGE
        self._text.set_class(large, "large")
        pane["asked"].show(picture.question_text, question, now, view.lay_out, view.heard, large)
        pane["offered"].show(picture.offered, choices, roomy, self._columns(choices) if large else 0)
        pane["lines"].show(picture.lines, view.lines)
        pane["commands"].show(picture.commands, wide, view.reveals)
        pane["recent"].show(picture.recent, standing.recent)
        for name in ("strip", "recent", "results"):
            pane[name].set_class(roomy, "roomy")
        results = self.results and standing.revealed
        pane["results"].display, pane["recent"].display = results, not results
        if results:
            pane["results"].show(picture.results, standing, view.answers, side - 4)
        self._side.styles.width = side
        known = gauges is not None and now is not picture.GONE
        pane["left"].display = pane["gauges"].display = known
        pane["strip"].display = known and large and not results
        pane["trace"].display = known and not results and gauges is not None and bool(gauges.trace_unit)
        if gauges is not None:
            pane["left"].show(Text, picture.time_left(gauges.left_s))
            if pane["strip"].display:
                pane["strip"].show(picture.measures, standing, bool(gauges.trace_unit) and not view.at_will)
            pane["trace"].show(picture.trace, gauges.trace, gauges.trace_unit, side - 4, 4 if roomy else 2)
            still = gauges.model_copy(update={"trace": (), "left_s": 0.0})
            pane["gauges"].show(picture.gauges, still, roomy, side - 4)
        fitted = (question, view.lines, view.lay_out, view.heard, now, form, self.app.size)
        if fitted != self._fitted:
            self._fitted = fitted
            self.call_after_refresh(self._fit)

    def _columns(self, choices: tuple[Choice, ...]) -> int:
        """Return in how many columns answers have room with keys of three rows; 0 if they have none."""
        high = sum(choice.answer for choice in choices) or len(choices)
        rows = self.app.size.height - ABOVE_KEYS - math.ceil((len(choices) - high) / 2)
        return next((columns for columns in (1, 2) if HIGH * math.ceil(high / columns) <= rows), 0)

    def _count(self, view: View) -> None:
        """Show the trial's number, or what is left of a break or a familiarisation."""
        counted = self._panes["counted"]
        if view.pause_until_ns is not None:
            left_s = (view.pause_until_ns - wall_ns()) / 1e9
            shown = picture.countdown(left_s)
            counted.show(picture.counts_down, view.question, left_s > 0)
        else:
            shown = "" if view.trial is None else str(view.trial)
            most = view.training if view.trial is not None else None
            of = view.standing.trials if most is None else most
            left = view.standing.remaining if most is None else None
            counted.show(picture.counted, view.trial, of, left, view.attempt)
        if shown != self._trial.value:
            self._trial.update(shown)

    def _fit(self) -> None:
        """Let a long text scroll, so that the keys below it stay on the screen; show the newest lines."""
        width, height = self._main.content_size
        room = height - self._panes["notice"].size.height
        asked = self._panes["asked"].lines(min(width, LINE) if self._text.has_class("large") else width)
        self._text.styles.max_height = max(3, room - self._panes["offered"].lines(width) - 1)
        self._keys.styles.max_height = max(3, room - min(3, asked))
        # Whatever becomes of its height, its end stays on the screen.
        self._told.anchor()
