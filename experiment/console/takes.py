"""What the experimenter sees and keys while takes are recorded, as lines of text."""

from __future__ import annotations

from collections.abc import Callable
from typing import TextIO

from experiment.console.prompts import RESTS
from experiment.recordings.plan import Condition
from experiment.recordings.workflow import SPEED_TOLERANCE, Step

KEEP, REPEAT = "k", "r"


def _made_ready(condition: Condition) -> str:
    return f"Lay out a fresh {condition.material}" if condition.material else "Leave the panel bare"


class TerminalTakes:
    """Implements `TakesConsole` on a text stream; nothing is kept without a key."""

    def __init__(self, *, write: TextIO, ask: Callable[[str], str]) -> None:
        """Set up the screen.

        Args:
            write: where lines go.
            ask: shows a prompt and returns the line that was typed; `input` on a terminal.
        """
        self._write = write
        self._ask = ask

    def rest(self, *, why: str) -> None:
        if why:
            self._show(why)
        self._ask(RESTS)

    def place(self, condition: Condition, *, done: int, total: int) -> None:
        self._ask(f"Take {done + 1} of {total}. {_made_ready(condition)}. Press Enter when the panel is ready: ")

    def arm(self, condition: Condition, *, attempt: int) -> None:
        again = f", attempt {attempt}" if attempt > 1 else ""
        what = condition.material or "bare panel"
        self._show(f"{what}, take {condition.number}{again}: step at {condition.speed_mm_s:g} mm/s.")

    def keeps(self, step: Step) -> bool:
        target = step.condition.speed_mm_s
        verdict = "; ".join([*(step.problems or (f"within {SPEED_TOLERANCE:.0%}",)), *step.notes])
        self._show(
            f"Achieved {step.achieved_mm_s:.0f} mm/s, target {target:g} mm/s ({step.deviation:+.1%}): {verdict}."
        )
        again = f"{_made_ready(step.condition)}. Press Enter when the panel is ready again: "
        if step.window is None:
            self._ask(f"No take to keep. {again}")
            return False
        kept = self._key(f"[{KEEP}] keep  [{REPEAT}] repeat: ")
        if kept and step.problems:
            kept = self._key(f"It has the problems above. [{KEEP}] keep it all the same  [{REPEAT}] repeat: ")
        if not kept:
            self._ask(again)
        return kept

    def _key(self, prompt: str) -> bool:
        """Whether the take is kept, by one of the two keys."""
        while (key := self._ask(prompt).strip().lower()) not in (KEEP, REPEAT):
            self._show(f"'{key}' is no key here; use {KEEP} or {REPEAT}")
        return key == KEEP

    def _show(self, text: str) -> None:
        self._write.write(text + "\n")
        self._write.flush()
