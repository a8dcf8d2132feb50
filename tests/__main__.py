"""Run every test: `python -m tests`.

What computes runs beside what mostly waits for the clock on the wall, and leaves the processor to it. What needs the
machine to itself runs last.
"""

from __future__ import annotations

import subprocess
import sys
import time
from shutil import which
from tempfile import TemporaryFile

SIDE_BY_SIDE = ("--dist", "loadfile", "--no-loadscope-reorder")
COMPUTING = ("-n", "3", *SIDE_BY_SIDE, "-m", "not clocked and not alone")
WAITING = ("-n", "4", *SIDE_BY_SIDE, "tests/rig", "-m", "clocked")
ALONE = ("tests/rig", "-m", "alone")


def pytest(arguments: tuple[str, ...]) -> list[str]:
    """Return the command of one part."""
    return [sys.executable, "-m", "pytest", *arguments]


def main() -> int:
    """Run the parts, and return the largest of their exit codes: 0 if every test passed."""
    begun_s = time.monotonic()
    yielding = ["nice", "-n", "10"] if which("nice") else []
    with TemporaryFile() as kept:
        waiting = subprocess.Popen(pytest(WAITING), stdout=kept, stderr=subprocess.STDOUT)
        codes = [subprocess.call(yielding + pytest(COMPUTING)), waiting.wait()]
        kept.seek(0)
        sys.stdout.buffer.write(kept.read())
        sys.stdout.flush()
    codes.append(subprocess.call(pytest(ALONE)))
    print(f"The tests took {time.monotonic() - begun_s:.0f} s.")
    return max(codes)


if __name__ == "__main__":
    sys.exit(main())
