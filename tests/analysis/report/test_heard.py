"""What was heard of each stimulus beside what was sent, in a study's tables: by hand, and where nothing listened."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from palpate.analysis.reading.dataset import read
from palpate.analysis.report.heard import UNLISTENED, heard_tables
from palpate.analysis.report.played_section import played_sections
from palpate.experiment.errors import DatasetError
from palpate.experiment.synthesis.noticing import THIRDS_HZ
from tests.analysis.datasets import trial, write_dataset

BY_HAND = Path(__file__).with_name("heard_by_hand.py")


def heard(number: int, presented: str, rng: np.random.Generator, **cells: object) -> dict[str, object]:
    sent = np.round(rng.uniform(-60.0, 0.0, THIRDS_HZ.size), 2)
    off = np.round(sent + rng.normal(0.0, 1.0, sent.size), 2)
    return trial(
        number, presented, "sand", stimulus_method="inverse", stimulus_error=0.1, left_out=0.0, dissimilarity=0.1,
        sent_peak=float(rng.uniform(1.0, 9.0)), heard_peak=float(rng.uniform(1.0, 9.0)),
        heard_delay=float(rng.uniform(0.0, 0.02)), heard_gain=1.0,
        sent_thirds=" | ".join(map(str, sent)), heard_thirds=" | ".join(map(str, off)), **cells,
    )  # fmt: skip


def dataset(root: Path) -> Path:
    rng = np.random.default_rng(1)
    unheard = trial(8, "glass", "sand", stimulus_method="inverse", stimulus_error=0.1, left_out=0.0, dissimilarity=0.1)
    people = {
        who: {"virtual": [*(heard(n, ("sand", "snow")[n % 2], rng) for n in range(1, 8)), unheard]} for who in "12"
    }
    return write_dataset(root, people, tasks=("virtual",))


def test_the_table_is_what_another_program_makes_of_the_dataset(tmp_path: Path) -> None:
    root = dataset(tmp_path)
    printed = subprocess.run([sys.executable, BY_HAND], cwd=root, check=True, capture_output=True, text=True).stdout
    (section,) = played_sections(read(root))
    table = section.tables[1]
    assert "14 of 16" in table.title
    names = {"peak": "peak_db", "third": "third_octave_db", "delay": "delay_ms"}
    found = {
        (record["task"], record["presented"], name): [record[f"{key}_{of}"] for of in ("median", "worst")]
        for record in table.records
        for name, key in names.items()
    }
    by_hand = {
        (task, presented, name): [float(median), float(worst)]
        for task, presented, name, median, worst in (line.split("\t") for line in printed.splitlines())
    }
    assert len(by_hand) == 6
    assert found.keys() == by_hand.keys()
    for key, values in by_hand.items():
        assert found[key] == pytest.approx(values, rel=1e-9)


def test_the_worst_third_octave_is_named_and_one_that_hardly_sounds_does_not_count(tmp_path: Path) -> None:
    sent, off = np.full(18, -20.0), np.zeros(18)
    sent[3], off[3], off[10] = -60.0, 9.0, -2.5
    rows = [heard(1, "sand", np.random.default_rng(1))]
    rows[0] |= {"sent_thirds": " | ".join(map(str, sent)), "heard_thirds": " | ".join(map(str, sent + off))}
    rows[0] |= {"sent_peak": 2.0, "heard_peak": 4.0, "heard_delay": None}
    study = read(write_dataset(tmp_path, {"1": {"virtual": rows}}, tasks=("virtual",)))
    (record,) = heard_tables(study, study.attempts)[0].records
    worst = [record[f"{key}_worst"] for key in ("third_octave_db", "third_octave_hz", "peak_db")]
    assert worst == pytest.approx([2.5, 100.0, 20 * np.log10(2)])
    assert record["delay_ms_median"] is None


def test_where_nothing_listened_that_is_in_place_of_the_table(tmp_path: Path) -> None:
    bare = trial(1, "sand", "sand", stimulus_method="inverse", stimulus_error=0.1, left_out=0.0, dissimilarity=0.1)
    (section,) = played_sections(read(write_dataset(tmp_path, {"1": {"virtual": [bare]}}, tasks=("virtual",))))
    assert len(section.tables) == 1
    assert UNLISTENED in section.paragraphs
    assert "no accelerometer" not in UNLISTENED


@pytest.mark.parametrize("cell", ["1.0 | 2.0", " | ".join(["nan"] * 18)])
def test_levels_that_are_not_eighteen_numbers_are_refused(cell: str, tmp_path: Path) -> None:
    row = heard(1, "sand", np.random.default_rng(1)) | {"heard_thirds": cell}
    with pytest.raises(DatasetError):
        read(write_dataset(tmp_path, {"1": {"virtual": [row]}}, tasks=("virtual",)))
