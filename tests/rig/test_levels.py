"""Tasks with levels rehearsed through their ports: the track of a participant with a threshold leads to that.

The simulated participant feels a tap whose peak is `THRESHOLD_M_S2` or more, and its speeds are log-normal, so that the
share of right answers at a level has a closed form.
"""

from __future__ import annotations

import csv
import hashlib
import json
import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import norm

from palpate.analysis.analyse import analyse
from palpate.experiment import storage
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.dataset import build, checks
from palpate.experiment.errors import DatasetError
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.kinds.tapping import Tapping
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Answer, Entry, LevelChosen, TrackEnded
from palpate.experiment.records.kinds.footstep import FootStep
from palpate.experiment.records.kinds.tapping import Tapped
from palpate.experiment.rehearsal.kinds.tapping.hand import SPEED_MEDIAN_MM_S, SPEED_SIGMA
from palpate.experiment.rehearsal.kinds.tapping.participant import AGAIN, THRESHOLD_M_S2
from palpate.experiment.rehearsal.study import rehearse
from palpate.experiment.session import scene
from palpate.experiment.session.kinds.footstep import preparation
from palpate.experiment.session.kinds.footstep.levels import scaled
from tests.experiment.protocol import leveled
from tests.experiment.records.test_journal import chained

PEOPLE = 4
RIG = shipped("rigs/rehearsal.toml")


@pytest.fixture(scope="module")
def tapped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tapped")
    file = leveled.written(folder, leveled.tapping())
    return dataset(file, "rigs/tapping.toml", participants=PEOPLE)


def dataset(file: Path, rig: str, *, participants: int) -> Path:
    return rehearse(
        protocol_file=file,
        rig_file=shipped(rig),
        out=file.parent / "dataset",
        participants=participants,
        seed=1,
        control="none",
        jobs=1,
    )


def sessions(root: Path) -> list[tuple[Entry, ...]]:
    return [journal.read(path).entries for path in storage.journals(root)]


def levels_of(entries: tuple[Entry, ...]) -> list[float]:
    return [entry.level for entry in entries if isinstance(entry, LevelChosen)]


def at_reversals(levels: list[float]) -> list[float]:
    """The levels at which a track turned, from its levels alone."""
    moves = [(level, np.sign(after - level)) for level, after in pairwise(levels) if after != level]
    return [level for (_, before), (level, way) in pairwise(moves) if way != before]


def share_right(level: float, protocol: Protocol) -> float:
    """The share of right answers to the pair: aluminum is felt, or nothing, once or of some pairs twice."""
    (aluminum,) = (one for one in protocol.table(Tapping).surfaces if one.material == "aluminum")
    t = np.arange(0, 0.01, 1e-6)
    ring = np.exp(-protocol.table(Tapping).decay_per_s * t) * np.sin(2 * np.pi * aluminum.attack_hz * t)
    peak_m_s2 = level * aluminum.amplitude * protocol.table(Tapping).full_m_s2 * SPEED_MEDIAN_MM_S / 200 * ring.max()
    felt = float(norm.cdf(np.log(peak_m_s2 / THRESHOLD_M_S2) / SPEED_SIGMA))
    return felt + (1 - felt) * ((1 - AGAIN) * 0.5 + AGAIN * (felt + (1 - felt) * 0.5))


def test_tracks_lead_to_the_level_at_which_so_many_answers_are_right(tapped: Path) -> None:
    protocol = files.load(storage.protocol_path(tapped))
    ends = [entry for entries in sessions(tapped) for entry in entries if isinstance(entry, TrackEnded)]
    assert [(entry.track, entry.why) for entry in ends] == [("aluminum | basswood", "reversals")] * PEOPLE
    # p^2 = 1/2, Levitt (1971): 70.7 %.
    wanted = float(brentq(lambda level: share_right(level, protocol) - 0.5**0.5, leveled.GRID[0], leveled.GRID[-1]))
    turned = [np.mean(np.log10(at_reversals(levels_of(entries))[-8:])) for entries in sessions(tapped)]
    # Levels are 2 dB apart, 0.1 of a decade. An SD of about 0.06 for one person.
    assert np.abs(np.array(turned) - np.log10(wanted)).max() < 0.2
    assert np.mean(turned) == pytest.approx(np.log10(wanted), abs=0.1)


def test_the_level_reaches_the_finger_and_the_table(tapped: Path) -> None:
    protocol = files.load(storage.protocol_path(tapped))
    full = {one.material: one.amplitude * protocol.table(Tapping).full_m_s2 for one in protocol.table(Tapping).surfaces}
    for entries in sessions(tapped):
        level = 0.0
        for entry in entries:
            if isinstance(entry, LevelChosen):
                level = entry.level
            if isinstance(entry, Tapped) and entry.material == "aluminum":
                wanted = level * full["aluminum"] * entry.speed_mm_s / 200
                assert entry.stimulus.handed_peak == pytest.approx(wanted, rel=0.06)
    path = min(tapped.glob("sub-*/beh/*_events.tsv"))
    with path.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file, delimiter="\t"))
    given = {(entry.trial, entry.attempt): entry for entry in sessions(tapped)[0] if isinstance(entry, LevelChosen)}
    assert {(int(row["trial"]), int(row["attempt"])): float(row["level"]) for row in rows} == {
        place: entry.level for place, entry in given.items()
    }
    assert {row["track"] for row in rows} == {"aluminum | basswood"}
    sidecar = json.loads(path.with_suffix(".json").read_text("utf-8"))
    assert {"level", "track"} <= sidecar.keys()


def test_it_is_analysed_without_trials_that_were_never_due(tapped: Path, tmp_path: Path) -> None:
    report = analyse([tapped], tmp_path / "out", figures=False)
    (task,) = report.results.tasks
    assert task.trials == sum(len(levels_of(entries)) for entries in sessions(tapped))
    assert not report.study.exclusions


def test_a_level_that_does_not_follow_is_a_finding_of_its_check(tapped: Path, tmp_path: Path) -> None:
    root = tmp_path / "forged"
    shutil.copytree(tapped, root)
    assert list(checks.findings(checks.load(root))) == []
    path = storage.journals(root)[1]
    recorded = journal.read(path).entries
    places = [place for place, entry in enumerate(recorded) if isinstance(entry, LevelChosen)]
    true = recorded[places[20]]
    assert isinstance(true, LevelChosen)
    grid = leveled.GRID
    forged = true.model_copy(update={"level": grid[grid.index(true.level) - 1]})
    chained(path, places[20], forged.model_dump_json().encode())
    (finding,) = [one for one in checks.findings(checks.load(root)) if one.check == "levels"]
    assert (finding.where, finding.line) == (path, places[20] + 1)
    with pytest.raises(DatasetError) as refused:
        build.build(root)
    assert refused.value.finding == finding


def test_a_step_is_made_of_the_recordings_at_its_level(tmp_path: Path) -> None:
    root = dataset(leveled.written(tmp_path, leveled.footsteps()), "rigs/rehearsal.toml", participants=1)
    assert list(checks.findings(checks.load(root))) == []
    protocol, recordings = files.load(storage.protocol_path(root)), root / storage.RECORDINGS
    planned, rate_hz = scene.plan(protocol=protocol, task_id="virtual"), rigs.load(RIG).actuator.rate_hz
    made = preparation.open_stimuli(scene=planned, protocol=protocol, recordings=recordings, output_rate_hz=rate_hz)
    (entries,) = sessions(root)
    steps, levels = 0, set[float]()
    level = 0.0
    for entry in entries:
        if isinstance(entry, LevelChosen):
            level = entry.level
        if isinstance(entry, FootStep) and entry.stimulus is not None:
            asked = scaled(made[entry.presented[0]], level).at(entry.speed_mm_s).exact
            assert entry.stimulus.asked_sha256 == hashlib.sha256(asked.astype("<f8").tobytes()).hexdigest()
            steps += 1
            levels.add(level)
    assert steps > 8
    assert len(levels) > 2
    report = analyse([root], tmp_path / "out", figures=False)
    assert len(report.study.to_frame()) == len([entry for entry in entries if isinstance(entry, Answer)])
