"""Every claimed bound on an error holds on 300 spectra drawn at random, each at five speeds of the foot.

`python -m tests.benchmarks.bounds` draws 10,000.
"""

from __future__ import annotations

import hashlib

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from palpate.analysis.numerics.cases import WAYS
from tests.experiment.synthesis.drawn import Family, families, feet_mm_s, material
from tests.experiment.synthesis.oracle import exact, worst_excess

WANTED = 300
BATCH = 10


def test_every_claimed_bound_holds_on_hundreds_of_different_spectra() -> None:
    check(WANTED)


def check(wanted_spectra: int) -> None:
    """Every way keeps its claims on as many different spectra, and some more.

    Where all bins are silent, or of the smallest numbers there are, few spectra differ.
    """
    drawn: set[bytes] = set()

    @settings(
        max_examples=wanted_spectra // BATCH * 5 // 4,
        deadline=None,
        database=None,
        suppress_health_check=[HealthCheck.too_slow],
    )
    @given(family=families(), seed=st.integers(0, 2**32 - 1))
    def every_way_keeps_its_claims(family: Family, seed: int) -> None:
        rng = np.random.default_rng([seed, *hashlib.sha256(repr(family).encode()).digest()])
        for _ in range(BATCH):
            s = material(family, rng)
            speeds_mm_s, rate_hz = feet_mm_s(s, rng), family.output_rate_hz
            wanted = exact(s, speeds_mm_s, rate_hz)
            for way in WAYS:
                assert worst_excess(way, s, speeds_mm_s, rate_hz, wanted) <= 1, way.name
            drawn.add(hashlib.sha256((s.amplitudes * s.signs).tobytes()).digest())

    every_way_keeps_its_claims()
    assert len(drawn) >= wanted_spectra
