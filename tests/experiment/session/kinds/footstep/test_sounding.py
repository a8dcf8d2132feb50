"""The stimulus of one step: where its onset is aimed while predictions change and time runs out."""

from __future__ import annotations

import hashlib
from typing import Literal

import pytest

from palpate.experiment.apparatus.panel.conditioning import Conditioner, Played
from palpate.experiment.apparatus.tracker.landing import Landing
from palpate.experiment.protocol.models import Ahead
from palpate.experiment.records.stimulus import Delivered
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.session.kinds.footstep.stimulus import Sounder, Sounding
from palpate.experiment.synthesis.waveforms import Waveform
from tests.experiment.synthesis.stimuli import basis_of

LEAD_NS = 10_000_000


class Aimed:
    """An actuator that takes every aim which leaves it its lead."""

    rate_hz = 1000
    lead_ns = LEAD_NS

    def __init__(self, clock: ManualClock) -> None:
        self._clock = clock
        self.aims: list[int] = []
        self.prepared = 0

    def prepare(self, stimulus: Waveform) -> Played:
        self.prepared += 1
        return Conditioner(full_scale=64.0, limit_m_s2=20.0)(stimulus)

    def aim(self, onset_ns: int) -> bool:
        assert onset_ns >= self._clock.now_ns() + LEAD_NS
        self.aims.append(onset_ns)
        return True

    def landed(self, contact_ns: int) -> None: ...

    def withdraw(self) -> bool:
        return True

    def is_silent(self) -> bool:
        return True

    def delivered(self, contact_ns: int) -> Delivered | None:
        return None

    def close(self) -> None: ...


class Going(ManualClock):
    """Passes for a clock of the machine."""

    simulated = False


def landing(ms: float) -> Landing:
    return Landing(us=ms * 1e3, standard_error_us=100.0, from_us=0)


def silent(actuator: Aimed, clock: ManualClock, ahead: Ahead | None = None) -> Sounding:
    basis = basis_of([0.0], samples=10, rate_hz=1000, material="copy paper")
    sounder = Sounder({"copy paper": basis}, actuator, ahead)
    return Sounding(sounder, "copy paper", lambda us: round(us * 1e3), clock)


def test_a_stimulus_is_prepared_once_for_a_speed_and_anew_for_another() -> None:
    clock = ManualClock(0)
    actuator = Aimed(clock)
    sounding = silent(actuator, clock)
    assert sounding.stimulus is None
    for speed_mm_s in (100.0, 100.0, 101.0, 101.0):
        sounding.prepare(speed_mm_s)
    assert actuator.prepared == 2
    assert sounding.stimulus is not None
    assert sounding.stimulus.asked_sha256 == hashlib.sha256(bytes(8)).hexdigest()
    assert sounding.stimulus.handed_sha256 == hashlib.sha256(bytes(40)).hexdigest()
    assert (sounding.stimulus.handed_unit, sounding.stimulus.handed_peak) == ("m/s^2", 0.0)


def test_an_onset_is_put_off_only_where_that_brings_it_nearer_to_the_contact() -> None:
    clock = ManualClock(0)
    actuator = Aimed(clock)
    sounding = silent(actuator, clock)
    sounding.prepare(100.0)
    sounding.aim(landing(13.0))
    clock.sleep_ns(2_000_000)
    sounding.aim(landing(12.5))
    clock.sleep_ns(2_000_000)
    # The soonest is 14 ms now: what stands at 12.5 is nearer to a contact at 12 or 13, and farther from one at 14.5.
    sounding.aim(landing(12.0))
    sounding.aim(landing(13.0))
    assert actuator.aims == [13_000_000, 12_500_000]
    sounding.aim(landing(14.5))
    assert actuator.aims[-1] == 14_500_000
    onset = sounding.onset(landing(14.4), 14_400_000)
    assert (onset.scheduled_ns, onset.predicted_us) == (14_500_000, 14_500.0)


def test_what_replaces_a_stimulus_is_not_on_record_as_scheduled_before_it_is() -> None:
    clock = ManualClock(0)
    actuator = Aimed(clock)
    sounding = silent(actuator, clock)
    sounding.prepare(100.0)
    sounding.aim(landing(13.0))
    clock.sleep_ns(4_000_000)
    sounding.prepare(120.0)
    never = sounding.onset(landing(13), 13_000_000)
    assert (never.scheduled_ns, never.predicted_us, never.prediction_error_ms) == (None, None, None)
    # The soonest is 14 ms now, farther from contact than what the first was aimed at: the second is aimed all the same.
    sounding.aim(landing(13.0))
    assert actuator.aims == [13_000_000, 14_000_000]
    assert sounding.onset(landing(13), 13_000_000).scheduled_ns == 14_000_000


@pytest.mark.parametrize(("clock", "waited_ms"), [(Going(0), 3.5), (ManualClock(0), None)])
def test_how_long_it_took_from_the_gates_frame_to_the_first_schedule(
    clock: ManualClock, waited_ms: float | None
) -> None:
    sounding = silent(Aimed(clock), clock)
    clock.sleep_ns(1_000_000)
    sounding.prepare(100.0)
    # The frame came 0.5 ms before it was read, and was aimed 3 ms after that; where it is aimed later is no matter.
    sounding.prepare_for_gate(100.0, 500_000)
    clock.sleep_ns(3_000_000)
    sounding.aim(landing(40.0))
    clock.sleep_ns(5_000_000)
    sounding.aim(landing(41.0))
    onset = sounding.onset(landing(41), 41_000_000)
    assert onset.gate_to_scheduled_ms == waited_ms


def test_what_is_never_scheduled_has_no_time_of_it() -> None:
    clock = Going(0)
    actuator = Aimed(clock)
    actuator.lead_ns = 0
    sounding = silent(actuator, clock)
    sounding.prepare_for_gate(100.0, 0)
    sounding.aim(landing(40.0))
    onset = sounding.onset(landing(40), 40_000_000)
    assert (onset.scheduled_ns, onset.gate_to_scheduled_ms) == (None, None)


def test_what_comes_before_contact_is_aimed_that_much_earlier() -> None:
    clock = ManualClock(0)
    actuator = Aimed(clock)
    sounding = silent(actuator, clock, Ahead(delay_ms=-20))
    sounding.prepare(100.0)
    assert sounding.begun is None
    # The lead of 10 ms comes off what is left until 20 ms before contact.
    assert [sounding.in_time(landing(ms)) for ms in (29.9, 30.0)] == [False, True]
    sounding.aim(landing(33.0))
    clock.sleep_ns(4_000_000)
    # 14 ms is the soonest now: nearer to 15.5 than 13, and farther from 12.
    sounding.aim(landing(32.0))
    assert actuator.aims == [13_000_000]
    sounding.aim(landing(35.5))
    assert actuator.aims == [13_000_000, 15_500_000]
    begun = sounding.begun
    assert begun is not None
    assert (begun.scheduled_ns, begun.predicted_us, begun.standard_error_ms) == (15_500_000, 35_500.0, 0.1)
    onset = sounding.onset(landing(34.0), 34_000_000)
    assert (onset.ahead_ms, onset.scheduled_ns, onset.prediction_error_ms) == (20.0, 15_500_000, 1.5)
    assert onset.off_ms == 1.5


def test_what_was_not_scheduled_before_contact_is_off_by_all_of_that() -> None:
    clock = ManualClock(0)
    sounding = silent(Aimed(clock), clock, Ahead(delay_ms=-20))
    sounding.prepare(100.0)
    assert sounding.onset(landing(34.0), 34_000_000).off_ms == 20.0


@pytest.mark.parametrize(("broken_off", "plays"), [("nothing", False), ("vibration", True)])
def test_only_what_is_scheduled_plays_on_and_only_if_the_protocol_has_it(
    broken_off: Literal["nothing", "vibration"], plays: bool
) -> None:
    clock = ManualClock(0)
    sounding = silent(Aimed(clock), clock, Ahead(delay_ms=-20, broken_off=broken_off))
    sounding.prepare(100.0)
    assert not sounding.plays_on
    sounding.aim(landing(40.0))
    assert sounding.plays_on == plays
