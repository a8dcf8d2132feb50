"""Thresholds of simulated observers: a rule's own level is met, and a rule that misses it is warned of."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import pytest

from palpate.analysis.power import thresholds
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.study.levels import methods
from tests.conftest import Palpate
from tests.experiment.protocol.detection import UP_DOWN, protocol

GRID = tuple(round(10 ** (db / 20), 6) for db in range(-40, 1, 2))
STAIRS: dict[str, Any] = {**UP_DOWN, "grid": GRID, "reversals": 20, "steps": (3, 1)}


def study(**levels: Any) -> Protocol:
    return protocol(2, {**STAIRS, **levels}, repetitions=60)


@pytest.fixture
def one_observer(monkeypatch: pytest.MonkeyPatch) -> None:
    """One slope and no lapses: a fit costs some 30 ms."""
    monkeypatch.setattr(thresholds, "SPREADS_DB", (3.0,))
    monkeypatch.setattr(thresholds, "LAPSES", (0.0,))


@pytest.mark.usefixtures("one_observer")
def test_a_staircase_of_many_reversals_is_near_its_own_level() -> None:
    """Levitt (1971): 2 down, 1 up settles at 70.7 %; Garcia-Perez (1998) has it within a step for equal steps."""
    of = study()
    found = thresholds.run(of, methods(of), sessions=12)
    (steep,) = found.observers
    assert steep.rule_bias_db == pytest.approx(0.0, abs=2.0)
    assert steep.fit_bias_db == pytest.approx(0.0, abs=2.0)
    assert steep.fitted + steep.beyond == 12
    assert steep.coverage is not None
    assert steep.coverage > 0.7


@pytest.mark.usefixtures("one_observer")
def test_the_same_seed_gives_the_same_and_another_one_does_not() -> None:
    of = study()
    one, again, other = (thresholds.run(of, methods(of), sessions=2, seed=seed).observers for seed in (1, 1, 2))
    assert one == again != other
    assert replace(one[0], fitted=0).coverage is None


def test_observers_on_two_cores_are_those_on_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(thresholds, "SPREADS_DB", (3.0,))
    monkeypatch.setattr(thresholds, "LAPSES", (0.0, 0.05))
    of, ticks = study(), list[int]()
    one = thresholds.run(of, methods(of), sessions=2, jobs=1)
    assert thresholds.run(of, methods(of), sessions=2, jobs=2, tick=lambda: ticks.append(1)) == one
    assert (len(ticks), [each.lapse for each in one.observers]) == (2, [0.0, 0.05])


def test_a_staircase_that_ends_before_it_arrives_is_warned_of() -> None:
    assert list(thresholds.doubts(study(), {})) == []
    short = study(first=1.0, reversals=4, steps=(1,), down=3)
    (doubt,) = thresholds.doubts(short, methods(short))
    assert doubt.verdict == "warns"


@pytest.mark.usefixtures("one_observer")
def test_two_levels_are_enough() -> None:
    of = protocol(2, {"method": "constant", "grid": (0.1, 1.0)}, repetitions=20)
    (found,) = thresholds.run(of, methods(of), sessions=3).observers
    assert (found.trials, found.fitted) == (40, 3)
    assert list(thresholds.doubts(of, methods(of))) == []


def test_a_rule_that_gives_no_threshold_is_warned_of() -> None:
    """Three right answers in a row, of two trials."""
    short = protocol(2, {**STAIRS, "down": 3, "steps": (4, 2, 1)}, repetitions=2)
    (doubt,) = thresholds.doubts(short, methods(short))
    assert (doubt.verdict, "in 0 of 40" in doubt.what) == ("warns", True)


@pytest.mark.parametrize("option", [("--looks", "5,10"), ("--alpha", "0.01")])
def test_options_that_a_detection_does_not_use_are_refused(palpate: Palpate, option: tuple[str, str]) -> None:
    code, _, err = palpate("power", "protocols/threshold.toml", *option)
    assert code == 2
    assert option[0] in err


@pytest.mark.usefixtures("one_observer")
def test_the_command_shows_the_bias(palpate: Palpate) -> None:
    code, out, _ = palpate("power", "protocols/threshold.toml", "--studies", "2", "--json")
    found = json.loads(out)
    assert (code, len(found["observers"])) == (0, 1)
    assert "coverage" in found["observers"][0]


def test_the_share_of_intervals_has_that_of_wilson() -> None:
    """R 4.2.2, prop.test(20, 20, correct = FALSE)$conf.int: 0.8388749 to 1."""
    one = thresholds.Observer("a", 3.0, 0.0, 20, 60.0, 20, 0.0, 1.0, 0.0, 1.0, 20, 20, 0)
    assert one.coverage_interval is not None
    assert one.coverage_interval.low == pytest.approx(0.8388749, abs=1e-6)
    assert replace(one, fitted=0).coverage_interval is None


def test_participants_for_a_mean_threshold() -> None:
    """R 4.2.2: the least n of which qt(0.975, n - 1) * sd / sqrt(n) <= within."""
    assert [thresholds.people_for(5.0, within) for within in (2.0, 3.0)] == [27, 14]
    one = thresholds.Observer("a", 3.0, 0.0, 20, 60.0, 20, 0.0, 1.0, 0.0, 5.44, 20, 20, 0)
    assert (one.needed, replace(one, fit_sd_db=None).needed) == (26, None)
