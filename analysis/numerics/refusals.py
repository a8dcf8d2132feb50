"""Extreme responses and limits, and NaN and infinity in every input: what must be refused, and what must hold."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analysis.numerics import oracle
from analysis.numerics.cases import BINS, Case, Seen, material, refused
from analysis.numerics.inputs import (
    BINS_HZ,
    EITHER,
    FREQUENCIES_HZ,
    GAIN_LIMIT_V_PER_M_S2,
    LEVELS_V,
    Call,
    answers,
    changed,
    inputs,
    response,
)
from analysis.numerics.oracle import RATE_HZ, SPEEDS_MM_S
from experiment.errors import PalpateError
from experiment.synthesis import response as rig_response
from experiment.synthesis import shaping, voltages
from experiment.synthesis import shaping as driving
from experiment.synthesis.waveforms import BinsAtSpeed

Limit = Callable[[ArrayLike, float], tuple[NDArray[np.float64], int]]
"""The limiter: any samples and the largest magnitude that may pass -> samples within it, and how many were changed."""

LIMIT_M_S2 = 20.0

PREPARED = "volts prepared for a speed are those worked out at it, to 1e-12 of the largest"


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
        Case("response", "prepared", PREPARED, lambda: _prepared(1.0, answers())),
        Case("response", "prepared, a null at 300 Hz", PREPARED, lambda: _prepared(1.0, _with_a_null())),
        Case(
            "response", "prepared, 1e300 m/s^2", f"{PREPARED}; half are", lambda: _prepared(1e300, answers(), least=0.5)
        ),
        Case(
            "response",
            "prepared, denormals",
            f"{PREPARED}, or none",
            lambda: _prepared(oracle.LEAST, answers(), least=0),
        ),
    ]


def _shaped(coefficients: NDArray[np.float64], by: rig_response.Response) -> shaping.Shaped:
    return shaping.shape(coefficients, frequencies_hz=BINS_HZ, response=by, gain_limit_v_per_m_s2=GAIN_LIMIT_V_PER_M_S2)


def _with_a_null() -> NDArray[np.float64]:
    answered = answers()
    answered[np.argmin(np.abs(FREQUENCIES_HZ - 300.0))] = 0.0
    return answered


def _prepared(level_m_s2: float, answered: NDArray[np.float64], *, least: float = 1.0) -> Seen:
    rng = np.random.default_rng(8)
    of = material(level_m_s2 * np.ceil(rng.uniform(1.0, 9.0, (len(SPEEDS_MM_S), BINS))))
    by = rig_response.Response(FREQUENCIES_HZ, LEVELS_V, answered)
    gain_limit, off, held = GAIN_LIMIT_V_PER_M_S2, 0.0, 0
    basis = voltages.prepare(of, rate_hz=RATE_HZ, response=by, gain_limit_v_per_m_s2=gain_limit)
    feet_mm_s = np.linspace(SPEEDS_MM_S[0], voltages.FASTEST * SPEEDS_MM_S[-1], 37).tolist()
    for v in feet_mm_s:
        found, bins = basis(v), BinsAtSpeed(of, v)()
        if found is None:
            continue
        held += 1
        wanted_v, _ = driving.drive(bins, rate_hz=RATE_HZ, response=by, gain_limit_v_per_m_s2=gain_limit)
        off = np.maximum(off, np.abs(found[0] - wanted_v).max() / np.abs(wanted_v).max())
    seen = f"off by at most {off:.1g} of the largest; held at {held} of {len(feet_mm_s)} speeds"
    return bool(off <= 1e-12) and held >= least * len(feet_mm_s), seen


def _null() -> Seen:
    wanted = np.full(BINS_HZ.size, 0.05)
    made = _shaped(wanted, rig_response.Response(FREQUENCIES_HZ, LEVELS_V, _with_a_null()))
    gains = np.abs(made.coefficients_v) / wanted
    holds = bool(np.all(gains <= GAIN_LIMIT_V_PER_M_S2 * (1 + 1e-15))) and made.bounded.bins > 0
    return holds, f"at most {gains.max():.3g} V per m/s^2; bins bounded: {made.bounded.bins}"


def _not_rising(step: float) -> Seen:
    answered = answers()
    answered[20, 2] = answered[20, 1] + step
    return refused([("the table", lambda: rig_response.Response(FREQUENCIES_HZ, LEVELS_V, answered))])


def _empty() -> Seen:
    return refused([("the table", lambda: rig_response.Response(np.zeros(0), LEVELS_V, np.zeros((0, LEVELS_V.size))))])


def _undone() -> Seen:
    within = np.clip(BINS_HZ, FREQUENCIES_HZ[0], FREQUENCIES_HZ[-1]) == BINS_HZ
    wanted = np.where(within, np.random.default_rng(6).uniform(-4.0, 4.0, BINS_HZ.size), 0.0)
    made = _shaped(wanted, response())
    moved = rig_response.accelerations(made.coefficients_v[within], frequencies_hz=BINS_HZ[within], response=response())
    off = float(np.max(np.abs(moved - wanted[within]))) / 4.0
    return off <= 1e-12 and not made.saturated.bins + made.bounded.bins, f"off by {off:.1g} of the largest"


def _saturated() -> Seen:
    made = _shaped(np.full(BINS_HZ.size, 1e300), response())
    counted = made.saturated.bins + made.bounded.bins + made.outside.bins
    largest = float(np.max(np.abs(made.coefficients_v)))
    held = largest <= LEVELS_V[-1] and counted == BINS_HZ.size
    return held, f"at most {largest:.3g} V of {LEVELS_V[-1]:.3g} V; {counted} of {BINS_HZ.size} bins counted"


def _quiet(amplitude: float) -> Seen:
    made = _shaped(np.full(BINS_HZ.size, amplitude), response())
    largest = float(np.max(np.abs(made.coefficients_v)))
    lost = made.saturated.bins + made.bounded.bins + (made.outside.bins if amplitude == 0 else 0)
    return largest <= amplitude * GAIN_LIMIT_V_PER_M_S2 and not lost, f"at most {largest:.3g} V; bins lost: {lost}"


def _refusals() -> list[Case]:
    invariant = "refused with SynthesisError"
    return [Case("NaN and infinity", name, invariant, partial(_each, call, values)) for name, call, values in inputs()]


def _each(call: Call, values: dict[str, float]) -> Seen:
    return refused([(name, partial(call, value)) for name, value in values.items()])


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
    given = changed(wanted, value)
    made, count = limit(given, LIMIT_M_S2)
    same = np.array_equal(np.delete(made, 5), np.delete(wanted, 5))
    return same and bool(np.abs(made[5]) <= LIMIT_M_S2), f"{made[5]:g} m/s^2; {count} of {made.size} samples changed"
