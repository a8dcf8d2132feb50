"""Binary formats of recordings, a module each, with its `FORMAT`: another format is another module and a line here."""

from importlib import import_module
from typing import cast

from palpate.experiment.recordings.formats.interface import Format

FORMATS = ("tdms", "hdf5", "mat")


def format_of(content: bytes) -> Format | None:
    """Return the format of a file, None for text or WAV."""
    found = (cast("Format", import_module(f"{__name__}.{name}").FORMAT) for name in FORMATS)
    return next((one for one in found if content.startswith(one.begins)), None)
