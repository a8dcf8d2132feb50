"""Limits of stability from print and by simulation."""

from __future__ import annotations

from math import inf, sqrt

import numpy as np
import pytest

from palpate.analysis.numerics import contact as simulated
from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis.contact.block import RETURNING, Block, Motion
from palpate.experiment.synthesis.stepping import stability
from palpate.experiment.synthesis.stepping.steppers import STEPPERS


@pytest.mark.parametrize("ratio", [0.01, 0.1, 0.7, 1.0, 1.5, 4.0])
def test_limits_are_those_of_the_textbooks(ratio: float) -> None:
    """Euler: 2 z, or 2 / (z + sqrt(z^2 - 1)); semi-implicit: 2 (sqrt(1 + z^2) - z), by the Jury criterion by hand."""
    euler = 2 * ratio if ratio <= 1 else 2 / (ratio + sqrt(ratio**2 - 1))
    assert stability.limit("euler", damping_ratio=ratio) == pytest.approx(euler, rel=1e-6)
    semi = 2 * (sqrt(1 + ratio**2) - ratio)
    assert stability.limit("semi-implicit euler", damping_ratio=ratio) == pytest.approx(semi, rel=1e-6)


def test_rk4_has_its_known_limits() -> None:
    """On the imaginary axis 2 sqrt(2), on the real axis 2.785293563405282 (Hairer and Wanner)."""
    assert stability.limit("rk4", damping_ratio=0.0) == pytest.approx(2 * sqrt(2), rel=1e-6)
    assert stability.limit("rk4", damping_ratio=1.0) == pytest.approx(2.785293563405282, rel=1e-6)
    assert stability.limit("euler", damping_ratio=0.0) == 0.0


@pytest.mark.parametrize("method", ["implicit midpoint", "exponential", "exact"])
def test_some_methods_have_none(method: str) -> None:
    assert all(stability.limit(method, damping_ratio=z) == inf for z in (0.0, 0.3, 1.0, 5.0))
    for h_w, z in ((1e-3, 0.1), (3.0, 0.0), (1e3, 2.0)):
        matrix = stability.amplification(method, stiffness=h_w**2, damping=2 * z * h_w)
        assert matrix.radius <= 1 + 1e-12


@pytest.mark.parametrize("method", list(STEPPERS))
def test_amplification_matrices_are_those_of_the_steps(method: str) -> None:
    """One step of each method from (r, dr/dt) about F / K, as a matrix in (r, h dr/dt)."""
    k, c, h = 900.0, 7.0, 0.01
    block = Block((k, 0.0), (c, 0.0), (1.0, 1.0), law="printed", force_n=(k, 0.0))
    columns = []
    for x, u in ((1e-3, 0.0), (0.0, 1e-3 / h)):
        at, _ = STEPPERS[method](block, Motion(RETURNING, 1.0 + x, u), h)
        columns.append(((at.deep_m - 1.0) / 1e-3, at.deep_m_s * h / 1e-3))
    found = np.array(columns).T.ravel()
    np.testing.assert_allclose(stability.amplification(method, stiffness=k * h * h, damping=c * h), found, atol=1e-9)


@pytest.mark.parametrize("method", ["semi-implicit euler", "rk4", "implicit midpoint", "exact"])
def test_limits_hold_in_simulation(method: str) -> None:
    assert simulated._limit(method)[0]


def test_what_is_no_damping_ratio_is_refused() -> None:
    with pytest.raises(SynthesisError, match="damping ratio: got -1"):
        stability.limit("rk4", damping_ratio=-1.0)
