"""SIMULATED recording through a real serial line and a real socket; what it makes is whole and called simulated."""

from __future__ import annotations

import tomllib
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from scipy.io import wavfile

from palpate.experiment.errors import RecordingError
from palpate.experiment.protocol import files
from palpate.experiment.recordings import manifest
from palpate.experiment.recordings.manifest import Recordings
from palpate.experiment.recordings.store import Condition, plan
from palpate.experiment.recordings.workflow import SPEED_TOLERANCE, Step
from palpate.experiment.rehearsal.kinds.footstep import recorded_takes, recorder
from tests.approved import Refuses

pytestmark = pytest.mark.clocked


def record(out: Path, root: Path, **options: object) -> Path:
    given: dict[str, object] = {
        "protocol_file": root / "protocols" / "okamoto2012.toml",
        "rig_file": root / "protocols" / "rigs" / "rehearsal.toml",
        "out": out,
        "seed": 5,
    }
    return recorder.record_simulated(**{**given, **options})  # type: ignore[arg-type]


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory, repository_root: Path) -> Path:
    return record(tmp_path_factory.mktemp("recorded") / "set", repository_root).parent


def test_every_take_of_the_protocol_is_there_and_on_target(recorded: Path) -> None:
    listed = tomllib.loads((recorded / "manifest.toml").read_text("utf-8"))["takes"]
    assert len(listed) == (4 + 1) * 4 * 3
    off = [abs(take["achieved_mm_s"] / take["speed_mm_s"] - 1) for take in listed]
    assert 0 < max(off) <= SPEED_TOLERANCE
    assert len(set(off)) == len(off)


def test_it_is_called_simulated(recorded: Path) -> None:
    loaded = manifest.load_all(recorded)
    assert loaded.simulated
    assert "SIMULATED" in loaded.label


def test_takes_of_the_panel_are_its_thump_and_takes_of_a_material_are_more(recorded: Path) -> None:
    loaded = manifest.load_all(recorded)
    power = {name: np.square(takes).mean() for name, takes in loaded.objects.items()}
    assert all(power[name] > np.square(loaded.panel).mean() for name in ("copy paper", "aluminum foil", "typing paper"))


def test_an_interrupted_recording_goes_on_to_the_same_bytes(
    tmp_path: Path, repository_root: Path, recorded: Path
) -> None:
    keeps, steps = recorder.SimulatedExperimenter.keeps, count(1)

    def stopped(experimenter: recorder.SimulatedExperimenter, step: Step) -> bool:
        if next(steps) == 7:
            raise KeyboardInterrupt
        return keeps(experimenter, step)

    with pytest.MonkeyPatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(recorder.SimulatedExperimenter, "keeps", stopped)
        record(tmp_path / "set", repository_root)
    assert not (tmp_path / "set").exists()
    record(tmp_path / "set", repository_root)
    assert contents(tmp_path / "set") == contents(recorded)


def test_fresh_takes_at_other_speeds(tmp_path: Path, repository_root: Path) -> None:
    record(tmp_path / "set", repository_root, speeds_mm_s=(150.0, 400.0), takes=2)
    loaded = manifest.load_all(tmp_path / "set")
    assert loaded.speeds_mm_s.tolist() == [150.0, 400.0]
    assert loaded.panel.shape == (2, 2, 2500)


def test_a_real_rig_is_refused(tmp_path: Path, repository_root: Path, refuses: Refuses) -> None:
    rig = tmp_path / "rig.toml"
    text = (repository_root / "protocols" / "rigs" / "rehearsal.toml").read_text("utf-8")
    rig.write_text(
        text.replace("simulated = true", "simulated = false").replace('"rehearsal"', '"127.0.0.1:1"'), "utf-8"
    )
    with refuses(RecordingError):
        record(tmp_path / "set", repository_root, rig_file=rig)


def test_a_rig_that_is_zeroed_needs_a_foot_that_rests(tmp_path: Path, repository_root: Path, refuses: Refuses) -> None:
    rig = tmp_path / "rig.toml"
    text = (repository_root / "protocols" / "rigs" / "rehearsal.toml").read_text("utf-8")
    rig.write_text(text.replace("[tracker]", "[tracker]\nzeroing_mm = 3.0"), "utf-8")
    with refuses(RecordingError):
        record(tmp_path / "set", repository_root, rig_file=rig)


def test_fresh_simulated_takes_are_new_and_named_by_their_seed(recorded: Path) -> None:
    loaded = manifest.load_all(recorded)
    one, again, other = (recorder.fresh_takes(loaded, seed=seed) for seed in (5, 5, 6))
    assert one.panel.shape == (3, 10, 2500)
    assert set(one.objects) == set(loaded.objects)
    np.testing.assert_array_equal(one.panel, again.panel)
    assert not np.any(np.all(one.panel == other.panel, axis=-1))
    assert one.simulated
    assert "SIMULATED" in one.label


def test_real_recordings_get_no_simulated_fresh_takes(refuses: Refuses) -> None:
    real = Recordings("rig bench", False, 5000, np.array([50.0, 100.0]), np.zeros((2, 1, 4)), {})
    with refuses(RecordingError):
        recorder.fresh_takes(real, seed=1)


def test_recording_needs_no_actuator(tmp_path: Path, repository_root: Path) -> None:
    """The response table that the rehearsal's rig file names is not there."""
    rig = tmp_path / "rig.toml"
    rig.write_bytes((repository_root / "protocols" / "rigs" / "rehearsal.toml").read_bytes())
    record(tmp_path / "set", repository_root, rig_file=rig, speeds_mm_s=(200.0, 300.0), takes=1)
    assert manifest.load_all(tmp_path / "set").panel.shape == (2, 1, 2500)


def test_what_is_recorded_is_the_session_that_rehearsals_write(recorded: Path, repository_root: Path) -> None:
    """Each take is the vibration drawn for it, from at most 2 ms before it reached the trigger, and called as fast."""
    protocol = files.load(repository_root / "protocols" / "okamoto2012.toml")
    drawn = recorded_takes.session(plan(protocol, source=recorded_takes.source(5), simulated=True), seed=5)
    listed = tomllib.loads((recorded / "manifest.toml").read_text("utf-8"))["takes"]
    same = 0
    for entry in listed:
        kept = drawn.kept_take(Condition(entry.get("material"), entry["speed_mm_s"], entry["number"]))
        _, heard = wavfile.read(recorded / entry["file"])
        shifts = range(-10, 60)
        off = [np.abs(heard[max(-s, 0) :][:2000] - kept.samples_m_s2[max(s, 0) :][:2000]).max() for s in shifts]
        # A foot at the edge of the tolerance may be kept at another attempt, by what the tracker saw.
        same += min(off) < 2e-5 * np.abs(kept.samples_m_s2).max() + 1e-5
        assert entry["achieved_mm_s"] == pytest.approx(entry["speed_mm_s"], rel=SPEED_TOLERANCE)
    assert same >= 0.9 * len(listed)


def test_an_experimenter_nobody_watches_gives_up(tmp_path: Path, repository_root: Path, refuses: Refuses) -> None:
    """At 1000 mm/s copy paper drives the rehearsal's accelerometer beyond its full scale, every time."""
    with refuses(RecordingError):
        record(tmp_path / "set", repository_root, speeds_mm_s=(1000.0,), takes=1)
    assert not (tmp_path / "set").exists()
