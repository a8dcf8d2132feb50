"""The SIMULATED observer beside Tables 2 and 3 of Wellman and Howe: 7 participants, 3 seeds.

Nothing of Table 2 is used for live taps; virtual ones are judged as FITTED to Table 3.

What is printed are the percentages of `tests/reference/`, cell by cell as in the paper.
"""

from __future__ import annotations

import csv
from collections import Counter
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import ndtr

from palpate.experiment.desk.questions import Arm, Place
from palpate.experiment.protocol import files
from palpate.experiment.protocol.designs.comparison import FIRST, Comparison
from palpate.experiment.protocol.kinds.tapping import Tapping
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.rehearsal.kinds.tapping.participant import (
    DISCRIMINATION,
    LEANING,
    SPREAD,
    Fingers,
    SimulatedTapper,
)
from palpate.experiment.rehearsal.kinds.tapping.surfaces import FITTED
from palpate.experiment.synthesis import tap

PAPER = files.load(files.shipped("wellman1995.toml"))
NAMES = [material.id for material in PAPER.materials]
RATE_HZ = 16_000
REFERENCE = Path(__file__).parents[4] / "reference"


def printed(name: str) -> dict[tuple[int, int], float]:
    """Return the percentages of a printed table by (harder, softer), counted from 0."""
    with (REFERENCE / f"wellman1995_{name}.csv").open() as file:
        return {
            (int(row["material_a"]) - 1, int(row["material_b"]) - 1): float(row["percent_correct"])
            for row in csv.DictReader(file)
        }


LIVE, VIRTUAL = printed("table2_live"), printed("table3_virtual")


class Panel:
    """Delivers the vibration of the surface that lies there; a foot, too, that needs nothing."""

    free_us = 0

    def __init__(self, silent: bool) -> None:
        self._rings = [
            tap.rings(surface, rate_hz=RATE_HZ, aluminum_m_s2=0.0 if silent else 50.0).at(0.1).waveform_m_s2
            for surface in tap.SURFACES
        ]
        self.lies = 0

    def felt(self, timeout_s: float) -> NDArray[np.float64] | None:
        return self._rings[self.lies] if timeout_s else None

    def step(self, *_: object) -> None: ...

    def finish(self) -> None: ...


def percent(seed: int, task: str, *, silent: bool = False) -> dict[tuple[int, int], float]:
    """Return percent right of each pair over the paper's 7 participants and 8 repetitions, half in either order."""
    right: Counter[tuple[int, int]] = Counter()
    for participant in range(1, 8):
        panel = Panel(silent)
        fingers = Fingers(cast("Any", panel), 0, cast("Any", panel), RATE_HZ) if task == "virtual" else None
        one = SimulatedTapper(
            protocol=PAPER,
            who=(f"{participant:02}", task),
            entropy=(seed, participant, task == "virtual"),
            clock=ManualClock(0),
            tick=lambda: None,
            screen=None,
            fingers=fingers,
        )
        for trial in range(1, 121):
            pair, turned = list(VIRTUAL)[trial % 15], trial // 15 % 2
            places = pair[::-1] if turned else pair
            if fingers is None:
                one.ask(Place(trial, (NAMES[places[0]], NAMES[places[1]])))
            else:
                one.ask(Arm(trial, 1, 120))
            taps, key = 0, PAPER.table(Tapping).switch_key
            while key == PAPER.table(Tapping).switch_key:
                panel.lies = places[taps % 2]
                taps, key = taps + 1, one.says(trial)[0]
            right[pair] += (PAPER.table(Comparison).answers[key] == FIRST) != turned
    return {pair: 100 * right[pair] / 56 for pair in VIRTUAL}


def r(one: dict[tuple[int, int], float], other: dict[tuple[int, int], float]) -> float:
    return float(np.corrcoef([one[pair] for pair in one], [other[pair] for pair in one])[0, 1])


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_choices_are_near_those_of_the_paper(seed: int) -> None:
    assert r(LIVE, percent(seed, "live")) >= 0.85
    assert r(VIRTUAL, percent(seed, "virtual")) >= 0.85


def expected(scale: NDArray[np.float64], errors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the probability of each right choice in Table 3, over participants who differ and lean to the first."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(41)
    acute = np.exp(SPREAD * nodes)
    return np.array(
        [
            weights
            @ ndtr((scale[i] - scale[j]) / np.hypot(acute * np.hypot(errors[i], errors[j]), LEANING / DISCRIMINATION))
            / weights.sum()
            for i, j in VIRTUAL
        ]
    )


def test_what_is_fitted_to_table_3_is_of_greatest_likelihood() -> None:
    """Case III of Thurstone, the error of plastic free: the scale of a naive search, from elsewhere."""
    chosen = np.array([one / 100 for one in VIRTUAL.values()])

    def unlikely(free: NDArray[np.float64]) -> float:
        p = np.clip(expected(np.r_[0, np.cumsum(np.exp(free[:4]))], np.r_[1, 1, 1, np.exp(free[4]), 1]), 1e-9, 1 - 1e-9)
        return -56 * float(np.sum(chosen * np.log(p) + (1 - chosen) * np.log(1 - p)))

    scale, errors = np.array(FITTED).T
    fitted = unlikely(np.r_[np.log(np.diff(scale)), np.log(errors[3])])
    starts = ([0.0, -1.0, 1.0, 0.0, 1.0], [0.0, 0.0, 0.0, 0.0, 0.0], [0.0, -1.0, 2.0, 0.0, 2.0])
    found = min(float(minimize(unlikely, start, method="BFGS").fun) for start in starts)
    assert fitted == pytest.approx(found, abs=0.01)
    assert np.corrcoef(expected(scale, errors), chosen)[0, 1] == pytest.approx(0.98, abs=0.01)


def test_silence_in_place_of_the_vibration_is_judged_by_chance() -> None:
    judged = percent(1, "virtual", silent=True)
    # 560 trials: an SD of 2.1 %.
    assert abs(np.mean([judged[pair] for pair in judged if pair[0] != pair[1]]) - 50) < 8.5


def best(closest: float) -> float:
    """Return the best correlation with Table 3 of any scale whose first step is at most a part of the second's end."""

    def badness(free: NDArray[np.float64]) -> float:
        part, third, fourth, fifth = closest * ndtr(free[0]), *free[1:]
        scale = [0.0, part * third, third, fourth, fifth]
        chosen = [ndtr((scale[one] - scale[other]) / 2**0.5) for one, other in VIRTUAL]
        return -float(np.corrcoef(chosen, list(VIRTUAL.values()))[0, 1])

    starts = ([2.0, 1.0, 2.0, 3.0], [2.0, 2.0, 1.0, 3.0], [0.0, 0.5, 1.0, 1.0])
    found = (minimize(badness, start, method="Nelder-Mead", options={"maxiter": 2000}).fun for start in starts)
    return -float(min(found))


def test_no_scale_of_frequency_reaches_table_3() -> None:
    """43 and 50 Hz lie ln(50 / 43) apart, 43 and 100 Hz ln(100 / 43), but Table 3 has them told in 80 % and 90 %."""
    assert best(np.log(50 / 43) / np.log(100 / 43)) == pytest.approx(0.82, abs=0.01)
    assert best(1.0) == pytest.approx(0.93, abs=0.01)
