"""A whole rehearsal through real ports: what it makes, how it resumes, what it refuses, and the control condition."""

from __future__ import annotations

import csv
import gzip
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from experiment import dataset
from experiment.apparatus import opening
from experiment.apparatus import rig as rigs
from experiment.errors import DatasetError, Interrupted, JournalError, ProtocolError, RigError
from experiment.protocol.shipped import shipped
from experiment.rehearsal import session, study
from experiment.rehearsal.foot import Faults, Foot
from experiment.rehearsal.movement import Trajectory
from experiment.rehearsal.participant import SimulatedParticipant
from experiment.session import journal, places
from tests.reference.okamoto2012 import MATERIALS, TABLE_1, TABLE_2

PUBLISHED = {"virtual": TABLE_1, "real": TABLE_2}

Rehearse = Callable[..., Path]


def rehearse(out: Path, **changed: object) -> Path:
    asked: dict[str, object] = {"participants": 1, "seed": 1} | changed
    return study.rehearse(
        protocol_file=shipped("okamoto2012.toml"), rig_file=shipped("rigs/rehearsal.toml"), out=out, **asked
    )


def counted(root: Path, task: str) -> list[dict[str, str]]:
    rows = []
    for path in sorted(root.glob(f"sub-*/beh/*_task-{task}_events.tsv")):
        with path.open() as file:
            rows += [row for row in csv.DictReader(file, delimiter="\t") if row["counted"] == "1"]
    return rows


def ratios(root: Path, task: str) -> np.ndarray:
    counts = np.zeros((4, 4))
    for row in counted(root, task):
        counts[MATERIALS.index(row["presented"]), MATERIALS.index(row["answered"])] += 1
    return counts / counts.sum(axis=1, keepdims=True)


@pytest.fixture(scope="module")
def one(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return rehearse(tmp_path_factory.mktemp("one") / "rehearsal")


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_confusions_are_those_of_the_paper(tmp_path: Path, seed: int) -> None:
    root = rehearse(tmp_path / "whole", participants=15, seed=seed, jobs=2)
    assert len(counted(root, "virtual")) == 15 * 40
    assert len(counted(root, "real")) == 10 * 40
    virtual = np.corrcoef(ratios(root, "virtual").ravel(), np.ravel(PUBLISHED["virtual"]))[0, 1]
    real = np.corrcoef(ratios(root, "real").ravel(), np.ravel(PUBLISHED["real"]))[0, 1]
    assert virtual >= 0.85
    assert real >= 0.95


def test_silence_is_answered_at_chance_and_leaves_the_real_task_alone(tmp_path: Path, one: Path) -> None:
    root = rehearse(tmp_path / "silent", participants=6, seed=1, control="silence", jobs=2)
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
    entries = journal.read(places.journal_path(one, "01", "virtual")).entries
    onsets = [entry.onset for entry in entries if entry.kind == "step"]
    errors_ms = [onset.prediction_error_ms for onset in onsets if onset and onset.prediction_error_ms is not None]
    assert len(errors_ms) == len(onsets) == 40
    # Predicted from all samples before contact, noise included: well below 1 ms.
    assert np.std(errors_ms) < 1.0
    assert all(onset.scheduled_ns is None for onset in onsets if onset)


def test_simulated_time_claims_no_durations(one: Path) -> None:
    steps = [e for e in journal.read(places.journal_path(one, "01", "virtual")).entries if e.kind == "step"]
    assert {step.dead_time_ms for step in steps} == {None}
    assert {step.onset.gate_to_scheduled_ms for step in steps if step.onset} == {None}
    (row, *_) = counted(one, "virtual")
    assert "prediction_error" in row
    assert not {"delivery_error", "gate_to_scheduled", "dead_time"} & set(row)
    assert "prediction_error" not in counted(one, "real")[0]


def test_every_file_says_rehearsal(one: Path) -> None:
    for path in sorted(one.rglob("*")):
        relative = path.relative_to(one).as_posix()
        if (
            not path.is_file()
            or path.name == "protocol.toml"
            or path.suffix in (".lock", ".cobs", ".head", ".wav", ".gz")
        ):
            continue
        text = path.read_text("utf-8")
        if path.suffix == ".jsonl":
            assert '"rehearsal":true' in text, relative
        elif path.suffix == ".csv":
            assert text.startswith("# SIMULATED"), relative
        elif path.suffix == ".toml":
            assert "simulated = true" in text, relative
        elif path.suffix == ".tsv":
            assert all("REHEARSAL" in line for line in text.splitlines()[1:]), relative
        else:
            assert "REHEARSAL" in re.sub(r'"Levels": \{[^}]*\}', "", text), relative


def test_stimuli_were_shaped_by_the_table_that_is_kept_beside_the_journal(one: Path) -> None:
    path = places.journal_path(one, "01", "virtual")
    rig = rigs.load(places.rig_path(path))
    assert rig.actuator.shaping is not None
    kept = path.with_name(rig.actuator.shaping.response)
    assert kept.read_bytes() == shipped("rigs/rehearsal-response.csv").read_bytes()
    driven = [entry.stimulus.driven for entry in journal.read(path).entries if entry.kind == "step" and entry.stimulus]
    assert len(driven) == 40
    for stimulus in driven:
        assert stimulus is not None
        assert 0 < stimulus.peak_v < rig.actuator.full_scale
        assert stimulus.limited == stimulus.shaping.bounded_bins == 0
        assert stimulus.shaping.outside_cost_m_s2 > 0


def test_another_table_of_the_same_name_is_never_put_over_the_one_that_was_used(tmp_path: Path, one: Path) -> None:
    root = tmp_path / "rehearsal"
    shutil.copytree(one, root)
    kept = root / "sourcedata" / "sub-01" / "rehearsal-response.csv"
    kept.write_text("# simulated, of another day\n")
    before = kept.read_bytes()
    with pytest.raises(RigError, match="rename the new table, in the rig file too"):
        opening.keep(root / "sourcedata" / "rig.toml", kept.with_name("another_rig.toml"))
    assert kept.read_bytes() == before


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


def test_it_goes_on_after_the_port_vanished_and_loses_nothing(
    tmp_path: Path, one: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps = 0
    step = Foot.step

    def unplugged_at_the_thirtieth(self: Foot, trajectory: Trajectory, start_us: int) -> None:
        nonlocal steps
        steps += 1
        step(self, trajectory, start_us, Faults(unplug_at=150) if steps == 30 else None)

    monkeypatch.setattr(Foot, "step", unplugged_at_the_thirtieth)
    monkeypatch.setattr(session, "RECONNECT_S", 0.2)
    with pytest.raises(Interrupted, match=r"not back within 0\.2 s .*plug the device in again"):
        rehearse(tmp_path / "rehearsal")
    root = rehearse(tmp_path / "rehearsal")
    for task in ("virtual", "real"):
        answers = [(row["trial"], row["presented"]) for row in counted(root, task)]
        assert answers == [(row["trial"], row["presented"]) for row in counted(one, task)]


def test_a_finished_rehearsal_is_not_run_again(tmp_path: Path) -> None:
    root = rehearse(tmp_path / "rehearsal")
    before = {path: path.read_bytes() for path in root.rglob("*") if path.is_file()}
    rehearse(tmp_path / "rehearsal")
    assert {path: path.read_bytes() for path in root.rglob("*") if path.is_file()} == before


def test_another_rehearsal_or_anything_else_in_the_folder_is_refused(tmp_path: Path, one: Path) -> None:
    with pytest.raises(DatasetError, match=r"seed 1 there, 2 asked for.*choose another folder with --out"):
        rehearse(one, seed=2)
    (tmp_path / "study").mkdir()
    (tmp_path / "study" / "data.tsv").write_text("precious")
    with pytest.raises(DatasetError, match="a rehearsal never writes into anything else"):
        rehearse(tmp_path / "study")
    assert (tmp_path / "study" / "data.tsv").read_text() == "precious"


def rig_with(folder: Path, old: str, new: str) -> Path:
    """The rehearsal's rig with one line changed, and the response table beside it."""
    for name in ("rehearsal.toml", "rehearsal-response.csv"):
        shutil.copyfile(shipped(f"rigs/{name}"), folder / name)
    path = folder / "rehearsal.toml"
    text = path.read_text("utf-8")
    assert text.count(old) == 1
    path.write_text(text.replace(old, new), "utf-8")
    return path


@pytest.mark.parametrize("jobs", [1, 2])
@pytest.mark.parametrize("exists", [False, True])
def test_a_rehearsal_that_is_refused_before_the_first_session_leaves_nothing(
    tmp_path: Path, jobs: int, exists: bool
) -> None:
    (tmp_path / "rig").mkdir()
    unfit = rig_with(tmp_path / "rig", "[tracker]\n", '[tracker]\ndriver = "nobody_wrote_this:Tracker"\n')
    out = tmp_path / "new" / "rehearsal"
    if exists:
        out.mkdir(parents=True)
    with pytest.raises(RigError, match="nobody_wrote_this"):
        study.rehearse(
            protocol_file=shipped("okamoto2012.toml"), rig_file=unfit, out=out, participants=2, seed=1, jobs=jobs
        )
    assert sorted(tmp_path.rglob("*")) == sorted(
        [*tmp_path.glob("rig"), *tmp_path.glob("rig/*"), *([out.parent, out] * exists)]
    )
    # Another rig may be rehearsed there.
    assert len(counted(rehearse(out), "virtual")) == 40


def test_of_two_rehearsals_that_begin_at_once_in_one_folder_one_is_refused_and_takes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second begins while the first makes the folder, and again just when it has made it."""
    out, refused = tmp_path / "made", 0
    make, participant, is_begun = study.simulated.make_recordings, study.rehearse_participant, study._is_begun

    def second() -> None:
        nonlocal refused
        with monkeypatch.context() as within:
            # It looked before the first had made anything.
            within.setattr(study, "_is_begun", lambda *_: False)
            within.setattr(study.simulated, "make_recordings", make)
            with pytest.raises(DatasetError, match="another palpate rehearse makes it at this moment"):
                rehearse(out)
        refused += 1

    def making(*at: Path, **what: object) -> Path:
        second()
        return make(*at, **what)

    def beginning(*of: object) -> None:
        plan = study.Plan(**json.loads((out / "sourcedata" / study.PLAN).read_text("utf-8")))
        second()
        assert is_begun(out, plan)
        monkeypatch.setattr(study, "rehearse_participant", participant)
        participant(*of)

    monkeypatch.setattr(study.simulated, "make_recordings", making)
    monkeypatch.setattr(study, "rehearse_participant", beginning)
    assert rehearse(out) == out
    assert refused == 2
    assert [path.name for path in tmp_path.iterdir()] == ["made"]
    assert not (out / study.LOCK).exists()
    assert len(counted(out, "virtual")) == 40


def test_a_rehearsal_that_fails_after_its_first_session_began_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Foot, "step", interrupted)
    with pytest.raises(Interrupted):
        rehearse(tmp_path / "rehearsal")
    assert journal.read(places.journal_path(tmp_path / "rehearsal", "01", "virtual")).lines


def interrupted(*_: object) -> None:
    raise KeyboardInterrupt


def test_a_broken_journal_is_refused_and_nothing_is_overwritten(tmp_path: Path, one: Path) -> None:
    root = tmp_path / "rehearsal"
    shutil.copytree(one, root)
    path = places.journal_path(root, "01", "virtual")
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(lines[:5] + lines[6:]))
    before = path.read_bytes()
    with pytest.raises(JournalError, match="line 6 does not follow the line before it"):
        rehearse(root)
    assert path.read_bytes() == before


def test_a_truncated_journal_is_refused_and_nothing_is_overwritten(tmp_path: Path, one: Path) -> None:
    root = tmp_path / "rehearsal"
    shutil.copytree(one, root)
    path = places.journal_path(root, "01", "virtual")
    path.write_bytes(path.read_bytes()[:-2000])
    before = path.read_bytes()
    for call in (lambda: rehearse(root), lambda: dataset.build(root)):
        with pytest.raises(JournalError, match=r"is truncated: it had .* restore the journal from a backup"):
            call()
    assert path.read_bytes() == before


def test_a_missing_journal_is_refused(tmp_path: Path, one: Path) -> None:
    root = tmp_path / "rehearsal"
    shutil.copytree(one, root)
    places.journal_path(root, "01", "real").unlink()
    with pytest.raises(JournalError, match=r"the journal is missing: it had \d+ lines; restore it from a backup"):
        rehearse(root)


def test_a_rehearsal_never_writes_inside_a_dataset(one: Path) -> None:
    with pytest.raises(DatasetError, match="lies inside the dataset"):
        rehearse(one / "inside" / "deeper")
    assert not (one / "inside").exists()


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_broken_copy_of_the_protocol_is_named(tmp_path: Path, one: Path, jobs: int) -> None:
    root = tmp_path / "rehearsal"
    shutil.copytree(one, root)
    (root / "sourcedata" / "protocol.toml").write_text("x =")
    with pytest.raises(ProtocolError, match=r"protocol\.toml: 1 error"):
        rehearse(root, jobs=jobs)


def test_a_repeated_trial_does_not_leave_its_stimulus_to_the_next(
    tmp_path: Path, one: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Every first attempt loses more frames than the protocol's rule allows.
    step, arm = Foot.step, SimulatedParticipant.arm
    first = True

    def noted(self: SimulatedParticipant, *, trial: int, attempt: int, trials: int) -> None:
        nonlocal first
        first = attempt == 1
        arm(self, trial=trial, attempt=attempt, trials=trials)
        first = False

    def lossy(self: Foot, trajectory: Trajectory, start_us: int) -> None:
        step(self, trajectory, start_us, Faults(drop=frozenset(range(20, 60))) if first else None)

    monkeypatch.setattr(SimulatedParticipant, "arm", noted)
    monkeypatch.setattr(Foot, "step", lossy)
    root = rehearse(tmp_path / "rehearsal", participants=4)
    rows = counted(root, "virtual")
    assert {row["attempt"] for row in rows} <= {"2", "3", "4"}
    correct = np.mean([row["presented"] == row["answered"] for row in rows])
    assert correct > 0.4, "judged on the stimulus before, it would be near 0.25"


def test_a_journal_without_a_header_is_left_out_of_the_dataset(tmp_path: Path, one: Path) -> None:
    root = tmp_path / "rehearsal"
    shutil.copytree(one, root)
    unborn = places.journal_path(root, "02", "virtual")
    unborn.parent.mkdir()
    unborn.write_bytes(b'{"n":0,"t_ns":9')
    dataset.build(root)
    assert not (root / "sub-02").exists()


def test_a_foot_trace_that_was_changed_is_refused(tmp_path: Path, one: Path) -> None:
    root = tmp_path / "rehearsal"
    shutil.copytree(one, root)
    path = places.foot_path(places.journal_path(root, "01", "real"))
    data = bytearray(path.read_bytes())
    data[1000] ^= 1
    path.write_bytes(data)
    with pytest.raises(DatasetError, match="are not those that the journal names; restore the file"):
        dataset.build(root)
