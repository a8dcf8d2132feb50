"""Every number that a public function of synthesis takes is refused as NaN and infinity, and extreme responses hold."""

from __future__ import annotations

import ast
import importlib
import inspect
import pkgutil
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from palpate.analysis.numerics import oracle
from palpate.analysis.numerics.cases import BINS, OUTPUT_RATES_HZ, material, some
from palpate.analysis.numerics.oracle import RATE_HZ, SPEEDS_MM_S
from palpate.experiment import synthesis
from palpate.experiment.errors import SynthesisError
from palpate.experiment.session.kinds.footstep import sampling
from palpate.experiment.synthesis import budget, crinkle, felt, noticing, shaping, spectra, voltages, waveforms
from palpate.experiment.synthesis.signals import dissimilarity, noise, weighting
from tests.approved import Refuses
from tests.experiment.synthesis.measured import accelerations

Call = Callable[[float], object]
EITHER = {"NaN": np.nan, "infinity": np.inf, "-infinity": -np.inf}
NAN = {"NaN": np.nan}
NO_LIMIT = {"NaN": np.nan, "-infinity": -np.inf}
"""Where infinity is a bound like any other."""

FREQUENCIES_HZ, LEVELS_V = np.linspace(10.0, 600.0, 60), np.sqrt(2) * np.array([0.1, 0.5, 1.0, 1.5])
BINS_HZ = np.linspace(0.0, 700.0, 50)
GAIN_LIMIT_V_PER_M_S2 = 2.0
ANSWERS = oracle.answered_m_s2(FREQUENCIES_HZ[:, None], LEVELS_V)
RESPONSE = shaping.Response(FREQUENCIES_HZ, LEVELS_V, ANSWERS)
WITH_A_NULL = np.where(np.abs(FREQUENCIES_HZ - 300.0)[:, None] < 5.0, 0.0, ANSWERS)


def changed(values: NDArray[np.float64], value: float) -> NDArray[np.float64]:
    """The same with one element in the middle replaced."""
    changed = values.copy()
    changed.flat[changed.size // 2] = value
    return changed


def _of_spectra() -> list[tuple[str, Call, dict[str, float]]]:
    c, f = some()[0], spectra.bin_frequencies_hz(bins=BINS, rate_hz=RATE_HZ)
    rates: dict[str, Any] = {"rate_hz": RATE_HZ, "output_rate_hz": OUTPUT_RATES_HZ[0]}
    on = spectra.grid(samples=BINS, bins=BINS, **rates)
    distance = dissimilarity.dissimilarity
    return [
        ("finite: values", lambda x: spectra.finite(changed(c, x), what="c"), EITHER),
        ("spectrum: samples", lambda x: spectra.spectrum(changed(c, x)), EITHER),
        ("bin_frequencies_hz: rate_hz", lambda x: spectra.bin_frequencies_hz(bins=BINS, rate_hz=x), EITHER),
        ("inverse: coefficients", lambda x: spectra.inverse(changed(c, x)), EITHER),
        ("inverse_on: coefficients", lambda x: spectra.inverse_on(changed(c, x), on), EITHER),
        ("rms: amplitudes", lambda x: spectra.rms(changed(some(), x), on), EITHER),
        ("highest: coefficients", lambda x: spectra.highest(changed(c, x)), EITHER),
        ("grid: rate_hz", lambda x: spectra.grid(samples=BINS, bins=BINS, **{**rates, "rate_hz": x}), EITHER),
        (
            "grid: output_rate_hz",
            lambda x: spectra.grid(samples=BINS, bins=BINS, **{**rates, "output_rate_hz": x}),
            EITHER,
        ),
        ("dissimilarity: a", lambda x: distance(changed(c, x), c, frequencies_hz=f), EITHER),
        ("dissimilarity: b", lambda x: distance(c, changed(c, x), frequencies_hz=f), EITHER),
        ("dissimilarity: frequencies_hz", lambda x: distance(c, c, frequencies_hz=changed(f, x)), EITHER),
        (
            "dissimilarity_matrix: spectra",
            lambda x: dissimilarity.dissimilarity_matrix(changed(some(), x), frequencies_hz=f),
            EITHER,
        ),
        (
            "dissimilarity_matrix: frequencies_hz",
            lambda x: dissimilarity.dissimilarity_matrix(some(), frequencies_hz=changed(f, x)),
            EITHER,
        ),
    ]


def _of_crinkle() -> list[tuple[str, Call, dict[str, float]]]:
    a, speeds, takes = some(), np.array(SPEEDS_MM_S), np.ones((4, 3, BINS))
    of, rate_hz = material(a), OUTPUT_RATES_HZ[0]
    make = partial(crinkle.CrinkleSpectra, rate_hz=RATE_HZ)
    subtract = partial(crinkle.subtract, rate_hz=RATE_HZ)
    outside = partial(crinkle.rms_outside, of)
    return [
        ("rising: speeds_mm_s", lambda x: crinkle.rising(changed(speeds, x)), EITHER),
        ("foot_speed: speed_mm_s", crinkle.foot_speed, EITHER),
        (
            "CrinkleSpectra: speeds_mm_s",
            lambda x: make(speeds_mm_s=changed(speeds, x), amplitudes=a, signs=of.signs),
            EITHER,
        ),
        (
            "CrinkleSpectra: amplitudes",
            lambda x: make(speeds_mm_s=speeds, amplitudes=changed(a, x), signs=of.signs),
            EITHER,
        ),
        ("CrinkleSpectra: signs", lambda x: make(speeds_mm_s=speeds, amplitudes=a, signs=changed(of.signs, x)), EITHER),
        (
            "subtract: speeds_mm_s",
            lambda x: subtract(speeds_mm_s=changed(speeds, x), panel_object_takes=takes, panel_takes=takes),
            EITHER,
        ),
        (
            "subtract: panel_object_takes",
            lambda x: subtract(speeds_mm_s=speeds, panel_object_takes=changed(takes, x), panel_takes=takes),
            EITHER,
        ),
        (
            "subtract: panel_takes",
            lambda x: subtract(speeds_mm_s=speeds, panel_object_takes=takes, panel_takes=changed(takes, x)),
            EITHER,
        ),
        ("at_speed: speed_mm_s", lambda x: crinkle.at_speed(of, speed_mm_s=x), EITHER),
        ("leave_out: band_hz, lowest", lambda x: crinkle.leave_out(of, band_hz=(x, 500.0)), EITHER),
        ("leave_out: band_hz, highest", lambda x: crinkle.leave_out(of, band_hz=(0.0, x)), NAN),
        ("rms_outside: band_hz, lowest", lambda x: outside(band_hz=(x, 500.0), fastest_mm_s=600.0), EITHER),
        ("rms_outside: band_hz, highest", lambda x: outside(band_hz=(0.0, x), fastest_mm_s=600.0), NAN),
        ("rms_outside: fastest_mm_s", lambda x: outside(band_hz=(100.0, 500.0), fastest_mm_s=x), EITHER),
        ("Basis.at: speed_mm_s", waveforms.prepare(of, material="any", output_rate_hz=rate_hz).at, EITHER),
    ]


def _of_shaping() -> list[tuple[str, Call, dict[str, float]]]:
    c, of = np.ones(BINS_HZ.size), RESPONSE
    f = np.linspace(20.0, 500.0, c.size)
    shape = partial(weighting.shape, response=of, gain_limit_v_per_m_s2=GAIN_LIMIT_V_PER_M_S2)
    asked = spectra.Bins(spectra.spectrum(c), samples=c.size, rate_hz=RATE_HZ)
    drive = partial(shaping.drive, rate_hz=RATE_HZ, response=of)
    within: Callable[..., object] = partial(drive, asked, gain_limit_v_per_m_s2=GAIN_LIMIT_V_PER_M_S2)

    def prepared(gain_limit_v_per_m_s2: float = GAIN_LIMIT_V_PER_M_S2, **limits: float) -> object:
        given: dict[str, Any] = {"gain_limit_v_per_m_s2": gain_limit_v_per_m_s2, **limits}
        return voltages.Drive({}, rate_hz=RATE_HZ, response=of, **given).prepared(material(some()))

    unbounded = partial(weighting.shape, c, frequencies_hz=f, response=of)
    at = shaping.at_bins(of, f)
    shape_at = partial(shaping.shape_at, at=at, gain_limit_v_per_m_s2=GAIN_LIMIT_V_PER_M_S2)
    return [
        ("at_bins: frequencies_hz", lambda x: shaping.at_bins(of, changed(f, x)), EITHER),
        ("shape_at: coefficients", lambda x: shape_at(changed(c, x)), EITHER),
        ("shape_at: gain_limit_v_per_m_s2", lambda x: shaping.shape_at(c, at, gain_limit_v_per_m_s2=x), EITHER),
        ("shape_at: scale", lambda x: shape_at(c, scale=x), EITHER),
        (
            "Response: frequencies_hz",
            lambda x: shaping.Response(changed(FREQUENCIES_HZ, x), LEVELS_V, ANSWERS),
            EITHER,
        ),
        (
            "Response: levels_v",
            lambda x: shaping.Response(FREQUENCIES_HZ, changed(LEVELS_V, x), ANSWERS),
            EITHER,
        ),
        (
            "Response: accelerations_m_s2",
            lambda x: shaping.Response(FREQUENCIES_HZ, LEVELS_V, changed(ANSWERS, x)),
            EITHER,
        ),
        ("not_rising: accelerations_m_s2", lambda x: shaping.not_rising(changed(ANSWERS, x)), EITHER),
        ("shape: coefficients", lambda x: shape(changed(c, x), frequencies_hz=f), EITHER),
        ("shape: frequencies_hz", lambda x: shape(c, frequencies_hz=changed(f, x)), EITHER),
        ("shape: gain_limit_v_per_m_s2", lambda x: unbounded(gain_limit_v_per_m_s2=x), EITHER),
        ("shape: scale", lambda x: shape(c, frequencies_hz=f, scale=x), EITHER),
        (
            "drive: bins",
            lambda x: drive(replace(asked, coefficients=changed(c, x)), gain_limit_v_per_m_s2=GAIN_LIMIT_V_PER_M_S2),
            EITHER,
        ),
        ("drive: gain_limit_v_per_m_s2", lambda x: drive(asked, gain_limit_v_per_m_s2=x), EITHER),
        ("drive: limit_m_s2", lambda x: within(limit_m_s2=x), NO_LIMIT),
        ("drive: limit_v", lambda x: within(limit_v=x), NO_LIMIT),
        ("drive: scale", lambda x: within(scale=x), EITHER),
        ("Drive.prepared: gain_limit_v_per_m_s2", lambda x: prepared(gain_limit_v_per_m_s2=x), EITHER),
        ("Drive.prepared: limit_m_s2", lambda x: prepared(limit_m_s2=x), NO_LIMIT),
        ("Drive.prepared: limit_v", lambda x: prepared(limit_v=x), NO_LIMIT),
    ]


def _of_noise() -> list[tuple[str, Call, dict[str, float]]]:
    make: Callable[..., object] = partial(noise.noise, colour="pink", rng=np.random.default_rng(1))
    return [
        ("noise: samples", lambda x: make(samples=x, rate_hz=OUTPUT_RATES_HZ[0]), EITHER),
        ("noise: rate_hz", lambda x: make(samples=OUTPUT_RATES_HZ[0], rate_hz=x), EITHER),
    ]


def _of_budget() -> list[tuple[str, Call, dict[str, float]]]:
    of, takes = material(some()), np.ones((4, 3, BINS))
    stimulus = waveforms.prepare(of, material="any", output_rate_hz=OUTPUT_RATES_HZ[0]).at(SPEEDS_MM_S[1])
    volts, done = shaping.drive(
        stimulus.bins,
        rate_hz=OUTPUT_RATES_HZ[0],
        response=RESPONSE,
        gain_limit_v_per_m_s2=GAIN_LIMIT_V_PER_M_S2,
    )
    in_volts = partial(budget.of_voltages, stimulus, shaped=done, response=RESPONSE)
    return [
        (
            "of_accelerations: handed_m_s2",
            lambda x: budget.of_accelerations(
                stimulus, handed_m_s2=changed(np.asarray(stimulus.waveform_m_s2), x), limited=0
            ),
            EITHER,
        ),
        (
            "of_accelerations: carries_hz",
            lambda x: budget.of_accelerations(
                stimulus, handed_m_s2=np.asarray(stimulus.waveform_m_s2), limited=0, carries_hz=(0.0, x)
            ),
            NO_LIMIT,
        ),
        ("of_voltages: handed_v", lambda x: in_volts(handed_v=changed(volts, x), voltages_v=volts), EITHER),
        ("of_voltages: voltages_v", lambda x: in_volts(handed_v=volts, voltages_v=changed(volts, x)), EITHER),
        (
            "averaging: panel_object_takes",
            lambda x: sampling.averaging(of, panel_object_takes=changed(takes, x), panel_takes=takes),
            EITHER,
        ),
        (
            "averaging: panel_takes",
            lambda x: sampling.averaging(of, panel_object_takes=takes, panel_takes=changed(takes, x)),
            EITHER,
        ),
    ]


def _of_noticing() -> list[tuple[str, Call, dict[str, float]]]:
    levels, silent = np.zeros(18), {"NaN": np.nan, "infinity": np.inf}
    return [
        ("noticed: asked_db", lambda x: noticing.noticed(changed(levels, x), levels, noticing.SOLE), silent),
        ("noticed: given_db", lambda x: noticing.noticed(levels, changed(levels, x), noticing.SOLE), silent),
        (
            "third_octave_energies: waveform",
            lambda x: noticing.third_octave_energies(changed(levels, x), 64, 1000),
            EITHER,
        ),
        ("noticed_where_alike: share", lambda x: noticing.noticed_where_alike(x, noticing.SOLE), EITHER),
    ]


def _of_felt() -> list[tuple[str, Call, dict[str, float]]]:
    rest = np.ones(18)
    between = partial(felt.felt_between, rate_hz=1000, drift_db=1.0)
    return [
        ("felt: asked_m_s2", lambda x: felt.felt(changed(rest, x), rest, rate_hz=1000), EITHER),
        ("felt: moved_m_s2", lambda x: felt.felt(rest, changed(rest, x), rate_hz=1000), EITHER),
        ("felt_between: asked_m_s2", lambda x: between(changed(rest, x), rest, rest), EITHER),
        ("felt_between: linear_m_s2", lambda x: between(rest, changed(rest, x), rest), EITHER),
        ("felt_between: soft_m_s2", lambda x: between(rest, rest, changed(rest, x)), EITHER),
        (
            "felt_between: drift_db",
            lambda x: felt.felt_between(rest, rest, rest, rate_hz=1000, drift_db=x),
            EITHER,
        ),
    ]


OF_TAPS = ("contact", "oscillator", "tap")
"""Modules whose own tests, such as test_contact.py, try what is not finite."""

INPUTS = [*_of_spectra(), *_of_crinkle(), *_of_shaping(), *_of_noise(), *_of_budget(), *_of_noticing(), *_of_felt()]
"""Every number that a public function takes: its name, what calls it so, values to refuse."""

NUMBERS = ("float", "ArrayLike", "NDArray[np.float64]", "tuple[float, float]")
"""Annotations of what could be NaN or infinite."""


@pytest.fixture(autouse=True)
def no_warning() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


@pytest.mark.parametrize(
    ("call", "value"),
    [pytest.param(call, value, id=f"{name} {said}") for name, call, values in INPUTS for said, value in values.items()],
)
def test_what_is_not_finite_is_refused(call: Call, value: float) -> None:
    with pytest.raises(SynthesisError, match="allowed: "):
        call(value)


def test_every_number_that_a_public_function_takes_is_tried() -> None:
    tried = {name.partition(",")[0] for name, _, _ in INPUTS}
    wanted = {"CrinkleSpectra: speeds_mm_s", "CrinkleSpectra: amplitudes", "CrinkleSpectra: signs"}
    wanted |= {"Response: frequencies_hz", "Response: levels_v", "Response: accelerations_m_s2", "Basis.at: speed_mm_s"}
    names = [one.name for one in pkgutil.iter_modules(synthesis.__path__) if one.name not in OF_TAPS]
    modules = [importlib.import_module(f"{synthesis.__name__}.{name}") for name in names]
    for module in (*modules, dissimilarity, weighting):
        for node in ast.parse(inspect.getsource(module)).body:
            if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
                taken = ((one.arg, one.annotation) for one in (*node.args.args, *node.args.kwonlyargs))
                wanted |= {
                    f"{node.name}: {name}" for name, of in taken if of is not None and ast.unparse(of) in NUMBERS
                }
    assert wanted <= tried
    assert len(wanted) > 40


def shaped(coefficients: NDArray[np.float64], answers: NDArray[np.float64] = ANSWERS) -> shaping.Shaped:
    by = shaping.Response(FREQUENCIES_HZ, LEVELS_V, answers)
    return weighting.shape(
        coefficients, frequencies_hz=BINS_HZ, response=by, gain_limit_v_per_m_s2=GAIN_LIMIT_V_PER_M_S2
    )


def test_at_a_null_no_bin_takes_more_volts_than_the_limit_of_the_gain() -> None:
    wanted = np.full(BINS_HZ.size, 0.05)
    made = shaped(wanted, WITH_A_NULL)
    assert np.all(np.abs(made.coefficients_v) / wanted <= GAIN_LIMIT_V_PER_M_S2 * (1 + 1e-15))
    assert made.bounded.bins > 0


@pytest.mark.parametrize("step", [0.0, -0.1], ids=["a plateau", "a reversal"])
def test_a_response_without_an_inverse_is_refused(step: float, refuses: Refuses) -> None:
    answered = ANSWERS.copy()
    answered[20, 2] = answered[20, 1] + step
    with refuses(SynthesisError):
        shaping.Response(FREQUENCIES_HZ, LEVELS_V, answered)


def test_an_empty_table_is_refused(refuses: Refuses) -> None:
    with refuses(SynthesisError):
        shaping.Response(np.zeros(0), LEVELS_V, np.zeros((0, LEVELS_V.size)))


def test_what_shaping_asks_for_moves_the_panel_as_asked() -> None:
    within = np.clip(BINS_HZ, FREQUENCIES_HZ[0], FREQUENCIES_HZ[-1]) == BINS_HZ
    wanted = np.where(within, np.random.default_rng(6).uniform(-4.0, 4.0, BINS_HZ.size), 0.0)
    made = shaped(wanted)
    moved = accelerations(made.coefficients_v[within], frequencies_hz=BINS_HZ[within], response=RESPONSE)
    assert np.max(np.abs(moved - wanted[within])) <= 1e-12 * 4.0
    assert made.saturated.bins == made.bounded.bins == 0


def test_1e300_m_s2_in_every_bin_takes_the_highest_level_and_each_bin_counts_once() -> None:
    made = shaped(np.full(BINS_HZ.size, 1e300))
    assert np.max(np.abs(made.coefficients_v)) <= LEVELS_V[-1]
    assert made.saturated.bins + made.bounded.bins + made.outside.bins == BINS_HZ.size


@pytest.mark.parametrize("amplitude", [0.0, oracle.LEAST], ids=["zeros", "denormals"])
def test_what_is_all_but_silent_loses_nothing_within_the_table(amplitude: float) -> None:
    made = shaped(np.full(BINS_HZ.size, amplitude))
    assert np.max(np.abs(made.coefficients_v)) <= amplitude * GAIN_LIMIT_V_PER_M_S2
    assert made.saturated.bins == made.bounded.bins == 0
    assert (made.outside.bins == 0) == (amplitude == 0)


@pytest.mark.parametrize(
    ("level_m_s2", "answers", "least"),
    [(1.0, ANSWERS, 1.0), (1.0, WITH_A_NULL, 1.0), (1e300, ANSWERS, 0.5), (oracle.LEAST, ANSWERS, 0.0)],
    ids=["as measured", "a null at 300 Hz", "1e300 m/s^2", "denormals"],
)
def test_voltages_prepared_for_a_speed_are_those_worked_out_at_it(
    level_m_s2: float, answers: NDArray[np.float64], least: float
) -> None:
    rng = np.random.default_rng(8)
    of = material(level_m_s2 * np.ceil(rng.uniform(1.0, 9.0, (len(SPEEDS_MM_S), BINS))))
    asked = waveforms.prepare(of, material="any", output_rate_hz=RATE_HZ)
    by = shaping.Response(FREQUENCIES_HZ, LEVELS_V, answers)
    given: dict[str, Any] = {"rate_hz": RATE_HZ, "response": by, "gain_limit_v_per_m_s2": GAIN_LIMIT_V_PER_M_S2}
    basis, held = voltages.Drive({}, **given).prepared(of), 0
    feet_mm_s = np.linspace(SPEEDS_MM_S[0], voltages.FASTEST * SPEEDS_MM_S[-1], 37).tolist()
    for v in feet_mm_s:
        found = basis.at(asked.at(v))
        if found is not None:
            held += 1
            wanted_v, _ = shaping.drive(asked.at(v).bins, **given)
            assert np.abs(found[0] - wanted_v).max() <= 1e-12 * np.abs(wanted_v).max()
    assert held >= least * len(feet_mm_s)
