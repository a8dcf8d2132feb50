"""Faults planted in a copy of the checkout, one at a time: the row that promises against each has to catch it.

`python -m tests.faults.planted WORD...` plants by themselves those whose name has all of the words.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from tests.faults.campaign import Count, Size
from tests.faults.patches import AWAITED, PATCHES, Patch

ROOT = Path(__file__).parents[2]
MOST_S = 60.0
"""A fault that is caught later than this is not caught."""

# What was compiled is taken along: it goes by the time of its source, which a patch changes.
LEFT = (".git", ".venv", "*.pyc.*", ".mypy_cache", ".ruff_cache", ".pytest_cache", ".hypothesis", "node_modules")


def attacks(size: Size) -> Iterator[Count]:
    """Plant each fault by itself; each row of the table names what caught it."""
    yield from caught([patch for patch in PATCHES if patch.subset or size is Size.WHOLE], size)
    if size is Size.WHOLE:
        yield from (Count(f"{name}: NOT PLANTED, palpate has no such part yet", 0, 0) for name in AWAITED)


def caught(chosen: Sequence[Patch], size: Size) -> Iterator[Count]:
    """Plant each of the chosen faults; of the whole, each row also runs once without any."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "checkout"
        shutil.copytree(ROOT, copy, symlinks=True, ignore=shutil.ignore_patterns(*LEFT))
        _check_that_the_copy_runs(copy)
        if size is Size.WHOLE:
            for rows in sorted({patch.rows for patch in chosen}):
                try:
                    by, _, said = run(copy, rows)
                except RuntimeError as error:
                    by, said = " ".join(rows), str(error)
                if by:
                    yield Count(f"nothing planted: `{by}` fails", 1, 0, 0, (said,))
        for patch in chosen:
            try:
                yield _caught(patch, copy)
            except (ValueError, RuntimeError) as error:
                # It proves nothing, and ends no run.
                yield Count(f"{patch.name}: could not be judged", 1, 0, 1, (str(error)[-2000:],))


def _caught(patch: Patch, copy: Path) -> Count:
    """Return whether a fault is caught. Raises `ValueError` for a stale patch, `RuntimeError` for one that breaks."""
    path = copy / patch.file
    as_it_is = path.read_bytes()
    try:
        patch.plant(copy)
        by, lasted_s, said = run(copy, patch.rows)
    finally:
        path.write_bytes(as_it_is)
    survived = bool(by) and lasted_s <= MOST_S
    told = f"caught by `{by}` in {lasted_s:.0f} s" if by else "caught by nothing"
    return Count(f"{patch.name}: {told}", 1, int(survived), int(not survived), () if survived else (said[-2000:],))


def run(copy: Path, rows: Sequence[str]) -> tuple[str, float, str]:
    """Return the row that fails in a copy of the checkout, or nothing, after how long, s, and what was printed.

    Raises `RuntimeError` if what ran was no test: a patch that breaks the source outright proves nothing.
    """
    begun_s = time.monotonic()
    part = rows[0].removeprefix("campaign:")
    campaigns = part != rows[0]
    named = ["-m", "tests.faults", part, "--subset"] if campaigns else ["-m", "pytest", "-q", "-x", "-rf", *rows]
    command = [sys.executable, *named, *([] if campaigns else ["-p", "no:cacheprovider"])]
    try:
        ended = subprocess.run(
            command, cwd=copy, env=_env(copy), capture_output=True, text=True, check=False, timeout=2 * MOST_S
        )
    except subprocess.TimeoutExpired:
        return "", time.monotonic() - begun_s, f"not done within {2 * MOST_S:g} s"
    lasted_s, said = time.monotonic() - begun_s, ended.stdout + ended.stderr
    if ended.returncode == 0:
        return "", lasted_s, said
    if campaigns:
        counts = re.findall(rf"^{part}: (.*): ([\d,]+) of ([\d,]+) survived, ([\d,]+) lost$", said, re.MULTILINE)
        failed = [f"{part}: {name}" for name, good, tried, lost in counts if good != tried or lost != "0"]
    else:
        failed = re.findall(r"^FAILED (.+?)(?: - |$)", said, re.MULTILINE)
    if not failed:
        raise RuntimeError(f"{' '.join(command)} ended with {ended.returncode}, and no test failed: {said[-3000:]}")
    return failed[0].replace("|", "/"), lasted_s, said


def _env(copy: Path) -> dict[str, str]:
    # Compiled files are told apart by second and size alone, and two patches may come in one second.
    fixed = {"PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1", "OPENBLAS_NUM_THREADS": "1"}
    return {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")} | fixed


def _check_that_the_copy_runs(copy: Path) -> None:
    asked = "import palpate.experiment, palpate.analysis; print(palpate.experiment.__file__, palpate.analysis.__file__)"
    said = subprocess.check_output([sys.executable, "-c", asked], cwd=copy, env=_env(copy), text=True).split()
    if not all(Path(one).resolve().is_relative_to(copy.resolve()) for one in said):
        raise RuntimeError(f"got {' and '.join(said)}; allowed: files of the copy at {copy}; the copy is not what runs")


def main() -> None:
    words = sys.argv[1:]
    for count in caught([patch for patch in PATCHES if all(word in patch.name for word in words)], Size.SUBSET):
        sys.stdout.write(f"{count.fault}\n" + "".join(f"  {failure}\n" for failure in count.failures))
        sys.stdout.flush()


if __name__ == "__main__":
    main()
