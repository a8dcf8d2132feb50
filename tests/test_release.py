"""What a repository shows to strangers: citation, workflows, and what only its owner can fill in."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib

import pytest

from palpate.experiment.cli import COMMANDS
from tests.measures.source import REPOSITORY

OPEN = {"repository-code", "url", "name", "email"}
"""The fields of `CITATION.cff` that the owner has to fill in."""

GITHUB = REPOSITORY / ".github"


@pytest.mark.parametrize(
    ("schema", "file"),
    [("vendor.citation-file-format", "CITATION.cff"), ("vendor.github-workflows", ".github/workflows/tests.yml")],
    ids=["citation", "workflow"],
)
def test_a_linter_finds_nothing(schema: str, file: str) -> None:
    command = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", schema, str(REPOSITORY / file)]
    checked = subprocess.run(command, capture_output=True, text=True, check=False)
    assert checked.returncode == 0, checked.stdout + checked.stderr


def test_addresses_stand_in_one_place_and_the_open_ones_are_listed_here() -> None:
    lines = (REPOSITORY / "CITATION.cff").read_text("utf-8").splitlines()
    marked = [re.sub(r"[\s-]*([\w-]+):.*", r"\1", line) for line in lines if re.search("to.be.filled.in", line, re.I)]
    assert sorted(marked) == sorted(OPEN)
    for page in GITHUB.glob("*.md"):
        assert not re.findall(r"https?://|\w@\w", page.read_text("utf-8"))


def test_the_workflow_tries_each_python_that_is_promised() -> None:
    promised = tomllib.loads((REPOSITORY / "pyproject.toml").read_text("utf-8"))["project"]["classifiers"]
    pythons = {one.rpartition(" ")[2] for one in promised if one.startswith("Programming Language :: Python :: 3.")}
    tried = set(re.findall(r'"(3\.\d+)"', (GITHUB / "workflows" / "tests.yml").read_text("utf-8")))
    assert pythons <= tried


def test_what_strangers_are_told_to_type_exists() -> None:
    listed = {name for part in COMMANDS.values() for name in part}
    named = {
        word for page in GITHUB.glob("*.md") for word in re.findall(r"`palpate ([a-z][a-z-]*)", page.read_text("utf-8"))
    }
    assert {"rehearse", "incident"} <= named <= listed
