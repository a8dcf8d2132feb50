"""Error against run time of synthesis, voltages, samples, resampling, shaping, noise and contact; and what holds."""

import platform
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from importlib import metadata
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from palpate.analysis.numerics import cases, contact, force, oracle, played
from palpate.analysis.numerics.cases import PRINTED_SUM, WAYS, Outcome, Way, settle
from palpate.analysis.numerics.force import Pushed
from palpate.analysis.numerics.oracle import PAPER_SAMPLES, RATE_HZ, SPEEDS_MM_S
from palpate.analysis.numerics.played import Condition, Played
from palpate.experiment.synthesis.crinkle import CrinkleSpectra
from palpate.experiment.synthesis.shaping import Response
from palpate.experiment.synthesis.signals.noise import CLAIMED_DB, CLAIMED_FROM_S, Colour, noise
from palpate.experiment.synthesis.signals.weighting import shape
from palpate.experiment.synthesis.spectra import bin_frequencies_hz, grid, inverse, inverse_on
from palpate.experiment.synthesis.stepping.steppers import EXACT, STEPPERS
from palpate.experiment.synthesis.waveforms import transform_error

LABEL = "SIMULATED spectra"
"""The label on everything: no recording is measured here."""

MOST_REPEATS = 2000

MATERIALS = {"dull": (60.0, 2, 2.0), "middle": (120.0, 2, 1.5), "bright": (240.0, 1, 1.0), "loud": (120.0, 2, 30.0)}
"""The SIMULATED materials: beyond which frequency, Hz, their spectra fall, with which power of f^2, and their level."""

QUIET_BELOW_HZ = 30.0
"""Below it they fall too, with f^2."""


@dataclass(frozen=True)
class Extent:
    """How much to measure, for recordings of `lengths` samples, and for how long.

    Limits: terms of a printed sum, frequencies and levels of a response table, places of a resampled recording, steps a
    contact of each diagram, and devices whose force is judged.
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
    devices: tuple[str, ...]

    @property
    def usual(self) -> int:
        """The length at which everything else is varied."""
        return usual_length(self.lengths)


def usual_length(lengths: Iterable[float]) -> int:
    """Return the paper's length in samples, or the longest where the paper's is not among them."""
    return int(max(lengths, key=lambda n: (n == PAPER_SAMPLES, n)))


FULL = Extent(
    lengths=(125, 250, 500, 1000, 2500, 5000), output_rates_hz=(44_100, 48_000, 96_000, 192_000),
    most_terms=60_000_000, table_sizes=(8, 15, 30, 60, 120, 240, 480), table_levels=(3, 7, 15),
    noise_s=(0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0), budget_s=0.2, least_repeats=5, places=200,
    diagrams=contact.DIAGRAMS, contact_steps=(2, 8, 32, 128, 512), devices=tuple(force.DEVICES),
)  # fmt: skip
QUICK = replace(
    FULL, lengths=(250, 1000, 2500), most_terms=10_000_000, table_sizes=(8, 30, 120, 480), table_levels=(3, 15),
    noise_s=(0.1, 0.5, 2.0), budget_s=0.05, contact_steps=(2, 8, 32, 128),
    devices=tuple(force.DEVICES)[:1],
)  # fmt: skip


@dataclass(frozen=True)
class Timed:
    """Run time of one call: the median and the quartiles of its repeats."""

    median_s: float
    quartiles_s: tuple[float, float]
    repeats: int


@dataclass(frozen=True)
class Measured:
    """One point: the run time and the error (relative, or in dB for noise) of one way to compute something.

    `given` are sizes by quantity and unit, `claimed` the way's own bound, `others` errors of other quantities.
    Preparation has a time and memory. `worst_at` names the worst of many.
    """

    subject: str
    way: str
    given: Mapping[str, float]
    timed: Timed
    error: float
    claimed: float | None = None
    prepared_s: float | None = None
    memory_bytes: int | None = None
    others: dict[str, float] = field(default_factory=dict)
    worst_at: str = ""

    @property
    def holds(self) -> bool:
        """Whether the error is within the claim; without one, whether it is a number."""
        return bool(np.isfinite(self.error)) if self.claimed is None else self.error <= self.claimed


def timed(
    call: Callable[[], object], *, budget_s: float, least_repeats: int, clock: Callable[[], int] = time.perf_counter_ns
) -> Timed:
    """Return the run time of a call, repeated for `budget_s` and at least `least_repeats` times; `clock` is in ns.

    The first call warms up and does not count, unless it takes longer than the budget.
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

WITHIN_MM_S = (50.0, 75.0, 100.0, 130.0, 170.0, 250.0, 300.0)
OUTSIDE_MM_S = (0.0, 1e-6, 20.0, 301.0, 400.0, 650.0, 1000.0)
"""Measured speeds, the middle of two and others; and those outside of them. An error is the worst over either."""

DB_PER_OCTAVE: dict[Colour, float] = {"pink": 0.0, "white": 10 * float(np.log10(10**0.3))}
Measurement = Callable[[], Measured]


def measurements(extent: Extent) -> list[Measurement]:
    """Return everything to measure, in the order of the tables."""
    return [
        *synthesis(extent, WAYS),
        *voltages(extent),
        *samples_of(extent),
        *resampling(extent),
        *shaping(extent),
        *noises(extent),
        *contacts(extent),
    ]


@lru_cache(maxsize=32)
def made_to_order(samples: int, material: str = "middle") -> CrinkleSpectra:
    """Return SIMULATED spectra, N = `samples`: random under an envelope that falls like that of one of `MATERIALS`."""
    rng = np.random.default_rng([samples, list(MATERIALS).index(material)])
    f, (corner_hz, power, level) = bin_frequencies_hz(bins=samples, rate_hz=RATE_HZ), MATERIALS[material]
    rises = (f / QUIET_BELOW_HZ) ** 2 / (1 + (f / QUIET_BELOW_HZ) ** 2)
    envelope = level * np.outer([0.5, 1.0, 1.4, 2.0], rises / (1 + (f / corner_hz) ** 2) ** power)
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


def voltages(extent: Extent) -> list[Measurement]:
    """Return the measurements of what a rig in volts plays, at every length and at the rate of the recordings."""
    points = [*((n, OUTPUT_RATE_HZ) for n in extent.lengths), (extent.usual, RATE_HZ)]
    return [partial(_voltages, way, n, rate_hz, extent) for way in played.WAYS for n, rate_hz in points]


def samples_of(extent: Extent) -> list[Measurement]:
    """Return the measurements of samples as a device takes them, beside the steps of its converter."""
    return [partial(_samples, way, extent) for way in SAMPLES]


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
    prepared = timed(lambda: way.prepare(spectra, rate_hz), budget_s=extent.budget_s / 5, least_repeats=3)
    found = []
    # A printed sum takes seconds: its error is that of one material at one speed.
    for name in [*MATERIALS] if way is not PRINTED_SUM else ["middle"]:
        of = made_to_order(samples, name)
        render_of, _ = way.prepare(of, rate_hz)
        for speed in (v,) if way is PRINTED_SUM else WITHIN_MM_S if v == BETWEEN_MM_S else OUTSIDE_MM_S:
            exact = oracle.stimulus(of, speed_mm_s=speed, output_rate_hz=rate_hz)
            found.append((float(oracle.error(render_of(speed), exact) / exact.scale), f"{name}, {speed:g} mm/s"))
    error, worst_at = max(found)
    given = {"samples": samples, "output_rate_hz": rate_hz, "speed_mm_s": v}
    taken = _timed(lambda: render(v), extent if way is not PRINTED_SUM else replace(extent, least_repeats=1))
    claimed, prepared_s = way.claim(spectra.grid(rate_hz)), prepared.median_s
    return Measured("synthesis", way.name, given, taken, error, claimed, prepared_s, nbytes, worst_at=worst_at)


def _voltages(way: str, samples: int, rate_hz: int, extent: Extent) -> Measured:
    rig, found, claims, prepared = replace(played.RIG, rate_hz=rate_hz), [], [], 0
    for name in MATERIALS:
        basis = rig.basis(made_to_order(samples, name))
        drive = rig.drive(way, basis)
        for v in (20.0, *WITHIN_MM_S, 400.0):
            one = played.compare(drive, basis, rig, speed_mm_s=v)
            # A broken claim of one place is not hidden by the larger claim of another.
            found.append((one.error_v / one.rms_v, f"{name}, {v:g} mm/s"))
            claims.append(one.claim_v / one.rms_v if one.error_v <= one.claim_v else 0.0)
            prepared += one.driven.prepared
    basis = rig.basis(made_to_order(samples))
    drive = rig.drive(way, basis)
    preparing = timed(lambda: rig.drive(way, basis), budget_s=extent.budget_s / 5, least_repeats=1)
    error, worst_at = max(found)
    given, others = {"samples": samples, "output_rate_hz": rate_hz}, {"prepared_share": prepared / len(found)}
    taken = _timed(lambda: drive(basis.at(BETWEEN_MM_S)), extent)
    claimed, prepared_s = max(claims) if all(claims) else 0.0, preparing.median_s
    return Measured("voltages", way, given, taken, error, claimed, prepared_s, drive.nbytes, others, worst_at)


SAMPLES: dict[str, int | None] = {"float32 samples": None, "24-bit converter": 24, "16-bit converter": 16}
"""How a stimulus is rounded on its way: as palpate hands it over, and by the steps of a converter behind it."""


def _samples(way: str, extent: Extent) -> Measured:
    bits, found, claims = SAMPLES[way], [], []
    step = 0.0 if bits is None else 2.0 ** (1 - bits)

    def rounded(samples: NDArray[np.float64]) -> NDArray[np.float64]:
        single = samples.astype(np.float32)
        return np.rint(single / np.float32(step)) * step if step else single.astype(np.float64)

    for name in MATERIALS:
        basis = played.RIG.basis(made_to_order(extent.usual, name))
        for v in WITHIN_MM_S:
            wanted = basis.at(v).waveform_m_s2 / played.FULL_SCALE_M_S2
            rms = float(np.sqrt(np.mean(wanted**2)))
            found.append((float(np.sqrt(np.mean((rounded(wanted) - wanted) ** 2))) / rms, f"{name}, {v:g} mm/s"))
            claims.append(2.0**-24 + step / 2 / rms)
    error, worst_at = max(found)
    given, taken = {"samples": extent.usual, "output_rate_hz": RATE_HZ}, _timed(lambda: rounded(wanted), extent)
    return Measured("samples", way, given, taken, error, max(claims), worst_at=worst_at)


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
    given = {"samples": samples, "output_rate_hz": rate_hz}
    error = float(np.sqrt(np.mean(difference**2) / np.mean(exact**2)))
    claimed = transform_error(on) if way == "inverse DCT" else None
    return Measured("resampling", way, given, _timed(call, extent), error, claimed)


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
    given = {"frequencies": size, "drive_levels": levels, "bins": bins_hz.size}
    error = float(np.sqrt(np.mean((call()[within] / exact - 1) ** 2)))
    return Measured("shaping", f"{levels} drive levels", given, _timed(call, extent), error)


def _noise(colour: Colour, seconds: float, extent: Extent) -> Measured:
    samples = round(seconds * OUTPUT_RATE_HZ)

    def call() -> NDArray[np.float64]:
        return noise(colour=colour, samples=samples, rate_hz=OUTPUT_RATE_HZ, rng=np.random.default_rng(1))

    deviations = oracle.octave_deviations_db(call(), rate_hz=OUTPUT_RATE_HZ, db_per_octave=DB_PER_OCTAVE[colour])
    given, error = {"length_s": seconds, "output_rate_hz": OUTPUT_RATE_HZ}, float(np.max(np.abs(deviations)))
    claimed = CLAIMED_DB if seconds >= CLAIMED_FROM_S else None
    return Measured("noise", f"{colour} noise", given, _timed(call, extent), error, claimed)


def _contact(method: str, stiffness: float, mass: float, step_s: float, extent: Extent) -> Measured:
    found = contact.worst(method, stiffness=stiffness, mass=mass, step_s=step_s)
    run_ = contact.run_of(method, stiffness=stiffness, mass=mass, step_s=step_s)
    given = {"stiffness_n_m": stiffness, "mass_kg": mass, "step_s": step_s}
    taken = timed(run_, budget_s=extent.budget_s / 10, least_repeats=3)
    claimed = contact.CLAIMED if method == EXACT else None
    others = {f"{name}_error": found[name] for name in ("release", "penetration", "energy")}
    return Measured("contact", method, given, taken, found["rebound"], claimed, others=others)


def _timed(call: Callable[[], object], extent: Extent) -> Timed:
    return timed(call, budget_s=extent.budget_s, least_repeats=extent.least_repeats)


NO_ANSWER = 0.5
"""An error of half of all is none that somebody would choose for its time."""

AS_GOOD = 2.0
"""Errors within this factor count as equal: roundings differ by chance."""


def dominated(one: Measured, rows: Sequence[Measured]) -> bool | None:
    """Return whether another row takes less time, quartiles apart, for no larger an error; None where none compares."""
    if one.subject in ("samples", "shaping", "noise"):
        return None
    same = {name: value for name, value in one.given.items() if name != "step_s"}
    return one.error >= NO_ANSWER or any(
        other.subject == one.subject
        and same.items() <= other.given.items()
        and other.timed.quartiles_s[1] < one.timed.quartiles_s[0]
        and other.error <= AS_GOOD * one.error
        for other in rows
    )


def order(steps: Sequence[float], found: Sequence[float], *, below: float = 0.3) -> float | None:
    """Return the slope of ln error over ln step, of errors neither rounding nor large; None for fewer than three."""
    between = [(h, error) for h, error in zip(steps, found, strict=True) if 1e-12 < error < below]
    if len(between) < 3:
        return None
    h, error = np.log(np.array(between)).T
    return float(np.polyfit(h, error, 1)[0])


def shaping_order(rows: Sequence[Measured]) -> float | None:
    """Return the order of shaping in the spacing of frequencies, of the table with the most levels."""
    most = max(one.given["drive_levels"] for one in rows)
    finest = [one for one in rows if one.given["drive_levels"] == most]
    return order([1 / (one.given["frequencies"] - 1) for one in finest], [one.error for one in finest], below=0.05)


@dataclass(frozen=True)
class Numerics:
    """What was measured, in the order of the tables, extreme cases, what was played and pushed, and software."""

    software: dict[str, str]
    measured: tuple[Measured, ...]
    outcomes: tuple[Outcome, ...]
    played: tuple[Played, ...]
    pushed: tuple[Pushed, ...]
    conditions: tuple[Condition, ...]
    materials: dict[str, CrinkleSpectra]

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
        budgets = [
            f"budget, {one.unit}, {one.material}, {one.speed_mm_s:g} mm/s: {one.budget.total:.2%}, not {one.truth:.2%}"
            for one in self.played
            if not one.holds
        ]
        return (*claims, *invariants, *budgets, *(line for one in self.pushed for line in one.broken))

    @property
    def jump(self) -> float:
        """How far a stimulus jumps in the middle of two speeds, as a part of its rms: the most of all materials."""
        return max(map(played.jump, self.materials.values()))

    @property
    def verdict(self) -> str:
        """One sentence, and a line for each thing that does not hold."""
        claimed = sum(one.claimed is not None for one in self.measured)
        budgets = len(self.played) + sum(len(one.truth) for one in self.pushed)
        every = f"{claimed} claimed bounds on errors, {len(self.outcomes)} invariants and {budgets} budgets"
        if not self.failed:
            return f"All {every} pass."
        return "\n".join([f"{len(self.broken)} of {every} fail:", *(f"  {line}" for line in self.broken)])


def run(
    extent: Extent, *, total: Callable[[int], None] = lambda _: None, tick: Callable[[], None] = lambda: None
) -> Numerics:
    """Measure everything and settle every case; `total` is told the number of steps, `tick` is called after each."""
    wanted, extremes = measurements(extent), [*cases.cases(), *played.cases(), *contact.cases()]
    total(len(wanted) + len(extremes) + len(MATERIALS) + len(extent.devices))
    measured, outcomes, budgets = [], [], list[Played]()
    for measure in wanted:
        measured.append(measure())
        tick()
    for case in extremes:
        outcomes.append(settle(case))
        tick()
    materials = {name: made_to_order(PAPER_SAMPLES, name) for name in MATERIALS}
    for name, spectra in materials.items():
        for unit in (played.IN_VOLTS, played.IN_M_S2):
            budgets += played.play(name, spectra, unit=unit)
        tick()
    pushed = list[Pushed]()
    for name in extent.devices:
        pushed.append(force.push(name))
        tick()
    hangs = (*played.conditions(materials, (20.0, *WITHIN_MM_S, 301.0, 400.0)), *contact.conditions())
    packages = {name: metadata.version(name) for name in ("palpate", "numpy", "scipy")}
    software = {**packages, "python": platform.python_version(), "oracle_epsilon": f"{oracle.extended_epsilon():.1e}"}
    return Numerics(software, tuple(measured), tuple(outcomes), tuple(budgets), tuple(pushed), hangs, materials)
