"""Detection through the ports of a rig: answers come from what the panel was played, and lead to the threshold.

A simulated participant feels a sinusoid's mean square in dB above the published threshold of its third octave, with an
SD of 1.5 dB, so that the share of right answers at a level has a closed form.
"""

from __future__ import annotations

import csv
from math import log10
from pathlib import Path
from statistics import NormalDist
from typing import Literal

import pytest

import palpate
from palpate.experiment.dataset.verify import verify
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.study import rehearse, simulated_rig
from palpate.experiment.synthesis.noticing import FINGERTIP, THIRDS_HZ

STUDY = shipped("threshold.toml").read_text("utf-8")
YES_NO = (
    STUDY.replace("intervals = 2  ", 'intervals = 1\ncatch_trials = 1\nyes_key = "1"\nno_key = "2"  ')
    .replace('first_key = "1"\nsecond_key = "2"\n', "")
    .replace("repetitions = 100", "repetitions = 12")
)
"""Yes or no at three constant levels, each in four trials, with as many catch trials."""
before, _, after = YES_NO.partition("[tasks.levels]")
YES_NO = (
    f'{before}[tasks.levels]\nmethod = "constant"\ngrid = [0.05, 0.08, 0.5]\n\n{after[after.index("[[exclusion]]") :]}'
)


def run_through(folder: Path, text: str, control: Literal["none", "silence"] = "none") -> Path:
    study = folder / "study.toml"
    study.write_text(text, "utf-8")
    rig, out = simulated_rig(files.load(study)), folder / f"dataset-{control}"
    rehearse(
        protocol_file=study, rig_file=rig, out=out, participants=1, seed=3, control=control, jobs=1
    )  # fmt: skip
    assert verify(out).refused == 0
    return out


def rows(dataset: Path) -> list[dict[str, str]]:
    with (dataset / "sub-01" / "beh" / "sub-01_task-detect_events.tsv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file, delimiter="\t"))


def wanted_db(share: float) -> float:
    """The level, dB, at which so many are right: 2 m/s^2 at its peak, with ramps over a fifth that hold 3/8 of it."""
    threshold = float(FINGERTIP.detected_m_s2[abs(THIRDS_HZ - 250).argmin()])
    above_db = 1.5 * 2**0.5 * NormalDist().inv_cdf(share)
    return above_db - 10 * log10(2.0**2 / 2 * (0.8 + 0.2 * 3 / 8) / threshold**2)


def test_a_staircase_leads_to_the_level_at_which_so_many_are_right(tmp_path: Path) -> None:
    (track,) = palpate.detect(run_through(tmp_path, STUDY)).tasks[0].tracks
    # Levitt (1971): p^3 = 1/2. Levels are 2 dB apart; an SD of about 0.7 dB for one person.
    assert track.estimate.share == pytest.approx(0.5 ** (1 / 3))
    assert track.estimate.db == pytest.approx(wanted_db(0.5 ** (1 / 3)), abs=2.0)
    assert track.fit is not None
    assert track.fit.threshold.low < wanted_db(0.75) < track.fit.threshold.high
    assert sum(step.reversal for step in track.steps) == 12


def test_without_vibration_nothing_is_detected(tmp_path: Path) -> None:
    made = rows(run_through(tmp_path, STUDY.replace("repetitions = 100", "repetitions = 20"), control="silence"))
    right = sum((row["first"] == "vibration") == (row["answered"] == "first") for row in made)
    # Of 20 guesses 16 and more are right once in 170 times.
    assert right < 16
    assert {row["first"] for row in made} == {"vibration", "nothing"}


def test_yes_or_no_has_catch_trials_without_a_level(tmp_path: Path) -> None:
    root = run_through(tmp_path, YES_NO)
    made = rows(root)
    assert [row["level"] == "n/a" for row in made] == [row["presented"] == "nothing" for row in made]
    assert sum(row["presented"] == "nothing" for row in made) == 12
    (task,) = palpate.detect(root).tasks
    counts = {round(one.x_db): (one.hits, one.signals) for one in task.tracks[0].by_level}
    assert [signals for _, signals in counts.values()] == [4, 4, 4]
    assert counts[-6] == (4, 4)
    # Somebody who felt nothing says yes in 7 % of trials.
    assert task.catches[0].false_alarms < 5
