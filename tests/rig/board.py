"""The tracker's firmware, built by its Makefile, on a simulated ATmega328P behind a pseudo-terminal."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
import pytest
from numpy.typing import NDArray

HERE = Path(__file__).parent
FIRMWARE = HERE.parent.parent / "experiment" / "apparatus" / "firmware"
STRICT = ["-std=c11", "-O2", "-Wall", "-Wextra", "-Werror"]

CYCLES_US = 16
"""Of the board's crystal in a microsecond."""

FIRST_CYCLE = 20_000
"""The board's clock starts before this cycle; a trajectory's time 0."""


def need(*programs: str) -> None:
    """Skip the test where one of them is missing."""
    for program in programs:
        if shutil.which(program) is None:
            pytest.skip(f"needs {program}")


def make(folder: Path, **settings: int) -> subprocess.CompletedProcess[str]:
    """Build the firmware with these settings."""
    need("make", "avr-gcc", "avr-size")
    command = ["make", "-C", str(FIRMWARE), f"BUILD={folder}", *(f"{name}={value}" for name, value in settings.items())]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def built(folder: Path, **settings: int) -> Path:
    """The firmware's ELF file."""
    done = make(folder, **settings)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / "tracker.elf"


def host(folder: Path) -> Path:
    """The simulator's program, compiled."""
    need("gcc")
    if not Path("/usr/include/simavr/sim_avr.h").is_file():
        pytest.skip("needs libsimavr-dev")
    program = folder / "simavr_host"
    command = ["gcc", *STRICT, "-o", str(program), str(HERE / "simavr_host.c"), "-lsimavr", "-lelf", "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return program


@dataclass(frozen=True)
class Events:
    """What the simulator saw on the chip.

    Attributes:
        converted_us: when each sample's conversion started, after the first, microseconds, shape (n,).
        volts_mv: what the wiper gave then, mV, shape (n,).
        first_us: when the first one started, in the trajectory's time.
        lamp: when the lamp changed, in the trajectory's time, microseconds, and whether it was lit.
        asleep: part of the cycles that the processor slept.
    """

    converted_us: NDArray[np.float64]
    volts_mv: NDArray[np.int64]
    first_us: float
    lamp: list[tuple[float, bool]]
    asleep: float


class Board:
    """A board with the firmware on it, whose potentiometer follows a trajectory once `go` is called."""

    def __init__(
        self,
        program: Path,
        firmware: Path,
        folder: Path,
        *,
        us: NDArray[np.float64],
        volts_mv: NDArray[np.float64],
        run_us: float,
    ) -> None:
        """Power the simulator.

        Args:
            program: from `host`.
            firmware: from `built`.
            folder: for its files.
            us: times of the trajectory's knots, microseconds, rising, shape (n,).
            volts_mv: of the wiper there, mV; straight lines between.
            run_us: how long it runs, microseconds.
        """
        self._cycles = int(run_us * CYCLES_US) + FIRST_CYCLE
        self._events = folder / "events"
        trajectory = folder / "trajectory"
        np.savetxt(trajectory, np.column_stack([us * CYCLES_US + FIRST_CYCLE, volts_mv]), fmt="%.6f")
        self._process = subprocess.Popen(
            [program, firmware, trajectory, self._events, str(self._cycles)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdout is not None
        lines = (line.split() for line in self._process.stdout)
        self.port = next(words[1] for words in lines if words[0] == "port")

    def go(self) -> None:
        """Start the board's clock."""
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()

    def unplug(self) -> None:
        """Hang up, after everything was sent."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        assert "done" in self._process.stdout.read()
        assert self._process.wait() == 0

    def events(self) -> Events:
        """What happened, after `unplug`."""
        lines = [line.split() for line in self._events.read_text().splitlines()]
        # The first conversion is the one after switching on; its result is thrown away.
        started = np.array([[int(a), int(b)] for kind, a, b in (x for x in lines if len(x) == 3) if kind == "convert"])
        cycle, volts_mv = started[1:].T
        return Events(
            converted_us=(cycle - cycle[0]) / CYCLES_US,
            volts_mv=volts_mv,
            first_us=(cycle[0] - FIRST_CYCLE) / CYCLES_US,
            lamp=[((int(x[1]) - FIRST_CYCLE) / CYCLES_US, x[2] == "1") for x in lines if x[0] == "lamp"],
            asleep=next(int(x[1]) for x in lines if x[0] == "asleep") / self._cycles,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None and not pipe.closed:
                pipe.close()
