"""Passivity against Colgate and Schenkel's condition."""

from __future__ import annotations

from math import exp, inf, pi

import numpy as np
import pytest

from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis.contact import sampled


def colgate(k: float, c: float, period: float, delay: float, crossover_hz: float = inf) -> float:
    """b > (T / 2) / (1 - cos w T) Re{(1 - exp(-j w T)) H(exp(j w T))}, as printed, on a fine grid.

    Below a crossover the damper is C - K / w0, and its force relaxes by w0.
    """
    w = np.linspace(1e-6, 1.0, 200_001) * pi / period
    late = np.exp(-1j * w * period)
    stays = exp(-2 * pi * crossover_hz * period)
    damper = (c - k / (2 * pi * crossover_hz)) * (1 - stays) / (1 - stays * late)
    h = (k + damper * (1 - late) / period) * np.exp(-1j * w * delay)
    return float(np.max(period / 2 / (1 - np.cos(w * period)) * np.real((1 - late) * h)))


@pytest.mark.parametrize("delay", [0.0, 1e-4, 4e-4, 1e-3])
@pytest.mark.parametrize(("k", "c"), [(2500.0, 100.0), (2500.0, 0.0), (1e5, 1.0)])
def test_the_damping_needed_is_that_of_the_condition(k: float, c: float, delay: float) -> None:
    needed = sampled.needed_damping_n_s_m(stiffness_n_m=k, damping_n_s_m=c, period_s=4e-4, delay_s=delay)
    assert needed == pytest.approx(colgate(k, c, 4e-4, delay), rel=1e-5)
    if not delay:
        assert needed == pytest.approx(k * 4e-4 / 2 + c, rel=1e-9)


@pytest.mark.parametrize("delay", [0.0, 4e-4])
@pytest.mark.parametrize("hz", [5.0, 40.0, 160.0])
def test_a_crossover_asks_for_less_damping_the_lower_it_is(hz: float, delay: float) -> None:
    given = {"stiffness_n_m": 2500.0, "damping_n_s_m": 100.0, "period_s": 4e-4, "delay_s": delay}
    needed = sampled.needed_damping_n_s_m(**given, crossover_hz=hz)
    assert needed == pytest.approx(colgate(2500.0, 100.0, 4e-4, delay, hz), rel=1e-5)
    assert needed < sampled.needed_damping_n_s_m(**given, crossover_hz=2 * hz)


def test_the_paper_is_judged() -> None:
    told = sampled.of_the_paper()
    assert "100.5 N s/m of damping" in told
    assert "0.5 N s/m" in told
    assert "17.5 N" in told


def test_what_is_no_servo_is_refused() -> None:
    with pytest.raises(SynthesisError, match="wall: got"):
        sampled.needed_damping_n_s_m(stiffness_n_m=-1.0, damping_n_s_m=0.0, period_s=1.0)
