"""The experimenter's screen as lines of text, on any terminal or in a pipe: for sessions and for recordings."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TextIO

from experiment.desk.port import RESTS
from experiment.errors import ScreenGone
from experiment.protocol.rules import LOUDER_KEY, SOFTER_KEY

if TYPE_CHECKING:
    from experiment.recordings.store import Condition
    from experiment.recordings.workflow import Step


GONE = "the screen is gone ({})"


class TerminalConsole:
    """Implements `Console` on a text stream. Answers are keyed, shown, and confirmed with Enter.

    The end of the input (Ctrl-D) interrupts as Ctrl-C does.
    """

    def __init__(self, *, write: TextIO, ask: Callable[[str], str], heading: str) -> None:
        """Write lines to `write`, each trial's after `heading`; `ask` shows a prompt and returns the line typed."""
        self._write = write
        self._read = ask
        self._heading = heading

    def _ask(self, prompt: str) -> str:
        try:
            return self._read(prompt)
        except EOFError:
            raise KeyboardInterrupt from None
        except (OSError, ValueError) as error:
            raise ScreenGone(GONE.format(error)) from error

    def show(self, text: str) -> None:
        try:
            self._write.write(text + "\n")
            self._write.flush()
        except (OSError, ValueError) as error:
            # A stream that was closed is a ValueError.
            raise ScreenGone(GONE.format(error)) from error

    def familiarise(self, *, instruction: str, min_s: float, max_s: float) -> None:
        self.show(f"{self._heading}  Familiarisation, {min_s / 60:.1f} to {max_s / 60:.1f} min. {instruction}")
        self._ask("Press Enter when the participant is familiar with the materials: ")

    def level(self, *, level_db_a: float, limit_db_a: float, criterion: str, keys: dict[str, str]) -> str:
        self.show(f"{self._heading}  Masker at {level_db_a:.0f} dB(A), at most {limit_db_a:.0f}. {criterion}")
        offered = "  ".join(f"[{key}] {meaning}" for key, meaning in keys.items())
        while (key := self._ask(f"{offered}  [Enter] keep the level\nKey: ").strip()) and key not in keys:
            self.show(f"'{key}' does not change the level; press one of {' '.join(keys)}, or Enter")
        return key

    def rest(self, *, why: str) -> None:
        if why:
            self.show(why)
        self._ask(f"{self._heading}  {RESTS}")

    def place(self, *, trial: int, material: str) -> None:
        self._ask(f"{self._heading}  Trial {trial}. Lay out {material}, then press Enter: ")

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
                self.show(f"'{key}' is not a key of this protocol; press one of {' '.join(keys)}")
                continue
            if key in (LOUDER_KEY, SOFTER_KEY):
                return key
            if not self._ask(f"{keys[key]} - press Enter to confirm, or type anything else to ask again: ").strip():
                return key

    def confirmed(self, *, trial: int, answer: str | None) -> None:
        self.show(f"{self._heading}  Trial {trial}: the answer is on disk: {answer or 'no answer'}.")


KEEP, REPEAT = "k", "r"


def _made_ready(condition: Condition) -> str:
    return f"Lay out a fresh {condition.material}" if condition.material else "Leave the panel bare"


class TerminalTakes:
    """Implements `TakesConsole` on a text stream; nothing is kept without a key."""

    def __init__(self, *, write: TextIO, ask: Callable[[str], str]) -> None:
        """Write lines to `write`; `ask` shows a prompt and returns the line typed."""
        self._write = write
        self._ask = ask

    def rest(self, *, why: str) -> None:
        if why:
            self._show(why)
        self._ask(RESTS)

    def place(self, condition: Condition, *, done: int, total: int) -> None:
        self._ask(f"Take {done + 1} of {total}. {_made_ready(condition)}, then press Enter: ")

    def arm(self, condition: Condition, *, attempt: int) -> None:
        again = f", attempt {attempt}" if attempt > 1 else ""
        what = condition.material or "bare panel"
        self._show(f"{what}, take {condition.number}{again}: step at {condition.speed_mm_s:g} mm/s.")

    def keeps(self, step: Step) -> bool:
        target = step.condition.speed_mm_s
        self._show(
            f"The speed was {step.achieved_mm_s:.0f} mm/s; the target is {target:g} mm/s ({step.deviation:+.1%}): "
            f"{step.verdict}."
        )
        again = f"{_made_ready(step.condition)}, then press Enter: "
        if step.window is None:
            self._ask(f"There is no take to keep. {again}")
            return False
        kept = self._key(f"[{KEEP}] keep the take  [{REPEAT}] repeat it: ")
        if kept and step.problems:
            kept = self._key(f"The take has the problems above. [{KEEP}] keep it all the same  [{REPEAT}] repeat it: ")
        if not kept:
            self._ask(again)
        return kept

    def _key(self, prompt: str) -> bool:
        while (key := self._ask(prompt).strip().lower()) not in (KEEP, REPEAT):
            self._show(f"'{key}' is not a key here; press {KEEP} or {REPEAT}")
        return key == KEEP

    def _show(self, text: str) -> None:
        self._write.write(text + "\n")
        self._write.flush()
