"""Which press of a key, or of the mouse's button, counts: not one that repeats, nor one from before its question.

Enter right after an answer's key belongs to that key, and confirms it however late its question is drawn.
"""

from dataclasses import dataclass

from palpate.experiment.desk.link.wire import Asked

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


@dataclass
class Chosen:
    """A key that was sent as the command `sent` to a `question`, whose answers are confirmed.

    `taken` is None until the session has replied. `entered`: Enter was pressed after it, with no press in between.
    """

    question: int
    sent: int
    taken: bool | None = None
    entered: bool = False

    def owns(self, asked: Asked | None, seen: int | None) -> bool:
        """Return whether Enter belongs to the key: nothing else that is asked could have been seen."""
        return asked is None or asked.number == self.question or asked.number != seen

    def confirmed_by(self, asked: Asked | None) -> bool | None:
        """Return whether Enter confirms the key at what is asked now; None while that is not known yet."""
        if self.taken is False:
            return False
        if asked is None or asked.number == self.question:
            return None
        return self.taken if asked.confirms == self.question else False
