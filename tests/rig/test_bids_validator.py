"""The official BIDS validator on what we write: no error, and no warning but of keys that nobody can fill."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palpate.analysis.analyse import analyse
from palpate.experiment.dataset import build, traces
from palpate.experiment.dataset.outside import sharing
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal import study as rehearsal
from palpate.experiment.study.people import enrolling, facts
from tests.analysis.datasets import balanced, trial, write_dataset
from tests.experiment.dataset.studies import make_study
from tests.experiment.protocol.asking import FORMS, PEOPLE, SHARING, asking
from tests.experiment.session.bench import HEADER
from tests.releases import RIGS
from tests.releases.__main__ import protocol as small

UNFILLED = {"JSON_KEY_RECOMMENDED", "SIDECAR_KEY_RECOMMENDED", "TOO_FEW_AUTHORS"}
"""Warnings about recommended keys: ontology terms and institutions, which a reconstruction or a rehearsal lacks."""


@pytest.fixture(scope="session")
def validator() -> str:
    found = shutil.which("bids-validator-deno", path=str(Path(sys.executable).parent))
    if found is None:
        pytest.skip("needs the BIDS validator (pip install bids-validator-deno)")
    return found


def _issues(validator: str, root: Path) -> list[dict[str, Any]]:
    done = subprocess.run(
        [validator, str(root), "--format", "json", "--max-rows", "-1"], capture_output=True, text=True, check=False
    )
    assert done.stdout, done.stderr
    issues: list[dict[str, Any]] = json.loads(done.stdout)["issues"]["issues"]
    assert (done.returncode == 0) == all(issue["severity"] != "error" for issue in issues)
    return issues


def _codes(issues: list[dict[str, Any]]) -> set[str]:
    return {issue["code"] for issue in issues}


def test_the_committed_reconstruction(validator: str, repository_root: Path) -> None:
    issues = _issues(validator, repository_root / "participants" / "okamoto2012")
    assert not [issue for issue in issues if issue["severity"] == "error"]
    assert _codes(issues) <= UNFILLED


def test_a_dataset_with_times_a_foot_trace_and_results(validator: str, tmp_path: Path) -> None:
    rows = [
        trial(1, "sand", "(none)", counted=False, onset=0.5, duration=0.5, redo_reason="slipped"),
        trial(1, "sand", "snow", attempt=2, onset=3.25, duration=0.5, response_time=1.5, foot_speed=120.0),
    ]
    root = write_dataset(tmp_path, {"01": {"virtual": rows, "real": balanced(1)}, "02": {"real": balanced(2)}})
    height_mm = np.concatenate([np.linspace(40, 0, 500), np.full(4000, np.nan), np.linspace(40, 0, 500)])
    traces.write(
        root,
        HEADER.model_copy(update={"task": "virtual"}),
        "foot",
        places=np.arange(5000.0),
        samples=[height_mm[:, None]],
        columns={"foot_height": traces.Column("Height of the sole above the panel.", "mm", 3)},
        rate_hz=2000.0,
        description="Foot height from the tracker.",
        origin="PARTICIPANT",
    )
    found = analyse([root], figures=False)
    assert found.out.parent == root / "derivatives"
    issues = _issues(validator, root)
    assert not [issue for issue in issues if issue["severity"] == "error"]
    assert _codes(issues) <= UNFILLED


def test_the_results_are_a_derivative_of_their_own(validator: str, tmp_path: Path) -> None:
    root = write_dataset(tmp_path, {"01": {"real": balanced(1)}, "02": {"real": balanced(2)}})
    issues = _issues(validator, analyse([root]).out)
    assert not [issue for issue in issues if issue["severity"] == "error"]


FILLED = {
    "License": "CC0-1.0",
    "Authors": ["A. Author", "B. Author"],
    "HEDVersion": "8.4.0",
    "SourceDatasets": [{"URL": "bids::sourcedata"}],
}
"""What a laboratory writes into `dataset_description.json`, beyond what palpate knows."""

OF_SESSIONS = {
    "InstitutionName": "A laboratory",
    "InstitutionAddress": "A street",
    "InstitutionalDepartmentName": "A department",
    "CogAtlasID": "https://www.cognitiveatlas.org/task/id/tsk_0",
    "CogPOID": "http://www.cogpo.org/ontologies/CogPOver1.owl#CogPO_0",
}
"""What it writes into an `events.json` at the top."""


def _fill(root: Path) -> None:
    path = root / "dataset_description.json"
    path.write_text(json.dumps({**json.loads(path.read_text("utf-8")), **FILLED}), "utf-8")
    (root / "events.json").write_text(json.dumps(OF_SESSIONS), "utf-8")


def _check_with_its_copy(validator: str, root: Path, folder: Path) -> None:
    """Neither a dataset nor its shared copy leaves a warning, and both have the same results."""
    _fill(root)
    out = sharing.share(root, folder / "copy").root
    assert [_issues(validator, one) for one in (root, out)] == [[], []]
    places = ((root, folder / "one"), (out, folder / "other"))
    numbers = [analyse([one], place, figures=False).numbers for one, place in places]
    assert _numbers(numbers[1]) == pytest.approx(_numbers(numbers[0]), rel=1e-9, nan_ok=True)


def test_a_study_and_its_shared_copy_leave_no_warning_once_a_laboratory_filled_its_keys(
    validator: str, tmp_path: Path
) -> None:
    study = make_study(tmp_path / "study", further=asking(SHARING + 'questionnaires = ["before"]\n', PEOPLE, FORMS))
    facts.record(study.file, "01", {"age": "34", "sex": "female", "sport": "swimming"}, root=study.root)
    build.build(study.root)
    for participant in ("01", "02"):
        enrolling.sharing(study.file, participant, True, root=study.root)
    _check_with_its_copy(validator, study.root, tmp_path)


@pytest.mark.parametrize("name", ["okamoto2012", "wellman1995"])
def test_rehearsals_of_both_papers_studies_leave_none_either(validator: str, tmp_path: Path, name: str) -> None:
    root = rehearsal.rehearse(
        protocol_file=small(name, tmp_path),
        rig_file=shipped(RIGS[name]),
        out=tmp_path / "dataset",
        participants=2,
        seed=1,
    )
    _check_with_its_copy(validator, root, tmp_path)


def _numbers(value: object) -> list[float]:
    """Every number of a result, in order of size: participants stand in another order."""
    if isinstance(value, dict | list):
        inner = value.values() if isinstance(value, dict) else value
        return sorted(number for one in inner for number in _numbers(one))
    return [float(value)] if isinstance(value, int | float) else []


def test_the_validator_sees_a_broken_dataset(validator: str, tmp_path: Path) -> None:
    root = write_dataset(tmp_path, {"01": {"real": balanced(1)}})
    (root / "dataset_description.json").unlink()
    assert any(issue["severity"] == "error" for issue in _issues(validator, root))
