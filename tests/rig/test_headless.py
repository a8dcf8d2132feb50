"""A rehearsal in real time on a sound card of its own: participants feel what the actuator's channel carried."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import pytest

from experiment.errors import DatasetError
from experiment.protocol.shipped import shipped
from experiment.rehearsal import study
from tests.rig import sound


def short(tmp_path: Path) -> Path:
    """The footstep study with four trials a task and hardly a break."""
    text = shipped("okamoto2012.toml").read_text("utf-8")
    for pattern, value in (("repetitions", "1"), ("min_s", "0"), ("max_s", "0.01"), ("break_min_s", "0")):
        text = re.sub(rf"(?m)^{pattern} = \S+", f"{pattern} = {value}", text)
    text = text.replace("limit = 36", "limit = 4")
    path = tmp_path / "short.toml"
    path.write_text(text, "utf-8")
    return path


def answers(root: Path, task: str) -> list[dict[str, str]]:
    [path] = root.glob(f"sub-01/beh/*_task-{task}_events.tsv")
    with path.open() as file:
        return [row for row in csv.DictReader(file, delimiter="\t") if row["counted"] == "1"]


def test_a_session_runs_in_real_time_on_a_sound_card_of_its_own(tmp_path: Path) -> None:
    with sound.sound_card():
        pass
    root = study.rehearse(
        protocol_file=short(tmp_path),
        rig_file=shipped("rigs/headless.toml"),
        out=tmp_path / "made",
        participants=1,
        seed=1,
        real_time=True,
    )
    assert [len(answers(root, task)) for task in ("virtual", "real")] == [4, 4]
    assert all(float(row["duration"]) == 0.5 for row in answers(root, "virtual"))


def test_simulated_time_is_too_fast_for_an_audio_device(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"its audio device runs in real time, .*; add --real-time, or give a rig"):
        study.rehearse(
            protocol_file=shipped("okamoto2012.toml"),
            rig_file=shipped("rigs/headless.toml"),
            out=tmp_path / "made",
            participants=1,
            seed=1,
        )
    assert not (tmp_path / "made").exists()
