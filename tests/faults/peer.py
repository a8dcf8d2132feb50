"""A process at a session's socket that can be made to stand still: `python -m tests.faults.peer SOCKET console|screen`.

A screen is palpate's own but for its window: a line at the standard input is the participant's stop. A peer says a line
once it is connected.
"""

from __future__ import annotations

import sys
import threading
import time
from contextlib import closing, suppress
from pathlib import Path
from typing import TYPE_CHECKING, cast

from palpate.experiment.apparatus.display import ScreenRig
from palpate.experiment.clock import monotonic_ns
from palpate.experiment.desk.link import Line
from palpate.experiment.desk.link.wire import Hello
from palpate.experiment.desk.screen import Feed, Screen
from palpate.experiment.errors import LinkError

if TYPE_CHECKING:
    from PIL.Image import Image

    from palpate.experiment.desk.screen import Window


class Blind:
    """A window that shows nothing, of which a line at the standard input presses Escape."""

    size_px = (640, 400)
    closed = False

    def __init__(self) -> None:
        self._keys: list[str] = []
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        for _ in sys.stdin:
            self._keys.append("escape")

    def put(self, picture: Image) -> None:
        pass

    def show(self, hand_mm: float | None) -> int:
        return monotonic_ns()

    def pressed(self) -> list[str]:
        keys, self._keys = self._keys, []
        return keys

    def offer(self, *, mouse: bool) -> None:
        pass

    def clicked(self) -> list[tuple[float, float]]:
        return []


def _say_connected() -> None:
    sys.stdout.write("connected\n")
    sys.stdout.flush()


def main() -> None:
    at, role = Path(sys.argv[1]), sys.argv[2]
    if role == "screen":
        with closing(Feed(at)) as feed:
            while feed.heard().line is None:
                time.sleep(0.01)
            _say_connected()
            window = cast("Window", Blind())
            Screen(feed, window, ScreenRig(fullscreen=False), at.parent, lambda _: None, stays=True).run()
    with suppress(LinkError), closing(Line(at, Hello(role="console", by="another"))) as line:
        _say_connected()
        for _ in line.messages():
            pass


if __name__ == "__main__":
    main()
