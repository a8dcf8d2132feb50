"""Figures of a response that is known: full scale, usable band, resonances, and the table of them."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from palpate.experiment.apparatus.panel import measured, movement, multisine
from palpate.experiment.apparatus.panel.multisine import Estimate

LINES_HZ = multisine.lines(5000)


def known(response_m_s2: np.ndarray, error_db: float = 0.01) -> Estimate:
    return Estimate(
        lines_hz=LINES_HZ,
        response_m_s2=response_m_s2.astype(np.complex128),
        standard_error_m_s2=np.abs(response_m_s2) * error_db * np.log(10) / 20,
        coherence=np.ones(LINES_HZ.size),
        gains=(1.0, 1.0),
        drift_ppm=0.0,
    )


EVERY = np.ones(LINES_HZ.size, bool)


def test_a_flat_panel_has_its_full_scale_over_its_band() -> None:
    falls = np.where((LINES_HZ >= 20) & (LINES_HZ <= 800), 40.0, 10.0)
    found = measured.figures(known(falls), EVERY)
    assert found.full_scale_m_s2 == pytest.approx(40.0)
    assert (found.low_hz, found.high_hz) == (20, LINES_HZ[LINES_HZ <= 800][-1])
    assert found.standard_error_m_s2 < 40.0 * 0.01 * np.log(10) / 20
    assert found.resonances == ()


@pytest.mark.parametrize("hz", [60.0, 233.3, 710.0])
def test_a_resonance_is_found_within_its_error(hz: float) -> None:
    part = LINES_HZ / hz
    rng, errors = np.random.default_rng(3), []
    clean = 10 / (1 + 0.1j * part - part**2)
    for _ in range(20):
        noisy = clean * 10 ** (rng.normal(0, 0.05, part.size) / 20)
        (found,) = measured.figures(known(noisy, 0.05), 4 * hz > LINES_HZ).resonances
        errors.append((found.hz - hz * np.sqrt(1 - 0.1**2 / 2)) / found.standard_error_hz)
        assert found.hz == pytest.approx(hz, rel=0.01)
        assert found.peak_m_s2 == pytest.approx(100.0, rel=0.02)
    assert np.sqrt(np.mean(np.square(errors))) < 2


def test_the_table_has_a_row_a_line_behind_its_remarks() -> None:
    content = measured.table(known(LINES_HZ * (1 + 2j)), ("ours", "measured today")).decode().splitlines()
    assert content[:2] == ["# ours", "# measured today"]
    rows = list(csv.DictReader(content[2:]))
    assert tuple(rows[0]) == movement.COLUMNS
    assert [int(row["frequency_hz"]) for row in rows] == LINES_HZ.tolist()
    assert [float(row["imaginary_m_s2"]) for row in rows] == pytest.approx((2.0 * LINES_HZ).tolist())
