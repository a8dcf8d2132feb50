"""A response table that is in order, and what writes one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import sqrt
from pathlib import Path

from palpate.experiment.apparatus.panel.response_table import COLUMNS, parse
from palpate.experiment.synthesis.shaping import Response

GOOD = """\
# bench 2, load 40 N
frequency_hz,drive_vrms,acceleration_pp_m_s2

10,0.1,0.5
10,1,4.0
20, 0.1, 1.0
20,1,8.0
"""

Write = Callable[[str], Path]


def read(path: Path) -> Response:
    """Return the response in a table on disk."""
    return parse(path, path.read_bytes())


def write(path: Path, response: Response, *, comments: Sequence[str]) -> None:
    """Write a response as a table, six significant digits a number, under comments."""
    lines = [f"# {comment}" for comment in comments] + [",".join(COLUMNS)]
    for frequency_hz, answers in zip(response.frequencies_hz, response.accelerations_m_s2, strict=True):
        for level_v, answer in zip(response.levels_v, answers, strict=True):
            lines.append(f"{frequency_hz:.6g},{level_v / sqrt(2):.6g},{2 * answer:.6g}")
    path.write_text("\n".join(lines) + "\n", "utf-8")
