"""The vibration of a tap, against the equations written out and Table 1 as a file from print holds it."""

from __future__ import annotations

import csv
from math import atan2, exp, inf, pi, sin
from pathlib import Path

import numpy as np
import pytest

from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis import tap
from tests.approved import Refuses

TABLE_1 = Path(__file__).parents[2] / "reference" / "wellman1995_table1_materials.csv"


def test_the_surfaces_are_those_of_table_1() -> None:
    with TABLE_1.open() as file:
        rows = list(csv.DictReader(file))
    printed = [
        (
            row["material"],
            float(row["stiffness_n_per_m"]),
            float(row["peak_amplitude_at_0.2_m_per_s"]),
            float(row["attack_hz"]),
        )
        for row in rows
    ]
    assert [(one.name, one.stiffness_n_m, one.amplitude, one.attack_hz) for one in tap.SURFACES] == printed


@pytest.mark.parametrize("surface", tap.SURFACES, ids=lambda one: one.name)
def test_the_waveform_is_equation_2(surface: tap.Surface) -> None:
    made = tap.waveform(surface, speed_m_s=0.1, rate_hz=48_000, aluminum_m_s2=30.0)
    for i in (0, 1, 17, 1000, made.size - 1):
        t = i / 48_000
        wanted = 30 * surface.amplitude * 0.5 * exp(-100 * t) * sin(2 * pi * surface.attack_hz * t)
        assert made[i] == pytest.approx(wanted, abs=1e-12)
    assert made.size == round(np.log(1000) / 100 * 48_000)


def test_the_amplitude_is_linear_in_the_speed() -> None:
    slow, fast = (tap.waveform(tap.SURFACES[3], speed_m_s=v, rate_hz=48_000, aluminum_m_s2=1.0) for v in (0.05, 0.15))
    np.testing.assert_allclose(fast, 3 * slow, rtol=1e-12)
    assert tap.amplitude(tap.SURFACES[4], speed_m_s=0.2) == 1.0


def test_the_peak_is_where_the_waveform_is_largest() -> None:
    """Where tan(W t) = W / B."""
    surface = tap.SURFACES[0]
    turns, decay = 2 * pi * surface.attack_hz, surface.decay_per_s
    after = atan2(turns, decay) / turns
    part = exp(-decay * after) * sin(turns * after)
    made = tap.waveform(surface, speed_m_s=0.2, rate_hz=1e6, aluminum_m_s2=1.0)
    assert np.argmax(made) / 1e6 == pytest.approx(after, abs=1e-6)
    assert made.max() == pytest.approx(surface.amplitude * part, rel=1e-9)


def test_what_a_rate_cannot_carry_is_refused(refuses: Refuses) -> None:
    with refuses(SynthesisError):
        tap.waveform(tap.SURFACES[4], speed_m_s=0.2, rate_hz=8000.0, aluminum_m_s2=1.0)
    with pytest.raises(SynthesisError, match="speed: got nan m/s"):
        tap.amplitude(tap.SURFACES[0], speed_m_s=float("nan"))
    with pytest.raises(SynthesisError, match="length: got inf s"):
        tap.waveform(tap.SURFACES[0], speed_m_s=0.2, rate_hz=8000.0, aluminum_m_s2=1.0, length_s=inf)


def test_the_curve_of_frequency_goes_through_what_is_exponential() -> None:
    k = np.array([4500.0, 19_000.0, 140_000.0])
    made = tap.frequency_curve(k, 40 * np.exp(k / 35_000))
    assert (made.at_zero_hz, made.per_n_m, made.r2) == pytest.approx((40, 35_000, 1.0))
    assert made.at(70_000.0) == pytest.approx(40 * exp(2))


def test_table_1_is_only_roughly_exponential() -> None:
    """numpy.polyfit of ln f over K: slope 1 / 39,135 N/m, 45.29 Hz at 0, R2 0.968; plastic is 62 % too high."""
    made = tap.frequency_curve([one.stiffness_n_m for one in tap.SURFACES], [one.attack_hz for one in tap.SURFACES])
    slope, start = np.polyfit([4500, 5800, 19_000, 140_000, 160_000], np.log([43, 50, 100, 1000, 4000]), 1)
    assert (made.at_zero_hz, made.per_n_m) == pytest.approx((exp(start), 1 / slope))
    assert made.r2 == pytest.approx(0.968, abs=5e-4)
    assert made.misfits[3] == pytest.approx(-0.483, abs=5e-4)


def test_l_and_d_come_back_from_a_straight_line() -> None:
    made = tap.scaling([0.1, 0.2, 0.3], [0.05, 0.1, 0.15])
    assert (made.amplitude, made.per_speed_s_m) == pytest.approx((0.1, 5.0))
    assert made.misfits == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: tap.frequency_curve([1.0, 1.0], [2.0, 3.0]), "two of them different"),
        (lambda: tap.frequency_curve([1.0, 2.0], [0.0, 3.0]), "frequencies above zero"),
        (lambda: tap.scaling([0.2, 0.2], [1.0, 1.0]), "two or more different speeds"),
        (lambda: tap.scaling([0.2, 0.4], [-1.0, -2.0]), "at 0.2 m/s; allowed: above zero"),
    ],
)
def test_what_gives_no_line_is_refused(call: object, words: str) -> None:
    assert callable(call)
    with pytest.raises(SynthesisError, match=words):
        call()
