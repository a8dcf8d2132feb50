"""Stimuli that are presented, through their ports on a rig without a tracker: from the protocol to the dataset."""

from __future__ import annotations

import csv
import re
from pathlib import Path

from palpate.experiment.dataset.verify import verify
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.study import rehearse, simulated_rig

STUDY = shipped("presented.toml").read_text("utf-8")
TWO = '[comparison]\nquality = "strength"\nfirst_key = "1"\nsecond_key = "2"\n\n[presented]\npause_s = 0.5'


def identified() -> str:
    return STUDY.replace("repetitions = 10", "repetitions = 3")


def compared() -> str:
    """The same stimuli in pairs, one after the other."""
    text = re.sub(r'\nkey = "\d"\nspoken = .*', "", STUDY).replace("[presented]", TWO, 1)
    text = text.replace('"identification"', '"comparison"').replace("repetitions = 10", "repetitions = 2")
    test = '[[analysis]]\ntest = "Bradley-Terry"\ntasks = ["name"]\nquestion = "How strong?"\n'
    return text[: text.index("[[analysis]]")] + test


def rows(dataset: Path) -> list[dict[str, str]]:
    with (dataset / "sub-01" / "beh" / "sub-01_task-name_events.tsv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file, delimiter="\t"))


def run_through(folder: Path, text: str, *, silence: bool = False) -> Path:
    study = folder / "study.toml"
    study.write_text(text, "utf-8")
    rig = simulated_rig(files.load(study))
    out = folder / ("silence" if silence else "dataset")
    rehearse(
        protocol_file=study,
        rig_file=rig,
        out=out,
        participants=1,
        seed=1,
        control="silence" if silence else "none",
        jobs=1,
    )
    assert verify(out).refused == 0
    return out


def test_a_study_is_rehearsed_and_nothing_but_the_vibration_says_what_was_presented(tmp_path: Path) -> None:
    felt, unfelt = (rows(run_through(tmp_path, identified(), silence=silence)) for silence in (False, True))
    right = [sum(row["presented"] == row["answered"] for row in each) for each in (felt, unfelt)]
    assert len(felt) == len(unfelt) == 12
    # Of 12 guesses among four, 8 and more are right once in 300 times.
    assert right[0] > 9
    assert right[1] < 8
    assert {row["foot_speed"] for row in felt if "foot_speed" in row} == set()


def test_a_trial_of_two_intervals_says_what_each_presented(tmp_path: Path) -> None:
    made = rows(run_through(tmp_path, compared()))
    assert len(made) == 20
    for column in ("first", "second"):
        assert {row[column] for row in made} == {"low hum", "high hum", "rustle", "knock"}
    assert "presented" not in made[0]
