"""What was found of one thing: the value that an error carries and that a check yields, and the sentences made of it.

Nothing reads a sentence back: whoever wants a part of it reads the field.
"""

import os
import re
import shlex
import subprocess
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import TextWrapper
from typing import Literal

Verdict = Literal["passes", "unknown", "warns", "refuses"]


@dataclass(frozen=True)
class Remedy:
    """What to do: `words`, and a command that can be pasted, as its arguments with `palpate` first.

    A `{}` in the words says where the command is shown; without it, the command follows them in brackets. An argument
    in capitals is for the user to fill in. The command `suffices` where it alone puts things right.
    """

    words: str
    command: tuple[str, ...]
    suffices: bool = True

    def __str__(self) -> str:
        command = shown(self.command)
        return self.words.format(command) if "{}" in self.words else f"{self.words} ({command})"


@dataclass(frozen=True)
class Finding:
    """What was found of one thing.

    `what` is a clause that goes on from the place: a file or the name of a thing (`where`), with a line of it and a
    field; `part` is element where it is no line but one of a JSON list. `got` is the value alone, of a settings file.
    `allowed` is what may be, empty where nothing was compared, and `check` the name of the check that found it.
    """

    what: str
    where: Path | str = ""
    line: int | None = None
    field: str = ""
    got: str = ""
    allowed: str = ""
    remedy: Remedy | str = ""
    verdict: Verdict = "refuses"
    check: str = ""
    part: str = "line"

    @property
    def refuses(self) -> bool:
        """Whether nothing goes on before it is mended; a warning is only told."""
        return self.verdict == "refuses"

    def place(self, root: Path | None = None) -> str:
        """Return where it was found; a file below `root` by its path in there."""
        if isinstance(self.where, Path) and root is not None and root in self.where.parents:
            return self.where.relative_to(root).as_posix()
        return str(self.where)

    def observation(self) -> str:
        """Return where something was found, and what, without what may be and what to do."""
        return ": ".join(part for part in (self.place(), self._problem()) if part)

    def _problem(self) -> str:
        line = "" if self.line is None else f"{self.part} {self.line}"
        return ": ".join(part for part in (line, self.field, self.what) if part)

    def clause(self) -> str:
        """Return what was found, without the file or thing that it was found of."""
        allowed = f"allowed: {self.allowed}" if self.allowed else ""
        return "; ".join(part for part in (self._problem(), allowed, str(self.remedy)) if part)

    def sentence(self, root: Path | None = None) -> str:
        """Return all of it as one line: the place, with files below `root` by their paths in there, and the clause."""
        return ": ".join(part for part in (self.place(root), self.clause()) if part)

    def lines(self, width: int, indents: tuple[str, str], root: Path | None = None) -> list[str]:
        """Return the sentence in lines, as `wrapped`."""
        return wrapped(self.sentence(root), self.remedy, width, indents)

    def record(self) -> dict[str, object]:
        """Return a finding of a settings file for programs."""
        return {"path": self.field, "line": self.line, "got": self.got, "allowed": self.allowed}


def mismatch(field: str, line: int | None, got: str, allowed: str, remedy: Remedy | str = "") -> Finding:
    """Return the finding of one value in a file that may not be so: what it is, what may stand there, what to do."""
    return Finding(f"got {got}", line=line, field=field, got=got, allowed=allowed, remedy=remedy)


def summary(file: Path | str, findings: Sequence[Finding]) -> Finding:
    """Return one finding that sums up what is wrong with a file."""
    return Finding("; ".join((counted(findings), *(one.clause() for one in findings))), file)


def counted(findings: Sequence[Finding]) -> str:
    """Return how many errors there are."""
    return f"{len(findings)} error{'' if len(findings) == 1 else 's'}"


def wrapped(text: str, remedy: Remedy | str, width: int, indents: tuple[str, str]) -> list[str]:
    """Return a text in lines, none of which ends inside of a remedy's command: pasted, the first part would run."""
    command = shown(remedy.command) if isinstance(remedy, Remedy) else ""
    filler = TextWrapper(width, *indents, break_long_words=False, break_on_hyphens=False)
    whole = text.replace(command, command.replace(" ", "\0")) if command else text
    return [line.replace("\0", " ") for line in filler.wrap(whole)]


def shown(command: Sequence[str]) -> str:
    """Return a command as this system's shell reads it."""
    return windows_command(command) if os.name == "nt" else shlex.join(command)


def windows_command(command: Iterable[str]) -> str:
    """Return a command as PowerShell and cmd read it.

    Both read double quotes alike (`subprocess.list2cmdline`), but for an argument with a double quote, `$`, a backtick
    or `%`, which is quoted for PowerShell.
    """
    return " ".join(map(_quoted_for_windows, command))


def _quoted_for_windows(argument: str) -> str:
    if re.fullmatch(r"[\w./:\\=+-]+", argument, re.ASCII):
        return argument
    if set('"$`%').intersection(argument):
        return "'" + argument.replace("'", "''") + "'"
    quoted = subprocess.list2cmdline([argument])
    return quoted if quoted.startswith('"') else f'"{quoted}"'
