"""WAV files whose recorder ended before it wrote how long they are, as far as they go."""

import struct

UNKNOWN = (0, 0xFFFFFFFF)
"""What stands for the size of a chunk until a recorder ends, or where it writes to a pipe."""


def completed(content: bytes) -> tuple[bytes, str]:
    """Return a WAV file with its length where its header states none, and what was missing; else the file itself.

    The last sample counts only if it is whole. A file that is shorter than its header says is left alone, and so are
    RF64 and big-endian files.
    """
    if content[:4] != b"RIFF" or content[8:12] != b"WAVE":
        return content, ""
    place, frame = 12, 1
    while place + 8 <= len(content):
        name, (size,) = content[place : place + 4], struct.unpack_from("<I", content, place + 4)
        left = len(content) - place - 8
        if name == b"fmt " and left >= 16:
            frame = max(struct.unpack_from("<H", content, place + 20)[0], 1)
        if name == b"data":
            if size not in UNKNOWN or left < frame:
                return content, ""
            whole = left - left % frame
            made = bytearray(content[: place + 8 + whole])
            struct.pack_into("<I", made, place + 4, whole)
            struct.pack_into("<I", made, 4, len(made) - 8)
            return bytes(
                made
            ), f"the WAV file is incomplete: its header does not state a length, and it contains {whole} bytes"
        place += 8 + size + size % 2
    return content, ""
