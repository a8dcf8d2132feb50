"""A driver of one's own: a module in a file beside the rig file, executed from the bytes that were read."""

import hashlib
import re
import sys
from pathlib import Path
from types import ModuleType

from palpate.experiment import storage


def driver_module(file: Path) -> ModuleType:
    """Return the module in a file, executed once for each content: from the bytes read here, never from a cache."""
    return module_in(storage.read_bytes(file), file)


def module_in(content: bytes, file: Path) -> ModuleType:
    """Return the module that bytes of a file are, executed once."""
    name = f"{__name__}.{file.stem}_{hashlib.sha256(content).hexdigest()[:16]}"
    if name in sys.modules:
        return sys.modules[name]
    module = sys.modules[name] = ModuleType(name)
    module.__file__ = str(file)
    try:
        exec(compile(content, file, "exec", dont_inherit=True), module.__dict__)  # noqa: S102
    except BaseException:
        del sys.modules[name]
        raise
    return module


def error_words(error: BaseException) -> str:
    """Return what a driver raised, in one line; of what pyserial says around the system's own words, those alone."""
    said = re.sub(r"^(\[Errno -?\d+\]) could not open port .*?: (?=\1)", "", " ".join(str(error).split()))
    said = f"{type(error).__name__}: {said}".removesuffix(": ")
    # A file beside the rig file is a module under a name of palpate's own, which tells nobody anything.
    return re.sub(rf"{re.escape(__name__)}\.(\w+)_[0-9a-f]{{16}}", r"\1", said)
