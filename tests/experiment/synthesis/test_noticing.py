"""How probably a difference is noticed: at the thresholds that were published, and by the formulas transcribed."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from palpate.experiment.synthesis.noticing import (
    FINGERTIP,
    RARELY,
    SOLE,
    THIRDS_HZ,
    Site,
    noticed,
    noticed_where_alike,
    unnoticed_share,
)

SILENCE_DB = np.full(18, -np.inf)
STRONG_DB = np.full(18, 60.0)
AT_THRESHOLD = 2 * 0.5 ** (1 / 3) - 1
"""Levitt 1971: three down, one up converges on 79.4 % correct, of which this part is no guess."""


def one(level_db: float, place: int = 8) -> np.ndarray:
    """A level in one third octave alone."""
    return np.where(np.arange(18) == place, level_db, 0.0)


@pytest.mark.parametrize("site", [SOLE, FINGERTIP], ids=["sole", "fingertip"])
@pytest.mark.parametrize("place", [0, 8, 17])
def test_a_detection_threshold_is_noticed_beside_silence_as_often_as_thresholds_are(site: Site, place: int) -> None:
    there = SILENCE_DB.copy()
    there[place] = 20 * np.log10(site.detected_m_s2[place])
    assert noticed(SILENCE_DB, there, site) == pytest.approx((AT_THRESHOLD, AT_THRESHOLD), rel=1e-9)
    assert noticed(there, SILENCE_DB, site) == pytest.approx(noticed(SILENCE_DB, there, site), rel=1e-9)


@pytest.mark.parametrize(("fraction", "end"), [(0.2, 1), (0.58, 0)])
def test_a_weber_fraction_of_a_strong_vibration_is_noticed_as_often(fraction: float, end: int) -> None:
    """Forta et al. 2012: 0.20 at 125 Hz, and 0.58 at 10 Hz."""
    found = noticed(STRONG_DB, STRONG_DB + one(20 * np.log10(1 + fraction)), FINGERTIP)
    assert found[end] == pytest.approx(AT_THRESHOLD, rel=1e-4)


def test_several_third_octaves_are_noticed_as_the_formula_says() -> None:
    """Green and Swets 1966: d' of independent observations add in squares; P = Phi(d' / sqrt(2))."""
    off_db = one(0.2, 3) - one(0.1, 9)
    d = np.sqrt(2) * norm.ppf(0.5 ** (1 / 3)) * np.hypot(0.2, 0.1) / (20 * np.log10(1.2))
    assert noticed(STRONG_DB, STRONG_DB + off_db, FINGERTIP).most == pytest.approx(
        2 * norm.cdf(d / np.sqrt(2)) - 1, rel=1e-4
    )
    assert noticed(STRONG_DB, STRONG_DB, FINGERTIP) == (0.0, 0.0)


def test_thresholds_are_those_printed() -> None:
    """Kowalzik et al. 1996: 1.2 um at 200 Hz; Lundstrom et al. 1992: 100 dB re 1e-6 m/s^2."""
    at_200_hz = float(SOLE.detected_m_s2[np.argmin(np.abs(THIRDS_HZ - 200))])
    assert 20 * np.log10(1.3398 / at_200_hz) == pytest.approx(21, abs=0.01)
    assert 20 * np.log10(FINGERTIP.detected_m_s2 / 1e-6) == pytest.approx(np.full(18, 100.0))


@pytest.mark.parametrize("site", [SOLE, FINGERTIP], ids=["sole", "fingertip"])
def test_a_share_is_noticed_as_such_levels_are_and_below_some_share_rarely(site: Site) -> None:
    share = 0.01
    off_db = STRONG_DB + 20 * np.log10(1 + share)
    assert noticed_where_alike(share, site) == pytest.approx(noticed(STRONG_DB, off_db, site).most, rel=1e-4)
    assert noticed_where_alike(unnoticed_share(site), site) == pytest.approx(RARELY, rel=1e-9)


@pytest.mark.parametrize("level_db", [-40.0, -20.0, 0.0])
def test_at_least_is_never_more_than_at_most(level_db: float) -> None:
    """Beside the threshold of the sole, some -20 dB, a small Weber fraction means the larger internal noise."""
    asked_db = np.full(18, level_db)
    found = noticed(asked_db, asked_db + one(3.0), SOLE)
    assert 0 < found.least < found.most
