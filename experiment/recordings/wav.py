"""The samples of a WAV file: all that a session reads of recordings, which are kept as such."""

import io
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.io import wavfile

from palpate.experiment.errors import RecordingError

FORMS = {2: "ADPCM", 6: "A-law", 7: "mu-law", 0x11: "IMA ADPCM", 0x55: "MP3"}
"""Forms that are neither PCM nor float, by their tag."""


def wav_samples(content: bytes, *, file: str) -> tuple[int, NDArray[Any]]:
    """Return what `header_and_samples` does. Raises `RecordingError` for a rate of 0, too."""
    rate_hz, samples = header_and_samples(content, file=file)
    if rate_hz < 1:
        raise RecordingError(file, f"got a rate of {rate_hz} Hz", "export it again", allowed="1 Hz or more")
    return rate_hz, samples


def header_and_samples(content: bytes, *, file: str) -> tuple[int, NDArray[Any]]:
    """Return the sampling rate in a WAV file's header, Hz, and its samples in their own type, shape (n,) or (n,
    channels).

    Raises `RecordingError`, naming `file`, for content that is not WAV, damaged, cut off or without samples.
    """
    try:
        with warnings.catch_warnings():
            # A file shorter than its header says is only warned about; a chunk of metadata is harmless.
            warnings.simplefilter("error")
            warnings.filterwarnings("ignore", message=r"Chunk \(non-data\) not understood")
            rate_hz, samples = wavfile.read(io.BytesIO(content))
    except Exception as error:
        # scipy meets a damaged header with whatever the broken number leads to: ZeroDivisionError, TypeError, ...
        states = int.from_bytes(content[4:8], "big" if content[:4] == b"RIFX" else "little") + 8
        short = f"is cut off: it contains {len(content)} of the {states} bytes stated in its header"
        got = (
            short
            if content[:4] != b"RF64" and content[8:12] == b"WAVE" and len(content) < states
            else _undecoded(content)
        )
        raise RecordingError(file, got, "export it again", allowed="complete PCM or float") from error
    if samples.size == 0:
        raise RecordingError(file, "got no samples", "export it again", allowed="one or more")
    return int(rate_hz), np.asarray(samples)


def _undecoded(content: bytes) -> str:
    """Return what cannot be decoded: a form other than PCM or float by the tag in its header, or a damaged file."""
    place = content.find(b"fmt ") + 8
    tag = int.from_bytes(content[place : place + 2], "big" if content[:4] == b"RIFX" else "little")
    known = tag in (1, 3, 0xFFFE) or place < 8
    return (
        "the WAV file is damaged"
        if known
        else f"got a WAV file in the format {tag:#06x} ({FORMS.get(tag, 'compressed')})"
    )
