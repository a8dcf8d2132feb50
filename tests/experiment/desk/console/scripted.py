"""A session's end of a real link that says what a test tells it to, and a console at the other end."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path

from textual import events
from textual.pilot import Pilot

from palpate.experiment.desk.console.app import Console, Left
from palpate.experiment.desk.link import Line, Link
from palpate.experiment.desk.link.wire import Asked, Deed, Hello, Typed, View
from palpate.experiment.desk.messages import Choice, Message
from tests.experiment.desk.attended import untimed

PATIENCE_S = 20.0
"""What is waited for comes within this time on any machine, s."""

APART_S = 10.0
"""So far apart are keys that are pressed one by one, s."""


@dataclass
class ScriptedEnd:
    """Implements `SessionEnd`: shows `view`, keeps what it was told to do, and refuses what is in `refusals`."""

    view: View
    refusals: dict[str, str] = field(default_factory=dict)
    words: str = ""
    deeds: list[Deed] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._changed = threading.Condition()

    def message(self, role: str) -> Message:
        return self.view

    def take(self, hello: Hello, deed: Deed) -> tuple[bool, str]:
        with self._changed:
            self.deeds.append(untimed(deed))
            self._changed.notify_all()
        refusal = self.refusals.get(getattr(deed, "key", deed.do), "")
        return not refusal, refusal or ("" if isinstance(deed, Typed) else self.words)

    def came(self, consoles: int, screens: int) -> None:
        pass

    def lost(self, why: str) -> None:
        raise AssertionError(why)

    def wait(self, count: int) -> list[Deed]:
        """Return what was asked for, once it is so much."""
        with self._changed:
            assert self._changed.wait_for(lambda: len(self.deeds) >= count, PATIENCE_S), self.deeds
            return list(self.deeds)


class Desk:
    """A console with a session's end, and hands that press its keys at times of their own."""

    def __init__(self, app: Console, pilot: Pilot[Left], end: ScriptedEnd, link: Link) -> None:
        self.app, self.pilot, self.end, self.link = app, pilot, end, link
        self.ended = False
        self._at_s = time.monotonic()

    async def show(self, view: View) -> None:
        """Have the session tell a view, and wait until it is drawn."""
        self.end.view = view
        self.link.wake()
        await self.until(lambda: self.app.view_now == view)
        await self.pilot.pause()

    def end_session(self) -> None:
        """Have the session's process be gone."""
        self.ended = True
        self.link.close()

    async def until(self, happened: Callable[[], bool]) -> None:
        """Wait until something has happened."""
        begun_s = time.monotonic()
        while not happened():
            assert time.monotonic() - begun_s < PATIENCE_S, self.text
            await self.pilot.pause()

    async def press(self, *keys: str, after_s: float = APART_S, at_s: float | None = None) -> None:
        """Press keys one after the other, each so long after the one before; `at_s` is a time of its own."""
        for key in keys:
            self._at_s += after_s
            character = key if len(key) == 1 else {"enter": "\r", "escape": "\x1b"}.get(key)
            event = events.Key(key, character)
            event.time = self._at_s if at_s is None else at_s
            self.app.post_message(event)
        await self.pilot.pause()

    async def deeds(self, count: int) -> list[Deed]:
        """Return what the session was asked for, once it is so much."""
        found = await asyncio.to_thread(self.end.wait, count)
        await self.pilot.pause()
        return found

    @property
    def text(self) -> str:
        """The characters on the screen, row by row."""
        return "\n".join(strip.text.rstrip() for strip in self.app.screen._compositor.render_strips())

    @property
    def notice(self) -> str:
        """What stands on the screen right above what is asked, on one line; empty for nothing."""
        return self.part("#notice")

    def part(self, name: str) -> str:
        """The words of one part of the screen, on one line."""
        place = self.app.screen.query_one(name).region
        rows = self.text.split("\n")[place.y : place.bottom]
        return " ".join(" ".join(row[place.x : place.right] for row in rows).strip("█▌▊ ").split())

    @property
    def said(self) -> str:
        """The words of the screen's left part, on one line."""
        return " ".join(word for line in self.text.split("\n") for word in line.split(" │")[0].strip("█▌▊ ").split())


@asynccontextmanager
async def desk(folder: Path, view: View, size: tuple[int, int] = (80, 24)) -> AsyncIterator[Desk]:
    """Show a view at a console in a terminal of this size."""
    end = ScriptedEnd(view)
    link = Link(folder / "s", end)
    line = Line(folder / "s", Hello(role="console", by="lab"))
    app = Console(line)
    there: Desk | None = None
    try:
        async with app.run_test(size=size) as pilot:
            there = Desk(app, pilot, end, link)
            await there.show(view)
            yield there
    finally:
        line.close()
        if there is None or not there.ended:
            link.close()


def question(kind: str, *, number: int = 5, text: str = "What is it?", keys: str = "ca") -> Asked:
    """Return a question of a kind with the keys that a session offers there."""
    answers = {"answer": True}
    if kind == "answer":
        choices = tuple(Choice(key=key, words=f"material {key}", **answers) for key in keys)
        choices += (Choice(key="n", words="no answer"),)
    elif kind == "level":
        choices = tuple(
            Choice(key=key, words=words) for key, words in (("+", "louder"), ("-", "softer"), ("enter", "keep"))
        )
    elif kind == "confirm":
        choices = (Choice(key="enter", words="confirm"), Choice(key="escape", words="choose again"))
    else:
        choices = () if kind in ("write", "break") else (Choice(key="enter", words="go on"),)
    return Asked.model_validate({"number": number, "kind": kind, "text": text, "choices": choices})
