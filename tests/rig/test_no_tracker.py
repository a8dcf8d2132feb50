"""A rig without a tracker, through its ports: real samples are compared on it, and no step is followed."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from palpate.experiment.apparatus.doctor import doctor
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.dataset.verify import verify
from palpate.experiment.errors import RigError
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.session import simulated_far_ends
from palpate.experiment.rehearsal.study import rehearse

PAPER = shipped("wellman1995.toml").read_text("utf-8")


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    text = re.sub(r"format = \d", "format = 5", shipped("rigs/rehearsal.toml").read_text("utf-8"))
    begins, ends = text.index("[tracker]"), text.index("[actuator]")
    file = tmp_path / "rig.toml"
    file.write_text(text[:begins] + text[ends:], "utf-8")
    (tmp_path / "rehearsal-response.csv").write_bytes(shipped("rigs/rehearsal-response.csv").read_bytes())
    return file


def samples_alone(folder: Path) -> Path:
    """Write a study with the paper's task of real samples alone, each pair twice."""
    begins, ends = PAPER.index('[[tasks]]\nid = "virtual"'), PAPER.index("[[exclusion]]")
    text = (PAPER[:begins] + PAPER[ends:]).replace('["live", "virtual"]', '["live"]')
    file = folder / "samples.toml"
    file.write_text(text.replace("repetitions = 8 ", "repetitions = 2 ").replace("limit = 108", "limit = 27"), "utf-8")
    return file


def run_through(protocol: Path, rig: Path, out: Path) -> Path:
    return rehearse(protocol_file=protocol, rig_file=rig, out=out, participants=1, seed=1, control="none", jobs=1)


def test_real_samples_are_compared_without_a_tracker(tmp_path: Path, rig: Path) -> None:
    assert verify(run_through(samples_alone(tmp_path), rig, tmp_path / "dataset")).refused == 0


@pytest.mark.parametrize("study", ["okamoto2012.toml", "wellman1995.toml"])
def test_what_follows_a_foot_or_pushes_a_hand_is_refused_before_a_folder_is_made(
    study: str, tmp_path: Path, rig: Path
) -> None:
    with pytest.raises(RigError):
        run_through(shipped(study), rig, tmp_path / "dataset")
    assert not (tmp_path / "dataset").exists()


def test_doctor_says_that_nothing_is_followed(tmp_path: Path, rig: Path) -> None:
    found = {
        one.check: one.verdict
        for one in doctor.examine(
            rig_path=rig, protocol_path=None, root=tmp_path, clock=MonotonicClock(), simulate=simulated_far_ends
        )
    }
    assert found["tracker port"] == "unknown"
    assert {"tracker", "tracker calibration"}.isdisjoint(found)
    assert found["actuator"] == "passes"
