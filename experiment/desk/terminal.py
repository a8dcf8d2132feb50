"""The experimenter's screen as lines of text, on any terminal or in a pipe: for sessions and for recordings."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, TextIO

from palpate.experiment.clock import minutes
from palpate.experiment.desk.messages import Correct, Repeat, TakeNote
from palpate.experiment.desk.port import NO, RESTS, WITHOUT, YES, Console, Remark, laid_out, lasting
from palpate.experiment.errors import ScreenGone
from palpate.experiment.settings import characters

if TYPE_CHECKING:
    from palpate.experiment.clock import Clock
    from palpate.experiment.recordings.store import Condition
    from palpate.experiment.recordings.workflow import Step


GONE = "the screen is gone ({})"

ENDED = "the input ended, and nobody can type"


REMARKS = "note TEXT, correct TRIAL KEY REASON, or repeat TRIAL REASON"
"""What may be typed instead of a key."""

MOST_DIGITS = 6
"""No trial's number has more digits."""


def typed_ahead(source: TextIO) -> str:
    """Return and drop what was typed early on a terminal, nothing on a pipe. Raises `OSError` for a lost terminal."""
    try:
        descriptor = source.fileno()
        if not os.isatty(descriptor):
            return ""
    except (OSError, ValueError):
        return ""
    if sys.platform == "win32":
        import msvcrt

        dropped = ""
        while msvcrt.kbhit():
            dropped += msvcrt.getwch()
        return dropped
    import termios

    try:
        settings = termios.tcgetattr(descriptor)
        at_once = [*settings[:6], [*settings[6]]]
        # By single characters, so that a line which was begun, and not ended, is dropped as well.
        at_once[3] &= ~(termios.ICANON | termios.ECHO)
        at_once[6][termios.VMIN] = at_once[6][termios.VTIME] = 0
        termios.tcsetattr(descriptor, termios.TCSANOW, at_once)
        try:
            dropped_bytes = b""
            while read := os.read(descriptor, 4096):
                dropped_bytes += read
        finally:
            termios.tcsetattr(descriptor, termios.TCSANOW, settings)
    except termios.error as lost:
        raise OSError(*lost.args) from lost
    return dropped_bytes.decode("utf-8", "replace")


class _Lines:
    """A text stream to show lines on, and what is typed at its prompts."""

    def __init__(self, *, write: TextIO, ask: Callable[[str], str], early: Callable[[], str] = str) -> None:
        """Write lines to `write`; `ask` prompts for a line, `early` returns and drops what was typed before."""
        self._write = write
        self._read = ask
        self._early = early
        self._ignored = ""

    def ignored(self) -> str:
        told, self._ignored = self._ignored, ""
        return told

    def _ask(self, prompt: str) -> str:
        try:
            early = self._early()
        except OSError as error:
            raise ScreenGone(GONE.format(error)) from error
        if early:
            self._ignored += early
            self.show(f"Ignored because it was typed before the question: {characters.keyed(early)}.")
        try:
            return self._read(prompt)
        except EOFError:
            raise ScreenGone(ENDED) from None
        except (OSError, ValueError) as error:
            raise ScreenGone(GONE.format(error)) from error

    def show(self, text: str) -> None:
        try:
            self._write.write(text + "\n")
            self._write.flush()
        except (OSError, ValueError) as error:
            # A stream that was closed is a ValueError.
            raise ScreenGone(GONE.format(error)) from error


class TerminalConsole(_Lines, Console):
    """`Console` on a text stream: an answer's key is typed twice, early keys do not count, Ctrl-D pauses as Ctrl-C."""

    def __init__(
        self, *, write: TextIO, ask: Callable[[str], str], heading: str, early: Callable[[], str] = str
    ) -> None:
        """Show each trial's lines after `heading`."""
        super().__init__(write=write, ask=ask, early=early)
        self._heading = heading

    def agree(self, *, text: str, yes: str, no: str) -> bool:
        while (typed := self._ask(f"{text}\n[{YES}] {yes}  [{NO}] {no}: ").strip().lower()) not in (YES, NO):
            self._refuse(typed, f"is no key; type {YES} or {NO}")
        return typed == YES

    def write(self, *, text: str) -> str:
        while True:
            typed = self._ask(f"{text} Type one line, or nothing; press Enter: ").strip()
            try:
                return characters.one_line(typed) if typed else ""
            except ValueError as error:
                self.show(f"The line {error}, which cannot go on record; type it again without that character")

    def wait(self, *, why: str, until_ns: int, clock: Clock) -> None:
        self.show(f"{why} Left of it: {minutes(max(until_ns - clock.now_ns(), 0) / 1e9)}.")
        clock.sleep_ns(until_ns - clock.now_ns())

    def familiarise(self, *, instruction: str, min_s: float, max_s: float, handled: dict[str, str]) -> str:
        self.show(f"{self._heading}  {lasting(min_s, max_s)} {instruction}")
        counts = "  ".join(f"[{key}] {words}" for key, words in handled.items())
        told = f"Handled: {counts}; type a key to count one more.\n" if counts else ""
        ends = "Press Enter when the participant is familiar with the materials: "
        while (key := self._ask(f"{told}{ends}").strip().lower()) and key not in handled:
            self._refuse(key, f"is no key; press Enter{', or type the key of a material' if handled else ''}")
        return key

    def instruct(self, *, instruction: str) -> None:
        self.show(f"{self._heading}  Tell the participant: {instruction}")

    def level(self, *, level_db_a: float, limit_db_a: float, criterion: str, keys: dict[str, str]) -> str:
        self.show(f"{self._heading}  Masker at {level_db_a:.0f} dB(A), at most {limit_db_a:.0f}. {criterion}")
        offered = "  ".join(f"[{key}] {meaning}" for key, meaning in keys.items())
        while (key := self._ask(f"{offered}  [Enter] keep the level\nKey: ").strip()) and key not in keys:
            self.show(f"'{key}' does not change the level; press one of {' '.join(keys)}, or Enter")
        return key

    def say(self, *, words: str, take: int, takes: int, why: str) -> bool:
        if why:
            self.show(why)
        asked = f"{self._heading}  Take {take} of {takes}: ask for '{words}'. Press Enter, then the participant says it"
        while typed := self._ask(f"{asked}; or type {WITHOUT} to go on without the microphone: ").strip().lower():
            if typed == WITHOUT:
                return False
            self._refuse(typed, f"is no key; press Enter, or type {WITHOUT}")
        return True

    def rest(self, *, why: str) -> None:
        if why:
            self.show(why)
        self._ask(f"{self._heading}  {RESTS}")

    def place(self, *, trial: int, presented: tuple[str, ...]) -> None:
        self._ask(f"{self._heading}  Trial {trial}. Lay out {laid_out(presented)}, then press Enter: ")

    def arm(self, *, trial: int, attempt: int, trials: int) -> bool:
        again = f", attempt {attempt}" if attempt > 1 else ""
        self.show(f"{self._heading}  Trial {trial} of {trials}{again}. Armed: the participant may step.")
        return False

    def rearm(self, *, trial: int, attempt: int, reason: str) -> bool:
        self.show(
            f"{self._heading}  Trial {trial}, attempt {attempt}: {reason}; nothing was played. Armed again: the "
            "participant may lift the foot and step."
        )
        return False

    def ask(self, *, trial: int, answers: dict[str, str], others: dict[str, str]) -> str | Remark:
        keys = answers | others
        offered = "  ".join(f"[{key}] {meaning}" for key, meaning in keys.items())
        while True:
            typed = self._ask(f"Trial {trial}, the participant said:  {offered}  or: {REMARKS}\nKey: ").strip()
            if remark := self._remark(typed, trial):
                return remark
            if (key := typed.lower()) in keys:
                return key
            self._refuse(typed, f"is no key; type one of {' '.join(keys)}, or {REMARKS}")

    def confirm(self, *, key: str, meaning: str) -> bool:
        # Not Enter: a key that somebody leans on repeats.
        typed = self._ask(f"{meaning} - type {key} again to confirm, anything else to ask again: ")
        return typed.strip().lower() == key

    def debrief(self) -> Remark | None:
        while typed := self._ask(
            f"{self._heading}  All trials are answered. Type {REMARKS}; press Enter to end the session: "
        ).strip():
            if remark := self._remark(typed, None):
                return remark
            self._refuse(typed, f"is no remark; type {REMARKS}, or press Enter")
        return None

    def _refuse(self, typed: str, why: str) -> None:
        unexplained = re.fullmatch(r"correct\s+\d+\s+\S|repeat\s+\d+", typed)
        shown = characters.quoted(typed)
        self.show(f"Give the reason too: {characters.plain(typed)} REASON" if unexplained else f"{shown} {why}")

    def _remark(self, typed: str, trial_now: int | None) -> Remark | None:
        """Return what was typed as a remark, a note as one of `trial_now`; None if it is none, or cannot be kept."""
        word, _, rest = typed.partition(" ")
        try:
            text = characters.one_line(rest.strip())
        except ValueError as error:
            self.show(f"The remark {error}, which cannot go on record; type it again without that character")
            return None
        if word == "note" and text:
            return TakeNote(text=text, trial=trial_now)
        trial, _, rest = text.partition(" ")
        numbered = trial.isdecimal() and len(trial) <= MOST_DIGITS
        if word == "repeat" and numbered and rest.strip():
            return Repeat(trial=int(trial), reason=rest.strip())
        key, _, reason = rest.strip().partition(" ")
        if word == "correct" and numbered and reason.strip():
            return Correct(trial=int(trial), key=key.lower(), reason=reason.strip())
        return None

    def confirmed(self, *, trial: int, answer: str | None) -> None:
        self.show(f"{self._heading}  Trial {trial}: the answer is on disk: {answer or 'no answer'}.")


KEEP, REPEAT = "k", "r"


def _made_ready(condition: Condition) -> str:
    return f"Lay out a fresh {condition.material}" if condition.material else "Leave the panel bare"


class TerminalTakes(_Lines):
    """Implements `TakesConsole` on a text stream; nothing is kept without a key, typed when it is asked for."""

    def rest(self, *, why: str) -> None:
        if why:
            self.show(why)
        self._ask(RESTS)

    def place(self, condition: Condition, *, done: int, total: int) -> None:
        self._ask(f"Take {done + 1} of {total}. {_made_ready(condition)}, then press Enter: ")

    def arm(self, condition: Condition, *, attempt: int) -> None:
        again = f", attempt {attempt}" if attempt > 1 else ""
        what = condition.material or "bare panel"
        self.show(f"{what}, take {condition.number}{again}: step at {condition.speed_mm_s:g} mm/s.")

    def keeps(self, step: Step) -> bool:
        target = step.condition.speed_mm_s
        self.show(
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
            self.show(f"'{key}' is not a key here; press {KEEP} or {REPEAT}")
        return key == KEEP
