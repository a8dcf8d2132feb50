"""What synthesis costs: run `python -m tests.benchmarks.synthesis`; every figure is a median, every ratio of one run.

One material as in the paper: 2,500 bins at 5 kHz, rendered for 0.5 s at 48 kHz. Ways and yardsticks take turns, so
that whatever else the machine does falls on all of them. Memory is that of new processes. Not a test: it asserts
nothing, because these figures belong to the machine that printed them.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from palpate.analysis.numerics.cases import BASIS, PRINTED_SUM, WAYS
from palpate.experiment.synthesis.crinkle import CrinkleSpectra

OUTPUT_RATE_HZ = 48_000
SPEEDS_MM_S = np.array([50.0, 100.0, 200.0, 300.0])
BETWEEN_MM_S, FLOORED_MM_S = 170.0, 400.0
ROUNDS = 1000
WARM_UP = 50

MEMORY = """
import tracemalloc
import numpy as np

def peak_mb():
    with open("/proc/self/status") as lines:
        return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) * 1024 / 1e6

numpy_mb = peak_mb()
import numpy.random
random_mb = peak_mb()
import scipy.fft
scipy_mb = peak_mb()
if {traced}:
    tracemalloc.start()
from palpate.experiment.synthesis import crinkle, response, shaping, waveforms
response = response.Response(
    np.linspace(10.0, 600.0, 60), np.linspace(0.2, 2.0, 10), np.outer(np.ones(60), np.linspace(0.8, 8.0, 10))
)
rng = np.random.default_rng(1)
materials = []
for material in range(4):
    takes = rng.normal(size=(2, 4, 3, 2500))
    spectra = crinkle.subtract(
        speeds_mm_s=[50, 100, 200, 300], rate_hz=5000, panel_object_takes=2 * takes[0], panel_takes=takes[1]
    )
    materials.append(waveforms.prepare(spectra, material=str(material), output_rate_hz=48_000))
for basis in materials:
    for v in range(0, 500, 10):
        stimulus = basis.at(v)
        stimulus.waveform_m_s2
        if v == 200:
            shaping.drive(
                stimulus.bins, rate_hz=48_000, response=response, gain_limit_v_per_m_s2=1.0, limit_m_s2=30.0
            )
if {traced}:
    print(tracemalloc.get_traced_memory()[1] / 1e6)
else:
    print(peak_mb() - numpy_mb, scipy_mb - random_mb, random_mb - numpy_mb)
"""


def paper() -> CrinkleSpectra:
    rng = np.random.default_rng(1)
    return CrinkleSpectra(
        SPEEDS_MM_S, 5000, np.abs(rng.normal(size=(4, 2500))), rng.choice([-1.0, 1.0], size=(4, 2500))
    )


def times_us(calls: dict[str, Callable[[], object]]) -> dict[str, NDArray[np.float64]]:
    """Times of each call, in turns, us."""
    times: dict[str, list[int]] = {name: [] for name in calls}
    for turn in range(WARM_UP + ROUNDS):
        for name, call in calls.items():
            begun = time.perf_counter_ns()
            call()
            if turn >= WARM_UP:
                times[name].append(time.perf_counter_ns() - begun)
    return {name: np.array(taken) / 1e3 for name, taken in times.items()}


def memory(*, traced: bool) -> list[float]:
    """Peak memory of a session's synthesis in a new process, MB."""
    code = MEMORY.format(traced=traced)
    return [
        float(x) for x in subprocess.run([sys.executable, "-c", code], capture_output=True, check=True).stdout.split()
    ]


def main() -> None:
    spectra = paper()
    rng = np.random.default_rng(2)
    x, y, kept, product = rng.normal(size=(4, OUTPUT_RATE_HZ // 2))

    def preallocated() -> None:
        np.multiply(x, 0.3, out=kept)
        np.multiply(y, 0.7, out=product)
        np.add(kept, product, out=kept)

    renderers = {way.name: way.prepare(spectra, OUTPUT_RATE_HZ)[0] for way in WAYS}
    fast = {name: render for name, render in renderers.items() if name != PRINTED_SUM.name}
    times = times_us(
        {
            "bare a*x + b*y, new array": lambda: 0.3 * x + 0.7 * y,
            "bare a*x + b*y, preallocated": preallocated,
            "scipy.fft.idct of 24,000": lambda: fft.idct(x),
            **{name: partial(render, BETWEEN_MM_S) for name, render in fast.items()},
            **{f"{name}, bins floored": partial(render, FLOORED_MM_S) for name, render in fast.items()},
        }
    )
    took = {name: float(np.median(taken)) for name, taken in times.items()}
    begun = time.perf_counter_ns()
    oracle = renderers[PRINTED_SUM.name](BETWEEN_MM_S)
    took[f"{PRINTED_SUM.name}, once"] = (time.perf_counter_ns() - begun) / 1e3
    print(f"0.5 s at 48 kHz, one material of 2,500 bins; medians of {ROUNDS}, in turns")
    for name, us in took.items():
        print(f"  {name:45s} {us:10.1f} us")
    engine, new, idct = took[BASIS.name], took["bare a*x + b*y, new array"], took["scipy.fft.idct of 24,000"]
    print(f"gate to waveform / bare sum into a new array      {engine / new:8.2f}   (at most 1.5)")
    print(f"gate to waveform / bare sum, preallocated         {engine / took['bare a*x + b*y, preallocated']:8.2f}")
    print(f"scipy.fft.idct / gate to waveform                 {idct / engine:8.2f}   (at least 5)")
    print("relative error against the printed sum, largest of any sample by largest sample; and as claimed")
    for way in WAYS:
        error = np.max(np.abs(renderers[way.name](BETWEEN_MM_S) - oracle)) / np.max(np.abs(oracle))
        print(f"  {way.name:45s} {error:10.1e}   {way.claim(spectra.grid(OUTPUT_RATE_HZ)):8.1e}")
    resident, scipy_alone, random = np.median([memory(traced=False) for _ in range(5)], axis=0).tolist()
    print("4 materials at 48 kHz with frequency shaping, as in a session; resident peak")
    print(f"  beyond numpy with numpy.random: the claim     {resident - random:10.1f} MB   (at most 40)")
    print(f"    of it to import scipy.fft                   {scipy_alone:10.1f} MB")
    print(f"  beyond `import numpy` alone                   {resident:10.1f} MB")
    print(f"  arrays and objects alone (tracemalloc)        {memory(traced=True)[0]:10.1f} MB")


if __name__ == "__main__":
    main()
