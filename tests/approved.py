"""What a whole screen, page, report or message says, in approved files: `assert text == approved`.

Each file is `approved/MODULE/TEST.txt` beside its test. `pytest FILE --snapshot-update` writes it anew; read what
changed before you commit it. A missing file fails, and so does one that no test reads.
"""

from collections.abc import Iterable

from syrupy.extensions.single_file import SingleFileSnapshotExtension, WriteMode


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
