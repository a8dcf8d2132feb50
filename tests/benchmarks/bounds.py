"""Whether every bound that a method claims holds: run `python -m tests.benchmarks.bounds`.

It draws 10,000 spectra for the ways of synthesis, and 3,000 with a response each for prepared voltages. The suite draws
1,000 and 30, by the same functions.
"""

from __future__ import annotations

from tests.experiment.synthesis import test_bounds, test_voltage_bounds

SPECTRA = 10_000
RESPONSES = 3_000

if __name__ == "__main__":
    worst = test_voltage_bounds.check(RESPONSES)
    print(f"Prepared voltages keep their claim on {RESPONSES} spectra and responses: {worst:.3f} of it at worst.")
    test_bounds.check(SPECTRA)
    print(f"Every method keeps its claims on {SPECTRA} different spectra, each at five speeds of the foot.")
