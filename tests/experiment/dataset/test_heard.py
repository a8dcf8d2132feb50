"""What an accelerometer heard, from journals of each kind to rows, the report and the export."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from palpate.analysis.designs import design_of
from palpate.analysis.export import files
from palpate.analysis.reading.dataset import read
from palpate.analysis.report.heard import heard_sections
from palpate.experiment.dataset.build import heard_cells
from palpate.experiment.dataset.kinds import presented, tapping
from palpate.experiment.records.entries import Entry
from palpate.experiment.records.journal import Contents, Line
from palpate.experiment.records.kinds.presented import Interval, Presentation
from palpate.experiment.records.kinds.tapping import PairLaidOut, Place, Tapped
from palpate.experiment.records.stimulus import Computed, Heard, Moved, Onset, Stimulus
from tests.analysis.datasets import compared, trials, write_dataset

THIRDS = tuple(np.linspace(-40.0, -6.0, 18).round(2).tolist())
TAPS: tuple[tuple[Place, str, float | None], ...] = (
    ("second", "cork", 5.0),
    ("first", "felt", 4.0),
    ("second", "cork", None),
)
LOUDER = [db + 1.0 for db in THIRDS]


def stimulus(peak_m_s2: float | None) -> Stimulus:
    """What was played, and heard 12 ms late, 1 dB louder; None: nothing was heard."""
    heard = Heard(peak_m_s2=peak_m_s2, thirds_db=tuple(LOUDER), sent_thirds_db=THIRDS, delay_ms=12.0, gain=1.122)
    return Stimulus(
        asked_sha256="0" * 64, floored_bins=0, extrapolated=False, handed_sha256="0" * 64, handed_unit="m/s^2",
        computed=Computed(method="declared", relative_error=0.0, left_out=0.0, dissimilarity_m_s2=0.0),
        handed_peak=1.0, samples=500, rate_hz=5000, limited=0, reached_peak_m_s2=1.0,
        moved=Moved(peak_m_s2=2.0, uncertainty_m_s2=0.1, scale=1.0), heard=None if peak_m_s2 is None else heard,
    )  # fmt: skip


def test_what_was_heard_with_samples_lost_stands_in_no_table() -> None:
    whole = stimulus(3.0)
    assert whole.heard is not None
    lost = whole.model_copy(update={"heard": whole.heard.model_copy(update={"lost_ms": ((40.0, 8.0),)})})
    assert (len(heard_cells(whole)), heard_cells(lost)) == (6, {})


def contents(*recorded: Entry) -> Contents:
    return Contents(tuple(Line(n * 10**9, one) for n, one in enumerate(recorded)))


@pytest.mark.parametrize("materials", [("felt",), ("felt", "cork")])
def test_a_presentation_tells_what_was_heard_of_its_last_stimulus(materials: Sequence[str]) -> None:
    intervals = tuple(
        Interval(material=one, onset_ns=n, stimulus=stimulus(3.0 + n), delivered=None)
        for n, one in enumerate(materials)
    )
    entry = Presentation(trial=1, attempt=1, presented=tuple(materials), intervals=intervals, set_off="clock")
    ((_, cells),) = presented.DATASET.cells(Path(), contents(entry))
    assert cells["heard_peak"] == 2.0 + len(materials)
    assert (cells["sent_peak"], cells["heard_delay"]) == (2.0, 0.012)
    assert cells.get("heard_of") == (None if len(materials) == 1 else "cork")


def test_a_pair_tells_what_was_heard_of_its_last_touch_that_was() -> None:
    onset = Onset(
        predicted_us=None, standard_error_ms=None, predicted_from_us=None, prediction_error_ms=None, contact_ns=1,
        scheduled_ns=None, gate_to_scheduled_ms=None, delivered=None,
    )  # fmt: skip
    laid = [PairLaidOut(trial=n, attempt=1, presented=("felt", "cork"), laid_ns=n) for n in (1, 2)]
    taps = [
        Tapped(trial=1, attempt=1, place=place, material=material, device_us=n, speed_mm_s=100.0, fast=False,
               stimulus=stimulus(peak), onset=onset)
        for n, (place, material, peak) in enumerate(TAPS)
    ]  # fmt: skip
    (_, first), (_, second) = tapping.DATASET.cells(Path(), contents(laid[0], *taps, laid[1]))
    assert (first["heard_of"], first["heard_peak"]) == ("felt", 4.0)
    assert "heard_peak" not in second


def test_report_and_export_have_what_was_heard_of_comparisons(tmp_path: Path) -> None:
    thirds = " | ".join(map(str, THIRDS))
    of = {"sent_peak": 2.0, "heard_peak": 4.0, "heard_delay": 0.012, "heard_gain": 1.1, "sent_thirds": thirds}
    rows = compared([("felt", "cork", "first")] * 3, heard_of="cork", heard_thirds=" | ".join(map(str, LOUDER)), **of)
    rows += [dict(compared([("felt", "cork", "second")])[0], trial=4)]
    root = write_dataset(
        tmp_path / "study", {"1": {"live": rows}, "2": {"live": rows}}, materials=("felt", "cork"), tasks=("live",),
        answers=("first", "second"),
    )  # fmt: skip
    study = read(root)
    ((table,),) = [one.tables for one in heard_sections(study)]
    [record] = table.records
    assert (record["presented"], record["heard"]) == ("cork", 6)
    assert record["peak_db_median"] == pytest.approx(20 * np.log10(2.0))
    off_db = record["third_octave_db_worst"]
    assert off_db == pytest.approx(1.0)
    assert record["delay_ms_median"] == pytest.approx(12.0)
    found = list(csv.DictReader(io.StringIO(files(study)["heard.csv"].decode())))
    assert [(row["trial"], row["heard_of"]) for row in found] == [(str(n), "cork") for _ in "12" for n in (1, 2, 3)]
    levels = [[float(row[name]) for name in row if name.startswith("heard_thirds_")] for row in found]
    assert levels == [LOUDER] * 6
    assert design_of(study).name == "comparison"


def test_nothing_is_told_where_nothing_listened(tmp_path: Path) -> None:
    root = write_dataset(tmp_path / "study", {who: {"virtual": trials([("sand", "sand")])} for who in "12"})
    study = read(root)
    assert not heard_sections(study)
    assert "heard.csv" not in files(study)
