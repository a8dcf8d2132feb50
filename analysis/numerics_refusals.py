"""Extreme responses and limits, and NaN and infinity in every input: what must be refused, and what must hold."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analysis import numerics_oracle as oracle
from analysis.numerics_invariants import BAND_HZ, BINS, OUTPUT_RATES_HZ, Case, Seen, material, refused, some
from analysis.numerics_oracle import RATE_HZ, SPEEDS_MM_S
from experiment.errors import PalpateError
from experiment.synthesis import crinkle, engine, methods, noise, pruning, shaping, spectra
from experiment.synthesis.first_block import FirstBlockFirst

Limit = Callable[[ArrayLike, float], tuple[NDArray[np.float64], int]]
"""The limiter: any samples and the largest magnitude that may pass -> samples within it, and how many were changed."""

Call = Callable[[float], object]
EITHER = {"NaN": np.nan, "infinity": np.inf, "-infinity": -np.inf}
NAN = {"NaN": np.nan}
NO_LIMIT = {"NaN": np.nan, "-infinity": -np.inf}
"""Where infinity is a bound like any other."""

FREQUENCIES_HZ, LEVELS_V = np.linspace(10.0, 600.0, 60), np.sqrt(2) * np.array([0.1, 0.5, 1.0, 1.5])
BINS_HZ = np.linspace(0.0, 700.0, 50)
GAIN_LIMIT_V_PER_M_S2, LIMIT_M_S2 = 2.0, 20.0


def cases(limit: Limit) -> list[Case]:
    """Every case of this module.

    Args:
        limit: the limiter, which stands with the devices; whoever may import both hands it in.
    """
    return [*_responses(), *_refusals(), *_limiter(limit)]


def _responses() -> list[Case]:
    rising = "refused with SynthesisError: there is no inverse"
    return [
        Case("response", "a null: no answer at 300 Hz", "no bin takes more volts than the limit of the gain", _null),
        Case("response", "a plateau between two levels", rising, partial(_not_rising, 0.0)),
        Case("response", "a reversal between two levels", rising, partial(_not_rising, -0.1)),
        Case("response", "an empty table", "refused with SynthesisError", _empty),
        Case("response", "as measured", "what shaping asks for moves the panel as asked, to 1e-12", _undone),
        Case("response", "1e300 m/s^2 in every bin", "the highest level, each bin counted once", _saturated),
        Case("response", "zeros", "no volts, nothing lost", partial(_quiet, 0.0)),
        Case("response", "denormals", "finite, below the lowest level", partial(_quiet, oracle.LEAST)),
    ]


def _answers() -> NDArray[np.float64]:
    return oracle.answered_m_s2(FREQUENCIES_HZ[:, None], LEVELS_V)


def _response() -> shaping.Response:
    return shaping.Response(FREQUENCIES_HZ, LEVELS_V, _answers())


def _shaped(coefficients: NDArray[np.float64], response: shaping.Response) -> shaping.Shaped:
    return shaping.shape(
        coefficients, frequencies_hz=BINS_HZ, response=response, gain_limit_v_per_m_s2=GAIN_LIMIT_V_PER_M_S2
    )


def _null() -> Seen:
    answers = _answers()
    answers[np.argmin(np.abs(FREQUENCIES_HZ - 300.0))] = 0.0
    wanted = np.full(BINS_HZ.size, 0.05)
    made = _shaped(wanted, shaping.Response(FREQUENCIES_HZ, LEVELS_V, answers))
    gains = np.abs(made.coefficients_v) / wanted
    holds = bool(np.all(gains <= GAIN_LIMIT_V_PER_M_S2 * (1 + 1e-15))) and made.bounded.bins > 0
    return holds, f"at most {gains.max():.3g} V per m/s^2; bins bounded: {made.bounded.bins}"


def _not_rising(step: float) -> Seen:
    answers = _answers()
    answers[20, 2] = answers[20, 1] + step
    return refused([("the table", lambda: shaping.Response(FREQUENCIES_HZ, LEVELS_V, answers))])


def _empty() -> Seen:
    return refused([("the table", lambda: shaping.Response(np.zeros(0), LEVELS_V, np.zeros((0, LEVELS_V.size))))])


def _undone() -> Seen:
    within = np.clip(BINS_HZ, FREQUENCIES_HZ[0], FREQUENCIES_HZ[-1]) == BINS_HZ
    wanted = np.where(within, np.random.default_rng(6).uniform(-4.0, 4.0, BINS_HZ.size), 0.0)
    made = _shaped(wanted, _response())
    moved = shaping.accelerations(made.coefficients_v[within], frequencies_hz=BINS_HZ[within], response=_response())
    off = float(np.max(np.abs(moved - wanted[within]))) / 4.0
    return off <= 1e-12 and not made.saturated.bins + made.bounded.bins, f"off by {off:.1g} of the largest"


def _saturated() -> Seen:
    made = _shaped(np.full(BINS_HZ.size, 1e300), _response())
    counted = made.saturated.bins + made.bounded.bins + made.outside.bins
    largest = float(np.max(np.abs(made.coefficients_v)))
    held = largest <= LEVELS_V[-1] and counted == BINS_HZ.size
    return held, f"at most {largest:.3g} V of {LEVELS_V[-1]:.3g} V; {counted} of {BINS_HZ.size} bins counted"


def _quiet(amplitude: float) -> Seen:
    made = _shaped(np.full(BINS_HZ.size, amplitude), _response())
    largest = float(np.max(np.abs(made.coefficients_v)))
    lost = made.saturated.bins + made.bounded.bins + (made.outside.bins if amplitude == 0 else 0)
    return largest <= amplitude * GAIN_LIMIT_V_PER_M_S2 and not lost, f"at most {largest:.3g} V; bins lost: {lost}"


def _refusals() -> list[Case]:
    invariant = "refused with SynthesisError"
    return [Case("NaN and infinity", name, invariant, partial(_each, call, values)) for name, call, values in _inputs()]


def _each(call: Call, values: dict[str, float]) -> Seen:
    return refused([(name, partial(call, value)) for name, value in values.items()])


def _with(values: NDArray[np.float64], value: float) -> NDArray[np.float64]:
    """The same with one element in the middle replaced."""
    changed = values.copy()
    changed.flat[changed.size // 2] = value
    return changed


def _inputs() -> list[tuple[str, Call, dict[str, float]]]:
    """Every number that a public function takes: its name, what calls it so, values to refuse."""
    return [*_of_spectra(), *_of_crinkle(), *_of_methods(), *_of_shaping(), *_of_noise()]


def _of_spectra() -> list[tuple[str, Call, dict[str, float]]]:
    c, f = some()[0], spectra.bin_frequencies_hz(bins=BINS, rate_hz=RATE_HZ)
    rates: dict[str, Any] = {"rate_hz": RATE_HZ, "output_rate_hz": OUTPUT_RATES_HZ[0]}
    on = spectra.grid(samples=BINS, bins=BINS, **rates)
    distance = spectra.dissimilarity
    return [
        ("finite: values", lambda x: spectra.finite(_with(c, x), what="c"), EITHER),
        ("spectrum: samples", lambda x: spectra.spectrum(_with(c, x)), EITHER),
        ("bin_frequencies_hz: rate_hz", lambda x: spectra.bin_frequencies_hz(bins=BINS, rate_hz=x), EITHER),
        ("inverse: coefficients", lambda x: spectra.inverse(_with(c, x)), EITHER),
        ("inverse_on: coefficients", lambda x: spectra.inverse_on(_with(c, x), on), EITHER),
        ("inverse_at_rate: coefficients", lambda x: spectra.inverse_at_rate(_with(c, x), **rates), EITHER),
        ("inverse_at_rate: rate_hz", lambda x: spectra.inverse_at_rate(c, **{**rates, "rate_hz": x}), EITHER),
        (
            "inverse_at_rate: output_rate_hz",
            lambda x: spectra.inverse_at_rate(c, **{**rates, "output_rate_hz": x}),
            EITHER,
        ),
        ("grid: rate_hz", lambda x: spectra.grid(samples=BINS, bins=BINS, **{**rates, "rate_hz": x}), EITHER),
        (
            "grid: output_rate_hz",
            lambda x: spectra.grid(samples=BINS, bins=BINS, **{**rates, "output_rate_hz": x}),
            EITHER,
        ),
        ("dissimilarity: a", lambda x: distance(_with(c, x), c, frequencies_hz=f), EITHER),
        ("dissimilarity: b", lambda x: distance(c, _with(c, x), frequencies_hz=f), EITHER),
        ("dissimilarity: frequencies_hz", lambda x: distance(c, c, frequencies_hz=_with(f, x)), EITHER),
        ("dissimilarity: band_hz, lowest", lambda x: distance(c, c, frequencies_hz=f, band_hz=(x, 500.0)), NAN),
        ("dissimilarity: band_hz, highest", lambda x: distance(c, c, frequencies_hz=f, band_hz=(0.0, x)), NAN),
        (
            "dissimilarity_matrix: spectra",
            lambda x: spectra.dissimilarity_matrix(_with(some(), x), frequencies_hz=f),
            EITHER,
        ),
        (
            "dissimilarity_matrix: frequencies_hz",
            lambda x: spectra.dissimilarity_matrix(some(), frequencies_hz=_with(f, x)),
            EITHER,
        ),
        (
            "dissimilarity_matrix: band_hz, lowest",
            lambda x: spectra.dissimilarity_matrix(some(), frequencies_hz=f, band_hz=(x, 500.0)),
            NAN,
        ),
        (
            "dissimilarity_matrix: band_hz, highest",
            lambda x: spectra.dissimilarity_matrix(some(), frequencies_hz=f, band_hz=(0.0, x)),
            NAN,
        ),
    ]


def _of_crinkle() -> list[tuple[str, Call, dict[str, float]]]:
    a, speeds, takes = some(), np.array(SPEEDS_MM_S), np.ones((4, 3, BINS))
    of, rate_hz = material(a), OUTPUT_RATES_HZ[0]
    make = partial(crinkle.CrinkleSpectra, rate_hz=RATE_HZ)
    subtract = partial(crinkle.subtract, rate_hz=RATE_HZ)
    return [
        ("rising: speeds_mm_s", lambda x: crinkle.rising(_with(speeds, x)), EITHER),
        ("foot_speed: speed_mm_s", crinkle.foot_speed, EITHER),
        (
            "CrinkleSpectra: speeds_mm_s",
            lambda x: make(speeds_mm_s=_with(speeds, x), amplitudes=a, signs=of.signs),
            EITHER,
        ),
        (
            "CrinkleSpectra: amplitudes",
            lambda x: make(speeds_mm_s=speeds, amplitudes=_with(a, x), signs=of.signs),
            EITHER,
        ),
        ("CrinkleSpectra: signs", lambda x: make(speeds_mm_s=speeds, amplitudes=a, signs=_with(of.signs, x)), EITHER),
        (
            "subtract: speeds_mm_s",
            lambda x: subtract(speeds_mm_s=_with(speeds, x), panel_object_takes=takes, panel_takes=takes),
            EITHER,
        ),
        (
            "subtract: panel_object_takes",
            lambda x: subtract(speeds_mm_s=speeds, panel_object_takes=_with(takes, x), panel_takes=takes),
            EITHER,
        ),
        (
            "subtract: panel_takes",
            lambda x: subtract(speeds_mm_s=speeds, panel_object_takes=takes, panel_takes=_with(takes, x)),
            EITHER,
        ),
        ("at_speed: speed_mm_s", lambda x: crinkle.at_speed(of, speed_mm_s=x), EITHER),
        ("synthesise: speed_mm_s", lambda x: crinkle.synthesise(of, speed_mm_s=x, output_rate_hz=rate_hz), EITHER),
    ]


def _of_methods() -> list[tuple[str, Call, dict[str, float]]]:
    of, rate_hz = material(some()), OUTPUT_RATES_HZ[0]
    on, band_hz = of.grid(rate_hz), (100.0, 500.0)
    share = partial(pruning.largest_share, of, carried=on.carried)
    loudest = partial(pruning.loudest_outside, of)
    begin = FirstBlockFirst().prepare(of, output_rate_hz=rate_hz).begin
    choose = partial(engine.choose, of, output_rate_hz=rate_hz)
    rendered = [
        (f"{method.name}: speed_mm_s", method.prepare(of, output_rate_hz=rate_hz), EITHER)
        for method in engine.methods(BAND_HZ)
    ]
    return [
        *rendered,
        ("first block alone: speed_mm_s", begin, EITHER),
        ("choose: allowed_relative_error", lambda x: choose(allowed_relative_error=x), NAN),
        ("choose: allowed_memory_bytes", lambda x: choose(allowed_memory_bytes=x), NAN),
        ("choose: band_hz, lowest", lambda x: choose(band_hz=(x, 500.0)), EITHER),
        ("choose: band_hz, highest", lambda x: choose(band_hz=(0.0, x)), NAN),
        ("prune: band_hz, lowest", lambda x: pruning.prune(of, band_hz=(x, 500.0)), EITHER),
        ("prune: band_hz, highest", lambda x: pruning.prune(of, band_hz=(0.0, x)), NAN),
        ("largest_share: band_hz, lowest", lambda x: share(band_hz=(x, 500.0)), EITHER),
        ("largest_share: band_hz, highest", lambda x: share(band_hz=(0.0, x)), NAN),
        ("loudest_outside: band_hz, lowest", lambda x: loudest(band_hz=(x, 500.0), fastest_mm_s=600.0), EITHER),
        ("loudest_outside: band_hz, highest", lambda x: loudest(band_hz=(0.0, x), fastest_mm_s=600.0), NAN),
        ("loudest_outside: fastest_mm_s", lambda x: loudest(band_hz=band_hz, fastest_mm_s=x), EITHER),
        ("rms: amplitudes", lambda x: methods.rms(_with(some(), x), on), EITHER),
    ]


def _of_shaping() -> list[tuple[str, Call, dict[str, float]]]:
    c, response = np.ones(BINS_HZ.size), _response()
    f = np.linspace(20.0, 500.0, c.size)
    shape = partial(shaping.shape, response=response, gain_limit_v_per_m_s2=GAIN_LIMIT_V_PER_M_S2)
    drive = partial(shaping.drive, rate_hz=RATE_HZ, response=response)
    move = partial(shaping.accelerations, response=response)
    within: Callable[..., object] = partial(drive, c, gain_limit_v_per_m_s2=GAIN_LIMIT_V_PER_M_S2)
    unbounded = partial(shaping.shape, c, frequencies_hz=f, response=response)
    return [
        (
            "Response: frequencies_hz",
            lambda x: shaping.Response(_with(FREQUENCIES_HZ, x), LEVELS_V, _answers()),
            EITHER,
        ),
        ("Response: levels_v", lambda x: shaping.Response(FREQUENCIES_HZ, _with(LEVELS_V, x), _answers()), EITHER),
        (
            "Response: accelerations_m_s2",
            lambda x: shaping.Response(FREQUENCIES_HZ, LEVELS_V, _with(_answers(), x)),
            EITHER,
        ),
        ("not_rising: accelerations_m_s2", lambda x: shaping.not_rising(_with(_answers(), x)), EITHER),
        ("shape: coefficients", lambda x: shape(_with(c, x), frequencies_hz=f), EITHER),
        ("shape: frequencies_hz", lambda x: shape(c, frequencies_hz=_with(f, x)), EITHER),
        ("shape: gain_limit_v_per_m_s2", lambda x: unbounded(gain_limit_v_per_m_s2=x), EITHER),
        ("accelerations: voltages_v", lambda x: move(_with(c, x), frequencies_hz=f), EITHER),
        ("accelerations: frequencies_hz", lambda x: move(c, frequencies_hz=_with(f, x)), EITHER),
        ("drive: waveform_m_s2", lambda x: drive(_with(c, x), gain_limit_v_per_m_s2=GAIN_LIMIT_V_PER_M_S2), EITHER),
        ("drive: gain_limit_v_per_m_s2", lambda x: drive(c, gain_limit_v_per_m_s2=x), EITHER),
        ("drive: limit_m_s2", lambda x: within(limit_m_s2=x), NO_LIMIT),
        ("drive: limit_v", lambda x: within(limit_v=x), NO_LIMIT),
    ]


def _of_noise() -> list[tuple[str, Call, dict[str, float]]]:
    make: Callable[..., object] = partial(noise.noise, colour="pink", rng=np.random.default_rng(1))
    return [
        ("noise: samples", lambda x: make(samples=x, rate_hz=OUTPUT_RATES_HZ[0]), EITHER),
        ("noise: rate_hz", lambda x: make(samples=OUTPUT_RATES_HZ[0], rate_hz=x), EITHER),
    ]


def _limiter(limit: Limit) -> list[Case]:
    samples = {**EITHER, "1e300": 1e300, "denormals": oracle.LEAST}
    invariant = f"finite and within {LIMIT_M_S2:g} m/s^2, every other sample as it was"
    return [
        *(Case("limiter", name, invariant, partial(_limited, limit, value)) for name, value in samples.items()),
        Case(
            "limiter",
            "NaN and infinity as the limit",
            "refused with PalpateError",
            lambda: refused([(name, partial(limit, np.ones(3), x)) for name, x in EITHER.items()], PalpateError),
        ),
    ]


def _limited(limit: Limit, value: float) -> Seen:
    wanted = np.linspace(-1.0, 1.0, 11)
    given = _with(wanted, value)
    made, changed = limit(given, LIMIT_M_S2)
    same = np.array_equal(np.delete(made, 5), np.delete(wanted, 5))
    return same and bool(np.abs(made[5]) <= LIMIT_M_S2), f"{made[5]:g} m/s^2; {changed} of {made.size} samples changed"
