"""One column of numbers, and a table of channels with the times of each, whatever file they are from."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.recordings.text.headings import BESIDE
from palpate.experiment.recordings.text.shape import Lines
from palpate.experiment.settings.delimited import Understood

__all__ = ["BESIDE", "Column", "Kept", "Table"]


@dataclass(frozen=True)
class Kept:
    """The lines of those rows that are kept, at these places."""

    lines: Lines
    places: NDArray[np.intp]

    def __getitem__(self, row: int, /) -> int:
        """Return the line of a row that is kept, from 0."""
        return self.lines[int(self.places[row])]


@dataclass(frozen=True)
class Column:
    """One column: heading, values, and their lines from 1; NaN where a sample is missing.

    A file may state the time between samples, s, in `step`, or in `bare_step` without a unit; NaN for none. `dimension`
    is what the column stands over, and `over` the name of the column that holds it, where the file says so.
    """

    name: str
    unit: str
    values: NDArray[Any]
    lines: Lines
    step: float = np.nan
    bare_step: float = np.nan
    dimension: str = "Time"
    over: str = ""


@dataclass(frozen=True)
class Table:
    """Channels, the column of times of each (None where it has none), the number of segments, and how it was read.

    `cut` says what makes its last row look cut off. `header_rates_hz` are readings of the rate above a text's rows.
    """

    signals: Sequence[Column]
    times: Sequence[Column | None]
    segments: int = 1
    understood: Understood | None = None
    cut: str = ""
    header_rates_hz: tuple[float, ...] = ()
