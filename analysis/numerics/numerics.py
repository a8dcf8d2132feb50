"""Error against run time of synthesis, resampling, shaping, noise and contact, and whether everything holds."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from importlib import metadata
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from analysis.numerics import cases, contact, oracle
from analysis.numerics.cases import PRINTED_SUM, WAYS, Outcome, Way, settle
from analysis.numerics.oracle import PAPER_SAMPLES, RATE_HZ, SPEEDS_MM_S
from experiment.synthesis.crinkle import CrinkleSpectra
from experiment.synthesis.noise import CLAIMED_DB, CLAIMED_FROM_S, Colour, noise
from experiment.synthesis.shaping import Response, shape
from experiment.synthesis.spectra import bin_frequencies_hz, grid, inverse, inverse_on
from experiment.synthesis.stepping.steppers import EXACT, STEPPERS
from experiment.synthesis.waveforms import transform_error

LABEL = "SIMULATED spectra"
"""The label on everything: no recording is measured here."""

MOST_REPEATS = 2000


@dataclass(frozen=True)
class Extent:
    """How much to measure, for recordings of `lengths` samples, and for how long.

    A printed sum of more than `most_terms` is not measured. A response table has `table_sizes` frequencies and
    `table_levels` drive levels. Resampling is compared with the sum taken term by term at so many `places`. Each of the
    `diagrams`, stiffness and mass, is gone through in so many steps a contact (`contact_steps`).
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
    diagrams: tuple[tuple[float, float], ...]
    contact_steps: tuple[int, ...]

    @property
    def usual(self) -> int:
        """The length at which everything else is varied."""
        return usual_length(self.lengths)


def usual_length(lengths: Iterable[float]) -> int:
    """Return the paper's length in samples, or the longest where the paper's is not among them."""
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
    diagrams=contact.DIAGRAMS,
    contact_steps=(2, 8, 32, 128, 512),
)
QUICK = replace(
    FULL,
    lengths=(250, 1000, 2500),
    most_terms=10_000_000,
    table_sizes=(8, 30, 120, 480),
    table_levels=(3, 7),
    noise_s=(0.1, 0.5, 2.0),
    budget_s=0.05,
    contact_steps=(2, 8, 32, 128),
)


@dataclass(frozen=True)
class Timed:
    """Run time of one call: the median and the quartiles of its repeats."""

    median_s: float
    quartiles_s: tuple[float, float]
    repeats: int


@dataclass(frozen=True)
class Measured:
    """One point: the run time and the error (relative, or in dB for noise) of one way to compute something.

    `way` is one curve of the plot, `given` the sizes by the name of a quantity with its unit. `claimed` is the bound
    that the way states on its error; then come the time and the memory of its preparation, where it has one, and errors
    of other quantities by their names.
    """

    subject: str
    way: str
    given: dict[str, float]
    timed: Timed
    error: float
    claimed: float | None = None
    prepared_s: float | None = None
    memory_bytes: int | None = None
    others: dict[str, float] = field(default_factory=dict)

    @property
    def holds(self) -> bool:
        """Whether the error is within the claim; without one, whether it is a number."""
        return bool(np.isfinite(self.error)) if self.claimed is None else self.error <= self.claimed


def timed(
    call: Callable[[], object], *, budget_s: float, least_repeats: int, clock: Callable[[], int] = time.perf_counter_ns
) -> Timed:
    """Return the run time of a call, repeated for `budget_s` and at least `least_repeats` (one or more) times.

    The first call warms up and does not count, unless it takes longer than the budget. `clock` is monotonic, in ns.
    """

    def once() -> int:
        begun = clock()
        call()
        return clock() - begun

    taken = [first] if (first := once()) > budget_s * 1e9 else []
    while len(taken) < least_repeats or (sum(taken) < budget_s * 1e9 and len(taken) < MOST_REPEATS):
        taken.append(once())
    low, middle, high = (np.quantile(taken, [0.25, 0.5, 0.75]) / 1e9).tolist()
    return Timed(middle, (low, high), len(taken))


OUTPUT_RATE_HZ = 48_000
BETWEEN_MM_S, BEYOND_MM_S = 170.0, 1000.0
"""A speed between the measured ones, and one so far beyond them that bins are floored."""

DB_PER_OCTAVE: dict[Colour, float] = {"pink": 0.0, "white": 10 * float(np.log10(10**0.3))}
Measurement = Callable[[], Measured]


def measurements(extent: Extent) -> list[Measurement]:
    """Return everything to measure, in the order of the tables."""
    return [*synthesis(extent, WAYS), *resampling(extent), *shaping(extent), *noises(extent), *contacts(extent)]


@lru_cache(maxsize=8)
def made_to_order(samples: int) -> CrinkleSpectra:
    """Return SIMULATED spectra, N = `samples`: random under an envelope that falls beyond 120 Hz like a crinkle's."""
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
    """Return the measurements of these ways at every length, at every output rate, and beyond the measured speeds."""
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
    """Return the measurements of a recording at other rates: by equation (5), which palpate uses, and by two others."""
    return [
        partial(_resampling, way, extent.usual, rate_hz, extent)
        for way in ("inverse DCT", "polyphase filter", "linear interpolation")
        for rate_hz in extent.output_rates_hz
    ]


def shaping(extent: Extent) -> list[Measurement]:
    """Return the measurements of the inverse of a response, by the size of its table."""
    return [partial(_shaping, levels, size, extent) for levels in extent.table_levels for size in extent.table_sizes]


def noises(extent: Extent) -> list[Measurement]:
    """Return the measurements of noise, by its length."""
    return [partial(_noise, colour, seconds, extent) for colour in DB_PER_OCTAVE for seconds in extent.noise_s]


def contacts(extent: Extent) -> list[Measurement]:
    """Return the measurements of one impact by each stepper, for each diagram, and at the servo's own step."""
    return [
        partial(_contact, method, stiffness, mass, step_s, extent)
        for stiffness, mass in extent.diagrams
        for method in STEPPERS
        for step_s in (
            *(contact.contact_s(stiffness=stiffness, mass=mass) / n for n in extent.contact_steps),
            contact.SERVO_S,
        )
    ]


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
    call: Callable[[], Any]
    numerators, denominator = (2 * np.arange(on.count, dtype=np.int64) + 1) * on.q, 2 * on.p
    if way == "inverse DCT":
        call = partial(inverse_on, coefficients, on)
    elif way == "linear interpolation":
        times = (np.arange(on.count) + 0.5) * (RATE_HZ / rate_hz) - 0.5
        call = partial(np.interp, times, np.arange(samples), recorded)
    else:
        # A polyphase filter keeps the time of the first sample; all others keep the beginning of the recording.
        numerators, denominator = rate_hz + 2 * RATE_HZ * np.arange(on.count, dtype=np.int64), 2 * samples * rate_hz
        call = partial(signal.resample_poly, recorded, rate_hz, RATE_HZ)
    # Both ends are left out, because only the DCT says how a recording goes on beyond them.
    places = np.linspace(on.count // 20, on.count - on.count // 20, extent.places).astype(np.int64)
    exact = oracle.term_by_term(coefficients, numerators=numerators[places], denominator=denominator)
    difference = np.asarray(call())[places] - exact
    return Measured(
        subject="resampling",
        way=way,
        given={"samples": samples, "output_rate_hz": rate_hz},
        timed=_timed(call, extent),
        error=float(np.sqrt(np.mean(difference**2) / np.mean(exact**2))),
        claimed=transform_error(on) if way == "inverse DCT" else None,
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


def _contact(method: str, stiffness: float, mass: float, step_s: float, extent: Extent) -> Measured:
    found = contact.worst(method, stiffness=stiffness, mass=mass, step_s=step_s)
    run_ = contact.run_once(method, stiffness=stiffness, mass=mass, step_s=step_s)
    return Measured(
        subject="contact",
        way=method,
        given={"stiffness_n_m": stiffness, "mass_kg": mass, "step_s": step_s},
        timed=timed(run_, budget_s=extent.budget_s / 10, least_repeats=3),
        error=found["rebound"],
        claimed=contact.CLAIMED if method == EXACT else None,
        others={f"{name}_error": found[name] for name in ("release", "penetration", "energy")},
    )


def _timed(call: Callable[[], object], extent: Extent) -> Timed:
    return timed(call, budget_s=extent.budget_s, least_repeats=extent.least_repeats)


@dataclass(frozen=True)
class Numerics:
    """What was measured, in the order of the tables, and the outcome of every extreme case.

    `software` maps names to versions, and also holds the rounding of the oracle.
    """

    software: dict[str, str]
    measured: tuple[Measured, ...]
    outcomes: tuple[Outcome, ...]

    @property
    def failed(self) -> bool:
        """Whether an invariant is broken, or an error is above the claim of its way."""
        return bool(self.broken)

    @property
    def broken(self) -> tuple[str, ...]:
        """One line for each invariant and each claim that does not hold."""
        claims = [
            f"{one.subject}, {one.way}: error {one.error:.2g}"
            + (f", above {one.claimed:.2g} claimed" if one.claimed is not None else "")
            for one in self.measured
            if not one.holds
        ]
        invariants = [f"{one.group}, {one.given}: {one.seen}" for one in self.outcomes if not one.holds]
        return (*claims, *invariants)

    @property
    def verdict(self) -> str:
        """One sentence, and a line for each thing that does not hold."""
        claimed = sum(one.claimed is not None for one in self.measured)
        every = f"{claimed} claimed bounds on errors and {len(self.outcomes)} invariants"
        if not self.failed:
            return f"All of {every} hold."
        return "\n".join([f"{len(self.broken)} of {every} do not hold:", *(f"  {line}" for line in self.broken)])


def run(
    extent: Extent, *, total: Callable[[int], None] = lambda _: None, tick: Callable[[], None] = lambda: None
) -> Numerics:
    """Measure everything and settle every case; `total` is told the number of steps, `tick` is called after each."""
    wanted, extremes = measurements(extent), [*cases.cases(), *contact.cases()]
    total(len(wanted) + len(extremes))
    measured, outcomes = [], []
    for measure in wanted:
        measured.append(measure())
        tick()
    for case in extremes:
        outcomes.append(settle(case))
        tick()
    packages = {name: metadata.version(name) for name in ("palpate", "numpy", "scipy")}
    software = {**packages, "python": platform.python_version(), "oracle_epsilon": f"{oracle.extended_epsilon():.1e}"}
    return Numerics(software, tuple(measured), tuple(outcomes))
