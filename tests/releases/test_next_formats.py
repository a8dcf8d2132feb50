"""A branch in which every format has its next number reads, builds and continues all that came before. SIMULATED."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from palpate.experiment.protocol.files import shipped
from tests import releases
from tests.releases import next_formats
from tests.releases.next_formats import RENAMED

ARCHIVED = sorted(path.parent for path in releases.FOLDER.glob("*/*/*.seal.toml"))


@pytest.fixture(scope="module")
def branch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return next_formats.plant(tmp_path_factory.mktemp("branch"))


def done_there(branch: Path, act: str, *given: Path) -> Any:
    """What an act returns that the branch does."""
    command = [sys.executable, "-m", "tests.releases.next_formats", act, *map(str, given)]
    env = {**os.environ, "PYTHONPATH": str(branch), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(command, cwd=branch, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    return json.loads(done.stdout)


def as_json(value: object) -> Any:
    return json.loads(json.dumps(value, default=str))


def test_every_format_has_a_key_of_another_name() -> None:
    assert {name.rpartition("-")[0] for name in releases.formats()} == set(RENAMED)


@pytest.mark.parametrize("archived", ARCHIVED, ids=lambda path: f"{path.parent.name}-{path.name}")
def test_a_dataset_of_a_release_has_the_same_trials_and_results(branch: Path, archived: Path, tmp_path: Path) -> None:
    here, there = (shutil.copytree(archived / "dataset", tmp_path / name) for name in ("here", "there"))
    had = as_json(next_formats.numbers(here, tmp_path / "results-here"))
    assert had["refused"] == [0, 0]
    assert done_there(branch, "numbers", there, tmp_path / "results-there") == had


def test_a_study_goes_on_in_the_branch_with_what_it_had(branch: Path, tmp_path: Path) -> None:
    here, there = (next_formats.make(tmp_path / name) for name in ("here", "there"))
    next_formats.go_on(here.file.parent)
    done_there(branch, "go_on", there.file.parent)
    found = done_there(branch, "numbers", there.root, tmp_path / "results-there")
    assert found == as_json(next_formats.numbers(here.root, tmp_path / "results-here"))
    assert found["refused"][1] == 0
    old, new = RENAMED["journal"]
    assert [one in text for text, one in zip(_journals(there.root), (old, new), strict=True)] == [True, True]
    roster = (there.root / "sourcedata" / "roster.jsonl").read_text("utf-8")
    assert [roster.count(f'"{name}"') for name in RENAMED["roster"]] == [1, 1]


def _journals(root: Path) -> list[str]:
    return [path.read_text("utf-8") for path in sorted(root.rglob("*_journal.jsonl"))]


def test_what_the_branch_writes_has_the_new_names(branch: Path, tmp_path: Path) -> None:
    """So the branch is one: a study, its seal, its rig and recordings, its results."""
    (archived,) = (one for one in ARCHIVED if one.name == "okamoto2012")
    file = tmp_path / "okamoto2012.toml"
    text = (archived / "okamoto2012.toml").read_text("utf-8").replace("format = 4", "format = 8")
    file.write_text(text.replace("voice_recordings", RENAMED["protocol"][1]), "utf-8")
    shutil.copy(shipped("rigs/rehearsal-response.csv"), tmp_path)
    rig = tmp_path / "rig.toml"
    text = shipped("rigs/rehearsal.toml").read_text("utf-8").replace("format = 2", "format = 7")
    rig.write_text(text.replace(*RENAMED["rig"]), "utf-8")
    root = tmp_path / "rehearsed"
    done_there(branch, "rehearse", file, rig, root)
    assert done_there(branch, "numbers", root, tmp_path / "results")["refused"] == [0, 0]
    done_there(branch, "make", tmp_path / "made")
    written = "".join(
        path.read_text("utf-8")
        for folder in (root, tmp_path / "results", tmp_path / "made")
        for path in folder.rglob("*")
        if path.suffix in (".json", ".jsonl", ".toml")
    )
    assert [name for name, (_, new) in RENAMED.items() if new not in written] == []
