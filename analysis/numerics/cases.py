"""What must hold of every way to compute a stimulus, at extreme speeds and for extreme spectra."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from math import floor, log2, sqrt

import numpy as np
from numpy.typing import NDArray

from palpate.analysis.numerics import oracle
from palpate.analysis.numerics.oracle import PAPER_SAMPLES, RATE_HZ, SPEEDS_MM_S
from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis import waveforms
from palpate.experiment.synthesis.crinkle import CrinkleSpectra, at_speed, subtract
from palpate.experiment.synthesis.spectra import Grid, inverse, inverse_on, spectrum, transformable
from palpate.experiment.synthesis.waveforms import ROUNDING, denormal_error_m_s2, transform_error

OUTPUT_RATES_HZ = (48_000, 44_100, 2_000)
"""A whole multiple of the recordings' rate, a rate that is none, and one that cannot carry every bin."""

ALL_SPEEDS_MM_S = (0.0, 1e-6, 20.0, 50.0, 75.0, 100.0, 150.0, 170.0, 200.0, 250.0, 299.0, 300.0, 301.0, 650.0, 1e4)
"""Extremes, the measured speeds, the speeds halfway between them, where the sign may change, and others."""

BINS = 60
"""Of the cases that the printed sum is tried on: of as many bins as a study has it would take minutes."""

FEET_MM_S = (0.0, 20.0, 75.0, 100.0, 170.0, 299.0, 301.0, 650.0, 1e4)
"""The speeds at which extreme spectra of as many bins as a study has are tried."""

AT_SPEED_ROUNDINGS = 8
"""Allowed for equation (3): `crinkle.at_speed` rounds a bin at most seven times, and one covers the second order."""

COSINE_ROUNDINGS = 13
"""Roundings, of 1, in a cosine of `cosines`: an angle below 2 pi is the product of a whole number below 2^53 and
pi / 2p, and so within 2.4 roundings of itself; its cosine within 2.4 max |x sin x| = 11.6, and one of its own."""

CHUNK_BYTES = 2**20
"""Memory for the terms that a printed sum adds up at a time; their phases take twice as much again."""

Render = Callable[[float], NDArray[np.float64]]
"""Speed of the foot, mm/s -> samples at the output rate, m/s^2, shape (n,)."""


@dataclass(frozen=True)
class Way:
    """A way to compute stimuli: the `claim` of its relative error on a grid, and `prepare` for an output rate in Hz.

    What is prepared does not depend on the speed; it renders stimuli, and has a size in bytes.
    """

    name: str
    claim: Callable[[Grid], float]
    prepare: Callable[[CrinkleSpectra, int], tuple[Render, int]]


def printed_sum_error(on: Grid) -> float:
    """Return the bound on the relative error of any sample of a printed sum, with blocks of 128 terms."""
    bins = on.carried
    return (AT_SPEED_ROUNDINGS + COSINE_ROUNDINGS + 20 + log2(bins)) * ROUNDING * sqrt(2 * bins)


def cosines(on: Grid, *, start: int, stop: int) -> NDArray[np.float64]:
    """Return cos(pi k q (i + 1/2) / p), shape (stop - start, carried - 1), each within `COSINE_ROUNDINGS` of 1."""
    odd = 2 * np.arange(start, stop, dtype=np.int64)[:, None] + 1
    phases = odd * (np.arange(1, on.carried, dtype=np.int64) * on.q)
    phases %= 4 * on.p
    return np.asarray(np.cos(phases * (np.pi / (2 * on.p))))


def _basis(spectra: CrinkleSpectra, output_rate_hz: int) -> tuple[Render, int]:
    basis = waveforms.prepare(spectra, material="simulated", output_rate_hz=output_rate_hz)
    return lambda speed_mm_s: basis.at(speed_mm_s).waveform_m_s2, basis.nbytes


def _inverse_dct(spectra: CrinkleSpectra, output_rate_hz: int) -> tuple[Render, int]:
    on = spectra.grid(output_rate_hz)
    transformable(on)
    return lambda speed_mm_s: inverse_on(at_speed(spectra, speed_mm_s=speed_mm_s).coefficients, on), spectra.nbytes


def _printed_sum(spectra: CrinkleSpectra, output_rate_hz: int) -> tuple[Render, int]:
    on = spectra.grid(output_rate_hz)
    rows = max(1, CHUNK_BYTES // (8 * on.carried))

    def render(speed_mm_s: float) -> NDArray[np.float64]:
        wanted = at_speed(spectra, speed_mm_s=speed_mm_s).coefficients[1 : on.carried]
        chunks = [
            (cosines(on, start=start, stop=min(start + rows, on.count)) * wanted).sum(axis=1)
            for start in range(0, on.count, rows)
        ]
        return np.concatenate(chunks)

    return render, spectra.nbytes + 3 * CHUNK_BYTES


BASIS = Way("basis waveforms", waveforms.relative_error, _basis)
INVERSE_DCT = Way("inverse DCT", lambda on: AT_SPEED_ROUNDINGS * ROUNDING + transform_error(on), _inverse_dct)
PRINTED_SUM = Way("printed sum", printed_sum_error, _printed_sum)
WAYS = (BASIS, INVERSE_DCT, PRINTED_SUM)
"""What sessions do; what they do beyond the basis waveforms; and equation (5) as printed, one cosine for each bin and
sample, which is slow and the oracle of the others."""

Seen = tuple[bool, str]
"""Whether the invariant holds, and what was seen."""


@dataclass(frozen=True)
class Case:
    """One extreme case: its input, the invariant that must hold, and the check that finds out."""

    group: str
    given: str
    invariant: str
    check: Callable[[], Seen]


@dataclass(frozen=True)
class Outcome:
    """A case, whether its invariant holds, and what was seen."""

    group: str
    given: str
    invariant: str
    holds: bool
    seen: str


def settle(case: Case) -> Outcome:
    """Return whether a case's invariant holds; an exception that it does not expect, or a warning, breaks it."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            holds, seen = case.check()
        except Exception as error:
            holds, seen = False, f"{type(error).__name__}: {error}"
    return Outcome(case.group, case.given, case.invariant, holds, seen)


def refused(calls: Sequence[tuple[str, Callable[[], object]]]) -> Seen:
    """Return whether every call raises a `SynthesisError`, and which does not."""
    accepted = []
    for name, call in calls:
        try:
            call()
        except SynthesisError:
            continue
        except Exception as error:
            accepted.append(f"{name}: {type(error).__name__}")
        else:
            accepted.append(f"{name}: accepted")
    return not accepted, "; ".join(accepted) or f"SynthesisError for {', '.join(name for name, _ in calls)}"


def some(bins: int = BINS) -> NDArray[np.float64]:
    """Return random amplitudes at four speeds, shape (4, bins)."""
    return np.abs(np.random.default_rng(11).normal(size=(4, bins)))


def material(amplitudes: NDArray[np.float64]) -> CrinkleSpectra:
    """Return a material with these amplitudes and random signs."""
    signs = np.random.default_rng(3).choice([-1.0, 1.0], size=amplitudes.shape)
    return CrinkleSpectra(np.array(SPEEDS_MM_S), RATE_HZ, amplitudes, signs)


def ways_of(spectra: CrinkleSpectra) -> tuple[Way, ...]:
    """Return the ways that a case is tried on."""
    return WAYS if spectra.samples <= BINS else (BASIS, INVERSE_DCT)


def within_claims(
    spectra: CrinkleSpectra, speeds_mm_s: Sequence[float] | None = None, *, denormal: bool = False
) -> Seen:
    """Compare ways with the oracle at every output rate; `denormal` bins that round to zero are not floored."""
    worst, ways = 0.0, ways_of(spectra)
    if speeds_mm_s is None:
        speeds_mm_s = ALL_SPEEDS_MM_S if spectra.samples <= BINS else FEET_MM_S
    for rate_hz in OUTPUT_RATES_HZ:
        exact = {v: oracle.stimulus(spectra, speed_mm_s=v, output_rate_hz=rate_hz) for v in speeds_mm_s}
        if not exact[speeds_mm_s[0]].samples.size:
            calls = [(f"{way.name}, {rate_hz} Hz, no sample", partial(way.prepare, spectra, rate_hz)) for way in ways]
            holds, seen = refused(calls)
            if not holds:
                return False, seen
            continue
        for way in ways:
            claim, (render, _) = way.claim(spectra.grid(rate_hz)), way.prepare(spectra, rate_hz)
            for v, wanted in exact.items():
                samples = render(v)
                at = f"{way.name}, {v:g} mm/s, {rate_hz} Hz"
                if samples.shape != wanted.samples.shape:
                    return False, f"{at}: {samples.size} samples, not {wanted.samples.size}"
                rounding = np.longdouble(denormal_error_m_s2(wanted.bins))
                share = float(oracle.error(samples, wanted) / (claim * wanted.scale + rounding))
                if not share <= 1:
                    return False, f"{at}: {share:.3g} of the error claimed"
                worst = max(worst, share)
        if wrong := _miscounted(spectra, rate_hz, exact, counted=not denormal):
            return False, wrong
    if not worst:
        return True, "no error at all"
    # Rounded down, so that a claim that is just kept does not look broken.
    return True, f"at most {floor(1000 * worst) / 1000:.3f} of the error claimed"


def _miscounted(spectra: CrinkleSpectra, rate_hz: int, exact: dict[float, oracle.Exact], *, counted: bool) -> str:
    """Return what a stimulus states wrongly about itself; empty where nothing is wrong."""
    basis = waveforms.prepare(spectra, material="simulated", output_rate_hz=rate_hz)
    for v, wanted in exact.items():
        stimulus = basis.at(v)
        if stimulus.extrapolated != wanted.extrapolated:
            return f"{v:g} mm/s, {rate_hz} Hz: extrapolated: {stimulus.extrapolated}"
        got, right = (stimulus.floored_bins, spectra.dropped(basis.on)), (wanted.floored, wanted.dropped)
        if counted and got != right:
            return f"{v:g} mm/s, {rate_hz} Hz: bins floored and dropped: {got}, not {right}"
    return ""


ROUND_TRIP, TRANSCRIBED, PARSEVAL = 1e-13, 1e-12, 1e-13


def cases() -> list[Case]:
    """Return every case of a stimulus in m/s^2."""
    return [*_speeds(), *_spectra(), *_lengths(), *_oracle()]


def _speeds() -> list[Case]:
    spectra = material(some(PAPER_SAMPLES))
    claims = "each method stays within its claimed error, and counts floored and dropped bins"
    exact = "the measured spectrum bit for bit, nothing floored; each method stays within its claimed error"
    near = "the same spectrum within 1e-13; each method stays within its claimed error"
    places = list(enumerate(SPEEDS_MM_S))
    beside = "one rounding step below and above"
    return [
        *(Case("speed", f"{v:g} mm/s", claims, partial(within_claims, spectra, (v,))) for v in (0.0, 1e-6, 1e4)),
        *(Case("speed", f"exactly {v:g} mm/s", exact, partial(_measured, spectra, i)) for i, v in places),
        *(Case("speed", f"{v:g} mm/s, {beside}", near, partial(_steps_beside, spectra, i)) for i, v in places),
    ]


def _measured(spectra: CrinkleSpectra, i: int) -> Seen:
    v = SPEEDS_MM_S[i]
    made = at_speed(spectra, speed_mm_s=v)
    if not np.array_equal(made.coefficients, spectra.amplitudes[i] * spectra.signs[i]):
        return False, f"off by up to {np.max(np.abs(np.abs(made.coefficients) - spectra.amplitudes[i])):.2g} m/s^2"
    if made.floored_bins or made.extrapolated:
        return False, f"{made.floored_bins} bins floored, extrapolated: {made.extrapolated}"
    return within_claims(spectra, (v,))


def _steps_beside(spectra: CrinkleSpectra, i: int) -> Seen:
    speeds = [float(np.nextafter(SPEEDS_MM_S[i], towards)) for towards in (0.0, np.inf)]
    for v in speeds:
        step = np.abs(at_speed(spectra, speed_mm_s=v).coefficients - spectra.amplitudes[i] * spectra.signs[i])
        if np.any(step > 1e-13 * spectra.amplitudes[i].max()):
            return False, f"a jump of {step.max():.2g} m/s^2 at {v!r} mm/s"
    return within_claims(spectra, speeds)


def _spectra() -> list[Case]:
    one, falling, loud = np.zeros((4, PAPER_SAMPLES)), some(PAPER_SAMPLES), some(PAPER_SAMPLES)
    one[:, 5] = [1.0, 2.0, 1.5, 3.0]
    falling[:, 4] = [3.0, 2.0, 1.0, 0.0]
    loud *= 1e300
    mixed = np.outer([1e300, 1e-300, 1e300, 1e-300], some(PAPER_SAMPLES)[0])
    few = np.random.default_rng(5).integers(0, 50, size=(4, PAPER_SAMPLES))
    denormals = np.asarray(few * oracle.LEAST, dtype=np.float64)
    falls = "on its line to 0, counted as floored after that; each method stays within its claimed error"
    nothing = "every sample is 0 at every speed"
    keeps = "finite; each method stays within its claimed error at every speed"
    tiny = f"{keeps}, except for rounding of denormals"
    return [
        Case("spectrum", "zeros", "every sample of each method is 0 at every speed", partial(_silent, one * 0)),
        Case("spectrum", "one bin", "the cosine of that bin, within 1e-13; the claimed errors", partial(_cosine, one)),
        Case("spectrum", "denormals", tiny, partial(within_claims, material(denormals), denormal=True)),
        Case("spectrum", "1e300 m/s^2", keeps, partial(within_claims, material(loud))),
        Case("spectrum", "1e300 beside 1e-300 m/s^2", tiny, partial(within_claims, material(mixed))),
        Case("spectrum", "1.7e308 m/s^2 in every bin", "refused with SynthesisError", _overflowing),
        Case("spectrum", "a bin that falls to zero", falls, partial(_falls, material(falling))),
        Case("spectrum", "panel louder than object everywhere", nothing, _louder_panel),
    ]


def _silent(amplitudes: NDArray[np.float64]) -> Seen:
    spectra = material(amplitudes)
    for way in ways_of(spectra):
        render, _ = way.prepare(spectra, OUTPUT_RATES_HZ[0])
        for v in ALL_SPEEDS_MM_S:
            if np.any(render(v) != 0):
                return False, f"{way.name}, {v:g} mm/s: {np.abs(render(v)).max():g} m/s^2"
    return within_claims(spectra)


def _cosine(amplitudes: NDArray[np.float64]) -> Seen:
    spectra, v, rate_hz = material(amplitudes), 150.0, OUTPUT_RATES_HZ[0]
    k = int(np.flatnonzero(amplitudes[0])[0])
    amplitude = (amplitudes[1, k] + amplitudes[2, k]) / 2 * spectra.signs[1, k]
    n = spectra.samples
    t_s = (np.arange(n * rate_hz // RATE_HZ) + 0.5) / rate_hz
    wanted = amplitude * np.cos(2 * np.pi * (RATE_HZ * k / (2 * n)) * t_s)
    for way in ways_of(spectra):
        render, _ = way.prepare(spectra, rate_hz)
        off = float(np.max(np.abs(render(v) - wanted))) / abs(amplitude)
        if not off <= max(ROUND_TRIP, way.claim(spectra.grid(rate_hz))):
            return False, f"{way.name}: off by {off:.2g} of the amplitude"
    return within_claims(spectra)


def _overflowing() -> Seen:
    takes = np.random.default_rng(2).choice([-1.7e308, 1.7e308], size=(4, 3, PAPER_SAMPLES))
    loud = "amplitudes", lambda: material(np.full((4, PAPER_SAMPLES), 1.7e308))
    return refused([loud, ("takes", lambda: _subtracted(takes, np.zeros_like(takes)))])


def _falls(spectra: CrinkleSpectra) -> Seen:
    for v, wanted in ((250.0, 0.5), (299.0, 0.01), (300.0, 0.0)):
        got = abs(at_speed(spectra, speed_mm_s=v).coefficients[4])
        if abs(got - wanted) > 1e-15:
            return False, f"{got!r} m/s^2 at {v:g} mm/s, not {wanted:g}"
    beyond = at_speed(spectra, speed_mm_s=301.0)
    if beyond.coefficients[4] != 0 or not beyond.floored_bins:
        return False, f"{beyond.coefficients[4]!r} m/s^2 at 301 mm/s, {beyond.floored_bins} bins floored"
    return within_claims(spectra)


def _subtracted(panel_object: NDArray[np.float64], panel: NDArray[np.float64]) -> CrinkleSpectra:
    return subtract(speeds_mm_s=SPEEDS_MM_S, rate_hz=RATE_HZ, panel_object_takes=panel_object, panel_takes=panel)


def _louder_panel() -> Seen:
    takes = np.random.default_rng(4).normal(size=(4, 3, PAPER_SAMPLES))
    spectra = _subtracted(takes, 2 * takes)
    if np.any(spectra.amplitudes != 0):
        return False, f"{np.count_nonzero(spectra.amplitudes)} bins are left"
    return _silent(spectra.amplitudes)


def _lengths() -> list[Case]:
    named = {1: "N = 1", 2: "N = 2", 9: "N = 9, odd", 15: "N = 15, odd", 59: "N = 59, prime", BINS: f"N = {BINS}"}
    invariant = (
        f"(1) as printed within {TRANSCRIBED:g}; (1) and (5) are inverses within {ROUND_TRIP:g}, except for the mean; "
        f"Parseval within {PARSEVAL:g}; each method, even the printed sum, stays within its claimed error"
    )
    return [Case("length", name, invariant, partial(_length, n)) for n, name in named.items()]


def _length(n: int) -> Seen:
    y = np.random.default_rng(n).normal(size=n)
    c, printed = spectrum(y), oracle.forward(y)
    if np.max(np.abs(c - printed)) > TRANSCRIBED * np.max(np.abs(printed)):
        return False, f"(1) off by {np.max(np.abs(c - printed)):.2g} m/s^2"
    back = inverse(c)
    if np.max(np.abs(back - (y - y.mean()))) > ROUND_TRIP * np.max(np.abs(y)):
        return False, f"off by {np.max(np.abs(back - (y - y.mean()))):.2g} m/s^2 after (1) and (5)"
    power, by_parseval = float(np.sum(y**2)), n * (c[0] ** 2 / 4 + float(np.sum(c[1:] ** 2)) / 2)
    if abs(power - by_parseval) > PARSEVAL * power:
        return False, f"Parseval off by {abs(power - by_parseval) / power:.2g}"
    return within_claims(material(some(n)))


def _oracle() -> list[Case]:
    invariant = "its fast sum equals the term-by-term sum within 1000 rounding steps of extended precision"
    return [Case("oracle", f"{rate_hz} Hz", invariant, partial(_term_by_term, rate_hz)) for rate_hz in OUTPUT_RATES_HZ]


def _term_by_term(rate_hz: int) -> Seen:
    spectra, v = material(some()), 170.0
    exact = oracle.stimulus(spectra, speed_mm_s=v, output_rate_hz=rate_hz)
    wanted, _, _ = oracle.spectrum_at(spectra, v)
    # t = (i + 1/2) / F' in units of the recording's N / F seconds is (2 i + 1) F / (2 N F').
    numerators = (2 * np.arange(exact.samples.size) + 1) * RATE_HZ
    terms = oracle.term_by_term(wanted[: BINS - exact.dropped], numerators=numerators, denominator=2 * BINS * rate_hz)
    off = float(np.max(np.abs(terms - exact.samples)) / exact.scale)
    return off <= 1000 * oracle.extended_epsilon(), f"off by {off:.1g} of the rms"
