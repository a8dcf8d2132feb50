"""The experimenter's screen as lines of text; works over any terminal, and in a pipe."""

from __future__ import annotations

from collections.abc import Callable
from typing import TextIO

from experiment.console.prompts import RESTS
from experiment.protocol.rules import LOUDER_KEY, SOFTER_KEY


class TerminalConsole:
    """Implements `Console` on a text stream. Answers are keyed, shown, and confirmed with Enter.

    The end of the input (Ctrl-D) interrupts as Ctrl-C does.
    """

    def __init__(self, *, write: TextIO, ask: Callable[[str], str], heading: str) -> None:
        """Set up the screen.

        Args:
            write: where lines go.
            ask: shows a prompt and returns the line that was typed; `input` on a terminal.
            heading: stands at the start of every trial's line, and says REHEARSAL where it is one.
        """
        self._write = write
        self._read = ask
        self._heading = heading

    def _ask(self, prompt: str) -> str:
        try:
            return self._read(prompt)
        except EOFError:
            raise KeyboardInterrupt from None

    def show(self, text: str) -> None:
        self._write.write(text + "\n")
        self._write.flush()

    def familiarise(self, *, instruction: str, min_s: float, max_s: float) -> None:
        self.show(f"{self._heading}  Familiarisation, {min_s / 60:.1f} to {max_s / 60:.1f} min. {instruction}")
        self._ask("Press Enter when the participant is familiar with the materials: ")

    def level(self, *, level_db_a: float, limit_db_a: float, criterion: str, keys: dict[str, str]) -> str:
        self.show(f"{self._heading}  Masker at {level_db_a:.0f} dB(A), at most {limit_db_a:.0f}. {criterion}")
        offered = "  ".join(f"[{key}] {meaning}" for key, meaning in keys.items())
        while (key := self._ask(f"{offered}  Enter keeps it\nKey: ").strip()) and key not in keys:
            self.show(f"'{key}' does not change the level; use one of: {' '.join(keys)}, or Enter")
        return key

    def rest(self, *, why: str) -> None:
        if why:
            self.show(why)
        self._ask(f"{self._heading}  {RESTS}")

    def place(self, *, trial: int, material: str) -> None:
        self._ask(f"{self._heading}  Trial {trial}. Lay out: {material}. Press Enter when it lies: ")

    def arm(self, *, trial: int, attempt: int, trials: int) -> None:
        again = f", attempt {attempt}" if attempt > 1 else ""
        self.show(f"{self._heading}  Trial {trial} of {trials}{again}. Armed: the participant may step.")

    def rearm(self, *, trial: int, attempt: int, reason: str) -> None:
        self.show(
            f"{self._heading}  Trial {trial}, attempt {attempt}: {reason}; nothing was played. Armed again: the "
            "participant may lift the foot and step."
        )

    def ask(self, *, trial: int, keys: dict[str, str]) -> str:
        offered = "  ".join(f"[{key}] {meaning}" for key, meaning in keys.items())
        while True:
            key = self._ask(f"Trial {trial}, the participant said:  {offered}\nKey: ").strip().lower()
            if key not in keys:
                self.show(f"'{key}' is no key of this protocol; use one of: {' '.join(keys)}")
                continue
            if key in (LOUDER_KEY, SOFTER_KEY):
                return key
            if not self._ask(f"{keys[key]} - Enter confirms, anything else asks again: ").strip():
                return key

    def confirmed(self, *, trial: int, answer: str | None) -> None:
        self.show(f"{self._heading}  Trial {trial}: {answer or 'no answer'} is on disk.")
