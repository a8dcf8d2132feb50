"""The subset of the fault campaign that every change has to survive; that of `stalls` is in `tests/rig`."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from pathlib import Path

import pytest

from palpate.experiment.cli import COMMANDS
from tests.faults import campaign
from tests.faults.campaign import BEGIN, END, PARTS, TABLE, Count, Size
from tests.faults.inputs import STARTED
from tests.faults.patches import PATCHES, Patch


@pytest.mark.parametrize("part", [part for part in PARTS if part != "stalls"])
def test_every_fault_is_survived(part: str) -> None:
    counts = list(campaign.attacks(part, Size.SUBSET))
    assert counts
    for count in counts:
        assert count.tried > 0, count.fault
        assert (count.survived, count.lost) == (count.tried, 0), (count.fault, *count.failures[:20])


@pytest.fixture(scope="module")
def with_undefined_names(tmp_path_factory: pytest.TempPathFactory, repository_root: Path) -> set[str]:
    """The patches with which a file would use a name that is gone."""
    folder = tmp_path_factory.mktemp("patched")
    for number, patch in enumerate(PATCHES):
        source = (repository_root / patch.file).read_text("utf-8")
        (folder / f"{number}.py").write_text(source.replace(patch.old, patch.new), "utf-8")
    undefined = [sys.executable, "-m", "ruff", "check", "--isolated", "--select", "F821", "--output-format", "json"]
    found = json.loads(subprocess.run([*undefined, folder], check=False, capture_output=True).stdout)
    return {PATCHES[int(Path(one["filename"]).stem)].name for one in found}


@pytest.mark.parametrize("patch", PATCHES, ids=[patch.name for patch in PATCHES])
def test_a_planted_fault_fits_the_source_as_it_is(
    patch: Patch, repository_root: Path, with_undefined_names: set[str]
) -> None:
    assert (repository_root / patch.file).read_text("utf-8").count(patch.old) == 1
    # A bare name that is gone would fail in a test of anything, and be caught by none that makes the promise.
    assert patch.name not in with_undefined_names


def test_ctrl_c_is_tried_at_the_start_of_every_command() -> None:
    listed = {name for part in COMMANDS.values() for name in part}
    assert {command[0] for command in STARTED} == {*listed, "--help"} - {"screen"}


def test_a_part_that_ran_replaces_its_own_rows_and_no_others(tmp_path: Path) -> None:
    readme, table = tmp_path / "README.md", tmp_path / "table.csv"
    readme.write_text(f"Before.\n\n{BEGIN}\n\nNothing yet.\n\n{END}\n\nAfter.\n")
    table.write_text("part,fault,tried,survived,lost\n")
    for part, tried in (("texts", [1]), ("kills", [2]), ("texts", [3000, 4])):
        campaign.write(part, [Count(f"{each} faults, of {part}", each, each - 1) for each in tried], table, readme)
    with table.open(encoding="utf-8", newline="") as file:
        assert [row for row in csv.reader(file) if row[0] in PARTS] == [
            ["kills", "2 faults, of kills", "2", "1", "0"],
            ["texts", "3000 faults, of texts", "3000", "2999", "0"],
            ["texts", "4 faults, of texts", "4", "3", "0"],
        ]
    assert readme.read_text() == (
        f"Before.\n\n{BEGIN}\n\n| part | faults | tried | survived | lost |\n|:--|--:|--:|--:|--:|\n"
        f"| `kills` | 1 | 2 | 1 | 0 |\n| `texts` | 2 | 3,004 | 3,002 | 0 |\n\n{END}\n\nAfter.\n"
    )


def test_the_readme_has_the_sums_of_the_table() -> None:
    with TABLE.open(encoding="utf-8", newline="") as file:
        _, *rows = csv.reader(file)
    shown = campaign.README.read_text("utf-8").partition(BEGIN)[2].partition(END)[0]
    assert shown.strip() == campaign.sums(rows)
