"""Columns of a recording beside what pandas takes for the same file: run `python -m tests.benchmarks.reading [MB]`.

Each file has a column of times and two of samples, in one dialect. Both read it in turn, seven times; CPU time of each,
seconds, medians, and the median of their ratios. Not a test: it asserts nothing.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd

from palpate.experiment.recordings.readers import read

DIALECTS = ((",", "."), (";", ","), ("\t", "."))
TURNS = 7


def main(megabytes: int) -> None:
    """Print a row for each dialect."""
    print(f"{megabytes} MB\n{'cells between':>14} {'decimal':>8} {'pandas':>8} {'palpate':>8} {'ratio':>6}")
    rng = np.random.default_rng(1)
    count = megabytes * 10**6 // 29
    times, samples = np.arange(count) / 10_000, rng.normal(size=(count, 2))
    with TemporaryDirectory() as folder:
        for delimiter, decimal in DIALECTS:
            path = Path(folder) / "recording.csv"
            columns = {"time (s)": times, "a (g)": samples[:, 0], "b (g)": samples[:, 1]}
            frame = pd.DataFrame(columns).round(6)
            frame.to_csv(path, sep=delimiter, decimal=decimal, index=False, float_format="%.6f")
            taken = []
            for _ in range(TURNS):
                begun = time.process_time()
                pd.read_csv(path, sep=delimiter, decimal=decimal)
                between = time.process_time()
                read(path)
                taken.append((between - begun, time.process_time() - between))
            theirs, ours = (median(one) for one in zip(*taken, strict=True))
            ratio = median(mine / other for other, mine in taken)
            print(f"{delimiter!r:>14} {decimal!r:>8} {theirs:8.2f} {ours:8.2f} {ratio:6.2f}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if sys.argv[1:] else 100)
