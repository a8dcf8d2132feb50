"""Stimuli that are presented, through their ports on a rig without a tracker: from the protocol to the dataset."""

from __future__ import annotations

import csv
import re
from pathlib import Path
from typing import Literal

from palpate.experiment import storage
from palpate.experiment.dataset.verify import verify
from palpate.experiment.protocol import files, new
from palpate.experiment.protocol.files import shipped
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Note
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


def rows(dataset: Path, task: str = "name") -> list[dict[str, str]]:
    with (dataset / "sub-01" / "beh" / f"sub-01_task-{task}_events.tsv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file, delimiter="\t"))


def run_through(folder: Path, text: str, control: Literal["none", "silence", "heard"] = "none") -> Path:
    study = folder / "study.toml"
    study.write_text(text, "utf-8")
    rig = simulated_rig(files.load(study))
    out = folder / control
    rehearse(
        protocol_file=study,
        rig_file=rig,
        out=out,
        participants=1,
        seed=1,
        control=control,
        jobs=1,
    )
    assert verify(out).refused == 0
    return out


def test_a_study_is_rehearsed_and_nothing_but_the_vibration_says_what_was_presented(tmp_path: Path) -> None:
    felt, unfelt = (rows(run_through(tmp_path, identified(), control)) for control in ("none", "silence"))
    right = [sum(row["presented"] == row["answered"] for row in each) for each in (felt, unfelt)]
    assert len(felt) == len(unfelt) == 12
    # Of 12 guesses among four, 8 and more are right once in 300 times.
    assert right[0] > 9
    assert right[1] < 8
    assert {row["foot_speed"] for row in felt if "foot_speed" in row} == set()


def test_a_control_is_answered_by_guesses_unless_its_stimuli_are_heard(tmp_path: Path) -> None:
    text = new.controlled(identified())
    masked, heard = (run_through(tmp_path, text, control) for control in ("none", "heard"))
    right = {
        (out.name, task): sum(row["presented"] == row["answered"] for row in rows(out, task))
        for out in (masked, heard)
        for task in ("name", "control")
    }
    # As above: of 12 guesses among four.
    assert right["none", "name"] > 9
    assert right["none", "control"] < 8
    assert right["heard", "control"] > 9
    confirmed = [
        entry.text
        for task in ("name", "control")
        for entry in journal.read(storage.journal_path(masked, "01", task)).entries
        if isinstance(entry, Note)
    ]
    assert [new.ARRANGEMENT in text for text in confirmed] == [False, True]


def test_a_trial_of_two_intervals_says_what_each_presented(tmp_path: Path) -> None:
    made = rows(run_through(tmp_path, compared()))
    assert len(made) == 20
    for column in ("first", "second"):
        assert {row[column] for row in made} == {"low hum", "high hum", "rustle", "knock"}
    assert "presented" not in made[0]
