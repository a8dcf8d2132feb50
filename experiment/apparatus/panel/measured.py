"""What a measured response says of a panel: full scale, usable band, resonances; and its table beside the rig file."""

import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from palpate.experiment.apparatus.panel.movement import COLUMNS
from palpate.experiment.apparatus.panel.multisine import Estimate

FLAT_DB = 6.0
"""From the lowest to the highest level of the usable band."""

PROMINENT_DB = 3.0
"""A resonance stands out by so much."""

BROAD = 2.0
"""A peak whose highest decibel reaches so many times its lowest frequency is no resonance."""


@dataclass(frozen=True)
class Resonance:
    """A peak of the response: its frequency with its standard error, Hz, and the acceleration of a sample of 1.0."""

    hz: float
    standard_error_hz: float
    peak_m_s2: float


@dataclass(frozen=True)
class Figures:
    """A panel in few numbers.

    Attributes:
        full_scale_m_s2: acceleration of a sample of 1.0: the mean level over the octaves of the usable band.
        standard_error_m_s2: of that, without what the accelerometer's own calibration is off by.
        low_hz, high_hz: the usable band.
        resonances: from the lowest on.
    """

    full_scale_m_s2: float
    standard_error_m_s2: float
    low_hz: float
    high_hz: float
    resonances: tuple[Resonance, ...]


def figures(found: Estimate, within: NDArray[np.bool_]) -> Figures:
    """Return the figures of a panel from the lines `within`, shape (K,)."""
    hz, level_db = found.lines_hz[within].astype(np.float64), _db(np.abs(found.response_m_s2[within]))
    error_db = found.standard_error_db[within]
    first, last = _flat(np.log(hz), level_db)
    band = slice(first, last + 1)
    octaves = np.gradient(np.log(hz[band])) if last > first else np.ones(1)
    shares = octaves / octaves.sum()
    full = float(10 ** ((shares * level_db[band]).sum() / 20))
    error = float(np.sqrt(np.square(shares * error_db[band]).sum())) * np.log(10) / 20
    return Figures(full, full * error, float(hz[first]), float(hz[last]), tuple(_resonances(hz, level_db, error_db)))


def _db(magnitudes: NDArray[np.float64]) -> NDArray[np.float64]:
    return 20 * np.log10(np.maximum(magnitudes, 1e-12))


def _flat(octaves: NDArray[np.float64], level_db: NDArray[np.float64]) -> tuple[int, int]:
    """Return the first and last line of the widest stretch in which levels differ by at most `FLAT_DB`."""
    widest, first = (0, 0), 0
    for last in range(level_db.size):
        while np.ptp(level_db[first : last + 1]) > FLAT_DB:
            first += 1
        if octaves[last] - octaves[first] > octaves[widest[1]] - octaves[widest[0]]:
            widest = first, last
    return widest


def _resonances(
    hz: NDArray[np.float64], level_db: NDArray[np.float64], error_db: NDArray[np.float64]
) -> Iterator[Resonance]:
    """Yield each prominent peak, at the top of a parabola through its highest decibel."""
    for peak in signal.find_peaks(level_db, prominence=PROMINENT_DB)[0]:
        low = high = int(peak)
        while low > 0 and level_db[peak] - level_db[low - 1] <= 1.0:
            low -= 1
        while high < hz.size - 1 and level_db[peak] - level_db[high + 1] <= 1.0:
            high += 1
        if hz[high] > BROAD * hz[low]:
            continue
        low, high = min(low, int(peak) - 1), max(high, int(peak) + 1)
        part = slice(low, high + 1)
        x, weights = np.log(hz[part] / hz[peak]), 1 / np.maximum(error_db[part], 1e-6)
        powers = np.vander(x, 3)
        a, b, c = np.polyfit(x, level_db[part], 2, w=weights)
        spread = np.linalg.inv((powers * weights[:, None] ** 2).T @ powers)
        slopes = np.array([b / (2 * a**2), -1 / (2 * a), 0.0])
        top = float(np.clip(-b / (2 * a), x[0], x[-1]))
        at = float(hz[peak] * np.exp(top))
        error = at * float(np.sqrt(slopes @ spread @ slopes))
        yield Resonance(at, error, float(10 ** ((c + b * top + a * top**2) / 20)))


def table(found: Estimate, remarks: tuple[str, ...]) -> bytes:
    """Return the response as a CSV table: one row a line, after one comment for each remark."""
    file = io.StringIO()
    file.writelines(f"# {remark}\n" for remark in remarks)
    rows = csv.writer(file, lineterminator="\n")
    rows.writerow(COLUMNS)
    columns = (found.response_m_s2.real, found.response_m_s2.imag, found.standard_error_m_s2, found.coherence)
    for hz, *values in zip(found.lines_hz.tolist(), *(column.tolist() for column in columns), strict=True):
        rows.writerow([hz, *(f"{value:.6g}" for value in values)])
    return file.getvalue().encode()
