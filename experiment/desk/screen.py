"""The participant's screen: a process of its own that shows a session's prompts in a window of PsychoPy.

It may crash and come back at any moment. Without a session it asks the participant to wait, and looks for one.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from math import sqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any

from filelock import FileLock, Timeout

from palpate.experiment.apparatus.display import ScreenRig
from palpate.experiment.clock import monotonic_ns, wall_ns
from palpate.experiment.desk import pages
from palpate.experiment.desk.link import Line
from palpate.experiment.desk.link.wire import Choose, Deed, Hello, Pause, Shown
from palpate.experiment.desk.messages import Prompt
from palpate.experiment.desk.pages import Page
from palpate.experiment.desk.pages.lettering import font_for
from palpate.experiment.errors import DisplayError, LinkError

if TYPE_CHECKING:
    from PIL.Image import Image

BY = "the participant's screen"
"""Who asks for something here, as it goes on record."""

POLL_S, ANSWER_S, AGAIN_S = 0.02, 0.002, 0.5
"""How often keys and prompts are looked for, s, keys while an answer is chosen, and a session where there was none."""

REDRAW_NS, FAREWELL_NS = 1_000_000_000, 60_000_000_000
"""How often a page is drawn anew, ns, in case something covered it, and how long it stays without a session."""


@dataclass(frozen=True)
class Heard:
    """What a session said last, and the way back to it; without a session no way, and thanks alone as what it said."""

    line: Line | None = None
    prompt: Prompt | None = None


class Feed:
    """Looks for a session, and hears it on a thread of its own."""

    def __init__(self, path: Path) -> None:
        """Look for a session at `path` from now on."""
        self._path = path
        self._heard = Heard()
        self._failed: LinkError | None = None
        self._closing = threading.Event()
        threading.Thread(target=self._follow, name="prompts", daemon=True).start()

    def heard(self) -> Heard:
        """Return what was heard last. Raises `LinkError` for a session of another version."""
        if self._failed is not None:
            raise self._failed
        return self._heard

    def close(self) -> None:
        """Leave the session."""
        self._closing.set()
        if (line := self._heard.line) is not None:
            line.close()

    def _follow(self) -> None:
        while not self._closing.is_set():
            try:
                line = Line(self._path, Hello(role="screen", by=BY))
            except LinkError:
                # None listens yet, or any longer: the participant was asked to wait, and it is looked for again.
                self._closing.wait(AGAIN_S)
                continue
            try:
                for message in line.messages():
                    if isinstance(message, Prompt):
                        self._heard = Heard(line, message)
            except LinkError as error:
                self._failed = error
                return
            finally:
                line.close()
                ended = self._heard.prompt is not None and self._heard.prompt.show == "thanks"
                self._heard = Heard(None, self._heard.prompt if ended else None)


class Window:
    """A window of PsychoPy that shows pictures of its own size, and the keys pressed in it."""

    def __init__(self, settings: ScreenRig) -> None:
        """Open it. Raises `DisplayError`."""
        try:
            from psychopy import logging, visual
            from psychopy.hardware import keyboard
        except ImportError as error:
            raise DisplayError(
                f"the participant's screen needs PsychoPy ({error})",
                remedy="install palpate[lab] with Python 3.11 or 3.12, and OpenGL with GLU from your system's packages",
            ) from error
        except Exception as error:
            raise _no_display(error) from error
        logging.console.setLevel(logging.ERROR)
        _check_display(settings.display)
        try:
            self._window = visual.Window(
                size=(settings.width_px, settings.height_px),
                fullscr=settings.fullscreen,
                screen=settings.display,
                winType="pyglet",
                units="pix",
                color=pages.BACKGROUND,
                colorSpace="rgb255",
                allowGUI=not settings.fullscreen,
                checkTiming=False,
                title="palpate",
            )
        except Exception as error:
            raise _no_display(error) from error
        self._clicks: list[tuple[float, float]] = []
        self._window.winHandle.push_handlers(on_mouse_press=self._click)
        self.offer(mouse=False)
        _press_once(self._window.winHandle)
        # The backend `event` hears this window alone; the others hear what the experimenter types elsewhere as well.
        self._keyboard = keyboard.Keyboard(backend="event")
        self._stimulus = visual.ImageStim(self._window, units="pix", size=self.size_px)
        self._hand = visual.Circle(self._window, units="pix", fillColor=pages.TEXT, lineColor=None, colorSpace="rgb255")

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height."""
        width, height = self._window.size
        return int(width), int(height)

    @property
    def closed(self) -> bool:
        """Whether somebody closed it."""
        return bool(self._window.winHandle.has_exit)

    def put(self, picture: Image) -> None:
        """Have another picture shown from the next `show` on."""
        self._stimulus.setImage(picture, log=False)

    def show(self, hand_mm: float | None) -> int:
        """Show the picture, and the hand if there is one; return since when, by the system's monotonic clock, ns."""
        self._stimulus.draw()
        if hand_mm is not None:
            high_px, self._hand.radius = pages.hand_px(hand_mm, self.size_px)
            self._hand.pos = (0, high_px)
            self._hand.draw()
        self._window.flip()
        return monotonic_ns()

    def pressed(self) -> list[str]:
        """Return the keys that were pressed since the last call, oldest first, by their names in PsychoPy."""
        pressed = self._keyboard.getKeys(waitRelease=False)
        # With this backend some versions of PsychoPy put the time beside the name.
        return [str(key.name if isinstance(key.name, str) else key.name[0]) for key in pressed]

    def clicked(self) -> list[tuple[float, float]]:
        """Return where the mouse was pressed, or the screen touched, up to the last `pressed`, oldest first: x and y
        from the upper left corner, pixels.
        """
        clicks, self._clicks = self._clicks, []
        return clicks

    def offer(self, *, mouse: bool) -> None:
        """Show the mouse's pointer, or hide it."""
        self._window.mouseVisible = mouse

    def _click(self, x: int, y: int, *_: int) -> None:
        self._clicks.append((x, self.size_px[1] - y))

    def close(self) -> None:
        """Close it."""
        self._window.close()


def _no_display(error: Exception) -> DisplayError:
    return DisplayError(
        f"the participant's screen cannot be opened ({type(error).__name__}: {error})",
        remedy="run this on the machine that has the display (on Linux, with DISPLAY set)",
        allowed="a display with OpenGL 2",
    )


def _check_display(display: int) -> None:
    """Refuse a display that is not there: PsychoPy would take the first, which may be the experimenter's."""
    import pyglet

    found = len(pyglet.canvas.get_display().get_screens())
    if display < found:
        return
    if sys.platform.startswith("linux"):
        # On X a display may be a screen of the server's own.
        with suppress(pyglet.canvas.xlib.NoSuchDisplayException):
            pyglet.canvas.Display(x_screen=display).close()
            return
    raise DisplayError("screen.display", f"got {display}", "use another", allowed=f"0 to {found - 1} on this machine")


def _press_once(window: Any) -> None:
    """Have a held key in a window of pyglet pressed once.

    X repeats it as releases and presses; pyglet has the server omit releases on one connection alone, PsychoPy has
    another.
    """
    if sys.platform.startswith("linux"):
        from ctypes import byref, c_int

        from pyglet.window.xlib import XkbSetDetectableAutoRepeat

        XkbSetDetectableAutoRepeat(window.display._display, c_int(1), byref(c_int()))


@contextmanager
def alone(path: Path) -> Iterator[None]:
    """Hold the place of the one screen of a session. Raises `DisplayError`."""
    try:
        with FileLock(path.with_suffix(".screen"), timeout=0):
            yield
    except Timeout:
        raise DisplayError(
            "this session's screen is already open", remedy="close that screen first, or use it"
        ) from None


@dataclass(eq=False)
class Screen:
    """Shows the prompts of `feed` until the window closes or the session ends; `folder` is where a font is looked for,
    and `pictures` are PNG files by name.

    A screen that `stays` looks for a session until somebody closes it; another leaves when none comes.
    """

    feed: Feed
    window: Window
    settings: ScreenRig
    folder: Path
    tell: Callable[[str], None]
    stays: bool = field(kw_only=True)
    pictures: Mapping[str, bytes] = field(default_factory=dict, kw_only=True)

    def __post_init__(self) -> None:
        self._font = self.folder / self.settings.font if self.settings.font else None
        self._page: Page | None = None
        self._prompt: Prompt | None = None
        # Letters take a while to be drawn, and whoever stops everything must not wait for them.
        self._artist = ThreadPoolExecutor(1, "artist")
        self._drawing: tuple[Page, Heard, Future[tuple[Image, int]]] | None = None
        self._part, self._parts = 0, 1
        self._shown = Heard(None, None)
        self._since_ns = self._drawn_ns = 0
        self._told: tuple[Line, int] | None = None
        self._gone_ns: int | None = None
        self._missing = ""

    def run(self) -> None:
        """Show page after page. Raises `LinkError` for a session of another version, and `DisplayError`."""
        looked_ns = monotonic_ns()
        while not self.window.closed:
            heard = self.feed.heard()
            keys, clicks = self._pressed(heard)
            before_ns, looked_ns = looked_ns, monotonic_ns()
            self._turn(sum(pages.turned(key, self.settings) for key in keys))
            chosen = [pages.chosen(self._prompt, key, self.settings) for key in keys]
            chosen += [pages.touched(self._prompt, place, self.window.size_px) for place in clicks]
            for choice in filter(None, chosen):
                if heard.line is not None and self._prompt is not None:
                    # Between two looks at the keys each moment is as likely.
                    error_s = (looked_ns - before_ns) / 1e9 / sqrt(12)
                    number = self._prompt.question or 0
                    _send(heard.line, Choose(question=number, key=choice, t_ns=looked_ns, error_s=error_s))
            self._show(heard)
            self._tell(heard)
            if self._session_over(heard):
                return
            answering = self._page is not None and self._page.options
            time.sleep(ANSWER_S if answering else POLL_S)

    def _pressed(self, heard: Heard) -> tuple[list[str], list[tuple[float, float]]]:
        """Return the keys that were pressed, and clicks; the key that stops everything counts at once, whatever is
        shown.
        """
        keys = self.window.pressed()
        if heard.line is not None and self.settings.stop in keys:
            _send(heard.line, Pause())
        return keys, self.window.clicked()

    def _show(self, heard: Heard) -> None:
        prompt = heard.prompt
        page, hand_mm = pages.page(prompt, self.settings, wall_ns()), prompt.hand_mm if prompt else None
        if self._page is None or page.text != self._page.text:
            self._part, self._parts = 0, 1
        named = prompt.pictures if prompt else ()
        if lacking := [name for name in named if name not in self.pictures]:
            what = f"the session shows the picture {lacking[0]}, which the protocol file given here does not list"
            raise DisplayError(what, remedy="give the protocol file with which the session was started")
        page = replace(page, part=self._part, pictures=tuple(self.pictures[name] for name in named))
        moved = hand_mm != (self._prompt.hand_mm if self._prompt else None)
        if page != self._page:
            self._drawing = self._drawing or (page, heard, self._artist.submit(self._picture, page))
            if not self._drawing[2].done():
                return
            # It is shown although another may be due meanwhile, so that one that changes all the time is seen.
            (page, heard, drawn), self._drawing = self._drawing, None
            prompt = heard.prompt
            picture, self._parts = drawn.result()
            self.window.put(picture)
            self.window.offer(mouse=bool(page.options))
            self._since_ns = self._drawn_ns = self.window.show(hand_mm)
            # What was pressed before the page was seen answers nothing on it.
            self._pressed(heard)
        elif moved or monotonic_ns() - self._drawn_ns > REDRAW_NS:
            self._drawn_ns = self.window.show(hand_mm)
        self._page, self._prompt, self._shown = page, prompt, heard

    def _turn(self, by: int) -> None:
        """Show another part of a text that is too long for one page."""
        self._part = min(max(self._part + by, 0), self._parts - 1)

    def _picture(self, page: Page) -> tuple[Image, int]:
        font, missing = font_for(page.letters, self._font)
        if missing and missing != self._missing:
            self._missing = missing
            self.tell(
                f"screen.font: {font.name} lacks {missing[:20]}; install a font that has these characters (for "
                "Japanese on Debian: fonts-noto-cjk or fonts-ipafont-gothic), or set screen.font to the file of such "
                "a font"
            )
        return pages.drawn(page, self.window.size_px, font)

    def _tell(self, heard: Heard) -> None:
        """Tell the session what is shown, once for each prompt that looks otherwise."""
        line, prompt = self._shown.line, self._shown.prompt
        if line is None or line is not heard.line or prompt is None or self._told == (line, prompt.number):
            return
        self._told = line, prompt.number
        _send(line, Shown(number=prompt.number, t_ns=self._since_ns))

    def _session_over(self, heard: Heard) -> bool:
        """Return whether the session has been gone for long enough: after its thanks, or for good."""
        if heard.line is not None or (heard.prompt is None and self.stays):
            self._gone_ns = None
            return False
        if self._gone_ns is None:
            self._gone_ns = monotonic_ns()
        return monotonic_ns() - self._gone_ns > FAREWELL_NS


def _send(line: Line, deed: Deed) -> None:
    # A session that has gone meanwhile needs to hear nothing; the next prompt says that it has.
    with suppress(LinkError):
        line.send(deed)


def show(
    path: Path,
    settings: ScreenRig,
    folder: Path,
    tell: Callable[[str], None],
    *,
    stays: bool,
    pictures: Mapping[str, bytes],
) -> None:
    """Be the participant's screen of the session at `path`, until it ends, or the window or process is closed.

    A screen that `stays` outlives a lost session. `tell` reports a line. Raises `DisplayError` and `LinkError`.
    """
    with alone(path), closing(Window(settings)) as window, closing(Feed(path)) as feed, suppress(KeyboardInterrupt):
        Screen(feed, window, settings, folder, tell, stays=stays, pictures=pictures).run()
