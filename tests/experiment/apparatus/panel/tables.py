"""A response table that is in order, and what writes one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

GOOD = """\
# bench 2, load 40 N
frequency_hz,drive_vrms,acceleration_pp_m_s2

10,0.1,0.5
10,1,4.0
20, 0.1, 1.0
20,1,8.0
"""

Write = Callable[[str], Path]
