"""Which press of a key, or of the mouse's button, counts: not one that repeats, nor one from before its question."""

HELD_S = 0.75
"""The same key again after less time than this is held down, s: a held key repeats after at most 0.66 s on X11, Wayland
and the systems' own defaults, and then every 10 to 50 ms.
"""

SEEN_S = 0.1
"""Nobody reacts within this time to what appears on a screen, s; terminal and keyboard take part of it."""

MOUSE = "mouse"
"""The key that stands for the mouse's button, wherever it is pressed."""


class Presses:
    """The presses so far, and since when a `question` has been on the screen; times are s of one monotonic clock."""

    def __init__(self) -> None:
        self.question: int | None = None
        self._latest: dict[bool, tuple[str, float]] = {}
        self._since_s = 0.0

    def continues(self, key: str, at_s: float) -> bool:
        """Note a press, and return whether it continues the one before, of the same key; a click never does."""
        before, before_s = self._latest.get(key == MOUSE, ("", 0.0))
        self._latest[key == MOUSE] = key, at_s
        return key == before and at_s - before_s < HELD_S

    def drawn(self, question: int | None, at_s: float) -> None:
        """Take note that this question has been drawn; None for no question, and while something covers it."""
        if question != self.question:
            self.question, self._since_s = question, at_s

    def seen(self, at_s: float) -> int | None:
        """Return the question that whoever pressed a key at that time could have seen; None for none."""
        return self.question if at_s - self._since_s >= SEEN_S else None
