"""Masks of Windows and macOS: in Python, palpate's own modules find what they would find there, and nothing else.

A process that starts with `environment(...)` wears the mask, and so does every Python that it starts, with `-P` or
without. Code of palpate lacks what `systems.py` lists, and meets what `windows.py` and `macos.py` refuse, also where
the standard library acts for it, as `pathlib` does. Other libraries, and the standard library for its own needs, have
the real system.

A mask shows less than the system itself would. Paths keep their slashes and names their case. What another process has
open can be replaced. Nothing takes longer. What only the other system has, such as `msvcrt`, is not there. Libraries
and drivers do what they do here.
"""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path

VARIABLE = "PALPATE_TESTED_AS"
"""The environment variable that names the mask."""

_START = Path(__file__).with_name("start")
_REPOSITORY = Path(__file__).parents[3]


def environment(system: str, home: Path) -> dict[str, str]:
    """Return the environment of a process that runs as on `system`, `windows` or `macos`, for a user with this home."""
    before = os.environ.get("PYTHONPATH")
    path = os.pathsep.join([str(_START), str(_REPOSITORY), *([before] if before else [])])
    # What Python on a Windows of Western Europe writes into a file or a pipe.
    code_page = {"PYTHONIOENCODING": "cp1252", "PYTHONUTF8": "0"} if system == "windows" else {}
    # The folders that Linux gives a user are not there.
    others = {name: value for name, value in os.environ.items() if not name.startswith("XDG_")}
    return {**others, **code_page, "HOME": str(home), "TMPDIR": str(home), "PYTHONPATH": path, VARIABLE: system}


def put_on() -> None:
    """Put the mask that the environment names on this process, which has imported nothing of palpate yet."""
    import_module(f"{__name__}.{os.environ[VARIABLE]}").MASK.put_on()
