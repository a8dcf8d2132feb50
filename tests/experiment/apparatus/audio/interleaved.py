"""Two threads without a lock, one after the other: what one does happens at each point of what the other does."""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import FrameType, ModuleType
from typing import Any


def points(modules: tuple[ModuleType, ...], run: Callable[[], object], meanwhile: Callable[[int], object]) -> int:
    """Run something, and before each opcode of some modules' functions something else.

    Args:
        modules: whose functions are interrupted.
        run: what is interrupted.
        meanwhile: called with the number of the opcode, from 0; it is not interrupted itself.

    Returns:
        How many opcodes there were.
    """
    passed, files = 0, {module.__file__ for module in modules}

    def trace(frame: FrameType, event: str, _argument: Any) -> Any:
        nonlocal passed
        if frame.f_code.co_filename not in files:
            return None
        frame.f_trace_opcodes = True
        if event == "opcode":
            meanwhile(passed)
            passed += 1
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        run()
    finally:
        sys.settrace(before)
    return passed
