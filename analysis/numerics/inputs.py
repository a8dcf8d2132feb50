"""Every number that a public function of synthesis takes, to be tried with NaN and infinity."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.numerics import oracle
from analysis.numerics.cases import BAND_HZ, BINS, OUTPUT_RATES_HZ, material, some
from analysis.numerics.oracle import RATE_HZ, SPEEDS_MM_S
from experiment.synthesis import crinkle, engine, noise, pruning, shaping, spectra, voltages, waveforms
from experiment.synthesis import response as rig_response
from experiment.synthesis import shaping as driving
from experiment.synthesis.first_block import FirstBlockFirst

Call = Callable[[float], object]
EITHER = {"NaN": np.nan, "infinity": np.inf, "-infinity": -np.inf}
NAN = {"NaN": np.nan}
NO_LIMIT = {"NaN": np.nan, "-infinity": -np.inf}
"""Where infinity is a bound like any other."""

FREQUENCIES_HZ, LEVELS_V = np.linspace(10.0, 600.0, 60), np.sqrt(2) * np.array([0.1, 0.5, 1.0, 1.5])
BINS_HZ = np.linspace(0.0, 700.0, 50)
GAIN_LIMIT_V_PER_M_S2 = 2.0


def inputs() -> list[tuple[str, Call, dict[str, float]]]:
    """Every number that a public function takes: its name, what calls it so, values to refuse."""
    return [*_of_spectra(), *_of_crinkle(), *_of_methods(), *_of_shaping(), *_of_noise()]


def changed(values: NDArray[np.float64], value: float) -> NDArray[np.float64]:
    """The same with one element in the middle replaced."""
    changed = values.copy()
    changed.flat[changed.size // 2] = value
    return changed


def answers() -> NDArray[np.float64]:
    return oracle.answered_m_s2(FREQUENCIES_HZ[:, None], LEVELS_V)


def response() -> rig_response.Response:
    return rig_response.Response(FREQUENCIES_HZ, LEVELS_V, answers())


def _of_spectra() -> list[tuple[str, Call, dict[str, float]]]:
    c, f = some()[0], spectra.bin_frequencies_hz(bins=BINS, rate_hz=RATE_HZ)
    rates: dict[str, Any] = {"rate_hz": RATE_HZ, "output_rate_hz": OUTPUT_RATES_HZ[0]}
    on = spectra.grid(samples=BINS, bins=BINS, **rates)
    distance = spectra.dissimilarity
    return [
        ("finite: values", lambda x: spectra.finite(changed(c, x), what="c"), EITHER),
        ("spectrum: samples", lambda x: spectra.spectrum(changed(c, x)), EITHER),
        ("bin_frequencies_hz: rate_hz", lambda x: spectra.bin_frequencies_hz(bins=BINS, rate_hz=x), EITHER),
        ("inverse: coefficients", lambda x: spectra.inverse(changed(c, x)), EITHER),
        ("inverse_on: coefficients", lambda x: spectra.inverse_on(changed(c, x), on), EITHER),
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
        ("dissimilarity: band_hz, lowest", lambda x: distance(c, c, frequencies_hz=f, band_hz=(x, 500.0)), NAN),
        ("dissimilarity: band_hz, highest", lambda x: distance(c, c, frequencies_hz=f, band_hz=(0.0, x)), NAN),
        (
            "dissimilarity_matrix: spectra",
            lambda x: spectra.dissimilarity_matrix(changed(some(), x), frequencies_hz=f),
            EITHER,
        ),
        (
            "dissimilarity_matrix: frequencies_hz",
            lambda x: spectra.dissimilarity_matrix(some(), frequencies_hz=changed(f, x)),
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
            "CrinkleSpectra: left_out",
            lambda x: make(speeds_mm_s=speeds, amplitudes=a, signs=of.signs, left_out=changed(a, x)),
            EITHER,
        ),
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
        ("BinsAtSpeed: speed_mm_s", lambda x: waveforms.BinsAtSpeed(of, x)(), EITHER),
        ("synthesise: speed_mm_s", lambda x: waveforms.synthesise(of, speed_mm_s=x, output_rate_hz=rate_hz), EITHER),
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
        ("left_out_error: band_hz, lowest", lambda x: pruning.left_out_error(of, band_hz=(x, 500.0), on=on), EITHER),
        ("left_out_error: band_hz, highest", lambda x: pruning.left_out_error(of, band_hz=(0.0, x), on=on), NAN),
        ("loudest_outside: band_hz, lowest", lambda x: loudest(band_hz=(x, 500.0), fastest_mm_s=600.0), EITHER),
        ("loudest_outside: band_hz, highest", lambda x: loudest(band_hz=(0.0, x), fastest_mm_s=600.0), NAN),
        ("loudest_outside: fastest_mm_s", lambda x: loudest(band_hz=band_hz, fastest_mm_s=x), EITHER),
        ("rms: amplitudes", lambda x: waveforms.rms(changed(some(), x), on), EITHER),
    ]


def _of_shaping() -> list[tuple[str, Call, dict[str, float]]]:
    c, of = np.ones(BINS_HZ.size), response()
    f = np.linspace(20.0, 500.0, c.size)
    shape = partial(shaping.shape, response=of, gain_limit_v_per_m_s2=GAIN_LIMIT_V_PER_M_S2)
    asked = driving.bins_of_waveform(c, rate_hz=RATE_HZ)
    drive = partial(driving.drive, rate_hz=RATE_HZ, response=of)
    move = partial(rig_response.accelerations, response=of)
    within: Callable[..., object] = partial(drive, asked, gain_limit_v_per_m_s2=GAIN_LIMIT_V_PER_M_S2)
    prepare = partial(voltages.prepare, material(some()), rate_hz=RATE_HZ, response=of)
    prepared = partial(prepare, gain_limit_v_per_m_s2=GAIN_LIMIT_V_PER_M_S2)
    unbounded = partial(shaping.shape, c, frequencies_hz=f, response=of)
    at = rig_response.at_bins(of, f)
    shape_at = partial(shaping.shape_at, at=at, gain_limit_v_per_m_s2=GAIN_LIMIT_V_PER_M_S2)
    return [
        ("at_bins: frequencies_hz", lambda x: rig_response.at_bins(of, changed(f, x)), EITHER),
        ("bins_of: values", lambda x: rig_response.bins_of(changed(c, x), f, what="c"), EITHER),
        ("bins_of: frequencies_hz", lambda x: rig_response.bins_of(c, changed(f, x), what="c"), EITHER),
        ("shape_at: coefficients", lambda x: shape_at(changed(c, x)), EITHER),
        ("shape_at: gain_limit_v_per_m_s2", lambda x: shaping.shape_at(c, at, gain_limit_v_per_m_s2=x), EITHER),
        ("shape_at: scale", lambda x: shape_at(c, scale=x), EITHER),
        ("accelerations_at: voltages_v", lambda x: rig_response.accelerations_at(changed(c, x), at), EITHER),
        (
            "Response: frequencies_hz",
            lambda x: rig_response.Response(changed(FREQUENCIES_HZ, x), LEVELS_V, answers()),
            EITHER,
        ),
        (
            "Response: levels_v",
            lambda x: rig_response.Response(FREQUENCIES_HZ, changed(LEVELS_V, x), answers()),
            EITHER,
        ),
        (
            "Response: accelerations_m_s2",
            lambda x: rig_response.Response(FREQUENCIES_HZ, LEVELS_V, changed(answers(), x)),
            EITHER,
        ),
        ("not_rising: accelerations_m_s2", lambda x: rig_response.not_rising(changed(answers(), x)), EITHER),
        ("shape: coefficients", lambda x: shape(changed(c, x), frequencies_hz=f), EITHER),
        ("shape: frequencies_hz", lambda x: shape(c, frequencies_hz=changed(f, x)), EITHER),
        ("shape: gain_limit_v_per_m_s2", lambda x: unbounded(gain_limit_v_per_m_s2=x), EITHER),
        ("shape: scale", lambda x: shape(c, frequencies_hz=f, scale=x), EITHER),
        ("accelerations: voltages_v", lambda x: move(changed(c, x), frequencies_hz=f), EITHER),
        ("accelerations: frequencies_hz", lambda x: move(c, frequencies_hz=changed(f, x)), EITHER),
        ("bins_of_waveform: waveform_m_s2", lambda x: driving.bins_of_waveform(changed(c, x), rate_hz=RATE_HZ), EITHER),
        (
            "drive: bins",
            lambda x: drive(replace(asked, coefficients=changed(c, x)), gain_limit_v_per_m_s2=GAIN_LIMIT_V_PER_M_S2),
            EITHER,
        ),
        ("drive: gain_limit_v_per_m_s2", lambda x: drive(asked, gain_limit_v_per_m_s2=x), EITHER),
        ("drive: limit_m_s2", lambda x: within(limit_m_s2=x), NO_LIMIT),
        ("drive: limit_v", lambda x: within(limit_v=x), NO_LIMIT),
        ("drive: scale", lambda x: within(scale=x), EITHER),
        ("prepare: gain_limit_v_per_m_s2", lambda x: prepare(gain_limit_v_per_m_s2=x), EITHER),
        ("prepare: limit_m_s2", lambda x: prepared(limit_m_s2=x), NO_LIMIT),
        ("prepare: limit_v", lambda x: prepared(limit_v=x), NO_LIMIT),
    ]


def _of_noise() -> list[tuple[str, Call, dict[str, float]]]:
    make: Callable[..., object] = partial(noise.noise, colour="pink", rng=np.random.default_rng(1))
    return [
        ("noise: samples", lambda x: make(samples=x, rate_hz=OUTPUT_RATES_HZ[0]), EITHER),
        ("noise: rate_hz", lambda x: make(samples=OUTPUT_RATES_HZ[0], rate_hz=x), EITHER),
    ]
