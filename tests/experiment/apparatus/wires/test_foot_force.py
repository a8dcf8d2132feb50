"""The force of a foot: what a step's frames say of it, what is refused, and what a simulated foot leaves on record."""

from __future__ import annotations

import csv
import json
from contextlib import nullcontext
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from palpate.experiment import storage
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.rig import Rig, tracker_of
from palpate.experiment.apparatus.tracker import frame_runs
from palpate.experiment.apparatus.tracker.frames import Decoder
from palpate.experiment.apparatus.wires import foot_force
from palpate.experiment.errors import RigError
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.kinds.footstep import Footstep
from palpate.experiment.records.journal import read
from palpate.experiment.records.kinds.footstep import FootStep
from palpate.experiment.records.tracker import Pressed
from palpate.experiment.rehearsal import study
from palpate.experiment.rehearsal.wires.foot import Foot
from palpate.experiment.session.kinds.footstep.trials import KIND, check_force
from palpate.experiment.settings import load as settings
from tests.experiment.rehearsal.wires.test_foot import Recorder

RIG = rigs.load(shipped("rigs/weight.toml"))
TRACKER = tracker_of(RIG)
COUNT_N = 327.6 / 4095
"""The force of one count of this rig."""

GATE_US, CONTACT_US, TAIL_US = 300_000.0, 400_000.0, 600_000.0


def frames_of(force_n: NDArray[np.float64]) -> bytes:
    """Frames of a foot at 1000 Hz, from time 0, with these forces."""
    counts = np.column_stack([np.full(force_n.size, 268), TRACKER.second_counts(force_n)])
    numbers = np.arange(force_n.size)
    return frame_runs.encode(frame_runs.Run(numbers, 1000 * numbers, counts))


def read_of(force_n: NDArray[np.float64]) -> Pressed:
    return foot_force.pressed(b"\0" + frames_of(force_n), TRACKER, GATE_US, CONTACT_US)


def step_of(rest_n: float, peak_n: float, zero_n: float) -> NDArray[np.float64]:
    """A panel of `zero_n`, on which a foot lands with `peak_n` for 50 ms, and rests with `rest_n`."""
    force_n = np.full(601, zero_n)
    force_n[400:450] += peak_n
    force_n[450:] += rest_n
    return force_n


@pytest.mark.parametrize("zero_n", [0.0, 12.0, -7.0])
def test_the_force_is_what_the_foot_adds(zero_n: float) -> None:
    found = read_of(step_of(40.0, 65.0, zero_n))
    assert found.mean_n == pytest.approx(40.0, abs=COUNT_N)
    assert found.peak_n == pytest.approx(65.0, abs=COUNT_N)
    assert found.zero_n == pytest.approx(zero_n, abs=COUNT_N)
    assert (found.held, found.problem) == (0, "")


def test_noise_of_the_sensor_averages_out_and_is_on_record() -> None:
    noise_n = np.random.default_rng(1).normal(0.0, 0.5, 601)
    found = read_of(step_of(40.0, 40.0, 0.0) + noise_n)
    # A hundred samples less fifty.
    assert found.mean_n == pytest.approx(40.0, abs=4 * 0.5 * (1 / 100 + 1 / 50) ** 0.5)
    assert found.spread_n == pytest.approx(0.5, rel=0.3)


def test_samples_at_an_end_of_the_calibration_are_counted() -> None:
    assert read_of(step_of(40.0, 400.0, 0.0)).held == 50
    assert read_of(step_of(40.0, 60.0, -50.0)).held == 50


@pytest.mark.parametrize("part", [slice(330, 601), slice(0, 450)], ids=["from the gate on", "until contact"])
def test_a_step_with_too_few_samples_has_no_force(part: slice) -> None:
    whole = frames_of(step_of(40.0, 65.0, 0.0))
    each = len(whole) // 601
    found = foot_force.pressed(b"\0" + whole[part.start * each : part.stop * each], TRACKER, GATE_US, CONTACT_US)
    assert found.problem
    assert (found.mean_n, found.peak_n, found.zero_n) == (None, None, None)


@pytest.mark.parametrize("force", [True, False])
def test_the_force_is_measured_where_the_protocol_records_it_and_nowhere_else(force: bool) -> None:
    protocol = files.load(shipped("weight.toml"))
    states = protocol.model_copy(update={"footstep": protocol.table(Footstep).model_copy(update={"force": force})})
    with_sensor, without = RIG, rigs.load(shipped("rigs/rehearsal.toml"))
    agrees, differs = (with_sensor, without) if force else (without, with_sensor)
    check_force(agrees, states)
    with pytest.raises(RigError):
        check_force(differs, states)


@pytest.mark.parametrize(("days", "counts"), [(-1, False), (0, True), (30, True), (31, False)])
def test_no_session_records_a_force_whose_calibration_is_out_of_date(days: int, counts: bool) -> None:
    """As that of the heights, which is of the same day here; a simulated rig does not age."""
    sensor = TRACKER.force
    assert sensor is not None
    protocol, today = files.load(shipped("weight.toml")), sensor.calibrated_on + timedelta(days)
    dated = TRACKER.model_copy(update={"calibrated_on": today, "calibration_days": 30})
    real = RIG.rig.model_copy(update={"simulated": False})
    KIND.check_rig(protocol, RIG, today)
    with nullcontext() if counts else pytest.raises(RigError) as refused:
        KIND.check_rig(protocol, RIG.model_copy(update={"rig": real, "tracker": dated}), today)
    if refused is not None:
        assert f"{refused.value.finding.where}".endswith("force.calibrated_on")


def test_what_a_rig_that_measures_a_force_is_told_to_do_works() -> None:
    """Either the protocol records it, or table and second reading go."""
    weight, steps = (files.load(shipped(name)) for name in ("weight.toml", "okamoto2012.toml"))
    footstep = steps.table(Footstep)
    with pytest.raises(RigError):
        check_force(RIG, steps)
    check_force(RIG, steps.model_copy(update={"footstep": footstep.model_copy(update={"force": True})}))
    alone = TRACKER.model_copy(update={"force": None})
    check_force(RIG.model_copy(update={"tracker": alone}), steps)
    assert (alone.readings, TRACKER.readings) == (1, 2)
    with pytest.raises(RigError):
        check_force(RIG.model_copy(update={"tracker": alone}), weight)


def points(*pairs: tuple[int, float], of: str = "n") -> tuple[dict[str, float], ...]:
    return tuple({"counts": counts, of: value} for counts, value in pairs)


BROKEN: list[tuple[dict[str, Any], str]] = [
    ({"along_calibration": points((0, 0.0), (9, 9.0), of="mm")}, "tracker.force"),
    ({"force": {"calibration": points((0, 1.0), (5, 1.0))}}, "tracker.force.calibration[1].n"),
    ({"force": {"calibration": points((5, 1.0), (5, 2.0))}}, "tracker.force.calibration[1].counts"),
    ({"baud": 139_000}, "tracker.baud"),
]


@pytest.mark.parametrize(("changes", "field"), BROKEN)
def test_what_is_refused_in_a_rig_file_says_where(changes: dict[str, Any], field: str) -> None:
    document = RIG.model_dump(exclude_none=True)
    document["tracker"] |= {**changes, "force": document["tracker"]["force"] | changes.get("force", {})}
    (problem,) = settings.find(Rig, document, {})
    assert problem.field == field


def test_a_simulated_foot_presses_from_contact_to_its_lift() -> None:
    line = Recorder()
    foot = Foot(line, TRACKER, noise_mm=0.0)
    step = replace(foot.trajectory(np.random.default_rng(3), 150.0, "none"), force_n=50.0)
    foot.step(step, 1_000_000)
    assert foot.finish()
    foot.close()
    decoded = Decoder(readings=2).feed(line.data)[1]
    us = decoded.device_us - (foot.true_contact_us - step.contact_us)
    read_n = TRACKER.force_n(decoded.along)
    assert np.abs(read_n[us < step.contact_us]).max() <= COUNT_N
    assert read_n[(us > step.contact_us + 100_000) & (us < step.lift_us)] == pytest.approx(50.0, abs=0.5)


def test_a_rehearsal_has_the_force_of_each_step_on_record(tmp_path: Path) -> None:
    """One participant presses about alike in every step; table and trace have what the journal has."""
    file = tmp_path / "weight.toml"
    file.write_text(shipped("weight.toml").read_text("utf-8").replace("repetitions = 10", "repetitions = 2"), "utf-8")
    root = study.rehearse(
        protocol_file=file, rig_file=shipped("rigs/weight.toml"), out=tmp_path / "made", participants=1, seed=1
    )
    logs = []
    for task in ("light", "heavy"):
        entries = read(storage.journal_path(root, "01", task)).entries
        forces = [one.force for one in entries if isinstance(one, FootStep) and one.force is not None]
        assert all(one.problem == "" and one.held == 0 for one in forces)
        means = [one.mean_n for one in forces if one.mean_n is not None]
        logs += np.log(means).tolist()
        table = root / "sub-01" / "beh" / f"sub-01_task-{task}_events.tsv"
        rows = list(csv.DictReader(table.read_text("utf-8").splitlines(), delimiter="\t"))
        told = [float(row["foot_force"]) for row in rows if row["foot_force"] != "n/a"]
        assert told == pytest.approx(means, abs=5e-4)
        columns = json.loads(table.with_suffix(".json").read_text("utf-8"))
        assert columns["foot_force"]["Units"] == "N"
        trace = json.loads(table.with_name(f"sub-01_task-{task}_recording-foot_physio.json").read_text("utf-8"))
        assert trace["Columns"] == ["foot_height", "foot_force"]
        assert trace["foot_force"]["Units"] == "N"
    assert len(logs) >= 16
    assert 0.08 < np.std(logs) < 0.25
