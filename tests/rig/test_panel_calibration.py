"""`palpate calibrate actuator` through real ports: a panel with states, a sensor on it, and sensors that are not."""

from __future__ import annotations

import hashlib
import re
import tomllib
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from palpate.experiment.apparatus import opening
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.panel import calibration, multisine
from palpate.experiment.apparatus.panel.accelerometer import Window
from palpate.experiment.apparatus.panel.calibration import Devices
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.errors import RecordingError, RigError
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.rehearsal.wires.bench import Bench
from palpate.experiment.rehearsal.wires.modes import Modes, MovingPanel, Resonance, read
from palpate.experiment.rehearsal.wires.panel import Panel
from palpate.experiment.rehearsal.wires.sensor import Sensor
from tests.conftest import Palpate

RIG = shipped("rigs/rehearsal.toml")
PANEL = shipped("rigs/rehearsal-panel.toml")
ONE_MODE = read(PANEL)
MODE = ONE_MODE.modes[0]
LOOSE = ONE_MODE.model_copy(update={"modes": (MODE.model_copy(update={"frequency_hz": 90.0, "damping": 0.03}),)})
TWO_MODES = ONE_MODE.model_copy(
    update={
        "modes": (
            MODE.model_copy(update={"frequency_hz": 180.0, "damping": 0.05, "part": 0.6}),
            MODE.model_copy(update={"frequency_hz": 420.0, "part": 0.4}),
        )
    }
)


@contextmanager
def laid_out(kind: type[Bench] = Bench, *, modes: Modes | None = None, seed: int = 1) -> Iterator[Devices]:
    """A bench of the rehearsal's rig, with a sensor of some kind."""
    rig, clock = rigs.load(RIG), ManualClock(0)
    assert rig.accelerometer is not None
    sensor = Sensor(rig.accelerometer, clock)
    panel = Panel(rig.actuator, real_time=False, moving=MovingPanel(modes) if modes is not None else None)
    with closing(sensor), closing(panel):
        bench = kind(rig, panel, sensor, clock, np.random.default_rng(seed))
        with closing(bench):
            yield Devices(bench, bench, rig.actuator.rate_hz, rig.accelerometer.rate_hz)


def truth_m_s2(modes: Modes, lines_hz: NDArray[np.int64] | NDArray[np.float64]) -> NDArray[np.complex128]:
    """Acceleration of a sample of 1.0, by the formula that the panel's file is about."""

    def divided(one: Resonance) -> NDArray[np.complex128]:
        natural = 2 * np.pi * one.frequency_hz
        return np.asarray(s**2 + 2 * one.damping * natural * s + natural**2)

    s: NDArray[np.complex128] = np.asarray(2j * np.pi * lines_hz)
    passed = sum(one.part * (2 * np.pi * one.frequency_hz) ** 2 / divided(one) for one in modes.modes)
    volts = rigs.load(RIG).actuator.full_scale
    return np.asarray(volts * modes.gain_m_s2_per_v * s**2 / divided(modes.suspension) * passed)


@pytest.mark.parametrize("modes", [ONE_MODE, TWO_MODES, LOOSE], ids=["one mode", "two modes", "loose"])
def test_full_scale_and_response_are_those_of_the_panel(modes: Modes) -> None:
    with laid_out(modes=modes) as devices:
        made = calibration.measure(devices, loudest=0.2, seed=3)
    found, figures = made.found, made.figures
    truth = truth_m_s2(modes, found.lines_hz)
    within = (found.lines_hz >= 10) & (found.lines_hz <= 500)
    off = (found.response_m_s2 / truth)[within]
    assert np.abs(20 * np.log10(np.abs(off))).max() < 0.1
    assert np.abs(np.degrees(np.angle(off))).max() < 5
    band = (found.lines_hz >= figures.low_hz) & (found.lines_hz <= figures.high_hz)
    octaves = np.gradient(np.log(found.lines_hz[band].astype(float)))
    level = np.log(np.abs(truth[band]))
    assert figures.full_scale_m_s2 == pytest.approx(np.exp((octaves * level).sum() / octaves.sum()), rel=0.002)
    assert abs(made.compression_db) < 0.01
    fine_hz = np.arange(40, 800, 0.1)
    peak = float(fine_hz[np.argmax(np.abs(truth_m_s2(modes, fine_hz)))])
    assert min(abs(one.hz - peak) for one in figures.resonances) < 0.005 * peak


def test_a_coil_that_saturates_is_measured_for_a_small_drive() -> None:
    with laid_out(modes=ONE_MODE.model_copy(update={"soft_v": 5.0})) as devices:
        made = calibration.measure(devices, loudest=0.2, seed=3)
    within = (made.found.lines_hz >= 10) & (made.found.lines_hz <= 500)
    off = np.abs(made.found.response_m_s2 / truth_m_s2(ONE_MODE, made.found.lines_hz))[within]
    assert np.abs(20 * np.log10(off)).max() < 0.5
    assert 0.05 < made.compression_db < 0.2
    assert np.all(np.diff(made.found.gains[:3]) < 0)


def test_a_load_moves_the_resonance() -> None:
    loaded = ONE_MODE.model_copy(update={"load": None}).model_copy(
        update={"modes": (MODE.loaded(0.2, 0.0),), "suspension": ONE_MODE.suspension.loaded(0.2, 0.0)}
    )
    with laid_out(modes=ONE_MODE) as devices, laid_out(modes=loaded) as others:
        bare, heavy = (calibration.measure(each, loudest=0.2, seed=3).figures for each in (devices, others))
    assert heavy.resonances[0].hz / bare.resonances[0].hz == pytest.approx(1 / np.sqrt(1.2), rel=0.005)


class Dead(Bench):
    """A sensor whose cable is off: one value."""

    def heard_since_armed(self) -> Window:
        return Window(np.full_like(super().heard_since_armed().samples_m_s2, 0.5), 0)


class AtRest(Bench):
    """A sensor that lies beside the panel."""

    def sensed(self, moved_m_s2: NDArray[np.float64]) -> NDArray[np.float64]:
        return super().sensed(np.zeros(moved_m_s2.size))


class Humming(Bench):
    """A sensor that lies beside the panel, near a transformer of 50 Hz."""

    def sensed(self, moved_m_s2: NDArray[np.float64]) -> NDArray[np.float64]:
        t = np.arange(moved_m_s2.size) / 5000
        hum = sum(np.sin(2 * np.pi * 50 * n * t + n) / n for n in range(1, 20))
        return super().sensed(np.asarray(hum))


class Elsewhere(Bench):
    """A sensor on another panel, which is calibrated at the same time."""

    def sensed(self, moved_m_s2: NDArray[np.float64]) -> NDArray[np.float64]:
        lines_hz = multisine.lines(5000)
        played = multisine.drawn(lines_hz, rate_hz=5000, rng=self._rng)
        return super().sensed(np.resize(10 * multisine.period(played, lines_hz, rate_hz=5000), moved_m_s2.size))


class Walked(Bench):
    """A sensor on another panel, on which somebody walks."""

    def sensed(self, moved_m_s2: NDArray[np.float64]) -> NDArray[np.float64]:
        steps = np.zeros(moved_m_s2.size)
        steps[self._rng.integers(0, steps.size, 12)] = 40.0
        return super().sensed(np.convolve(steps, np.exp(-np.arange(500) / 60))[: steps.size])


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("kind", [Dead, AtRest, Humming, Elsewhere, Walked])
def test_a_sensor_that_is_dead_or_of_another_panel_is_refused(kind: type[Bench], seed: int) -> None:
    with laid_out(kind, modes=ONE_MODE, seed=seed) as devices, pytest.raises(RecordingError) as refused:
        calibration.measure(devices, loudest=0.2, seed=seed)
    assert refused.value.finding.remedy
    assert ("coherence" in refused.value.finding.what) == (kind is not Dead)


class Shaken(Bench):
    """A sensor on a panel beside a road."""

    plays = 0

    def sensed(self, moved_m_s2: NDArray[np.float64]) -> NDArray[np.float64]:
        type(self).plays += 1
        return super().sensed(moved_m_s2) + self._rng.normal(0, 1.5, moved_m_s2.size)


def test_a_response_that_is_uncertain_is_measured_once_more_and_then_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calibration, "LONGER", calibration.PERIODS + 1)
    monkeypatch.setattr(Shaken, "plays", 0)
    with laid_out(Shaken, modes=ONE_MODE) as devices, pytest.raises(RecordingError) as refused:
        calibration.measure(devices, loudest=0.2, seed=1)
    assert Shaken.plays == 2 * len(calibration.LEVELS)
    assert "0.3 dB" in refused.value.finding.allowed


class Loud(Bench):
    """A sensor whose range is too small."""

    def sensed(self, moved_m_s2: NDArray[np.float64]) -> NDArray[np.float64]:
        return super().sensed(100 * moved_m_s2).clip(-100, 100)


def test_a_sensor_that_clips_is_refused() -> None:
    with laid_out(Loud, modes=ONE_MODE) as devices, pytest.raises(RecordingError) as refused:
        calibration.measure(devices, loudest=0.2, seed=1)
    assert "--peak" in str(refused.value.finding.remedy)


def calibrated(palpate: Palpate, rig: Path, out: Path, *options: object) -> tuple[int, str, str]:
    return palpate("calibrate", "actuator", "--rig", rig, "--panel", PANEL, "--out", out, *options)


def test_the_command_writes_a_new_rig_file_and_its_table(
    palpate: Palpate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []

    def presses(prompt: str) -> str:
        asked.append(prompt)
        return ""

    monkeypatch.setattr("builtins.input", presses)
    out, before = tmp_path / "new.toml", RIG.read_bytes()
    code, printed, _ = calibrated(palpate, RIG, out, "--load", "sand bag", "--days", 12)
    assert code == 0
    assert len(asked) == 1
    assert "sand bag" in asked[0]
    # Whoever reads it stays away for as long as the panel can move.
    told = re.findall(r"(\d+) s, or (\d+) min", asked[0])
    around_s = calibration.BEFORE_S + calibration.AFTER_S
    first_s, again_s = (len(calibration.LEVELS) * (s + around_s) for s in (calibration.PERIODS, calibration.LONGER))
    assert [int(s) >= first_s and 60 * int(m) >= first_s + again_s for s, m in told] == [True]
    assert RIG.read_bytes() == before
    rig = rigs.load(out)
    found = rig.actuator.measured
    assert found is not None
    assert (rig.format, found.load, found.calibration_days, found.accelerometer_m_s2) == (6, "sand bag", 12, 100.0)
    assert found.output == rigs.load(RIG).actuator.full_scale
    content = (tmp_path / "new-panel.csv").read_bytes()
    assert hashlib.sha256(content).hexdigest() == found.response_sha256
    assert content.startswith(b"# SIMULATED")
    assert f"{found.full_scale_m_s2:.4g}" in printed
    assert rig.actuator.shaping == rigs.load(RIG).actuator.shaping
    # What a session keeps of a rig has the table too.
    (tmp_path / "kept").mkdir()
    opening.copy_rig(out, tmp_path / "kept" / "rig.toml")
    assert (tmp_path / "kept" / "new-panel.csv").read_bytes() == content
    # A file that exists is never written over.
    assert calibrated(palpate, RIG, out)[0] == 2
    assert len(asked) == 1


def test_a_calibration_that_is_interrupted_writes_nothing(
    palpate: Palpate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def ends(_: str) -> str:
        raise EOFError

    monkeypatch.setattr("builtins.input", ends)
    assert calibrated(palpate, RIG, tmp_path / "new.toml")[0] != 0
    assert list(tmp_path.iterdir()) == []


ACCELERATIONS = """
[actuator]
driver = "pcm-tcp"
address = "rehearsal"
rate_hz = 5000
full_scale_m_s2 = 500.0  # NOT MEASURED: `palpate calibrate actuator` measures it
# a remark

[accelerometer]
"""


def test_a_device_that_takes_accelerations_gets_its_full_scale_and_band() -> None:
    found = {"full_scale_m_s2": 49.7, "low_hz": 12.0, "high_hz": 600.0, "load": "nobody"}
    text = calibration.rewritten("format = 2\n" + ACCELERATIONS, found)
    values = tomllib.loads(text)
    actuator = values["actuator"]
    assert [actuator[key] for key in ("full_scale_m_s2", "low_hz", "high_hz")] == [49.7, 12.0, 600.0]
    assert actuator["measured"] == found
    assert values["accelerometer"] == {}
    assert "NOT MEASURED" not in text
    assert "# a remark" in text
    assert text.startswith("format = 4\n")


def test_a_rig_keeps_the_format_that_its_keys_need() -> None:
    found = {"full_scale_m_s2": 49.7, "low_hz": 12.0, "high_hz": 600.0, "load": "nobody"}
    for before, more, after in ((6, {}, 6), (2, {"output": 5.0}, 6), (5, {"driver_sha256": "0"}, 6)):
        text = calibration.rewritten(f"format = {before}\n" + ACCELERATIONS, found | more)
        assert tomllib.loads(text)["format"] == after


def test_a_real_rig_states_when_its_accelerometer_was_calibrated() -> None:
    rig = rigs.load(RIG)
    assert rig.accelerometer is not None
    calibration.check_accelerometer(rig)
    real = rig.model_copy(update={"rig": rig.rig.model_copy(update={"simulated": False})})
    with pytest.raises(RigError):
        calibration.check_accelerometer(real)
    without: Rig = rig.model_copy(update={"accelerometer": None})
    with pytest.raises(RigError):
        calibration.check_accelerometer(without)
