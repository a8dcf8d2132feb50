"""Runs commands of palpate behind a mask, each in a fork of one process that has imported every module.

So each command finds what its system has, and the seconds that numpy, scipy and their like take are spent once. What a
command starts anew, such as the processes of a pool, imports for itself.
"""

from __future__ import annotations

import atexit
import gc
import json
import os
import pkgutil
import select
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Self

from tests.portable import masks

LIBRARIES = (
    "matplotlib.backends.backend_agg",
    "matplotlib.backends.backend_svg",
    "scipy.signal",
    "statsmodels.genmod.generalized_estimating_equations",
)
"""What commands import late, beside what modules of palpate import."""

PATIENCE_S = 180.0
"""What takes longer stands still."""


@dataclass(frozen=True)
class Ended:
    """How commands ended, and what they wrote."""

    codes: tuple[int, ...]
    out: str
    err: str


class Masked:
    """The process as whoever gives it commands sees it."""

    def __init__(self, system: str, home: Path) -> None:
        """Start it behind the mask of `system`, for a user with this home. Raises `TimeoutError` as `run`."""
        self._process = subprocess.Popen(
            [sys.executable, "-m", __name__],
            env=masks.environment(system, home),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,
        )
        self.platform: str
        """The system as palpate sees it."""
        self.failures: dict[str, str]
        """The modules of palpate that could not be imported, and why."""
        self.platform, self.failures = self._read(system)

    def run(self, *commands: Sequence[str], folder: Path, keys: str = "") -> Ended:
        """Run `palpate` once for each of some lists of arguments, in one fork, with these keys on standard input.

        Raises `TimeoutError` if it does not end.
        """
        assert self._process.stdin is not None
        with tempfile.TemporaryDirectory() as said:
            streams = [Path(said) / name for name in ("in", "out", "err", "codes")]
            streams[0].write_text(keys, "utf-8")
            order = json.dumps([commands, str(folder), [str(stream) for stream in streams]])
            self._process.stdin.write(order.encode() + b"\n")
            self._process.stdin.flush()
            ended = int(self._read(str(commands)))
            # As soon as one ends otherwise than by its exit code, nothing is known of those after it.
            codes = json.loads(streams[3].read_text()) if streams[3].exists() else [ended]
            out, err = (stream.read_bytes().decode("utf-8", "replace") for stream in streams[1:3])
            return Ended((*codes[:-1], ended), out, err)

    def _read(self, what: str) -> Any:
        assert self._process.stdout is not None
        if not select.select([self._process.stdout], [], [], PATIENCE_S)[0]:
            raise TimeoutError(what)
        return json.loads(self._process.stdout.readline())

    def close(self) -> None:
        """End it, and all that it started."""
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.communicate()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _import_everything() -> dict[str, str]:
    failures = {}
    for package in (import_module("palpate.experiment"), import_module("palpate.analysis")):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            try:
                import_module(module.name)
            except Exception as error:
                failures[module.name] = f"{type(error).__name__}: {error}"
    for library in LIBRARIES:
        import_module(library)
    return failures


def _serve() -> None:
    """Be the process: say what it sees, then run what each line of standard input orders, and answer its exit code."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    failures = _import_everything()
    answer: object = import_module("palpate.experiment.storage").sys.platform, failures
    # Otherwise each fork would copy the memory in which the collector counts.
    gc.freeze()
    while True:
        sys.stdout.write(json.dumps(answer) + "\n")
        sys.stdout.flush()
        line = sys.stdin.readline()
        if not line:
            return
        if (process := os.fork()) == 0:
            _run(*json.loads(line))
            return
        _, status = os.waitpid(process, 0)
        answer = os.waitstatus_to_exitcode(status)


def _run(commands: list[list[str]], folder: str, files: list[str]) -> None:
    """Run commands in this fork, as if a shell had started it with its streams in files, and exit as the last one."""
    os.chdir(folder)
    before = sys.stdin, sys.stdout, sys.stderr
    streams: list[Any] = []
    for number, (file, mode) in enumerate(zip(files, "rww", strict=False)):
        with Path(file).open(mode) as opened:
            os.dup2(opened.fileno(), number)
        code, errors = before[number].encoding, before[number].errors
        streams.append(open(number, mode, encoding=code, errors=errors, closefd=False))  # noqa: SIM115
    sys.stdin, sys.stdout, sys.stderr = streams
    codes = []
    for arguments in commands:
        sys.argv = ["palpate", *arguments]
        try:
            import_module("palpate.experiment.__main__").main()
            codes.append(0)
        except SystemExit as end:
            codes.append(int(end.code or 0))
    Path(files[3]).write_text(json.dumps(codes), "utf-8")
    # As Python ends, but for taking every module to pieces, which would cost more than most commands.
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(codes[-1])


if __name__ == "__main__":
    _serve()
