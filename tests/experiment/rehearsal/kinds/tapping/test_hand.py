"""The SIMULATED hand's path along the face: a minimum jerk reach while it comes down and presses, and one back."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.experiment.rehearsal.kinds.tapping import hand


def test_it_goes_along_the_face_until_it_is_lifted_and_back() -> None:
    slid_mm = []
    for seed in range(200):
        one = hand.tap(np.random.default_rng(seed), 100.0)
        lifted_us = one.contact_us + hand.PRESSES_S * 1e6
        out_mm = float(one.along_at(np.array([lifted_us]))[0])
        slid_mm.append(out_mm)
        # Flash and Hogan (1985): 10 s^3 - 15 s^4 + 6 s^5.
        s = np.linspace(0.0, 1.0, 50)
        reach = 10 * s**3 - 15 * s**4 + 6 * s**5
        assert one.along_at(s * lifted_us) == pytest.approx(out_mm * reach, abs=1e-3)
        back = one.along_at(lifted_us + s * hand.LIFTS_S * 1e6)
        # The path ends one knot, 0.25 ms, before the lift does.
        assert back == pytest.approx(out_mm * (1 - reach), abs=1e-3)
    # An SD of 5 % of it.
    assert np.std(slid_mm) == pytest.approx(hand.SLIDES_MM, rel=0.15)
    assert abs(np.mean(slid_mm)) < 0.5


def test_where_it_goes_along_the_face_changes_nothing_of_how_it_taps() -> None:
    first, again = (hand.tap(np.random.default_rng(3)) for _ in range(2))
    assert first.noise_seed == again.noise_seed
    rng = np.random.default_rng(3)
    # Speed and the noise's seed are drawn first, as before a hand went along the face.
    speed_mm_s = float(rng.lognormal(np.log(hand.SPEED_MEDIAN_MM_S), hand.SPEED_SIGMA))
    assert (first.speed_mm_s, first.noise_seed) == (speed_mm_s, int(rng.integers(2**63)))
