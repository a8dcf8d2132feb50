"""Commands behind the mask of the system that a module of tests names as its `SYSTEM`, and what is asked of them."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import pytest
from _pytest.mark.structures import ParameterSet

from palpate.experiment.cli import COMMANDS
from tests.portable import matrix
from tests.portable.commands import Ended, Masked
from tests.portable.matrix import FAULTS, REFUSED, Command

NO_TEXTS = (".bin", ".cobs", ".gz", ".npz", ".pdf", ".png", ".svg", ".wav")
"""Endings of files in which a carriage return is a byte like others, or which a library draws."""


@dataclass(frozen=True)
class Results:
    """How each command ended in a folder, by its line."""

    folder: Path
    ended: Mapping[str, Ended]


@pytest.fixture(scope="module")
def masked(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Masked]:
    """A process that runs commands."""
    with Masked(request.module.SYSTEM, tmp_path_factory.mktemp("home")) as process:
        yield process


@pytest.fixture(scope="module")
def results(
    masked: Masked, request: pytest.FixtureRequest, repository_root: Path, tmp_path_factory: pytest.TempPathFactory
) -> Results:
    """Every command of the matrix, run in its order, for later ones read what earlier ones wrote."""
    folder = tmp_path_factory.mktemp(request.module.SYSTEM)
    matrix.lay_out(folder, repository_root)
    ended = {
        command.line: masked.run(shlex.split(command.line), folder=folder, keys=command.keys)
        for command in matrix.commands(request.module.SYSTEM)
    }
    return Results(folder, ended)


def cases(system: str) -> list[ParameterSet]:
    """Return the commands of a system as parameters; those on the list of faults have to fail."""
    faults = {
        line: pytest.mark.xfail(raises=AssertionError, reason=why) for (on, line), why in FAULTS.items() if on == system
    }
    commands = matrix.commands(system)
    assert set(faults) <= {command.line for command in commands}
    return [
        pytest.param(command, id=command.line, marks=[faults[command.line]] if command.line in faults else [])
        for command in commands
    ]


def check_help(masked: Masked, folder: Path) -> None:
    """Check that every command prints its help."""
    names = [name for part in COMMANDS.values() for name in part]
    helped = masked.run(*([name, "--help"] for name in names), folder=folder)
    assert helped.codes == (0,) * len(names), helped.err
    usages = [line.split() for line in helped.out.splitlines() if line.startswith("Usage: ")]
    assert all(name in usage for name, usage in zip(names, usages, strict=True))


def check_end(results: Results, command: Command) -> None:
    """Check how a command ended: well, or with words for whoever typed it."""
    ended = results.ended[command.line]
    assert ended.codes[0] in command.ends, ended.err
    assert "Traceback" not in ended.err
    if command.ends == REFUSED:
        # A doctor's red checks are on standard output.
        assert ended.out or ended.err.startswith("palpate: ")


def check_texts(folder: Path) -> None:
    """Check that texts are in UTF-8, with line feeds alone, whatever the system."""
    files = [path for path in folder.rglob("*") if path.is_file() and path.suffix not in NO_TEXTS]
    assert len(files) > 100
    # Not by `read_text`, which takes every end of a line for a line feed.
    assert [path for path in files if "\r" in path.read_bytes().decode("utf-8")] == []
