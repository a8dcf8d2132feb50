"""`palpate record` and `palpate validate`, as the experimenter calls them."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from palpate.experiment.cli.app import app
from palpate.experiment.errors import DatasetError, PalpateError
from tests.approved import Refuses


def call(*arguments: object) -> Result:
    result = CliRunner().invoke(app, [*map(str, arguments)])
    if isinstance(result.exception, PalpateError):
        raise result.exception
    return result


@pytest.fixture(scope="module")
def protocol(repository_root: Path) -> Path:
    return repository_root / "protocols" / "okamoto2012.toml"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory, protocol: Path) -> Path:
    out = tmp_path_factory.mktemp("recorded") / "set"
    result = call("record", protocol, "--simulated", "--seed", 1, "--out", out)
    assert (result.exit_code, result.stdout) == (0, f"SIMULATED recordings: {out}\n")
    assert re.search(r"seed 1; session \d+, the ", (out / "manifest.toml").read_text("utf-8"))
    return out


def test_at_least_half_of_the_takes_are_on_their_own_or_a_neighbouring_speed(recorded: Path, tmp_path: Path) -> None:
    """Over twenty seeds in `rehearsal/kinds/footstep/test_recorded_takes.py`."""
    result = call("validate", recorded, "--seed", 1, "--out", tmp_path / "v", "--no-figures", "--json")
    found = json.loads(result.stdout)
    assert found["label"] == "SIMULATED"
    for one in found["classification"]:
        assert one["takes"] == 30
        assert 2 * sum(one["same_or_neighbouring"]) >= 30, one["material"]
    assert found["holds"]
    assert "Table 3" in found["fitted"]


def test_a_validation_keeps_out_of_a_dataset(recorded: Path, tmp_path: Path, refuses: Refuses) -> None:
    (tmp_path / "dataset_description.json").write_text('{"DatasetType": "raw"}')
    with refuses(DatasetError):
        call("validate", recorded, "--out", tmp_path / "stimuli" / "v")
    assert not (tmp_path / "stimuli").exists()


def test_fresh_takes_from_a_folder(recorded: Path, tmp_path: Path, protocol: Path) -> None:
    call("record", protocol, "--simulated", "--seed", 2, "--out", tmp_path / "f", "--speeds", "150,400", "--takes", 2)
    result = call("validate", recorded, "--fresh", tmp_path / "f", "--out", tmp_path / "v", "--no-figures")
    assert "SIMULATED" in result.stdout
    assert result.stdout.rstrip().endswith("report.html")
    assert "of 4" in result.stdout


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--speeds", "400,150"], "speeds: got 400, 150 mm/s; allowed: 10 to 10000, each above the previous one"),
        (["--speeds", "100,10001"], "speeds: got 100, 10001 mm/s; allowed: 10 to 10000"),
        (["--speeds", "slow"], "--speeds: got 'slow'; allowed: numbers and commas"),
        (["--takes", "0"], "takes: got 0; allowed: 1 to 100"),
    ],
)
def test_bad_options_are_refused_and_nothing_is_written(
    tmp_path: Path, protocol: Path, options: list[str], message: str
) -> None:
    with pytest.raises(PalpateError, match=message):
        call("record", protocol, "--simulated", "--out", tmp_path / "set", *options)
    assert not any(tmp_path.iterdir())


def test_a_real_recording_needs_a_rig(tmp_path: Path, protocol: Path, refuses: Refuses) -> None:
    with refuses(PalpateError):
        call("record", protocol, "--out", tmp_path / "set")


def test_recordings_are_no_fresh_takes_of_themselves(recorded: Path, refuses: Refuses) -> None:
    with refuses(PalpateError):
        call("validate", recorded, "--fresh", recorded)


def test_real_recordings_need_fresh_takes(recorded: Path, tmp_path: Path, refuses: Refuses) -> None:
    real = tmp_path / "real"
    shutil.copytree(recorded, real, ignore=shutil.ignore_patterns("validation"))
    text = (real / "manifest.toml").read_text("utf-8")
    (real / "manifest.toml").write_text(text.replace("simulated = true", "simulated = false"), "utf-8")
    with refuses(PalpateError):
        call("validate", real, "--out", tmp_path / "v")
    assert not (tmp_path / "v").exists()


def test_an_empty_folder_is_refused(tmp_path: Path, refuses: Refuses) -> None:
    with refuses(PalpateError):
        call("validate", tmp_path)
    assert not any(tmp_path.iterdir())
