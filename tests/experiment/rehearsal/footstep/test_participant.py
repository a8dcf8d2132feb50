"""The simulated participant, where it cannot do what it is asked for."""

from __future__ import annotations

import pytest

from experiment.apparatus.tracker.calibration import ZeroedTracker
from experiment.clock import ManualClock
from experiment.errors import TrackerError
from experiment.protocol import files
from experiment.protocol.files import shipped
from experiment.rehearsal.footstep.foot import Foot
from experiment.rehearsal.footstep.participant import MOST_RESTS, SimulatedParticipant
from experiment.rehearsal.footstep.recorded_takes import SimulatedMaterials
from tests.experiment.session.scripted import ScriptedTracker, rest_samples


class Resting(Foot):
    """A foot that speaks to nobody; it counts how often it was put down."""

    def __init__(self) -> None:
        self.rests = 0

    def put_down(self) -> None:
        self.rests += 1


def participant(foot: Foot) -> SimulatedParticipant:
    protocol = files.load(shipped("okamoto2012.toml"))
    return SimulatedParticipant(
        protocol=protocol,
        materials=SimulatedMaterials(protocol.footstep.synthesis.rate_hz, protocol.footstep.synthesis.samples),
        who=("01", "real"),
        entropy=(1, 1, 0),
        foot=foot,
        powered_ns=0,
        panel=None,
        actuator_rate_hz=5000,
        clock=ManualClock(0),
        real_time=True,
        tick=lambda: None,
        screen=None,
    )


def test_a_foot_that_rests_too_far_from_contact_ends_the_zeroing() -> None:
    foot = Resting()
    one = participant(foot)
    # Twice a good zero after all but one of the tries, then none.
    tries = [*[9.0] * (MOST_RESTS - 1), 0.5]
    heights_mm = [*tries, *tries, *[9.0] * (MOST_RESTS + 1)]
    reads = ScriptedTracker([rest_samples(0, mm) for mm in heights_mm], clock=ManualClock(0), comes_back=True)
    tracker = ZeroedTracker(reads, contact_mm=0.0, farthest_mm=3.0, samples=200)
    for _ in range(2):
        assert tracker.settle(one).offset_mm == 0.5
        tracker.reconnect(1.0)
    with pytest.raises(TrackerError, match=r"zeroing: got an offset of 9\.00 mm; .* rested 5 times and cannot rest"):
        tracker.settle(one)
    assert foot.rests == 3 * MOST_RESTS
    assert tracker.due
