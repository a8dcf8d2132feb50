"""What a whole screen, page, report or message says, in approved files: `assert text == approved`.

Each file is `approved/MODULE/TEST.txt` beside its test. `pytest FILE --snapshot-update` writes it anew; read what
changed before you commit it. A missing file fails, and so does one that no test reads.
"""

import re
from collections.abc import Iterable
from pathlib import Path

from syrupy.extensions.single_file import SingleFileSnapshotExtension, WriteMode

OF_A_RUN = {
    r"\d{4}-\d\d-\d\d": "DAY",
    r"\b[0-9a-f]{12}(?:[0-9a-f]{52})?\b": "HASH",
    r"\b(?:[0-9a-f]{4}-){3}[0-9a-f]{4}\b": "ANCHOR",
}
"""What differs from run to run, or with a protocol that changes, and what stands for it in an approved file."""


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
