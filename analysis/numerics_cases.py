"""Extreme speeds and spectra: what must hold of every way to compute a stimulus."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from analysis import numerics_oracle as oracle
from analysis.numerics_invariants import (
    ALL_SPEEDS_MM_S,
    BAND_HZ,
    BINS,
    OUTPUT_RATES_HZ,
    Case,
    Seen,
    material,
    refused,
    some,
    within_claims,
)
from analysis.numerics_oracle import RATE_HZ, SPEEDS_MM_S
from experiment.synthesis.crinkle import CrinkleSpectra, at_speed, subtract
from experiment.synthesis.engine import FASTEST_FIRST, methods
from experiment.synthesis.spectra import inverse, spectrum

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
