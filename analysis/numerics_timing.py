"""How much `palpate numerics` measures, how it times a call, and what it keeps of a measurement."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from analysis.numerics_oracle import PAPER_SAMPLES

MOST_REPEATS = 2000


@dataclass(frozen=True)
class Extent:
    """How much to measure.

    Attributes:
        lengths: N of recordings, samples.
        output_rates_hz: of resampling, Hz.
        most_terms: of a printed sum; a larger one is not measured.
        table_sizes: frequencies in a response table.
        table_levels: drive levels in it.
        noise_s: lengths of noise, s.
        budget_s: for the repeats of one measurement, s.
        least_repeats: of one measurement, whatever they take.
        places: samples at which resampling is compared with the sum taken term by term.
    """

    lengths: tuple[int, ...]
    output_rates_hz: tuple[int, ...]
    most_terms: int
    table_sizes: tuple[int, ...]
    table_levels: tuple[int, ...]
    noise_s: tuple[float, ...]
    budget_s: float
    least_repeats: int
    places: int

    @property
    def usual(self) -> int:
        """The length that everything but the length is varied at."""
        return usual_length(self.lengths)


def usual_length(lengths: Iterable[float]) -> int:
    """The paper's, or the longest where that is not among them, samples."""
    return int(max(lengths, key=lambda n: (n == PAPER_SAMPLES, n)))


FULL = Extent(
    lengths=(125, 250, 500, 1000, 2500, 5000),
    output_rates_hz=(44_100, 48_000, 96_000, 192_000),
    most_terms=60_000_000,
    table_sizes=(8, 15, 30, 60, 120, 240, 480),
    table_levels=(3, 7, 15),
    noise_s=(0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0),
    budget_s=0.2,
    least_repeats=5,
    places=200,
)
QUICK = replace(
    FULL,
    lengths=(250, 1000, 2500),
    most_terms=10_000_000,
    table_sizes=(8, 30, 120, 480),
    table_levels=(3, 7),
    noise_s=(0.1, 0.5, 2.0),
    budget_s=0.05,
)


@dataclass(frozen=True)
class Timed:
    """Run time of one call.

    Attributes:
        median_s: s.
        quartiles_s: of the repeats, s.
        repeats: how many.
    """

    median_s: float
    quartiles_s: tuple[float, float]
    repeats: int


@dataclass(frozen=True)
class Measured:
    """One point: what a way of computing something takes, and errs.

    Attributes:
        subject: `synthesis`, `resampling`, `shaping` or `noise`.
        way: how it was computed: one curve of the plot.
        given: of what size: name of a quantity with its unit -> value.
        timed: run time.
        error: relative, or dB for noise.
        claimed: bound on the error that the way states; None where it states none.
        prepared_s: time of what was done beforehand, s; None where there is nothing to do.
        memory_bytes: that it holds then; None likewise.
    """

    subject: str
    way: str
    given: dict[str, float]
    timed: Timed
    error: float
    claimed: float | None = None
    prepared_s: float | None = None
    memory_bytes: int | None = None

    @property
    def holds(self) -> bool:
        """Whether the error is within the claim; without one, whether it is a number."""
        return bool(np.isfinite(self.error)) if self.claimed is None else self.error <= self.claimed


def timed(
    call: Callable[[], object],
    *,
    budget_s: float,
    least_repeats: int,
    clock: Callable[[], int] = time.perf_counter_ns,
) -> Timed:
    """Repeat a call for a while, and at least some times.

    Args:
        call: what to time; the first call warms up and does not count, unless it takes longer than the budget.
        budget_s: for all repeats, s.
        least_repeats: whatever they take, one or more.
        clock: monotonic, ns.
    """

    def once() -> int:
        begun = clock()
        call()
        return clock() - begun

    taken = [first] if (first := once()) > budget_s * 1e9 else []
    while len(taken) < least_repeats or (sum(taken) < budget_s * 1e9 and len(taken) < MOST_REPEATS):
        taken.append(once())
    low, high = np.quantile(taken, [0.25, 0.75]).tolist()
    return Timed(statistics.median(taken) / 1e9, (low / 1e9, high / 1e9), len(taken))
