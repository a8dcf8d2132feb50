"""The simulated participant, where it cannot do what it is asked for."""

from __future__ import annotations

import io
from collections import deque

import numpy as np
import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.apparatus.tracker.zeroing import ZeroedTracker
from palpate.experiment.desk.messages import ENTER, TakeNote
from palpate.experiment.desk.questions import Arm, Confirm, Level, Reply, Rest, TrialAnswer
from palpate.experiment.desk.terminal import TerminalConsole
from palpate.experiment.errors import TrackerError
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.kinds.footstep import Footstep
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.rehearsal.kinds.footstep import participant as footstep
from palpate.experiment.rehearsal.kinds.footstep.participant import MOST_RESTS, SimulatedParticipant
from palpate.experiment.rehearsal.kinds.footstep.recorded_takes import SimulatedMaterials
from palpate.experiment.rehearsal.practice import Guided, Practiced
from palpate.experiment.rehearsal.wires.foot import Foot
from tests.approved import Refuses
from tests.experiment.session.scripted import ScriptedTracker, rest_samples


class Resting(Foot):
    """A foot that speaks to nobody; it counts how often it was put down."""

    def __init__(self) -> None:
        self.rests = 0

    def put_down(self) -> None:
        self.rests += 1


def participant(foot: Foot, entropy: tuple[int, int, int] = (1, 1, 0)) -> SimulatedParticipant:
    protocol = files.load(shipped("okamoto2012.toml"))
    return SimulatedParticipant(
        protocol=protocol,
        materials=SimulatedMaterials(
            protocol.table(Footstep).synthesis.rate_hz, protocol.table(Footstep).synthesis.samples
        ),
        who=("01", "real"),
        entropy=entropy,
        foot=foot,
        powered_ns=0,
        panel=None,
        actuator_rate_hz=5000,
        clock=ManualClock(0),
        real_time=True,
        tick=lambda: None,
        screen=None,
    )


def test_one_observer_does_all_tasks_of_a_participant_and_no_other_participants(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    drawn: list[tuple[float, float]] = []

    class Observer:
        def __init__(self, *_: object, rng: np.random.Generator) -> None:
            self.touch = rng.random()

        def familiarise(self, *, rng: np.random.Generator) -> None:
            drawn.append((self.touch, rng.random()))

    monkeypatch.setattr(footstep, "Observer", Observer)
    for entropy in ((1, 1, 0), (1, 1, 1), (1, 2, 0), (1, 2, 1), (2, 1, 0), (2, 1, 1)):
        participant(Resting(), entropy)
    assert drawn[::2] == drawn[1::2]
    assert len({number for one in drawn for number in one}) == 6


def test_a_foot_that_rests_too_far_from_contact_ends_the_zeroing(refuses: Refuses) -> None:
    foot = Resting()
    one = participant(foot)
    # Twice a good zero after all but one of the tries, then none.
    tries = [*[9.0] * (MOST_RESTS - 1), 0.5]
    heights_mm = [*tries, *tries, *[9.0] * (MOST_RESTS + 1)]
    reads = ScriptedTracker([rest_samples(0, mm) for mm in heights_mm], clock=ManualClock(0), comes_back=True)
    tracker = ZeroedTracker(reads, contact_mm=0.0, farthest_mm=3.0, samples=200)
    for _ in range(2):
        assert tracker.settle(lambda why: one.ask(Rest(why))).offset_mm == 0.5
        tracker.reconnect(1.0)
    with refuses(TrackerError):
        tracker.settle(lambda why: one.ask(Rest(why)))
    assert foot.rests == 3 * MOST_RESTS
    assert tracker.zero is None


def test_at_the_keys_an_experimenter_hears_one_answer_however_often_they_are_asked(
    monkeypatch: pytest.MonkeyPatch,
    approved: SnapshotAssertion,
) -> None:
    spoken = deque([("a", "aluminum foil"), ("c", "copy paper")])
    monkeypatch.setattr(SimulatedParticipant, "says", lambda *_: spoken.popleft())
    monkeypatch.setattr(SimulatedParticipant, "ask", lambda *_: Reply())
    typed, screen = deque(["note Coughs.", "p", "n", "c", "c"]), io.StringIO()
    desk = TerminalConsole(write=screen, ask=lambda _: typed.popleft(), heading="PRACTICE")
    one = Practiced(desk=Guided(desk, first=False), participant=participant(Resting()))
    answers = {"c": "copy paper", "p": "polypropylene"}
    one.ask(Arm(1, 1, 2))
    assert one.ask(TrialAnswer(1, answers, "n", {})).remark == TakeNote(text="Coughs.", trial=1)
    # The key decides, whatever was said.
    assert one.ask(TrialAnswer(1, answers, "n", {})).key == "p"
    assert one.ask(Confirm("p", "polypropylene")).key != ENTER
    one.ask(Arm(2, 1, 2))
    assert one.ask(TrialAnswer(2, answers, "n", {})).key == "c"
    said = [line for line in screen.getvalue().splitlines() if "says" in line]
    assert said == approved


def test_at_the_keys_the_participant_says_how_loud_the_masker_is_and_rests_the_foot_once_asked(
    approved: SnapshotAssertion,
) -> None:
    foot, screen = Resting(), io.StringIO()
    order: list[str] = []

    def ask(prompt: str) -> str:
        order.append(f"{prompt[:9]}{foot.rests}")
        return ""

    desk = TerminalConsole(write=screen, ask=ask, heading="PRACTICE")
    one = Practiced(desk=Guided(desk, first=False), participant=participant(foot))
    for level_db_a in (40.0, 70.0):
        assert one.ask(Level(level_db_a, 80.0, "Nothing is heard.", probe=False, by="experimenter")).key == ENTER
    assert screen.getvalue() == approved
    one.ask(Rest(""))
    assert (order[-1], foot.rests) == ("PRACTICE 0", 1)
