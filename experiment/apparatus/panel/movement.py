"""A panel's movement by its measured complex response, and a bound on its peak, which the protocol's limit rests on.

Beyond the lines that were measured the slope of the nearest octave goes on, at the phase of the nearest line; how
uncertain that is, nobody knows. Its table is read here, since palpate alone writes it and a rig has its hash.
"""

import csv
import io
from dataclasses import dataclass, field
from math import ceil, cos, pi
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.interpolate import CubicSpline

from palpate.experiment.apparatus.panel.conditioning import Drifted, Peak, Played
from palpate.experiment.apparatus.rig import MeasuredRig, response_table
from palpate.experiment.errors import RigError
from palpate.experiment.records import stimulus as records
from palpate.experiment.synthesis.felt import Felt, felt_between

COLUMNS = ("frequency_hz", "real_m_s2", "imaginary_m_s2", "standard_error_m_s2", "coherence")

RINGS_S = 0.2
"""How long a panel rings after a stimulus, s: ours, some 10 periods of its slowest resonance."""

FINER = 16
"""So many times the highest line is the rate at which a peak is looked for. What this adds between points, up to 2 %,
also covers the worst of many lines, which may be off by more than `ERRORS`: with 48, a tone of 2 s exceeded the limit
by 0.07 % on 2 of 20 SIMULATED panels, and with 16 on none (at most 0.987 of it)."""

ERRORS = 2.0
"""So many standard errors of all lines at once, in whatever phase, are in the uncertainty of a peak: a stimulus that
happens to meet what a measurement is off by does not exceed it."""

DRIFT_DB = 1.0
"""How far a panel may have drifted since it was measured if no session has compared it: a comparison warns of more
(`drift.py`)."""

UNCOMPARED = Drifted(louder_db=DRIFT_DB, off_db=DRIFT_DB)

CREST = 3.4
"""How many times its rms the multisine that finds compression peaks at the most: of `multisine.DRAWS` the lowest."""

FEWEST, LEAST = 10, 1e-12
"""Lines of a response, at the least, and m/s^2 that count as none."""


@dataclass(frozen=True, eq=False)
class Reference:
    """A panel as it was measured, for a small drive: lines, Hz, and the response with its standard error, m/s^2."""

    lines_hz: NDArray[np.int64]
    response_m_s2: NDArray[np.complex128]
    standard_error_m_s2: NDArray[np.float64]


def read_reference(path: Path, content: bytes) -> Reference:
    """Return the table that `measured.table` made. Raises `RigError` for one that it did not make."""
    rows = csv.DictReader(io.StringIO("\n".join(r for r in content.decode().splitlines() if not r.startswith("#"))))
    try:
        table = np.array([[float(row[key]) for key in COLUMNS] for row in rows])
    except (KeyError, TypeError, ValueError):
        table = np.empty((0, len(COLUMNS)))
    if len(table) < FEWEST or not np.isfinite(table).all() or np.any(np.diff(table[:, 0], prepend=0.0) <= 0):
        remedy, allowed = (
            "restore it, or measure the panel again",
            f"rising frequencies, each with {', '.join(COLUMNS)}",
        )
        raise RigError(path, "is not a panel response", remedy, allowed=allowed)
    hz, real, imaginary, error, _ = table.T
    return Reference(hz.astype(np.int64), real + 1j * imaginary, error)


def expected_gain(measured: MeasuredRig, peak: float) -> float:
    """Return the gain of a panel at a peak, relative to a small drive; what it loses rises as the drive's power."""
    return float(10 ** (-measured.compression_db * (peak / measured.loudest) ** 2 / 20))


class _Grid(NamedTuple):
    """For stimuli of one length: points, times as many that are looked at, response, and where lines' bins begin."""

    size: int
    finer: int
    response_m_s2: NDArray[np.complex128]
    cells: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Movement:
    """How a measured panel moves by samples at a rate, 1.0 being full scale; it has `drifted` by that much at most."""

    reference: Reference
    measured: MeasuredRig
    rate_hz: int
    drifted: Drifted = UNCOMPARED
    _grids: dict[int, _Grid] = field(default_factory=dict)

    def grid(self, count: int) -> _Grid:
        """Return the grid of so many samples, which is computed once."""
        if count not in self._grids:
            size = fft.next_fast_len(count + round(RINGS_S * self.rate_hz), real=True)
            f, lines = np.arange(size // 2 + 1) * (self.rate_hz / size), self.reference.lines_hz.astype(np.float64)
            response = self.response_m_s2(f)
            ends = np.concatenate([[0.0], (lines[:-1] + lines[1:]) / 2, [2 * lines[-1] - lines[-2]]])
            finer = ceil(FINER * lines[-1] / self.rate_hz)
            self._grids[count] = _Grid(size, finer, response, np.searchsorted(f, np.minimum(ends, f[-1])))
        return self._grids[count]

    def response_m_s2(self, frequencies_hz: NDArray[np.float64]) -> NDArray[np.complex128]:
        """Return the acceleration of a sample of 1.0 at any frequencies, shape (n,)."""
        lines, response = self.reference.lines_hz.astype(np.float64), self.reference.response_m_s2
        within = np.clip(frequencies_hz, lines[0], lines[-1])
        found = np.asarray(CubicSpline(lines, response)(within))
        for octave in (lines <= 2 * lines[0], lines >= lines[-1] / 2):
            slope = float(np.polyfit(np.log(lines[octave]), np.log(np.maximum(np.abs(response[octave]), LEAST)), 1)[0])
            beyond = frequencies_hz < within if octave[0] else frequencies_hz > within
            found[beyond] *= (frequencies_hz[beyond] / within[beyond]) ** (
                max(slope, 0) if octave[0] else min(slope, 0)
            )
        return found

    def moved_m_s2(self, samples: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return the movement by samples, shape (n,), from the first one on and until it rings no more, m/s^2, (m,)."""
        on = self.grid(samples.size)
        moved: NDArray[np.float64] = fft.irfft(
            fft.rfft(samples.astype(np.float64), on.size) * on.response_m_s2, on.size
        )
        return moved

    def peak(self, samples: NDArray[np.float32] | NDArray[np.float64]) -> Peak:
        """Return the peak that finite samples, shape (n,), move the panel by.

        Between points a sum of bins below the part r of the points' rate is at most 1 / cos(pi r) times as high as at
        them (Ehlich and Zeller 1964). A soft coil or spring may leave a peak what it takes from the power.
        """
        on, loudest = self.grid(samples.size), float(np.abs(samples).max(initial=0.0))
        bins = fft.rfft(samples.astype(np.float64, copy=False), on.size)
        moved = fft.irfft(bins * on.response_m_s2, on.finer * on.size, overwrite_x=True)
        highest = on.finer * max(float(moved.max()), -float(moved.min()))
        highest /= cos(pi * float(self.reference.lines_hz[-1]) / (on.finer * self.rate_hz))
        parts = np.add.reduceat(np.abs(bins), on.cells)[:-1] * self.reference.standard_error_m_s2
        uncertain = ERRORS * 2 / on.size * float(parts.sum())
        gain, louder = expected_gain(self.measured, loudest), 10 ** (self.drifted.louder_db / 20)
        at_most = louder * (highest * (gain + abs(1 - gain)) + uncertain)
        return Peak(highest * gain, at_most - highest * gain)

    def felt(self, asked_m_s2: NDArray[np.float64], samples: NDArray[np.float32], *, ahead: int = 0) -> Felt:
        """Return how the panel's movement differs from what was asked for, with intervals for 95 of 100 stimuli.

        `ahead` samples come before the stimulus. An interval is for a coil anywhere between linear and soft, and for
        drift either way. Of 320 SIMULATED stimuli on a panel that became 3 % heavier and on a soft coil, the intervals
        of a plan and those after a comparison cover the truth in 320. Of the 160 by an inverse, 34 and 17 are wider
        than twice the truth (`python -m tests.benchmarks.felt`).
        """
        soft = after_soft_coil(samples, self.measured)
        linear_m_s2, soft_m_s2 = (self.moved_m_s2(one)[ahead:] for one in (samples, soft))
        return felt_between(asked_m_s2, linear_m_s2, soft_m_s2, rate_hz=self.rate_hz, drift_db=self.drifted.off_db)

    def on_record(self, played: Played, peak: Peak) -> records.Moved:
        """Return the record of a stimulus that moves the panel with this peak."""
        found = self.felt(played.stimulus.waveform_m_s2, played.samples, ahead=played.ahead)
        return records.Moved(
            **peak._asdict(),
            scale=played.panel_scale,
            drift_db=self.drifted.off_db,
            third_octave_between_db=found.third_octave_between_db,
            envelope_between_db=found.envelope_between_db,
        )


def after_soft_coil(samples: NDArray[np.float32], measured: MeasuredRig) -> NDArray[np.float32]:
    """Return samples as a coil passes them on that is at least as soft as it was measured to be.

    s - a s^3 takes 3 a times the mean square from the gain of a noise (Bussgang 1952, MIT Res. Lab. Electronics, Tech.
    Rep. 216), which of a multisine is at least its peak by `CREST`, squared.
    """
    lost = max(1 - 10 ** (-measured.compression_db / 20), 0.0)
    a = lost * CREST**2 / (3 * measured.loudest**2)
    return (samples / np.sqrt(1 + 2 * a * np.square(samples))).astype(np.float32)


def open_movement(folder: Path, measured: MeasuredRig, *, rate_hz: int) -> Movement:
    """Return how a panel moves whose response is a table in a folder. Raises `RigError` for the table."""
    return Movement(read_reference(folder / measured.response, response_table(folder, measured)), measured, rate_hz)
