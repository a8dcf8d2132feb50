"""A SIMULATED participant who compares: by its taps alone, with an error, and the same again for the same seed."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.desk.questions import Place, Proposed, TrialAnswer
from palpate.experiment.protocol import files
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.rehearsal.kinds.tapping.participant import TAPS_AT_MOST, Fingers, SimulatedTapper
from palpate.experiment.rehearsal.practice import Guided, Practiced
from tests.experiment.protocol.tapping import protocol
from tests.experiment.session.scripted import ScriptedConsole

PAPER = files.load(files.shipped("wellman1995.toml"))


def tapper(study: Protocol = PAPER, seed: int = 1, clock: ManualClock | None = None) -> SimulatedTapper:
    return SimulatedTapper(
        protocol=study,
        who=("01", "live"),
        entropy=(seed, 1, 0),
        clock=clock or ManualClock(0),
        tick=lambda: None,
        screen=None,
    )


def said(one: SimulatedTapper, *pair: str, trials: int = 200) -> list[str]:
    answers = []
    for trial in range(1, trials + 1):
        one.ask(Place(trial, pair))
        answers.append(one.ask(TrialAnswer(trial, {}, "n", {})).key)
    return answers


def test_far_apart_is_told_right_in_either_order() -> None:
    assert said(tapper(), "polystyrene", "plastic").count("2") > 195
    assert said(tapper(), "plastic", "polystyrene").count("1") > 195


def test_a_sample_and_itself_are_called_by_chance() -> None:
    # 2000 answers of 10 participants: half of them first, with an SD of 1.1 % and of what each leans to.
    first = sum(said(tapper(seed=seed), "basswood", "basswood").count("1") for seed in range(1, 11))
    assert 850 < first < 1150


def test_the_same_seed_says_the_same_and_another_something_else() -> None:
    assert said(tapper(seed=3), "plastic", "aluminum") == said(tapper(seed=3), "plastic", "aluminum")
    assert said(tapper(seed=3), "plastic", "aluminum") != said(tapper(seed=4), "plastic", "aluminum")


def test_a_trial_that_comes_again_is_judged_anew() -> None:
    one = tapper()
    answers = []
    for _ in range(40):
        one.ask(Place(1, ("plastic", "aluminum")))
        answers.append(one.says(1)[0])
    assert {*answers} == {"1", "2"}


def test_what_feels_alike_takes_longer() -> None:
    def lasts(*pair: str) -> int:
        clock = ManualClock(0)
        said(tapper(clock=clock), *pair)
        return clock.now_ns()

    assert lasts("plastic", "plastic") > 1.2 * lasts("plastic", "polystyrene")


def test_it_says_neither_only_where_that_is_allowed() -> None:
    assert {*said(tapper(protocol(tie_key="3")), "cork", "cork")} == {"1", "2", "3"}
    assert {*said(tapper(protocol()), "cork", "cork")} == {"1", "2"}


@pytest.mark.parametrize("unfelt", [0, 1, TAPS_AT_MOST])
def test_in_real_time_a_hand_that_feels_nothing_taps_again(unfelt: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Only then does it ask for the other surface."""
    clock = ManualClock(0)
    monkeypatch.setattr(clock, "simulated", False)
    reached: list[int] = []
    foot: Any = SimpleNamespace(free_us=0, step=lambda _path, us: reached.append(us), finish=lambda: True)
    vibration = np.sin(np.arange(800) * 0.3)
    panel: Any = SimpleNamespace(felt=lambda s: vibration if s and len(reached) > unfelt else None)
    one = tapper(clock=clock)
    one.fingers = Fingers(foot, 0, panel, 16_000)
    assert one.says(1)[0] == "s"
    assert len(reached) == min(unfelt + 1, TAPS_AT_MOST)


def test_who_practices_is_told_what_the_participant_says(approved: SnapshotAssertion) -> None:
    desk = ScriptedConsole(ManualClock(0), "1")
    one = Practiced(desk=Guided(desk, first=False), participant=tapper())
    one.ask(Place(1, ("plastic", "silicone")))
    assert one.ask(TrialAnswer(1, {"1": "first"}, "n", {})).key == "1"
    assert desk.placed == [(1, "plastic | silicone")]
    assert desk.proposed == approved
    one.tell(Proposed("heard: first (0.92)"))
    assert desk.proposed[1:] == approved
