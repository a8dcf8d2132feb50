"""What shaping is tested on and with: a response by hand, any response, any bins; and what a response answers."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from numpy.typing import ArrayLike, NDArray

from palpate.experiment.synthesis.shaping import ROUND_OFF, Loss, Response, Shaped
from palpate.experiment.synthesis.spectra import Bins, spectrum

NO_LIMIT = 1e300
NOTHING = Loss(bins=0, cost_m_s2=0.0)

F_HZ = np.array([100.0, 200.0, 300.0, 500.0])
LEVELS_V = np.array([0.5, 1.0, 2.0])
MEASURED = np.array([[0.5, 0.9, 1.6], [2.0, 4.5, 8.0], [1.0, 2.0, 4.0], [0.25, 0.75, 1.0]])
TABLE = Response(F_HZ, LEVELS_V, MEASURED)


@st.composite
def responses(draw: st.DrawFn) -> Response:
    """Any response that rises, with steps over six decades."""
    rows, columns = draw(st.integers(2, 5)), draw(st.integers(1, 4))

    def rising(count: int) -> np.ndarray:
        return np.cumsum(draw(st.lists(st.floats(1e-3, 1e3), min_size=count, max_size=count)))

    return Response(rising(rows), rising(columns), np.array([rising(columns) for _ in range(rows)]))


def some_bins(seed: int, *, samples: int = 2500, held: int = 2500) -> Bins:
    """What a waveform is the sum of, by chance."""
    rng = np.random.default_rng(seed)
    return Bins(rng.normal(0, 0.3, held), samples=samples, rate_hz=5000)


def bins_of_waveform(waveform_m_s2: ArrayLike, *, rate_hz: int) -> Bins:
    """What a waveform is the sum of, by (1), without what is round-off of the transform."""
    y = np.asarray(waveform_m_s2, dtype=np.float64)
    coefficients = spectrum(y)
    coefficients[np.abs(coefficients) <= ROUND_OFF * np.abs(y).max()] = 0.0
    return Bins(coefficients, samples=y.size, rate_hz=rate_hz)


def losses(did: Shaped) -> tuple[Loss, Loss, Loss]:
    """What each cause kept below what was asked for."""
    return did.saturated, did.outside, did.bounded


def accelerations(voltages_v: ArrayLike, *, frequencies_hz: ArrayLike, response: Response) -> NDArray[np.float64]:
    """A(f, e) with the sign of the voltage, m/s^2: straight lines in f at each level, then in e, by `numpy.interp`."""
    levels_v = np.concatenate([[0.0], response.levels_v])
    moved = []
    for e, f in zip(np.asarray(voltages_v), np.asarray(frequencies_hz), strict=True):
        curve = [np.interp(f, response.frequencies_hz, answers) for answers in response.accelerations_m_s2.T]
        moved.append(np.copysign(np.interp(np.abs(e), levels_v, [0.0, *curve]), e))
    return np.array(moved)
