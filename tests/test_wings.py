"""What a study does not need can be deleted from the source: the rest works, and says what is not installed."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable
from importlib.util import cache_from_source
from pathlib import Path

import pytest

from palpate.experiment.protocol import designs, kinds
from tests.analysis.datasets import compared, write_dataset
from tests.conftest import REPOSITORY
from tests.measures.imports import WINGS
from tests.measures.source import is_inside, module_of, tracked_files

COMMAND = "from palpate.experiment.__main__ import main; main()"
COMMON = ("audit", "power", "numerics", "validation")
"""Wings of the analysis that no design needs."""

NEITHER = (
    "ahead",
    "floor",
    "levels",
    "phase",
    "prose",
    "stepping",
    "tap fit",
    "imports",
    "training",
    "voice",
    "weight",
)
"""Further wings that neither study here needs."""

REFUSED = {
    "audit": ("audit", "okamoto2012"),
    "power": ("power", "protocols/okamoto2012.toml"),
    "numerics": ("numerics", "--quick"),
    "validation": ("validate", "none"),
}
"""A command of each."""


def copied(folder: Path, wings: Iterable[str]) -> Path:
    """Copy the source into a folder, without these wings, and with what Python has compiled of it."""
    rooms = [room for wing in wings for room in WINGS[wing]]
    for file in tracked_files("experiment", "analysis", "palpate", "protocols"):
        name = file.as_posix()
        if not (is_inside(name, rooms) or name in ("palpate/analysis", "palpate/experiment")):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(REPOSITORY / name, folder / name)
            compiled, copy = (Path(cache_from_source(str(root / name))) for root in (REPOSITORY, folder))
            if compiled.exists():
                copy.parent.mkdir(exist_ok=True)
                shutil.copyfile(compiled, copy)
    return folder


def other_than(*names: str) -> list[str]:
    """Return the kinds and designs with other names, which are wings as well."""
    return [name for name in (*kinds.NAMES, *designs.NAMES) if name not in names]


def list_alone(folder: Path, room: str, *names: str) -> None:
    """Have a copy's list of kinds or designs name these alone."""
    file = folder / "experiment" / "protocol" / room / "__init__.py"
    listed = f"= Literal[{', '.join(map(repr, names))}]"
    text, changed = re.subn(r"(?m)^(Kind|Design) = Literal\[[^\]]*\]", rf"\1 {listed}", file.read_text("utf-8"))
    assert changed == 1
    file.write_text(text, "utf-8")


def run(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a command of the source in a folder."""
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    words = [sys.executable, "-c", COMMAND, *arguments]
    return subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def identifies(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The source without every wing that the identification of steps does not need."""
    wings = (*COMMON, *NEITHER, "servo", *other_than("footstep", "identification"))
    folder = copied(tmp_path_factory.mktemp("identifies"), wings)
    list_alone(folder, "kinds", "footstep")
    list_alone(folder, "designs", "identification")
    return folder


def test_an_identification_needs_none_of_them(identifies: Path) -> None:
    """A rehearsal ends with the analysis."""
    checked = run(identifies, "check", "protocols/okamoto2012.toml")
    assert (checked.returncode, checked.stderr) == (0, "")
    done = run(identifies, "rehearse", "--participants", "1", "--jobs", "1", "--out", "dataset")
    assert done.returncode == 0, done.stderr
    written = {path.name for path in (identifies / "dataset" / "derivatives" / "palpate" / "tables").iterdir()}
    assert {"found.csv", "confusion.csv", "tests.csv", "intervals.csv"} <= written
    assert "comparison.csv" not in written


def test_a_comparison_of_taps_needs_no_other_kind_or_design(tmp_path: Path) -> None:
    """Its protocol has a fourth of the repetitions; the rehearsal ends with the analysis."""
    source = copied(tmp_path, (*COMMON, *NEITHER, *other_than("tapping", "comparison")))
    list_alone(source, "kinds", "tapping")
    # What a protocol says of an identification is not in its wing.
    list_alone(source, "designs", "identification", "comparison")
    protocol = source / "protocols" / "wellman1995.toml"
    shortened = protocol.read_text("utf-8").replace("repetitions = 8 ", "repetitions = 2 ").replace("= 108", "= 27")
    protocol.write_text(shortened, "utf-8")
    checked = run(source, "check", "protocols/wellman1995.toml")
    assert (checked.returncode, checked.stderr) == (0, "")
    arguments = ("--participants", "1", "--jobs", "1", "--out", "dataset")
    done = run(source, "rehearse", "protocols/wellman1995.toml", *arguments)
    assert done.returncode == 0, done.stderr
    written = {path.name for path in (source / "dataset" / "derivatives" / "palpate" / "tables").iterdir()}
    assert {"pairs.csv", "bias.csv"} <= written


@pytest.mark.parametrize("wing", COMMON)
def test_a_command_of_a_wing_says_that_it_is_not_installed(identifies: Path, wing: str) -> None:
    refused = run(identifies, *REFUSED[wing])
    assert (refused.returncode, refused.stdout) == (2, "")
    assert module_of(WINGS[wing][0]) in refused.stderr
    assert len(refused.stderr.splitlines()) == 1


def test_an_audit_of_printed_numbers_reads_no_sentences(tmp_path: Path) -> None:
    source = copied(tmp_path, ("prose",))
    done = run(source, "audit", "okamoto2012")
    assert done.returncode == 0, done.stderr
    page = source / "paper.html"
    page.write_text("<p>t(11) = 8.14, p < .001</p>", "utf-8")
    refused = run(source, "audit", "paper.html")
    assert refused.returncode == 2
    assert module_of(WINGS["prose"][0]) in refused.stderr


def test_a_dataset_of_a_kind_that_is_not_installed_is_refused(identifies: Path) -> None:
    sessions = {"1": {"live": compared([("felt", "cork", "second")])}}
    pair = {"materials": ("felt", "cork"), "tasks": ("live",), "answers": ("first", "second")}
    write_dataset(identifies / "pairs", sessions, origin="REHEARSAL", **pair)  # type: ignore[arg-type]
    refused = run(identifies, "analyse", "pairs", "--out", "out")
    assert (refused.returncode, refused.stdout) == (2, "")
    assert "Kind is 'tapping'" in refused.stderr


def test_an_import_of_a_wing_is_seen(identifies: Path, tmp_path: Path) -> None:
    shutil.copytree(identifies, tmp_path / "source")
    with (tmp_path / "source" / "analysis" / "analyse.py").open("a", encoding="utf-8") as file:
        file.write("from palpate.analysis.audit.audit import audit\n")
    done = run(tmp_path / "source", "analyse", "dataset", "--out", "out")
    assert done.returncode == 2
    assert module_of(WINGS["audit"][0]) in done.stderr
