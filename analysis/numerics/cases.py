"""Extreme speeds and spectra: what must hold of every way to compute a stimulus.

An extreme case, what must hold of every way to compute a stimulus, and whether it does.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import floor

import numpy as np
from numpy.typing import NDArray

from analysis.numerics import oracle
from analysis.numerics.oracle import RATE_HZ, SPEEDS_MM_S
from experiment.errors import SynthesisError
from experiment.synthesis.crinkle import CrinkleSpectra, at_speed, subtract
from experiment.synthesis.engine import FASTEST_FIRST, methods
from experiment.synthesis.first_block import FirstBlockRenderer
from experiment.synthesis.spectra import inverse, spectrum
from experiment.synthesis.waveforms import Estimate, Renderer, denormal_error_m_s2

OUTPUT_RATES_HZ = (48_000, 44_100, 2_000)
"""A whole multiple of the recordings' rate, none, and one that cannot carry every bin."""

BAND_HZ = (100.0, 1500.0)
"""What the band-pruned methods keep here: some bins at either end are left out."""

ALL_SPEEDS_MM_S = (0.0, 1e-6, 20.0, 50.0, 75.0, 100.0, 150.0, 170.0, 200.0, 250.0, 299.0, 300.0, 301.0, 650.0, 1e4)
"""Extremes, the measured speeds, those halfway, where the sign may change, and others."""

BINS = 60

Seen = tuple[bool, str]
"""Whether the invariant holds, and what was seen."""


@dataclass(frozen=True)
class Case:
    """One extreme case.

    Attributes:
        group: of cases.
        given: the input.
        invariant: what must hold.
        check: finds out.
    """

    group: str
    given: str
    invariant: str
    check: Callable[[], Seen]


@dataclass(frozen=True)
class Outcome:
    """What became of a case; attributes as in `Case`."""

    group: str
    given: str
    invariant: str
    holds: bool
    seen: str


def settle(case: Case) -> Outcome:
    """Find out whether a case's invariant holds; an exception that it does not expect, or a warning, breaks it."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            holds, seen = case.check()
        except Exception as error:
            holds, seen = False, f"{type(error).__name__}: {error}"
    return Outcome(case.group, case.given, case.invariant, holds, seen)


def refused(calls: Sequence[tuple[str, Callable[[], object]]], kind: type[Exception] = SynthesisError) -> Seen:
    """Whether each call raises an error of this kind, and which did not."""
    accepted = []
    for name, call in calls:
        try:
            call()
        except kind:
            continue
        except Exception as error:
            accepted.append(f"{name}: {type(error).__name__}")
        else:
            accepted.append(f"{name}: accepted")
    return not accepted, "; ".join(accepted) or f"{kind.__name__} for {', '.join(name for name, _ in calls)}"


def some(bins: int = BINS) -> NDArray[np.float64]:
    """Amplitudes at four speeds, none of them special, shape (4, bins)."""
    return np.abs(np.random.default_rng(11).normal(size=(4, bins)))


def material(amplitudes: NDArray[np.float64]) -> CrinkleSpectra:
    """A material of these amplitudes, and of random signs."""
    signs = np.random.default_rng(3).choice([-1.0, 1.0], size=amplitudes.shape)
    return CrinkleSpectra(np.array(SPEEDS_MM_S), RATE_HZ, amplitudes, signs)


def within_claims(
    spectra: CrinkleSpectra, speeds_mm_s: Sequence[float] = ALL_SPEEDS_MM_S, *, denormal: bool = False
) -> Seen:
    """Every method, at every output rate, against the oracle: error, length, counts, flags and first block.

    Args:
        spectra: of one material.
        speeds_mm_s: of the foot.
        denormal: floored bins are not compared: what rounds to zero before it is floored is none.
    """
    worst = {True: 0.0, False: 0.0}
    for rate_hz in OUTPUT_RATES_HZ:
        exact = {v: oracle.stimulus(spectra, speed_mm_s=v, output_rate_hz=rate_hz) for v in speeds_mm_s}
        for method in methods(BAND_HZ):
            if not exact[speeds_mm_s[0]].samples.size:
                without_a_sample = partial(method.prepare, spectra, output_rate_hz=rate_hz)
                holds, seen = refused([(f"{method.name}, {rate_hz} Hz, no sample", without_a_sample)])
                if not holds:
                    return False, seen
                continue
            claims = method.estimate(spectra, output_rate_hz=rate_hz)
            render = method.prepare(spectra, output_rate_hz=rate_hz)
            for v, wanted in exact.items():
                share, wrong = _compared(render, v, wanted, claims, counted=not denormal)
                if wrong:
                    return False, f"{method.name}, {v:g} mm/s, {rate_hz} Hz: {wrong}"
                worst[method in FASTEST_FIRST] = max(worst[method in FASTEST_FIRST], share)
    if not any(worst.values()):
        return True, "no error at all"
    # Rounded down, for what is just kept is kept.
    on_all, on_band = (floor(1000 * worst[whole]) / 1000 for whole in (True, False))
    return True, f"at most {on_all:.3f} of the error claimed; {on_band:.3f} where bins are left out"


def _compared(
    render: Renderer, v: float, wanted: oracle.Exact, claims: Estimate, *, counted: bool
) -> tuple[float, str]:
    """The error as a part of the one claimed; and what is wrong, empty where nothing is."""
    made = render(v)
    samples = made.waveform_m_s2
    if samples.shape != wanted.samples.shape:
        return 0.0, f"{samples.size} samples, not {wanted.samples.size}"
    if made.extrapolated != wanted.extrapolated:
        return 0.0, f"extrapolated: {made.extrapolated}"
    if counted and (made.floored_bins, made.dropped_bins) != (wanted.floored, wanted.dropped):
        got, right = (made.floored_bins, made.dropped_bins), (wanted.floored, wanted.dropped)
        return 0.0, f"bins floored and dropped: {got}, not {right}"
    share = _share(samples, wanted, claims.relative_error)
    if isinstance(render, FirstBlockRenderer) and claims.first_block_error is not None:
        first = render.begin(v).first_m_s2
        if not np.array_equal(first, samples[: first.size]):
            return 0.0, "the first block is not the beginning of the whole"
        block = replace(wanted, samples=wanted.samples[: first.size])
        share = max(share, _share(first, block, claims.first_block_error))
    return share, "" if share <= 1 else f"{share:.3g} of the error claimed"


def _share(samples: NDArray[np.float64], wanted: oracle.Exact, claim: float) -> float:
    rounding = np.longdouble(denormal_error_m_s2(wanted.bins))
    return float(oracle.error(samples, wanted) / (claim * wanted.scale + rounding))


ROUND_TRIP, TRANSCRIBED, PARSEVAL = 1e-13, 1e-12, 1e-13


def cases() -> list[Case]:
    """Every case of this module."""
    return [*_speeds(), *_spectra(), *_lengths(), *_oracle()]


def _speeds() -> list[Case]:
    spectra = material(some())
    claims = "every method keeps the error it claims, and counts floored and dropped bins"
    extremes = [Case("speed", f"{v:g} mm/s", claims, partial(within_claims, spectra, (v,))) for v in (0.0, 1e-6, 1e4)]
    exactly = [
        Case(
            "speed",
            f"exactly {v:g} mm/s",
            "the measured spectrum bit for bit, nothing floored; every method keeps the error it claims",
            partial(_measured, spectra, i),
        )
        for i, v in enumerate(SPEEDS_MM_S)
    ]
    nearly = [
        Case(
            "speed",
            f"{v:g} mm/s, one rounding below and above",
            "the same spectrum to 1e-13 of it; every method keeps the error it claims",
            partial(_beside, spectra, i),
        )
        for i, v in enumerate(SPEEDS_MM_S)
    ]
    return [*extremes, *exactly, *nearly]


def _measured(spectra: CrinkleSpectra, i: int) -> Seen:
    v = SPEEDS_MM_S[i]
    made = at_speed(spectra, speed_mm_s=v)
    if not np.array_equal(made.coefficients, spectra.amplitudes[i] * spectra.signs[i]):
        return False, f"off by up to {np.max(np.abs(np.abs(made.coefficients) - spectra.amplitudes[i])):.2g} m/s^2"
    if made.floored_bins or made.extrapolated:
        return False, f"{made.floored_bins} bins floored, extrapolated: {made.extrapolated}"
    return within_claims(spectra, (v,))


def _beside(spectra: CrinkleSpectra, i: int) -> Seen:
    speeds = [float(np.nextafter(SPEEDS_MM_S[i], towards)) for towards in (0.0, np.inf)]
    for v in speeds:
        step = np.abs(at_speed(spectra, speed_mm_s=v).coefficients - spectra.amplitudes[i] * spectra.signs[i])
        if np.any(step > 1e-13 * spectra.amplitudes[i].max()):
            return False, f"a jump of {step.max():.2g} m/s^2 at {v!r} mm/s"
    return within_claims(spectra, speeds)


def _spectra() -> list[Case]:
    one, falling, loud = np.zeros((4, BINS)), some(), some()
    one[:, 5] = [1.0, 2.0, 1.5, 3.0]
    falling[:, 4] = [3.0, 2.0, 1.0, 0.0]
    loud *= 1e300
    denormals = np.asarray(np.random.default_rng(5).integers(0, 50, size=(4, BINS)) * oracle.LEAST, dtype=np.float64)
    keeps = "finite; every method keeps the error it claims at every speed"
    tiny = f"{keeps}, rounding of denormals apart"
    return [
        Case("spectrum", "zeros", "every sample of every method is 0, at every speed", partial(_silent, one * 0)),
        Case("spectrum", "one bin", "the cosine of that bin, to 1e-13; and the errors claimed", partial(_cosine, one)),
        Case("spectrum", "denormals", tiny, partial(within_claims, material(denormals), denormal=True)),
        Case("spectrum", "1e300 m/s^2", keeps, partial(within_claims, material(loud))),
        Case("spectrum", "1e300 beside 1e-300 m/s^2", tiny, partial(within_claims, _beside_each_other())),
        Case("spectrum", "1.7e308 m/s^2 in every bin", "refused with SynthesisError", _overflowing),
        Case(
            "spectrum",
            "a bin that falls to zero",
            "on its line to 0, counted as floored beyond; every method keeps the error it claims",
            partial(_falls, material(falling)),
        ),
        Case(
            "spectrum",
            "panel louder than object everywhere",
            "nothing is left: every sample is 0, at every speed",
            _louder_panel,
        ),
    ]


def _beside_each_other() -> CrinkleSpectra:
    return material(np.outer([1e300, 1e-300, 1e300, 1e-300], some()[0]))


def _silent(amplitudes: NDArray[np.float64]) -> Seen:
    spectra = material(amplitudes)
    for method in methods(BAND_HZ):
        render = method.prepare(spectra, output_rate_hz=OUTPUT_RATES_HZ[0])
        for v in ALL_SPEEDS_MM_S:
            made = render(v)
            if np.any(made.waveform_m_s2 != 0) or made.floored_bins:
                return False, f"{method.name}, {v:g} mm/s: {np.abs(made.waveform_m_s2).max():g} m/s^2"
    return within_claims(spectra)


def _cosine(amplitudes: NDArray[np.float64]) -> Seen:
    spectra, v, rate_hz = material(amplitudes), 150.0, OUTPUT_RATES_HZ[0]
    k = int(np.flatnonzero(amplitudes[0])[0])
    amplitude = (amplitudes[1, k] + amplitudes[2, k]) / 2 * spectra.signs[1, k]
    t_s = (np.arange(BINS * rate_hz // RATE_HZ) + 0.5) / rate_hz
    wanted = amplitude * np.cos(2 * np.pi * (RATE_HZ * k / (2 * BINS)) * t_s)
    for method in FASTEST_FIRST:
        claim = method.estimate(spectra, output_rate_hz=rate_hz).relative_error
        made = method.prepare(spectra, output_rate_hz=rate_hz)(v).waveform_m_s2
        off = float(np.max(np.abs(made - wanted))) / abs(amplitude)
        if not off <= max(ROUND_TRIP, claim):
            return False, f"{method.name}: off by {off:.2g} of the amplitude"
    return within_claims(spectra)


def _overflowing() -> Seen:
    takes = np.random.default_rng(2).choice([-1.7e308, 1.7e308], size=(4, 3, BINS))
    return refused(
        [
            ("amplitudes", lambda: material(np.full((4, BINS), 1.7e308))),
            ("takes", lambda: _subtracted(takes, np.zeros((4, 3, BINS)))),
        ]
    )


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
    takes = np.random.default_rng(4).normal(size=(4, 3, BINS))
    spectra = _subtracted(takes, 2 * takes)
    if np.any(spectra.amplitudes != 0):
        return False, f"{np.count_nonzero(spectra.amplitudes)} bins are left"
    return _silent(spectra.amplitudes)


def _lengths() -> list[Case]:
    named = {1: "N = 1", 2: "N = 2", 9: "N = 9, odd", 15: "N = 15, odd", 59: "N = 59, prime", BINS: f"N = {BINS}"}
    invariant = (
        f"(1) as printed to {TRANSCRIBED:g}; (1) and (5) undo each other to {ROUND_TRIP:g} but for the mean; Parseval "
        f"to {PARSEVAL:g}; every method keeps the error it claims"
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
    invariant = "its fast sum is the sum taken term by term, to 1000 roundings of extended precision"
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
