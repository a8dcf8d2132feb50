"""Levels in dB(A) against the printed table of IEC 61672-1, and the dose against the directive's own figures."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.experiment.apparatus.audio import masker

PRINTED_DB = {
    # IEC 61672-1:2013, table 3: nominal frequency, A-weighting. The exact frequency of band n is 1000 * 10^(n/10) Hz.
    -20: -70.4, -17: -50.5, -15: -39.4, -12: -26.2, -9: -16.1, -6: -8.6, -3: -3.2, 0: 0.0, 3: 1.2, 6: 1.0, 9: -1.1,
    12: -6.6, 13: -9.3,
}  # fmt: skip


@pytest.mark.parametrize(("band", "printed_db"), PRINTED_DB.items())
def test_weighting_is_that_of_the_printed_table(band: int, printed_db: float) -> None:
    frequency_hz = np.array([1000.0 * 10 ** (band / 10)])
    assert masker.a_weighting_db(frequency_hz=frequency_hz)[0] == pytest.approx(printed_db, abs=0.051)


def test_a_tone_of_1_khz_weighs_nothing_and_pink_noise_what_its_octaves_weigh() -> None:
    assert masker.a_weighted_db(frequency_hz=np.array([1000.0]), power=np.array([3.0])) == pytest.approx(0)
    # Pink noise is equal in every third of an octave: the printed weights of all thirds from 20 Hz to 20 kHz, by power.
    thirds = [-50.5, -44.7, -39.4, -34.6, -30.2, -26.2, -22.5, -19.1, -16.1, -13.4, -10.9, -8.6, -6.6, -4.8, -3.2, -1.9]
    thirds += [-0.8, 0.0, 0.6, 1.0, 1.2, 1.3, 1.2, 1.0, 0.5, -0.1, -1.1, -2.5, -4.3, -6.6, -9.3]
    printed = 10 * np.log10(np.mean(10 ** (np.array(thirds) / 10)))
    assert masker.pink_weighted_db(rate_hz=44_100) == pytest.approx(printed, abs=0.1)


@pytest.mark.parametrize(
    ("level_db_a", "hours", "daily_db_a"),
    # Directive 2003/10/EC: 80, 85 and 87 dB(A) refer to eight hours; 3 dB more is half the time.
    [(80, 8, 80), (85, 8, 85), (87, 8, 87), (83, 4, 80), (86, 2, 80), (70, 8, 70), (80, 4, 77)],
)
def test_the_daily_level_is_that_of_equal_energy(level_db_a: float, hours: float, daily_db_a: float) -> None:
    used = masker.dose(level_db_a=level_db_a, duration_s=3600 * hours)
    # 3 dB is 10 lg 2 = 3.0103 dB in the standard's own rounding.
    assert masker.daily_level_db_a(dose=used) == pytest.approx(daily_db_a, abs=0.025)


def test_no_sound_is_no_dose() -> None:
    assert masker.daily_level_db_a(dose=0) == -np.inf


@given(level_db_a=st.floats(30, 120), used=st.floats(0, 2))
def test_what_is_left_uses_up_the_dose_exactly(level_db_a: float, used: float) -> None:
    left_s = masker.left_s(dose=used, level_db_a=level_db_a)
    total = used + masker.dose(level_db_a=level_db_a, duration_s=left_s)
    assert total == pytest.approx(max(used, 1.0), rel=1e-9)
