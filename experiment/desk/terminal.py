"""The experimenter's screen as lines of text, on any terminal or in a pipe: for sessions and for recordings."""

from __future__ import annotations

import os
import re
import sys
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Literal, TextIO

from palpate.experiment.clock import minutes
from palpate.experiment.desk import questions
from palpate.experiment.desk.messages import ENTER, ESCAPE, Correct, Repeat, TakeNote, TellIncident
from palpate.experiment.desk.questions import Arm, Attended, Question, Remark, Reply
from palpate.experiment.errors import ScreenGone
from palpate.experiment.settings import characters

if TYPE_CHECKING:
    from palpate.experiment.recordings.store import Condition
    from palpate.experiment.recordings.workflow import Step


GONE = "the terminal was closed ({})"

ENDED = "the terminal's input ended, so nothing more can be typed"


REMARKS = "note TEXT, correct TRIAL KEY REASON, repeat TRIAL REASON, or adverse (or deviation) TEXT; WHAT WAS DONE"
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
            self.show(f"Ignored because it was typed before the question appeared: {characters.keyed(early)}.")
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


class TerminalConsole(_Lines):
    """`Console` on a text stream: an answer's key is typed twice, early keys do not count, Ctrl-D pauses as Ctrl-C."""

    def __init__(
        self, *, write: TextIO, ask: Callable[[str], str], heading: str, early: Callable[[], str] = str
    ) -> None:
        """Ask and tell of trials after `heading`."""
        super().__init__(write=write, ask=ask, early=early)
        self._heading = heading

    def attend(self, session: Attended | None) -> None:
        """Do nothing: nothing is shown of a session but what it tells."""

    def tell(self, event: questions.Event) -> None:
        match event:
            case questions.Notice(text=text) | questions.Proposed(words=text):
                self.show(text)
            case questions.Answered(text=text) | questions.Playing(text=text):
                self.show(f"{self._heading}  {text}")
            case questions.Instructed(words=words):
                self.show(f"{self._heading}  Tell the participant: {words}")
            case questions.Stopped():
                self.show(questions.STOPPED)

    def ask(self, question: Question | Arm) -> Reply:
        match question:
            case Arm(text=text):
                self.show(f"{self._heading}  {text}")
                return Reply()
            case questions.GoOn():
                # Whoever has lines of text gives the command again.
                return Reply(questions.STOP)
            case questions.Break(text=text, left_s=left_s):
                self.show(f"{text} Time left: {minutes(max(left_s, 0))}.")
                time.sleep(max(left_s, 0))
                return Reply()
            case questions.Report(text=text):
                return Reply(text=self._line(text))
            case questions.Confirm(key=key, text=text):
                # Not Enter: a key that somebody leans on repeats.
                typed = self._ask(f"{text} - type {key} again to confirm, or anything else to choose again: ").strip()
                if typed.lower() == key:
                    return Reply(ENTER)
                if self._remark(typed, None):
                    self._refuse(typed, "is not possible here; type this at the next question")
                return Reply(ESCAPE)
            case _:
                return self._reply(question)

    def _reply(self, question: Question) -> Reply:
        """Return the reply to a question, asked until it is one."""
        remarks = isinstance(question, questions.TrialAnswer | questions.Debrief)
        trial_now = question.trial if isinstance(question, questions.TrialAnswer) else None
        heading = self._heading if trial_now is None else f"{self._heading}  Trial {trial_now}."
        typed = {"" if one.key == ENTER else one.key: one for one in question.choices}
        offered = "  ".join(f"[{key or 'Enter'}] {one.words}" for key, one in typed.items())
        or_remark = f"  or: {REMARKS}" if remarks else ""
        while True:
            said = self._ask(f"{heading}  {question.text}\n{offered}{or_remark}: ").strip()
            if remarks and (remark := self._remark(said, trial_now)):
                return Reply(remark=remark)
            if (one := typed.get(said.lower())) is not None:
                return Reply(one.key)
            keys = " ".join(key or "Enter" for key in typed)
            self._refuse(said, f"is not a valid key; type one of {keys}{f', or {REMARKS}' if remarks else ''}")

    def _line(self, text: str) -> str:
        while True:
            typed = self._ask(f"{text} Type one line, or leave it blank, and press Enter: ").strip()
            try:
                return characters.one_line(typed) if typed else ""
            except ValueError as error:
                self.show(f"The line {error}, which cannot be recorded; type it again without that character")

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
            self.show(f"The remark {error}, which cannot be recorded; type it again without that character")
            return None
        if word == "note" and text:
            return TakeNote(text=text, trial=trial_now)
        what, _, done = map(str.strip, text.partition(";"))
        if word in ("adverse", "deviation") and what and done:
            sort: Literal["adverse event", "deviation"] = "deviation" if word == "deviation" else "adverse event"
            return TellIncident(sort=sort, text=what, done=done, trial=trial_now)
        trial, _, rest = text.partition(" ")
        numbered = trial.isdecimal() and len(trial) <= MOST_DIGITS
        if word == "repeat" and numbered and rest.strip():
            return Repeat(trial=int(trial), reason=rest.strip())
        key, _, reason = rest.strip().partition(" ")
        if word == "correct" and numbered and reason.strip():
            return Correct(trial=int(trial), key=key.lower(), reason=reason.strip())
        return None


KEEP, REPEAT = "k", "r"


def _made_ready(condition: Condition) -> str:
    return f"Lay out a fresh {condition.material}" if condition.material else "Leave the panel bare"


class TerminalTakes(_Lines):
    """Implements `TakesConsole` on a text stream; nothing is kept without a key, typed when it is asked for."""

    def rest(self, why: str) -> None:
        if why:
            self.show(why)
        self._ask(f"{questions.Rest('').text} Then press Enter, or press Ctrl-C to pause; the same command continues: ")

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
            kept = self._key(
                f"This take has the problems listed above. [{KEEP}] keep it anyway  [{REPEAT}] repeat it: "
            )
        if not kept:
            self._ask(again)
        return kept

    def _key(self, prompt: str) -> bool:
        while (key := self._ask(prompt).strip().lower()) not in (KEEP, REPEAT):
            self.show(f"'{key}' is not a key here; press {KEEP} or {REPEAT}")
        return key == KEEP
