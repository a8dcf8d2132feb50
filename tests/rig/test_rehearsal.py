"""A whole rehearsal through real ports: what it makes, how close it comes to the paper, and the control condition.

How near the answers are to the printed ones is judged over three seeds in `rehearsal/kinds/footstep/test_observer.py`.
"""

from __future__ import annotations

import csv
import gzip
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from palpate.experiment import storage
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.cli import analysis
from palpate.experiment.dataset.verify import verify
from palpate.experiment.desk.questions import Arm, Question, Reply
from palpate.experiment.protocol.files import shipped
from palpate.experiment.records import journal
from palpate.experiment.records.kinds.footstep import FootStep
from palpate.experiment.rehearsal.kinds.footstep.participant import SimulatedParticipant
from palpate.experiment.rehearsal.wires.foot import Foot, Trajectory
from tests.conftest import Palpate
from tests.experiment.protocol.small import SMALL
from tests.reference.okamoto2012 import MATERIALS, TABLE_1, TABLE_2
from tests.rig.faults import Faults
from tests.rig.rehearsed import assert_all_say, counted, rehearse

PUBLISHED = {"virtual": TABLE_1, "real": TABLE_2}


def ratios(root: Path, task: str) -> np.ndarray:
    counts = np.zeros((4, 4))
    for row in counted(root, task):
        counts[MATERIALS.index(row["presented"]), MATERIALS.index(row["answered"])] += 1
    return np.asarray(counts / counts.sum(axis=1, keepdims=True))


def test_confusions_are_those_of_the_paper(tmp_path: Path) -> None:
    root = rehearse(tmp_path / "whole", participants=5, jobs=2)
    assert len(counted(root, "virtual")) == len(counted(root, "real")) == 5 * 40
    virtual = np.corrcoef(ratios(root, "virtual").ravel(), np.ravel(PUBLISHED["virtual"]))[0, 1]
    real = np.corrcoef(ratios(root, "real").ravel(), np.ravel(PUBLISHED["real"]))[0, 1]
    assert virtual >= 0.85
    assert real >= 0.95


def test_silence_is_answered_at_chance_and_leaves_the_real_task_alone(tmp_path: Path, one: Path) -> None:
    root = rehearse(tmp_path / "silent", participants=3, seed=1, control="silence", jobs=1)
    rows = counted(root, "virtual")
    correct = sum(row["presented"] == row["answered"] for row in rows)
    low, high = stats.binom.ppf([0.0005, 0.9995], len(rows), 0.25)
    assert low <= correct <= high
    first = counted(root, "real")[:40]
    assert [row["answered"] for row in first] == [row["answered"] for row in counted(one, "real")]


def test_the_same_seed_gives_the_same_files_and_another_does_not(tmp_path: Path, one: Path) -> None:
    again = rehearse(tmp_path / "again")
    other = rehearse(tmp_path / "other", seed=2)
    made = sorted(path.relative_to(one) for path in one.glob("sub-*/beh/*"))
    assert len(made) == 8
    for path in made:
        assert (again / path).read_bytes() == (one / path).read_bytes(), path
        if path.name.endswith("_events.tsv"):
            assert (other / path).read_bytes() != (one / path).read_bytes()


def test_the_rendered_speed_is_the_foots(one: Path) -> None:
    rows = counted(one, "virtual") + counted(one, "real")
    speeds = np.array([float(row["foot_speed"]) for row in rows])
    assert np.all((speeds > 45) & (speeds < 440))
    assert len(set(speeds)) == len(speeds)


def test_steps_that_broke_off_stand_in_the_events_with_their_reason(one: Path) -> None:
    rows = []
    for path in sorted(one.glob("sub-*/beh/*_events.tsv")):
        with path.open() as file:
            rows += [(path.name, row) for row in csv.DictReader(file, delimiter="\t")]
    in_vain = [(name, row) for name, row in rows if row["redo_reason"].startswith("the foot ")]
    assert in_vain
    for name, row in in_vain:
        assert (row["counted"], row["answered"], row["duration"]) == ("0", "n/a", "n/a")
        (counts,) = (o for file, o in rows if (file, o["trial"], o["counted"]) == (name, row["trial"], "1"))
        assert counts["attempt"] > row["attempt"]
        assert float(counts["onset"]) > float(row["onset"])


def test_contact_was_predicted_in_every_virtual_trial(one: Path) -> None:
    entries = journal.read(storage.journal_path(one, "01", "virtual")).entries
    onsets = [entry.onset for entry in entries if isinstance(entry, FootStep)]
    errors_ms = [onset.prediction_error_ms for onset in onsets if onset and onset.prediction_error_ms is not None]
    assert len(errors_ms) == len(onsets) == 40
    # Predicted from all samples before contact, noise included: well below 1 ms.
    assert np.std(errors_ms) < 1.0
    assert all(onset.scheduled_ns is None for onset in onsets if onset)


def test_simulated_time_claims_no_durations(one: Path) -> None:
    steps = [e for e in journal.read(storage.journal_path(one, "01", "virtual")).entries if isinstance(e, FootStep)]
    assert {step.dead_time_ms for step in steps} == {None}
    assert {step.onset.gate_to_scheduled_ms for step in steps if step.onset} == {None}
    (row, *_) = counted(one, "virtual")
    assert "prediction_error" in row
    assert not {"delivery_error", "gate_to_scheduled", "dead_time"} & set(row)
    assert "prediction_error" not in counted(one, "real")[0]


def test_every_file_says_rehearsal(one: Path) -> None:
    assert_all_say(one, "REHEARSAL")


def test_any_five_materials_are_rehearsed_to_the_end_and_told_apart(
    tmp_path: Path, palpate: Palpate, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(analysis, "analysed", lambda *_, **__: "")
    material = '[[materials]]\nid = "{0}"\nkey = "{1}"\nspoken = ["{0}"]\ndescription = "A {0}."\n\n'
    more = "".join(material.format(name, name[0]) for name in ("felt tip", "moss", "sand")).replace('"f"', '"x"')
    file = tmp_path / "five.toml"
    file.write_text(
        SMALL.replace("[task_order]", f"{more}[task_order]").replace("chance = 0.5", "chance = 0.2"), "utf-8"
    )
    code, _, err = palpate("rehearse", file, "--participants", 2, "--out", tmp_path / "five", "--jobs", 1)
    said = "The simulation of 'felt', 'cork', 'felt tip', 'moss' and 'sand' is generic: it does not resemble the real "
    said += "materials."
    assert (code, said in err) == (0, True)
    assert said in (tmp_path / "five" / "stimuli" / "recordings" / "manifest.toml").read_text("utf-8")
    assert "it resembles nothing" in (tmp_path / "five" / "README").read_text("utf-8")
    rows = counted(tmp_path / "five", "one") + counted(tmp_path / "five", "two")
    assert len(rows) == 2 * 5 * (3 + 2)
    right = [row["presented"] == row["answered"] for row in rows]
    assert stats.binomtest(sum(right), len(right), 0.2, alternative="greater").pvalue < 1e-4


def test_tasks_that_present_some_of_the_materials_are_rehearsed_and_analysed(tmp_path: Path, palpate: Palpate) -> None:
    file = tmp_path / "some.toml"
    text = SMALL.replace('kind = "max-run", max_run = 2', 'kind = "full-random"')
    for kind, only in (("virtual", "felt"), ("real", "cork")):
        text = text.replace(f'stimulus = "{kind}"', f'stimulus = "{kind}"\nmaterials = ["{only}"]')
    file.write_text(text[: text.rindex("[[analysis]]")], "utf-8")
    root = tmp_path / "rehearsed"
    code, out, err = palpate("rehearse", file, "--participants", 3, "--out", root)
    assert code == 0, err
    assert "no material is" in out
    for task, only, trials in (("one", "felt", 3), ("two", "cork", 2)):
        rows = counted(root, task)
        assert {row["presented"] for row in rows} == {only}
        assert {row["answered"] for row in rows} <= {"felt", "cork", "none"}
        assert len(rows) == 3 * trials
    assert verify(root).refused == 0


def test_stimuli_were_shaped_by_the_table_that_is_kept_beside_the_journal(one: Path) -> None:
    path = storage.journal_path(one, "01", "virtual")
    rig = rigs.load(storage.rig_path(path))
    assert rig.actuator.shaping is not None
    kept = path.with_name(rig.actuator.shaping.response)
    assert kept.read_bytes() == shipped("rigs/rehearsal-response.csv").read_bytes()
    stimuli = [entry.stimulus for entry in journal.read(path).entries if isinstance(entry, FootStep) and entry.stimulus]
    assert len(stimuli) == 40
    for stimulus in stimuli:
        assert stimulus.shaping is not None
        assert stimulus.handed_unit == "V"
        assert 0 < stimulus.handed_peak < rig.actuator.full_scale
        assert stimulus.limited == stimulus.shaping.bounded_bins == 0
        assert stimulus.shaping.outside_cost_m_s2 > 0


def test_the_foot_trace_is_the_frames_that_the_journal_names(one: Path) -> None:
    sidecar = json.loads(next(one.glob("sub-01/beh/*virtual_recording-foot_physio.json")).read_text())
    with gzip.open(next(one.glob("sub-01/beh/*virtual_recording-foot_physio.tsv.gz")), "rt") as file:
        height = np.array([float("nan") if line.strip() == "n/a" else float(line) for line in file])
    seconds = sidecar["StartTime"] + np.arange(len(height)) / sidecar["SamplingFrequency"]
    for row in counted(one, "virtual"):
        contact = float(row["onset"])
        around = height[(seconds > contact - 0.012) & (seconds < contact - 0.004)]
        assert np.all((around > -1) & (around < 6))
        assert np.nanmin(height[(seconds > contact) & (seconds < contact + 0.05)]) < 0.3


def test_a_finished_rehearsal_is_not_run_again(tmp_path: Path, one: Path) -> None:
    root = tmp_path / "rehearsal"
    shutil.copytree(one, root)
    report = verify(root)
    assert (report.title, report.refused) == (f"REHEARSAL of okamoto2012: {root}", 0)
    before = {path: path.read_bytes() for path in root.rglob("*") if path.is_file()}
    told: list[tuple[int, int]] = []
    rehearse(root, total=lambda answers, done: told.append((answers, done)))
    assert told == [(80, 80)]
    assert {path: path.read_bytes() for path in root.rglob("*") if path.is_file()} == before


def test_a_repeated_trial_does_not_leave_its_stimulus_to_the_next(
    tmp_path: Path, one: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Every first attempt loses more frames than the protocol's rule allows.
    step, ask = Foot.step, SimulatedParticipant.ask
    first = True

    def noted(self: SimulatedParticipant, question: Question | Arm) -> Reply:
        nonlocal first
        first = isinstance(question, Arm) and not question.broken_off and question.attempt == 1
        reply = ask(self, question)
        first = False
        return reply

    def lossy(self: Foot, trajectory: Trajectory, start_us: int) -> None:
        step(self, trajectory, start_us, Faults(drop=frozenset(range(20, 60))) if first else None)

    monkeypatch.setattr(SimulatedParticipant, "ask", noted)
    monkeypatch.setattr(Foot, "step", lossy)
    root = rehearse(tmp_path / "rehearsal", participants=2)
    rows = counted(root, "virtual")
    assert {row["attempt"] for row in rows} <= {"2", "3", "4"}
    correct = np.mean([row["presented"] == row["answered"] for row in rows])
    # Judged on the stimulus before, it would be near 0.25.
    assert correct > 0.4
