"""Calibrating and zeroing: points, residuals, noise and offsets against sensors that are known, and refusals."""

from __future__ import annotations

from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.rig import Rig, tracker_of
from palpate.experiment.apparatus.tracker import calibration
from palpate.experiment.apparatus.tracker.calibration import Level
from palpate.experiment.apparatus.tracker.frames import LinkCounts, Samples
from palpate.experiment.errors import RigError, TrackerError
from palpate.experiment.rehearsal.clock import ManualClock
from tests.approved import Refuses
from tests.experiment.apparatus.tracker.test_zeroing import Heights

TODAY = date(2026, 5, 4)


@pytest.fixture(scope="session")
def rehearsal_file(repository_root: Path) -> Path:
    return repository_root / "protocols" / "rigs" / "rehearsal.toml"


@pytest.fixture(scope="session")
def rehearsal(rehearsal_file: Path) -> Rig:
    return rigs.load(rehearsal_file)


@given(st.floats(0.5, 100.0), st.sampled_from([1, -1]), st.integers(2, 8))
def test_a_straight_sensor_has_no_residuals(counts_per_mm: float, way: int, count: int) -> None:
    mm = np.linspace(-5, 60, count)
    levels = [Level(float(h), np.full(50, 30_000 + way * counts_per_mm * h)) for h in mm[::-1]]
    made = calibration.calibrate(levels, TODAY)
    counts = [point.counts for point in made.points]
    assert counts == sorted(counts)
    assert [point.mm for point in made.points] == pytest.approx(mm[::way].tolist())
    first, *inner, last = (point.residual_mm for point in made.points)
    assert (first, last) == (None, None)
    assert inner == pytest.approx([0.0] * (count - 2), abs=1e-9)
    assert made.noise_mm == pytest.approx(0.0, abs=1e-9)


def test_the_residual_of_a_bent_sensor_is_the_chords_distance() -> None:
    # mm = c^2: at the middle of three points c - h, c, c + h the chord lies h^2 above the parabola.
    made = calibration.calibrate([Level(float(c * c), np.full(9, float(c))) for c in (10, 14, 18)], TODAY)
    assert [point.residual_mm for point in made.points] == [None, pytest.approx(-16.0), None]


def test_noise_is_that_of_the_readings_in_mm() -> None:
    rng = np.random.default_rng(1)
    levels = [Level(h, 40 * h + 500 + rng.normal(0, 4.0, 20_000)) for h in (0.0, 10.0, 50.0)]
    made = calibration.calibrate(levels, TODAY)
    assert made.noise_mm == pytest.approx(0.1, rel=0.03)
    assert [point.counts for point in made.points] == pytest.approx([500, 900, 2500], abs=1)


@pytest.mark.parametrize(
    ("levels", "message"),
    [
        ([(0.0, 5.0)], "got the heights 0 mm; allowed: two or more"),
        ([(0.0, 5.0), (0.0, 9.0)], "got the heights 0, 0 mm; allowed: two or more, all different"),
        ([(0.0, 5.0), (10.0, 50.0), (20.0, 40.0)], "got .*50 counts at 10 mm, 40 counts at 20 mm; .* all rise"),
        # The lowest was read with the target still at 30 mm: it alone is wrong, and the others rise.
        (
            [(-2, 1400), (0, 120), (10, 200), (20, 280), (50, 520)],
            "got 1400 counts at -2 mm.*only the reading at -2 mm.*rise",
        ),
        ([(0, 120), (10, 200), (20, 150), (50, 520)], "got .*; the readings at 10 and 20 mm.* all rise"),
        ([(0.0, 50.0), (10.0, 50.0)], ".* readings that all rise or all fall with height"),
        ([(0.0, 50.0), (10.0, 90.0), (20.0, 50.0)], ".* readings that all rise or all fall with height"),
        ([(0.0, 50.0), (10.0, 50.4)], ".*6 SD apart"),
        # 20 mm below the middle of 10 and 50: 43.3 mm by the line, off by 23.3 of the 40 between them.
        ([(10.0, 100.0), (20.0, 183.3), (50.0, 200.0)], r"got 183.3 counts at 20 mm; the line .* gives 43\.3 mm"),
    ],
)
def test_readings_that_are_no_calibration_are_refused(levels: list[tuple[float, float]], message: str) -> None:
    with pytest.raises(TrackerError, match=f"calibration: {message}"):
        calibration.calibrate([Level(mm, np.full(10, counts)) for mm, counts in levels], TODAY)


def test_noise_that_hides_the_step_is_refused(refuses: Refuses) -> None:
    rng = np.random.default_rng(1)
    with refuses(TrackerError):
        calibration.calibrate([Level(h, 100 + h + rng.normal(0, 9.0, 500)) for h in (0.0, 20.0)], TODAY)


def test_a_rig_file_keeps_all_but_its_calibration(rehearsal: Rig, rehearsal_file: Path, tmp_path: Path) -> None:
    levels = [Level(h, np.full(9, 4000 - 30 * h)) for h in (-2.0, 0.0, 30.0)]
    made = calibration.calibrate(levels, TODAY)
    after = calibration.calibrated(rehearsal, made, 60)
    before = rehearsal_file.read_text("utf-8")
    (tmp_path / "rig.toml").write_text(calibration.rewritten(before, after), "utf-8")
    again = rigs.load(tmp_path / "rig.toml")
    assert again.model_dump() == after.model_dump()
    assert (tracker_of(again).calibrated_on, tracker_of(again).calibration_days) == (TODAY, 60)
    assert [(p.counts, p.mm) for p in tracker_of(again).calibration] == [(3100, 30.0), (4000, 0.0), (4060, -2.0)]
    for line in before.splitlines():
        if not line.startswith(("counts", "mm", "[[tracker.calibration]]")):
            assert line in (tmp_path / "rig.toml").read_text("utf-8").splitlines(), line


def reported(*levels: tuple[float, float], noise_counts: float = 0.0, link: LinkCounts | None = None) -> list[str]:
    rng = np.random.default_rng(1)
    read = [Level(mm, counts + rng.normal(0, noise_counts, 999)) for mm, counts in levels]
    return list(calibration.report(replace(calibration.calibrate(read, TODAY), link=link or LinkCounts(999))))


def test_a_sensor_in_order_is_reported_without_a_residual_where_none_was_measured(approved: SnapshotAssertion) -> None:
    assert reported((0.0, 500.0), (10.0, 900.0), (20.0, 1300.0)) == approved


def test_what_is_to_be_questioned_is_reported(approved: SnapshotAssertion) -> None:
    """A sensor that reads 1000 / (h + 28) is bent; its residual at 20 mm is 5.85, of the 40 mm from 10 to 50."""
    bent = [(h, 1e5 / (h + 28.0)) for h in (10.0, 20.0, 50.0)]
    assert reported(*bent) == approved
    # 6 counts of 40 a mm: 0.15 mm.
    restless = reported((0.0, 500.0), (10.0, 900.0), noise_counts=6.0)
    assert restless == approved
    assert reported((0.0, 500.0), (10.0, 900.0), link=LinkCounts(2000, 3, 600))[-1] == approved


def test_frames_count_while_the_sensor_is_read_and_not_while_somebody_holds_the_target() -> None:
    class Damaging(Heights):
        """Each read damages a frame, and each wait for Enter a hundred."""

        counts = LinkCounts()

        def read(self) -> Samples:
            self.counts = self.counts.plus(LinkCounts(received=1, damaged=1))
            return super().read()

    tracker, heights_mm = Damaging([]), iter((100.0, 900.0))

    def ask(_: str) -> str:
        tracker.counts = tracker.counts.plus(LinkCounts(damaged=100))
        tracker._heights_mm = np.full(500, next(heights_mm))
        return ""

    made = calibration.walk(tracker, (0.0, 20.0), ask=ask, clock=ManualClock(0))
    # 1000 readings at each of two heights, 500 a read.
    assert made.link == LinkCounts(received=4, damaged=4)


@pytest.mark.parametrize("name", ["laboratory", "tapping", "headless"])
def test_comments_of_other_tables_stay_and_the_stale_one_goes(name: str, repository_root: Path) -> None:
    file = repository_root / "protocols" / "rigs" / f"{name}.toml"
    levels = [Level(h, np.full(9, 4000 - 30 * h)) for h in (-2.0, 0.0, 30.0)]
    after = calibration.calibrated(rigs.load(file), calibration.calibrate(levels, TODAY), 60)
    before, made = file.read_text("utf-8"), calibration.rewritten(file.read_text("utf-8"), after)
    comments, left = ([line for line in text.splitlines() if line.startswith(("#", "["))] for text in (before, made))
    stale = ("# NOT CALIBRATED: `palpate calibrate tracker`", "[[tracker.calibration]]")
    assert left == [line for line in comments if not line.startswith(stale)]
    assert "NOT CALIBRATED: `palpate calibrate tracker`" not in made
    assert calibration.rewritten(made, after) == made


@pytest.mark.parametrize("text", ["", "5", "5,5", "a,b", "0,nan", "0;10"])
def test_heights_that_are_none_are_refused(text: str, refuses: Refuses) -> None:
    with refuses(RigError):
        calibration.heights_asked(text)


def test_heights_are_read() -> None:
    assert calibration.heights_asked("-2, 0,10.5") == (-2.0, 0.0, 10.5)
