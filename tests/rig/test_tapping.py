"""The tapping study rehearsed through its ports, from the protocol to its tables, by SIMULATED participants.

How near their choices are to the printed ones is judged over three seeds in `rehearsal/kinds/tapping/test_observer.py`.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from palpate.analysis.analyse import analyse
from palpate.analysis.designs.comparison.results import TaskComparisons
from palpate.experiment import storage
from palpate.experiment.apparatus.servo.record import cycles_of
from palpate.experiment.dataset import build
from palpate.experiment.dataset.checks import findings
from palpate.experiment.dataset.outside import sharing
from palpate.experiment.dataset.verify import verify
from palpate.experiment.protocol.files import shipped
from palpate.experiment.records import journal
from palpate.experiment.records.kinds.tapping import Pushed, Tapped
from palpate.experiment.rehearsal.study import rehearse


def dataset(folder: Path, text: str, *, name: str = "whole", participants: int = 2, silent: bool = False) -> Path:
    """Rehearse a protocol's text, each pair twice, and return the dataset."""
    protocol = folder / "short.toml"
    protocol.write_text(
        text.replace("repetitions = 8 ", "repetitions = 2 ").replace("limit = 108", "limit = 27"), "utf-8"
    )
    return rehearse(
        protocol_file=protocol,
        rig_file=shipped("rigs/tapping.toml"),
        out=folder / name,
        participants=participants,
        seed=1,
        control="silence" if silent else "none",
        jobs=1,
    )


def rehearsed(folder: Path, text: str, *, silent: bool) -> tuple[TaskComparisons, ...]:
    """Rehearse a protocol's text with 2 participants, and analyse it."""
    root = dataset(folder, text, silent=silent)
    assert verify(root).refused == 0
    tasks: tuple[TaskComparisons, ...] = analyse([root], folder / "out", figures=False).results.tasks
    return tasks


def paper() -> str:
    return shipped("wellman1995.toml").read_text("utf-8")


def virtual_alone(text: str) -> str:
    begins, ends = (text.index(f'[[tasks]]\nid = "{task}"') for task in ("live", "virtual"))
    return (text[:begins] + text[ends:]).replace('["live", "virtual"]', '["virtual"]')


def right(task: TaskComparisons) -> float:
    """Return the share of right choices in pairs of two materials, of 40 trials."""
    different = [pair.right for pair in task.pairs if not pair.same]
    assert sum(one.trials for one in different) == 40
    return sum(one.count for one in different) / 40


def test_both_tasks_give_their_matrices_beside_the_printed_ones(tmp_path: Path) -> None:
    tasks = rehearsed(tmp_path, paper(), silent=False)
    assert [task.task.id for task in tasks] == ["live", "virtual"]
    for task in tasks:
        assert (len(task.participants), task.trials, len(task.pairs)) == (2, 60, 15)
        assert task.in_print is not None
        # The table's own mean over pairs of two materials, within three SDs of 40 trials.
        printed = np.mean([cell.percent for cell in task.in_print.cells if cell.low != cell.high]) / 100
        assert abs(right(task) - printed) < 3 * np.sqrt(printed * (1 - printed) / 40)


def test_silence_in_place_of_the_vibration_leaves_chance(tmp_path: Path) -> None:
    (virtual,) = rehearsed(tmp_path, virtual_alone(paper()), silent=True)
    # An SD of 8 %.
    assert abs(right(virtual) - 0.5) < 0.25


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return dataset(tmp_path_factory.mktemp("whole"), virtual_alone(paper()), participants=1)


def test_the_same_seed_writes_the_same_files(whole: Path, tmp_path: Path) -> None:
    once, again = whole, dataset(tmp_path, virtual_alone(paper()), name="again", participants=1)
    files = sorted(path.relative_to(once) for path in once.rglob("*") if path.is_file())
    assert files == sorted(path.relative_to(again) for path in again.rglob("*") if path.is_file())
    assert [path for path in files if (once / path).read_bytes() != (again / path).read_bytes()] == []
    force_is_on_record(once, tmp_path / "copy")


@pytest.mark.parametrize(("share", "bytes_more"), [(1.0, -7), (0.5, 0), (0.0, 0)], ids=["torn", "half", "empty"])
def test_a_file_of_force_that_lost_its_end_is_told_and_the_rest_is_built(
    whole: Path, tmp_path: Path, share: float, bytes_more: int
) -> None:
    root = tmp_path / "study"
    shutil.copytree(whole, root)
    journal_file = storage.journal_path(root, "01", "virtual")
    raw = storage.raw_path(journal_file, "force.bin")
    data = raw.read_bytes()
    raw.write_bytes(data[: round(share * len(data)) + bytes_more])
    pushed = [one for one in journal.read(journal_file).entries if isinstance(one, Pushed)]
    there = [one for one in pushed if one.trace.offset + one.trace.length <= raw.stat().st_size]
    lost = sum(one.cycles for one in pushed) - sum(one.cycles for one in there)
    found = verify(root)
    assert found.refused == 0
    (told,) = [one for one in found.findings if one.check == "losses"]
    assert (told.where, told.verdict) == (raw.relative_to(root).as_posix(), "warns")
    assert str(lost) in told.what.split()
    (trace,) = root.rglob("*_recording-force_physio.tsv.gz")
    sidecar = trace.with_name(trace.name.replace(".tsv.gz", ".json"))
    trace.unlink()
    assert [one.what for one in findings(build.build(root), "losses")] == [told.what]
    assert trace.exists() is bool(there)
    if there:
        facts = json.loads(sidecar.read_text())["Force"]
        assert (facts["Cycles"], facts["LostCycles"]) == (sum(one.cycles for one in there), lost)
    assert verify(root).refused == 0
    raw.unlink()
    assert raw.relative_to(root).as_posix() in {str(one.where) for one in verify(root).findings if one.refuses}


def force_is_on_record(root: Path, copy: Path) -> None:
    """Assert that the force of each cycle is in the trace, in its copy, and under the journal's hashes."""
    journal_file = storage.journal_path(root, "01", "virtual")
    raw = storage.raw_path(journal_file, "force.bin")
    cycles = cycles_of(raw.read_bytes())
    beh = root / "sub-01" / "beh"
    sidecar = json.loads((beh / "sub-01_task-virtual_recording-force_physio.json").read_text())
    law = {"StiffnessNewtonPerMetre": 2500.0, "DampingNewtonSecondPerMetre": 100.0, "LimitNewton": 3.0}
    assert sidecar["Force"] == {**law, "Cycles": cycles.size, "LostCycles": 0}
    table = beh / "sub-01_task-virtual_recording-force_physio.tsv.gz"
    trace = pd.read_csv(table, sep="\t", names=sidecar["Columns"], na_values="n/a")
    recorded = trace[trace.force_sent.notna()]
    assert len(recorded) == cycles.size
    places_mm, sent_n = np.array(cycles["place_mm"], np.float64), np.array(cycles["sent_n"], np.float64)
    assert recorded["hand_height"].to_numpy(np.float64) == pytest.approx(places_mm[:, 0], abs=1e-5)
    assert recorded["force_sent_along"].to_numpy(np.float64) == pytest.approx(sent_n[:, 1], abs=1e-5)
    assert np.hypot(sent_n[:, 0], sent_n[:, 1]).max() <= 3.0
    # On the clock of the events: each touch, by its entry, is where the hand crosses the face.
    contents = journal.read(journal_file)
    taps = [one.onset.contact_ns for one in contents.entries if isinstance(one, Tapped)]
    rows = [round((ns - contents.lines[0].t_ns) / 1e9 * 2500 - sidecar["StartTime"] * 2500) for ns in taps]
    assert len(rows) > 40
    assert np.abs(trace.hand_height.to_numpy()[rows]).max() < 0.1
    description = root / "dataset_description.json"
    description.write_text(json.dumps({**json.loads(description.read_text("utf-8")), "License": "CC0-1.0"}), "utf-8")
    assert sharing.share(root, copy).participants == 1
    (shared,) = copy.glob("sub-*/beh/*_recording-force_physio.tsv.gz")
    assert shared.read_bytes() == table.read_bytes()
    assert json.loads((shared.parent / shared.name.replace(".tsv.gz", ".json")).read_text()).keys() == sidecar.keys()
    table.unlink()
    assert [one.where for one in verify(root).findings if one.refuses] == [table.relative_to(root).as_posix()]
    build.build(root)
    assert shared.read_bytes() == table.read_bytes()
    changed = bytearray(raw.read_bytes())
    changed[-1] ^= 1
    raw.write_bytes(changed)
    assert raw.relative_to(root).as_posix() in {str(one.where) for one in verify(root).findings if one.refuses}
