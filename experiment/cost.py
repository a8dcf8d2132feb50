"""The time and memory that a call, or an import, takes: measured here and now, on this machine."""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

REPEATS = 5


@dataclass(frozen=True)
class Taken:
    """A time, as the median of repeats, and how far these spread.

    Attributes:
        ms: median, ms.
        spread_ms: from the lower to the upper quartile, ms.
    """

    ms: float
    spread_ms: float

    @property
    def measurable(self) -> bool:
        """Whether it is more than the spread of the repeats; what is not is no saving."""
        return abs(self.ms) > self.spread_ms


def import_cost(modules: tuple[str, ...]) -> tuple[Taken, float | None]:
    """Time, and the median of resident memory, kB, that importing `modules` adds to a session without them.

    Each time a new interpreter first imports what every session needs. No memory where the system does not tell it.
    """
    code = (
        "import importlib, json, sys, time\n"
        "import experiment.study\n"
        "def kb():\n"
        "    try:\n"
        "        with open('/proc/self/statm') as file:\n"
        "            import resource\n"
        "            return int(file.read().split()[1]) * resource.getpagesize() / 1e3\n"
        "    except (OSError, ImportError):\n"
        "        return None\n"
        "held, begun = kb(), time.perf_counter()\n"
        "for name in sys.argv[1:]:\n"
        "    importlib.import_module(name)\n"
        "passed = time.perf_counter() - begun\n"
        "print(json.dumps([passed * 1e3, None if held is None else kb() - held]))\n"
    )
    command = [sys.executable, "-c", code, *modules]
    outputs = [subprocess.run(command, capture_output=True, check=True).stdout for _ in range(REPEATS)]  # noqa: S603
    runs = [json.loads(output) for output in outputs]
    resident_kb = None if runs[0][1] is None else statistics.median(run[1] for run in runs)
    return taken([run[0] for run in runs]), resident_kb


def measured(call: Callable[[], object]) -> tuple[Taken, float]:
    """What a call takes, and the memory that its result holds, kB."""
    times = taken([ms(call) for _ in range(REPEATS)])
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    result = call()
    held = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    del result
    return times, held / 1e3


def taken(ms: list[float]) -> Taken:
    """Median and spread of repeats, ms."""
    lower, median, upper = np.quantile(ms, [0.25, 0.5, 0.75]).tolist()
    return Taken(median, upper - lower)


def ms(call: Callable[[], object]) -> float:
    """What one call takes, ms."""
    begun = time.perf_counter()
    call()
    return (time.perf_counter() - begun) * 1e3
