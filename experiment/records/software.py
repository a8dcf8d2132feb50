"""Which palpate writes a record: its version, and a hash of its own source, which a change without a version shows."""

import hashlib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from palpate import __version__

ROOMS = ("experiment", "analysis")


@dataclass(frozen=True)
class Software:
    """A version of palpate, and the SHA-256 of its source, 64 hexadecimal digits."""

    version: str
    source_sha256: str


@cache
def this() -> Software:
    """Return what runs; the hash is of every module by path and content, alike in a checkout and an installed copy."""
    root = Path(__file__).parents[2]
    modules = {path.relative_to(root).as_posix(): path for room in ROOMS for path in (root / room).rglob("*.py")}
    found = hashlib.sha256()
    for name, path in sorted(modules.items()):
        # A checkout on Windows may have other line ends.
        content = path.read_bytes().replace(b"\r\n", b"\n")
        found.update(f"{name} {len(content)}\n".encode() + content)
    return Software(__version__, found.hexdigest())
