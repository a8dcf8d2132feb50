"""Error against run time of synthesis, resampling, frequency shaping and noise: how much is measured, and how.

All spectra are made to order, SIMULATED: random amplitudes under an envelope that falls beyond 120 Hz, as a crinkle's.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from analysis.numerics import oracle
from analysis.numerics.cases import PRINTED_SUM, WAYS, Way
from analysis.numerics.oracle import PAPER_SAMPLES, RATE_HZ, SPEEDS_MM_S
from experiment.synthesis.crinkle import CrinkleSpectra
from experiment.synthesis.noise import CLAIMED_DB, CLAIMED_FROM_S, Colour, noise
from experiment.synthesis.shaping import Response, shape
from experiment.synthesis.spectra import bin_frequencies_hz, grid, inverse, inverse_on
from experiment.synthesis.waveforms import transform_error

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


OUTPUT_RATE_HZ = 48_000
BETWEEN_MM_S, BEYOND_MM_S = 170.0, 1000.0
"""A speed between measured ones; and one so far beyond that bins are floored."""

DB_PER_OCTAVE: dict[Colour, float] = {"pink": 0.0, "white": 10 * float(np.log10(10**0.3))}
Measurement = Callable[[], Measured]


def measurements(extent: Extent) -> list[Measurement]:
    """Everything to measure, in the order of the tables."""
    return [*synthesis(extent, WAYS), *resampling(extent), *shaping(extent), *noises(extent)]


@lru_cache(maxsize=8)
def made_to_order(samples: int) -> CrinkleSpectra:
    """SIMULATED spectra of a material, N = `samples`, the same at every call."""
    rng = np.random.default_rng(samples)
    f = bin_frequencies_hz(bins=samples, rate_hz=RATE_HZ)
    envelope = np.outer([0.5, 1.0, 1.4, 2.0], 1 / (1 + (f / 120.0) ** 2) ** 2)
    shape_ = (len(SPEEDS_MM_S), samples)
    return CrinkleSpectra(
        speeds_mm_s=np.array(SPEEDS_MM_S),
        rate_hz=RATE_HZ,
        amplitudes=envelope * np.abs(rng.normal(size=shape_)) * np.sqrt(2 / samples),
        signs=rng.choice([-1.0, 1.0], size=shape_),
    )


def synthesis(extent: Extent, of: Sequence[Way]) -> list[Measurement]:
    """Every way, at every length, at every output rate, and beyond the measured speeds."""
    points = [(n, OUTPUT_RATE_HZ, BETWEEN_MM_S) for n in extent.lengths]
    points += [(extent.usual, rate, BETWEEN_MM_S) for rate in extent.output_rates_hz if rate != OUTPUT_RATE_HZ]
    points.append((extent.usual, OUTPUT_RATE_HZ, BEYOND_MM_S))
    return [
        partial(_synthesis, way, samples, rate_hz, v, extent)
        for way in of
        for samples, rate_hz, v in points
        if way is not PRINTED_SUM or samples * samples * rate_hz // RATE_HZ <= extent.most_terms
    ]


def resampling(extent: Extent) -> list[Measurement]:
    """A recording at other rates: by equation (5) as palpate does, and two ways that it does not take."""
    return [
        partial(_resampling, way, extent.usual, rate_hz, extent)
        for way in ("inverse DCT", "polyphase filter", "linear interpolation")
        for rate_hz in extent.output_rates_hz
    ]


def shaping(extent: Extent) -> list[Measurement]:
    """The inverse of a response, by the size of its table."""
    return [partial(_shaping, levels, size, extent) for levels in extent.table_levels for size in extent.table_sizes]


def noises(extent: Extent) -> list[Measurement]:
    """Noise, by its length."""
    return [partial(_noise, colour, seconds, extent) for colour in DB_PER_OCTAVE for seconds in extent.noise_s]


def _synthesis(way: Way, samples: int, rate_hz: int, v: float, extent: Extent) -> Measured:
    spectra = made_to_order(samples)
    render, nbytes = way.prepare(spectra, rate_hz)
    exact = oracle.stimulus(spectra, speed_mm_s=v, output_rate_hz=rate_hz)
    prepared = timed(lambda: way.prepare(spectra, rate_hz), budget_s=extent.budget_s / 5, least_repeats=3)
    return Measured(
        subject="synthesis",
        way=way.name,
        given={"samples": samples, "output_rate_hz": rate_hz, "speed_mm_s": v},
        timed=_timed(lambda: render(v), extent),
        error=float(oracle.error(render(v), exact) / exact.scale),
        claimed=way.claim(spectra.grid(rate_hz)),
        prepared_s=prepared.median_s,
        memory_bytes=nbytes,
    )


def _resampling(way: str, samples: int, rate_hz: int, extent: Extent) -> Measured:
    coefficients = (made_to_order(samples).amplitudes * made_to_order(samples).signs)[2]
    recorded = inverse(coefficients)
    on = grid(samples=samples, bins=samples, rate_hz=RATE_HZ, output_rate_hz=rate_hz)
    claimed: float | None = None
    numerators, denominator = (2 * np.arange(on.count, dtype=np.int64) + 1) * on.q, 2 * on.p
    if way == "inverse DCT":
        claimed = transform_error(on)

        def call() -> NDArray[np.float64]:
            return inverse_on(coefficients, on)
    elif way == "linear interpolation":
        times = (np.arange(on.count) + 0.5) * (RATE_HZ / rate_hz) - 0.5

        def call() -> NDArray[np.float64]:
            return np.asarray(np.interp(times, np.arange(samples), recorded))
    else:
        # It keeps the first sample's time, where all others keep the recording's beginning.
        numerators, denominator = rate_hz + 2 * RATE_HZ * np.arange(on.count, dtype=np.int64), 2 * samples * rate_hz

        def call() -> NDArray[np.float64]:
            return np.asarray(signal.resample_poly(recorded, rate_hz, RATE_HZ))

    # Both ends are left out: only the DCT says how a recording goes on beyond them.
    places = np.linspace(on.count // 20, on.count - on.count // 20, extent.places).astype(np.int64)
    exact = oracle.term_by_term(coefficients, numerators=numerators[places], denominator=denominator)
    difference = call()[places] - exact
    return Measured(
        subject="resampling",
        way=way,
        given={"samples": samples, "output_rate_hz": rate_hz},
        timed=_timed(call, extent),
        error=float(np.sqrt(np.mean(difference**2) / np.mean(exact**2))),
        claimed=claimed,
    )


def _shaping(levels: int, size: int, extent: Extent) -> Measured:
    f, levels_v = np.geomspace(10.0, 600.0, size), np.sqrt(2) * np.linspace(1.5 / levels, 1.5, levels)
    response = Response(f, levels_v, oracle.answered_m_s2(f[:, None], levels_v))
    bins_hz = bin_frequencies_hz(bins=PAPER_SAMPLES, rate_hz=RATE_HZ)
    within = (bins_hz >= f[0]) & (bins_hz <= f[-1])
    volts = np.random.default_rng(7).uniform(0.01, 2.0, bins_hz.size) * within
    coefficients = np.zeros(bins_hz.size)
    coefficients[within] = oracle.answered_m_s2(bins_hz[within], volts[within])

    def call() -> NDArray[np.float64]:
        return shape(coefficients, frequencies_hz=bins_hz, response=response, gain_limit_v_per_m_s2=1e3).coefficients_v

    exact = oracle.voltage_v(bins_hz[within], coefficients[within])
    return Measured(
        subject="shaping",
        way=f"{levels} drive levels",
        given={"frequencies": size, "drive_levels": levels, "bins": bins_hz.size},
        timed=_timed(call, extent),
        error=float(np.sqrt(np.mean((call()[within] / exact - 1) ** 2))),
    )


def _noise(colour: Colour, seconds: float, extent: Extent) -> Measured:
    samples = round(seconds * OUTPUT_RATE_HZ)

    def call() -> NDArray[np.float64]:
        return noise(colour=colour, samples=samples, rate_hz=OUTPUT_RATE_HZ, rng=np.random.default_rng(1))

    deviations = oracle.octave_deviations_db(call(), rate_hz=OUTPUT_RATE_HZ, db_per_octave=DB_PER_OCTAVE[colour])
    return Measured(
        subject="noise",
        way=f"{colour} noise",
        given={"length_s": seconds, "output_rate_hz": OUTPUT_RATE_HZ},
        timed=_timed(call, extent),
        error=float(np.max(np.abs(deviations))),
        claimed=CLAIMED_DB if seconds >= CLAIMED_FROM_S else None,
    )


def _timed(call: Callable[[], object], extent: Extent) -> Timed:
    return timed(call, budget_s=extent.budget_s, least_repeats=extent.least_repeats)
