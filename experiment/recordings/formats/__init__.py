"""Binary formats of recordings, a module each, with its `FORMAT`: another format is another module and a line here."""

from importlib import import_module
from typing import cast

from palpate.experiment.recordings.formats.interface import Format

FORMATS = ("tdms", "hdf5", "mat")

AUDIO = {b"fLaC": "FLAC", b"riff\x2e\x91\xcf\x11": "Wave64", b"OggS": "Ogg", b"ID3": "MP3", b"\xff\xfb": "MP3",
         b"FORM": "AIFF", b"caff": "Apple's Core Audio", b".snd": "Sun audio"}  # fmt: skip
"""How files of sound begin that are not read, and their names."""


def format_of(content: bytes) -> Format | None:
    """Return the format of a file, None for text or WAV."""
    found = (cast("Format", import_module(f"{__name__}.{name}").FORMAT) for name in FORMATS)
    return next((one for one in found if content.startswith(one.begins)), None)
