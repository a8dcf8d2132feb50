"""What a panel drifted, from lines that are known."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.experiment.apparatus.panel.drift import drifts
from palpate.experiment.apparatus.panel.movement import Reference


@pytest.mark.parametrize("lines_hz", [np.arange(8, 620), np.array([50, 51, 400])], ids=["every band", "three lines"])
def test_third_octaves_in_which_the_reference_has_a_line_have_their_drift(lines_hz: np.ndarray) -> None:
    rng = np.random.default_rng(1)
    response = np.full(lines_hz.size, 20.0 + 5.0j)
    reference = Reference(lines_hz, response, np.full(lines_hz.size, 1e-3))
    played = np.full(lines_hz.size, 0.1 + 0.0j)
    louder = 10 ** (1.5 / 20)
    noise = rng.normal(scale=1e-4, size=(8, lines_hz.size, 2)) @ np.array([1, 1j])
    found = list(drifts(played, louder * played * response + noise, reference, gain=1.0))
    assert len(found) == (17 if lines_hz.size > 3 else 2)
    assert [one.db for one in found] == pytest.approx([1.5] * len(found), abs=0.05)
