"""A protocol with fewer trials, for practice that does not take as long as a session."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import tomlkit

from palpate.experiment import storage
from palpate.experiment.errors import ProtocolError
from palpate.experiment.protocol import files


@contextmanager
def shortened(protocol_file: Path, repetitions: int | None) -> Iterator[Path]:
    """Give a copy of a protocol, for a while, whose tasks have so many repetitions at most; itself for None.

    They are as many more as its design asks for, such as both orders of each pair alike. Limits of `answers-below` fall
    with the trials. Raises `ProtocolError` as `files.load`.
    """
    if repetitions is None:
        yield protocol_file
        return
    most = max(task.repetitions for task in files.load(protocol_file).tasks)
    with TemporaryDirectory() as folder:
        copy = Path(folder) / protocol_file.name
        files.keep(protocol_file, copy)
        text = storage.read_text(copy).removeprefix("\ufeff")
        for number in range(min(repetitions, most), most + 1):
            storage.write_bytes(copy, _with_repetitions(text, number).encode())
            try:
                files.load(copy)
            except ProtocolError:
                continue
            break
        yield copy


def _with_repetitions(text: str, repetitions: int) -> str:
    """Return a protocol's text with so many repetitions at most."""
    document: Any = tomlkit.parse(text)
    part = 1.0
    for task in document["tasks"]:
        had, task["repetitions"] = task["repetitions"], min(task["repetitions"], repetitions)
        part = min(part, task["repetitions"] / had)
    for rule in document.get("exclusion", ()):
        if rule["when"] == "answers-below":
            rule["limit"] = int(rule["limit"] * part)
    return tomlkit.dumps(document)
