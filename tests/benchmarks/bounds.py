"""Whether every bound that a method claims holds on 10,000 spectra: run `python -m tests.benchmarks.bounds`.

The suite draws 1,000 of them, by the same function.
"""

from __future__ import annotations

from tests.experiment.synthesis import test_bounds

SPECTRA = 10_000

if __name__ == "__main__":
    test_bounds.check(SPECTRA)
    print(f"Every method keeps its claims on {SPECTRA} different spectra, each at five speeds of the foot.")
