"""Timing of the rig: figures against scipy's and counting by hand, and which attempts they are of."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.identification.time_course import Timing, course_of, timing
from palpate.analysis.reading.dataset import read
from palpate.analysis.report.identification_sections import course_section
from tests.analysis.datasets import trial, write_dataset


def _rows(values_ms: list[float], column: str) -> list[dict[str, object]]:
    return [trial(n, "sand", "sand", **{column: value / 1e3}) for n, value in enumerate(values_ms, start=1)]


def test_figures_of_many_attempts(tmp_path: Path, approved: SnapshotAssertion) -> None:
    """scipy's quantiles by the same interpolation (Hyndman and Fan's definition 7), of the magnitude."""
    values_ms = np.random.default_rng(4).normal(-0.2, 0.5, 1500).round(3)
    root = write_dataset(tmp_path, {"1": {"real": _rows(values_ms.tolist(), "prediction_error")}})
    (found,) = timing(read(root))["real"]
    assert found.attempts == 1500
    assert found.quantity == approved
    wanted = stats.mstats.mquantiles(np.abs(values_ms), [0.99, 0.999], alphap=1, betap=1)
    assert [found.p99_ms, found.p999_ms] == pytest.approx(wanted.tolist(), rel=1e-9)
    assert found.median_ms == pytest.approx(stats.scoreatpercentile(values_ms, 50), rel=1e-9)
    assert found.sd_ms == pytest.approx(stats.tstd(values_ms), rel=1e-9)
    assert found.largest_ms == pytest.approx(np.abs(values_ms).max(), rel=1e-9)


@pytest.mark.parametrize(("count", "has_p99", "has_p999"), [(99, False, False), (100, True, False), (1000, True, True)])
def test_a_percentile_needs_values_to_lie_beyond_it(tmp_path: Path, count: int, has_p99: bool, has_p999: bool) -> None:
    root = write_dataset(tmp_path, {"1": {"real": _rows([1.0] * count, "dead_time")}})
    (found,) = timing(read(root))["real"]
    assert (found.p99_ms is not None, found.p999_ms is not None) == (has_p99, has_p999)


def test_one_value_has_no_spread(tmp_path: Path) -> None:
    root = write_dataset(tmp_path, {"1": {"virtual": _rows([0.25], "gate_to_scheduled")}})
    assert timing(read(root)) == {"virtual": (Timing("gate to scheduled", 1, 0.25, None, None, None, 0.25),)}


def test_attempts_done_again_count_and_those_who_withdrew_do_not(tmp_path: Path, approved: SnapshotAssertion) -> None:
    missed = trial(1, "sand", "n/a", counted=False, delivery_error=-0.009, delivered=False, redo_reason="undelivered")
    again = trial(1, "sand", "sand", attempt=2, delivery_error=0.001, delivered=True)
    gone = _rows([50.0], "delivery_error")
    root = write_dataset(tmp_path, {"1": {"real": [missed, again]}, "2": {"real": gone}}, withdrawn=["2"])
    study = read(root)
    ((name, (found,)),) = timing(study).items()
    assert (name, found.attempts) == ("real", 2)
    assert found.quantity == approved
    assert (found.median_ms, found.largest_ms) == pytest.approx((-4.0, 9.0))
    section = course_section(course_of(study))
    (table,) = [table for table in section.tables if table.title == "Timing"]
    assert table.rows == approved
    assert [r["largest"] for r in section.records if "largest" in r] == pytest.approx([9.0])
