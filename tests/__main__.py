"""Run every test: `python -m tests`.

What computes runs beside what mostly waits for the clock on the wall, and leaves the processor to it. What needs the
machine to itself runs last. No part imports the modules of another, of which importing alone takes seconds a worker.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from shutil import which
from tempfile import TemporaryFile

SIDE_BY_SIDE = ("--dist", "loadfile", "--no-loadscope-reorder")
TESTS = Path(__file__).parent
RIG = TESTS / "rig"


def marked(mark: str) -> list[str]:
    """Return the modules that bear a mark: only those of the rig may."""
    return [str(path) for path in sorted(RIG.glob("test_*.py")) if f"pytest.mark.{mark}\n" in path.read_text("utf-8")]


def parts() -> tuple[list[str], list[str], list[str]]:
    """Return the arguments of what computes, of what waits, and of what runs alone."""
    waiting, alone = marked("clocked"), marked("alone")
    computing = ["-n", "4", *SIDE_BY_SIDE, *(f"--ignore={path}" for path in waiting + alone)]
    return computing, ["-n", "4", *SIDE_BY_SIDE, *waiting], alone


def pytest(arguments: list[str]) -> list[str]:
    """Return the command of one part."""
    return [sys.executable, "-m", "pytest", *arguments]


def compile_all() -> None:
    """In a fresh checkout, have two processes import, and so compile, all that seven would each compile at once."""
    if any(TESTS.glob("__pycache__/*-pytest-*.pyc")):
        return
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    folders = {str(path) for path in TESTS.iterdir() if path.is_dir() or path.match("test_*.py")}
    some = {str(TESTS / "experiment"), str(RIG)}
    importing = [
        subprocess.Popen(pytest(["--collect-only", "-q", *sorted(part)]), stdout=subprocess.DEVNULL, env=environment)
        for part in (some, folders - some)
    ]
    for one in importing:
        one.wait()


def main() -> int:
    """Run the parts, and return the largest of their exit codes: 0 if every test passed."""
    begun_s = time.monotonic()
    compile_all()
    yielding = ["nice", "-n", "10"] if which("nice") else []
    computing, waiting, alone = parts()
    with TemporaryFile() as kept:
        beside = subprocess.Popen(pytest(waiting), stdout=kept, stderr=subprocess.STDOUT)
        codes = [subprocess.call(yielding + pytest(computing)), beside.wait()]
        kept.seek(0)
        sys.stdout.buffer.write(kept.read())
        sys.stdout.flush()
    codes.append(subprocess.call(pytest(alone)))
    print(f"The tests took {time.monotonic() - begun_s:.0f} s.")
    return max(codes)


if __name__ == "__main__":
    sys.exit(main())
