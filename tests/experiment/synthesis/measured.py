"""What shaping is tested on: a response by hand, any response, any bins, no limit, no loss."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from experiment.synthesis.response import Response
from experiment.synthesis.shaping import Loss
from experiment.synthesis.spectra import Bins

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
