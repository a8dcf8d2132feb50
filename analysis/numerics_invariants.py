"""An extreme case, what must hold of every way to compute a stimulus, and whether it does."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import floor

import numpy as np
from numpy.typing import NDArray

from analysis import numerics_oracle as oracle
from analysis.numerics_oracle import RATE_HZ, SPEEDS_MM_S
from experiment.errors import SynthesisError
from experiment.synthesis.crinkle import CrinkleSpectra
from experiment.synthesis.engine import FASTEST_FIRST, methods
from experiment.synthesis.first_block import FirstBlockRenderer
from experiment.synthesis.methods import Estimate, Renderer, denormal_error_m_s2

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
