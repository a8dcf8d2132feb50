"""QUEST+ and psi against the package questplus, against entropies computed in full, and within their rule for ties."""

from __future__ import annotations

import json
from math import log, log10
from pathlib import Path
from statistics import NormalDist

import numpy as np
import pytest

from palpate.experiment.protocol.models import Levels
from palpate.experiment.study.levels import psi
from palpate.experiment.study.levels.quest_plus import TIE, QuestPlus, information

RUNS = json.loads((Path(__file__).parents[3] / "reference" / "questplus.json").read_text("utf-8"))


def levels(of: dict[str, object], **further: object) -> Levels:
    tuples = {key: tuple(one) if isinstance(one, list) else one for key, one in of.items()}
    return Levels.model_validate({"method": "quest-plus", **tuples, **further})


SMALL = levels(
    {
        "grid": [0.1, 0.2, 0.4, 0.8],
        "thresholds": [0.1, 0.3],
        "spreads_db": [2.0, 6.0],
        "lapses": [0.0, 0.04],
        "guess": 0.5,
    }
)


@pytest.mark.parametrize("run", RUNS["runs"], ids=lambda run: run["name"])
def test_levels_are_those_of_the_package_questplus(run: dict[str, object]) -> None:
    """Where the package's level is another, its expected entropy is within the rule for ties."""
    settings = run["levels"]
    assert isinstance(settings, dict)
    method = QuestPlus(levels(settings))
    state = method.init()
    for level, right in zip(run["presented"], run["right"], strict=True):  # type: ignore[call-overload]
        assert method.allows(state, level)
        state = method.step(state, level=level, right=bool(right))
    assert list(method.threshold_db(state)) == pytest.approx([run["mean_db"], run["sd_db"]], abs=1e-9)


def full(of: Levels, answers: list[tuple[float, bool]], *, beside_lapses: bool) -> list[float]:
    """The entropy that is expected after an answer at each level, nats, by every sum written out (Watson 2017)."""
    cells = [(t, s, m) for t in of.thresholds or () for s in of.spreads_db or () for m in of.lapses or ()]

    def right(x: float, cell: tuple[float, float, float]) -> float:
        t, s, m = cell
        return (of.guess or 0.0) + (1 - (of.guess or 0.0) - m) * NormalDist().cdf(20 * (log10(x) - log10(t)) / s)

    known = [1.0] * len(cells)
    for x, said in answers:
        known = [p * (right(x, cell) if said else 1 - right(x, cell)) for p, cell in zip(known, cells, strict=True)]
    known = [p / sum(known) for p in known]
    expected = []
    for x in of.grid:
        entropy = 0.0
        for said in (True, False):
            joint = [p * (right(x, c) if said else 1 - right(x, c)) for p, c in zip(known, cells, strict=True)]
            of_cell: dict[tuple[float, ...], float] = {}
            for p, cell in zip(joint, cells, strict=True):
                key = cell[:2] if beside_lapses else cell
                of_cell[key] = of_cell.get(key, 0.0) + p
            entropy -= sum(p * log(p / sum(joint)) for p in of_cell.values() if p)
        expected.append(entropy)
    return expected


@pytest.mark.parametrize("beside_lapses", [False, True])
def test_information_is_the_entropy_less_what_is_expected(beside_lapses: bool) -> None:
    method = QuestPlus(SMALL, beside_lapses=beside_lapses)
    state = method.init()
    answers: list[tuple[float, bool]] = []
    for level, right in [(0.8, True), (0.4, False), (0.4, True), (0.1, True), (0.2, False)]:
        told, expected = information(method, state), np.array(full(SMALL, answers, beside_lapses=beside_lapses))
        assert np.ptp(told + expected) < 1e-11
        answers.append((level, right))
        state = method.step(state, level=level, right=right)


def test_psi_with_one_lapse_is_quest_plus() -> None:
    one = SMALL.model_copy(update={"lapses": (0.02,)})
    state = QuestPlus(one).init()
    for place, right in enumerate([True, True, False, True, False, False, True]):
        state = QuestPlus(one).step(state, level=one.grid[place % 4], right=right)
        assert information(QuestPlus(one), state) == pytest.approx(information(psi.method(one), state), abs=1e-12)


def test_of_levels_that_tell_as_much_the_lowest_is_next_and_any_of_them_is_allowed() -> None:
    # Thresholds as far below the first level as above the second: by symmetry both tell as much.
    grid, apart = (10**-0.55, 10**-0.45), 10 ** (1 / 20)
    known = levels(
        {
            "grid": grid,
            "thresholds": [grid[0] / apart, grid[1] * apart],
            "spreads_db": [3.0],
            "lapses": [0.0],
            "guess": 0.0,
        }
    )
    method = QuestPlus(known)
    told = information(method, method.init())
    assert abs(told[0] - told[1]) < TIE
    assert method.level(method.init()) == grid[0]
    assert [method.allows(method.init(), level) for level in (*grid, 0.3)] == [True, True, False]


def test_a_track_ends_once_its_threshold_is_known() -> None:
    method = QuestPlus(SMALL.model_copy(update={"precision_db": 2.0}))
    state, sds = method.init(), []
    while (level := method.level(state)) is not None:
        sds.append(method.threshold_db(state)[1])
        state = method.step(state, level=level, right=level > 0.25)
    assert min(sds) > 2.0 >= method.threshold_db(state)[1]
    assert not any(method.allows(state, level) for level in SMALL.grid)
    # Two thresholds, 20 log10(3) dB apart and as probable at first.
    assert sds[0] == pytest.approx(10 * log10(3))


def test_the_order_of_answers_does_not_matter() -> None:
    method, answers = QuestPlus(SMALL), [(0.1, True), (0.8, False), (0.2, True), (0.1, False)]
    ends = set()
    for order in (answers, answers[::-1]):
        state = method.init()
        for level, right in order:
            state = method.step(state, level=level, right=right)
        ends.add(state)
    assert len(ends) == 1
