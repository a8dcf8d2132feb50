"""What a whole screen, page, report or message says, in approved files: `assert text == approved`.

Each file is `approved/MODULE/TEST.txt` beside its test, and `approved/MODULE.ambr` has what the errors of a module say:
`with refuses(RosterError): ...`. `pytest FILE --snapshot-update` writes them anew; read what changed before you commit
it. A missing file fails, and so does one that no test reads.
"""

import re
from collections.abc import Iterable
from contextlib import AbstractContextManager
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Protocol, TypeVar

import pytest
from syrupy.extensions.single_file import SingleFileSnapshotExtension, WriteMode

E = TypeVar("E", bound=BaseException)

OF_A_RUN = {
    r"\d{4}-\d\d-\d\d": "DAY",
    r"\b[0-9a-f]{12}(?:[0-9a-f]{52})?\b": "HASH",
    r"\b(?:[0-9a-f]{4}-){3}[0-9a-f]{4}\b": "ANCHOR",
}
"""What differs from run to run, or with a protocol that changes, and what stands for it in an approved file."""


OF_A_MACHINE = {
    r"/\S*/pytest-of-\w+/pytest-\d+/(?:popen-gw\d+/)?\w+": "FOLDER",
    r"127\.0\.0\.1:[3-6]\d{4}\b": "127.0.0.1:PORT",
    r"/dev/pts/\d+": "/dev/pts/N",
    r"connected ports are [^;]*": "connected ports are PORTS",
    r"\bdriver_\d+": "driver_N",
    r"\b(?!(.)\1{11})[0-9a-f]{12}(?:[0-9a-f]{52})?\b": "HASH",
    f"{date.today()}|{datetime.now(UTC).date()}": "TODAY",
}
"""What differs in an error from run to run or between machines, and what stands for it. Days that a test sets stay."""


def refusal(error: BaseException, folder: Path) -> str:
    """Return the class and the sentence of an error, without what its run and its machine alone say."""
    return on_any_machine(f"{type(error).__name__}: {error}", folder)


def on_any_machine(text: str, folder: Path) -> str:
    """Return a text without what its run and its machine alone say; days that a test sets stay."""
    text = text.replace(str(folder), "FOLDER")
    for pattern, word in OF_A_MACHINE.items():
        text = re.sub(pattern, word, text)
    return text


def anywhere(text: str, folder: Path) -> str:
    """Return a text without what its run alone says: `FOLDER` for a test's folder, and a word for days and hashes."""
    text = text.replace(str(folder), "FOLDER")
    for pattern, word in OF_A_RUN.items():
        text = re.sub(pattern, word, text)
    return text


class Approved(SingleFileSnapshotExtension):
    """One text file for each text that a test compares."""

    _write_mode = WriteMode.TEXT
    file_extension = "txt"

    def serialize(self, data: object, **_: object) -> str:
        """Return a text as it is, and several as a line each."""
        if isinstance(data, str):
            return data
        if not isinstance(data, Iterable):
            raise TypeError(f"got {type(data).__name__}; allowed: a text or several")
        return "".join(f"{each}\n" for each in data)


class Refuses(Protocol):
    """Expects an error of a class, whose class and whole sentence are as approved, and gives it."""

    def __call__(self, kind: type[E]) -> AbstractContextManager[pytest.ExceptionInfo[E]]: ...
