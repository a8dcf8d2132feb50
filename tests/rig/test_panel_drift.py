"""Before a session the panel is compared with its measurement through real ports, while nobody is on it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import date
from pathlib import Path

import numpy as np
import pytest

from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.doctor import sensor
from palpate.experiment.apparatus.panel import calibration, drift
from palpate.experiment.apparatus.panel.calibration import Devices
from palpate.experiment.apparatus.panel.conditioning import open_conditioner
from palpate.experiment.apparatus.panel.movement import DRIFT_DB, open_movement
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.desk.panel import compare_panel
from palpate.experiment.desk.questions import NO, YES, Agree, Reply
from palpate.experiment.errors import Finding, Interrupted, RecordingError, RigError
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.rehearsal.wires.bench import Bench
from palpate.experiment.rehearsal.wires.modes import Mode, Modes
from palpate.experiment.synthesis.felt import felt
from tests.benchmarks.drift import RATE_HZ, drifted, verdicts
from tests.benchmarks.felt import moved_m_s2
from tests.experiment.session.scripted import ScriptedConsole
from tests.experiment.synthesis.stimuli import of_bins
from tests.rig.test_panel_calibration import ONE_MODE, RIG, AtRest, Dead, Shaken, laid_out


@pytest.fixture(scope="module")
def rig_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a simulated rig whose panel was measured."""
    file = tmp_path_factory.mktemp("rig") / "rig.toml"
    with laid_out(modes=ONE_MODE) as devices:
        made = calibration.measure(devices, loudest=0.2, seed=3)
    calibration.write(RIG, file, made, load="nobody", today=date.today(), days=30)
    return file


@pytest.fixture
def rig(rig_file: Path) -> Rig:
    return rigs.load(rig_file)


def lay_out(monkeypatch: pytest.MonkeyPatch, kind: type[Bench] = Bench, modes: Modes = ONE_MODE) -> list[float]:
    """The rig's devices are those of a bench; returns the highest sample that each opening allowed."""
    allowed: list[float] = []

    @contextmanager
    def devices(_: Rig, *, loudest: float) -> Iterator[Devices]:
        allowed.append(loudest)
        with laid_out(kind, modes=modes, seed=5) as there:
            yield there

    monkeypatch.setattr(calibration, "devices", devices)
    return allowed


class Desk(ScriptedConsole):
    """Somebody who says, each time, whether nobody is on the panel."""

    def __init__(self, *, yes: bool) -> None:
        super().__init__(ManualClock(0), ())
        self.asked = 0
        self.yes = yes
        self.instead[Agree] = self.answer

    def answer(self) -> Reply:
        self.asked += 1
        return Reply(YES if self.yes else NO)


def compared(monkeypatch: pytest.MonkeyPatch, rig_file: Path, db: float) -> Finding:
    lay_out(monkeypatch, modes=drifted(ONE_MODE, db))
    return drift.compare_panel(rig_file, rigs.load(rig_file))[0]


@pytest.mark.parametrize(("db", "verdict"), [(0.0, "passes"), (0.5, "passes"), (1.5, "warns"), (-1.5, "warns")])
def test_drift_is_warned_of_from_one_decibel_on(
    monkeypatch: pytest.MonkeyPatch, rig_file: Path, db: float, verdict: str
) -> None:
    assert compared(monkeypatch, rig_file, db).verdict == verdict


@pytest.mark.parametrize("db", [3.5, -3.5])
def test_nobody_is_run_on_a_panel_that_drifted_by_three_decibels(
    monkeypatch: pytest.MonkeyPatch, rig_file: Path, db: float
) -> None:
    with pytest.raises(RigError) as refused:
        compared(monkeypatch, rig_file, db)
    assert (refused.value.finding.verdict, refused.value.finding.where) == ("refuses", rig_file)


def test_the_multisine_is_as_loud_as_the_rig_states(monkeypatch: pytest.MonkeyPatch, rig_file: Path, rig: Rig) -> None:
    allowed = lay_out(monkeypatch)
    drift.compare_panel(rig_file, rig)
    assert rig.actuator.measured is not None
    assert allowed == [rig.actuator.measured.check_peak] == [0.05]


def test_a_coil_that_softened_the_measurement_is_no_drift(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    soft, file = ONE_MODE.model_copy(update={"soft_v": 3.0}), tmp_path / "rig.toml"
    with laid_out(modes=soft) as devices:
        made = calibration.measure(devices, loudest=0.2, seed=3)
    calibration.write(RIG, file, made, load="nobody", today=date.today(), days=30)
    lay_out(monkeypatch, modes=soft)
    loud = rigs.load(file)
    assert loud.actuator.measured is not None
    measured = loud.actuator.measured.model_copy(update={"check_peak": 0.2})
    found, drifted_by = drift.compare_panel(
        file, loud.model_copy(update={"actuator": loud.actuator.model_copy(update={"measured": measured})})
    )
    assert measured.compression_db > 0.1
    assert found.verdict == "passes"
    assert 0 <= drifted_by.louder_db < 0.5


def test_a_panel_that_cannot_be_heard_clearly_is_measured_once_longer_and_then_refused(
    monkeypatch: pytest.MonkeyPatch, rig_file: Path, rig: Rig
) -> None:
    monkeypatch.setattr(Shaken, "plays", 0)
    lay_out(monkeypatch, Shaken)
    with pytest.raises(RecordingError):
        drift.compare_panel(rig_file, rig)
    assert Shaken.plays == 2


@pytest.mark.parametrize("kind", [Dead, AtRest])
def test_a_sensor_that_hears_nothing_passes_no_panel(
    monkeypatch: pytest.MonkeyPatch, rig_file: Path, rig: Rig, kind: type[Bench]
) -> None:
    lay_out(monkeypatch, kind)
    with pytest.raises((RecordingError, RigError)):
        drift.compare_panel(rig_file, rig)


@pytest.mark.parametrize(("db", "verdict"), [(0.0, "passes"), (1.5, "refuses"), (3.5, "refuses")])
def test_doctor_compares_a_panel_that_may_move(
    monkeypatch: pytest.MonkeyPatch, rig_file: Path, rig: Rig, db: float, verdict: str
) -> None:
    """A load that a session would warn of is red; in a rehearsal nothing moves."""
    allowed = lay_out(monkeypatch, modes=drifted(ONE_MODE, db))
    real = rig.model_copy(update={"rig": rig.rig.model_copy(update={"simulated": False})})
    away = real.model_copy(update={"accelerometer": None})
    nowhere = [*sensor.load(rig_file, real, may_move=False)]
    nowhere += [one for still in (rig, away) for one in sensor.load(rig_file, still, may_move=True)]
    assert [one.verdict for one in nowhere] == ["unknown"] * 3
    assert (f"{nowhere[0].remedy}".endswith("--compare-panel"), allowed) == (True, [])
    (found,) = sensor.load(rig_file, real, may_move=True)
    assert (found.check, found.verdict, allowed) == ("panel's load", verdict, [0.05])


def test_doctor_compares_no_panel_that_nobody_measured() -> None:
    assert list(sensor.load(RIG, rigs.load(RIG), may_move=True)) == []


def test_a_sensor_upside_down_beside_its_measurement_is_refused(
    monkeypatch: pytest.MonkeyPatch, rig_file: Path
) -> None:
    """By its phases, for its levels are the same."""
    down = ONE_MODE.model_copy(update={"modes": tuple(_turned(one) for one in ONE_MODE.modes)})
    lay_out(monkeypatch, modes=down)
    with pytest.raises(RecordingError) as refused:
        drift.compare_panel(rig_file, rigs.load(rig_file))
    assert "upside" in refused.value.finding.what
    with laid_out(modes=down) as devices:
        made = calibration.measure(devices, loudest=0.2, seed=3)
    assert made.found.upright < -0.9


def _turned(mode: Mode) -> Mode:
    return mode.model_copy(update={"part": -mode.part})


def test_the_panel_moves_once_nobody_is_on_it(monkeypatch: pytest.MonkeyPatch, rig_file: Path, rig: Rig) -> None:
    allowed, nobody = lay_out(monkeypatch), Desk(yes=True)
    noted, drifted_by = compare_panel(rig_file, rig, nobody)
    assert drifted_by is not None
    assert (nobody.asked, len(allowed), len(nobody.shown)) == (1, 1, 1)
    assert "dB" in noted
    with pytest.raises(Interrupted):
        compare_panel(rig_file, rig, Desk(yes=False))
    assert len(allowed) == 1


@pytest.mark.parametrize("stays", [True, False])
def test_without_an_accelerometer_that_stays_the_comparison_is_left_out_and_warned_of(
    monkeypatch: pytest.MonkeyPatch, rig_file: Path, rig: Rig, stays: bool
) -> None:
    allowed, desk = lay_out(monkeypatch), Desk(yes=True)
    assert rig.accelerometer is not None
    sensor = None if stays else rig.accelerometer.model_copy(update={"stays": False})
    noted, drifted_by = compare_panel(rig_file, rig.model_copy(update={"accelerometer": sensor}), desk)
    assert drifted_by is None
    assert (desk.asked, allowed) == (0, [])
    assert desk.shown == [f"WARNING: {noted}"]


@pytest.mark.parametrize("db", [0.0, 0.8, -0.8, 1.5])
def test_the_record_states_what_is_felt_by_the_drift_that_was_found(
    monkeypatch: pytest.MonkeyPatch, rig_file: Path, rig: Rig, db: float
) -> None:
    """The truth is that of the simulation of `tests.benchmarks.felt`, written from the panel's description alone."""
    now = drifted(ONE_MODE, db)
    lay_out(monkeypatch, modes=now)
    unheard = rig.model_copy(update={"accelerometer": None})
    found, none = (compare_panel(rig_file, one, Desk(yes=True))[1] for one in (rig, unheard))
    coefficients = np.zeros(2500)
    coefficients[100:300:10] = np.random.default_rng(1).choice([-0.4, 0.4], 20)
    stimulus = of_bins(coefficients, samples=2500, rate_hz=RATE_HZ)
    compared, planned = (
        open_conditioner(rig, limit_m_s2=100.0, drive=None, drifted=one)(stimulus) for one in (found, none)
    )
    assert rig.actuator.measured is not None
    size = open_movement(rig_file.parent, rig.actuator.measured, rate_hz=RATE_HZ).grid(compared.samples.size).size
    volts = compared.samples.astype(np.float64) * rig.actuator.full_scale
    moved = moved_m_s2(now, volts, rate_hz=RATE_HZ, size=size)
    true = felt(stimulus.waveform_m_s2, moved, rate_hz=RATE_HZ)
    by_session, by_plan = compared.on_record().moved, planned.on_record().moved
    assert by_session is not None
    assert by_plan is not None
    assert by_plan.drift_db == DRIFT_DB
    for stated, allowed, value in (
        (by_session.third_octave_between_db, by_plan.third_octave_between_db, true.third_octave_db),
        (by_session.envelope_between_db, by_plan.envelope_between_db, true.envelope_db),
    ):
        assert stated is not None
        assert allowed is not None
        assert stated[0] <= value <= stated[1]
        assert (stated[1] - stated[0] < (allowed[1] - allowed[0]) / 2) is (db == 0.0)
        assert (allowed[0] <= value <= allowed[1]) is (db < DRIFT_DB)


def test_drift_of_one_and_a_half_decibels_is_always_found_and_no_drift_never() -> None:
    assert verdicts(ONE_MODE, [1.5, -1.5] * 5, seed=2) == {"warns": 10}
    assert verdicts(ONE_MODE, [0.0] * 10, seed=3) == {"passes": 10}
