"""Nothing of the working folder is imported: by `python -m`, by what palpate starts, and by a library's workers."""

from __future__ import annotations

import ast
import inspect
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from palpate.experiment import storage
from tests.conftest import Palpate
from tests.working_folder import MODULES, WorkingFolder

STARTS = {"LocalCluster", "Manager", "Nanny", "Parallel", "Pool", "Process", "ProcessPoolExecutor"}
"""What has a library start processes of Python."""

OTHER_WAYS = re.compile(r"os\.(exec|spawn|posix_spawn|system|popen)\w*|asyncio\.create_subprocess_\w+")
"""Ways to start a process that palpate has no need of."""

PYTHON = re.compile(r"(.*/)?python[0-9.]*")
"""The first word of such a command."""


def escapes(source: str) -> list[int]:
    """Return the lines that may start a Python which looks for modules in the working folder.

    Those that name the interpreter do, those that use another way than `subprocess`, and those outside of a safe path
    that have a library start workers, unless by forks, which look where their parent does.
    """
    found, safe, forks = set[int](), set[ast.AST](), set[str]()
    for node in ast.walk(ast.parse(source)):
        first = node.elts[0] if isinstance(node, ast.List) and node.elts else None
        if isinstance(first, ast.Constant) and PYTHON.fullmatch(str(first.value)):
            found.add(first.lineno)
        elif isinstance(node, ast.Attribute) and node.attr == "executable":
            found.add(node.lineno)
        elif isinstance(node, ast.With) and any("safe_path" in ast.dump(item.context_expr) for item in node.items):
            safe.update(ast.walk(node))
        elif isinstance(node, ast.Assign) and "get_context('fork')" in ast.unparse(node.value):
            forks.update(map(ast.unparse, node.targets))
        elif isinstance(node, ast.Call):
            of, _, name = ast.unparse(node.func).rpartition(".")
            starts = name in STARTS and node not in safe and of not in forks
            if starts or OTHER_WAYS.fullmatch(f"{of}.{name}"):
                found.add(node.lineno)
    return sorted(found)


def test_one_function_names_the_interpreter_and_no_library_starts_workers_elsewhere(repository_root: Path) -> None:
    paths = [path for package in ("experiment", "analysis") for path in (repository_root / package).rglob("*.py")]
    found = {path.relative_to(repository_root).as_posix(): escapes(path.read_text("utf-8")) for path in paths}
    lines, first = inspect.getsourcelines(storage.python_command)
    assert {name: at for name, at in found.items() if at} == {"experiment/storage.py": [first + len(lines) - 1]}


@pytest.mark.parametrize(
    "source",
    [
        "subprocess.Popen([sys.executable, '-m', 'palpate.experiment'])",
        "subprocess.run(['/usr/bin/python3.11', '-m', 'palpate.experiment'])",
        "os.execv(program, arguments)",
        "Parallel(n_jobs=2)(work)",
        "with pool: ProcessPoolExecutor(2)",
        "context = multiprocessing.get_context('spawn')\ncontext.Process(target=work)",
        "distributed.LocalCluster(n_workers=2)",
    ],
)
def test_what_would_start_python_in_another_way_is_found(source: str) -> None:
    assert escapes(source) == [source.count("\n") + 1]


@pytest.mark.parametrize(
    "source",
    [
        "with storage.safe_path(), ProcessPoolExecutor(2) as pool: pool.submit(work)",
        "forking = multiprocessing.get_context('fork')\nforking.Process(target=work)",
        "subprocess.run(['ssh-keygen', '-Y', 'sign'])",
    ],
)
def test_what_imports_nothing_of_the_folder_is_not(source: str) -> None:
    assert escapes(source) == []


PROGRAM = """\
import multiprocessing, os, subprocess
from concurrent.futures import ProcessPoolExecutor
from joblib import Parallel, delayed
from palpate.experiment import storage

if __name__ == "__main__":
    subprocess.run(storage.python_command("-c", "import select, random, queue, experiment.errors"), stderr=-3)
    subprocess.run(storage.python_command("-m", "palpate.experiment", "--version"), check=True)
    with storage.safe_path():
        for way in ("spawn", "forkserver"):
            with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context(way)) as pool:
                print(pool.submit(abs, -1).result())
        print(Parallel(n_jobs=2)(delayed(abs)(one) for one in (-2, -3)))
    print(os.environ["PYTHONSAFEPATH"] != "")
"""
"""A laboratory's own program, which stands elsewhere: it started without a safe path."""


def test_a_command_leaves_a_safe_path_to_all_that_it_starts(palpate: Palpate) -> None:
    palpate("--version")
    assert os.environ["PYTHONSAFEPATH"] == "1"


def test_a_program_that_uses_the_library_starts_nothing_that_looks_into_the_folder(tmp_path: Path) -> None:
    folder = WorkingFolder(tmp_path / "lab")
    program = tmp_path / "program.py"
    program.write_text(PROGRAM, "utf-8")
    done = folder.run("python", program)
    assert (done.stdout.splitlines()[1:], folder.imported) == (["1", "1", "[2, 3]", "False"], []), done.stderr


def test_python_m_looks_no_longer_into_the_folder_from_the_first_line_of_palpate_on(tmp_path: Path) -> None:
    """Before that Python itself does, which takes a `palpate.py` there for palpate."""
    modules = tuple(name for name in MODULES if name != "palpate")
    folder = WorkingFolder(tmp_path / "lab", modules, ("analysis", "experiment"))
    done = folder.run("python", "-m", "palpate.experiment", "check", "okamoto2012")
    assert (done.returncode, folder.imported) == (0, []), done.stderr


def test_python_m_in_a_checkout_still_finds_palpate(repository_root: Path) -> None:
    done = subprocess.run([sys.executable, "-m", "palpate.experiment", "check", "okamoto2012"], cwd=repository_root)
    assert done.returncode == 0


def test_python_m_in_a_folder_that_was_deleted_needs_none(tmp_path: Path) -> None:
    command = (
        f"cd {tmp_path}; mkdir gone; cd gone; rmdir ../gone; {sys.executable} -m palpate.experiment check okamoto2012"
    )
    assert subprocess.run(["sh", "-c", command], stdout=subprocess.DEVNULL).returncode == 0
