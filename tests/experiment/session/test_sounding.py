"""The stimulus of one step: where its onset is aimed while predictions change and time runs out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from experiment.apparatus.gate import Contact, Gate
from experiment.apparatus.landing import Landing
from experiment.apparatus.ports import Played
from experiment.clock import ManualClock
from experiment.records import Computed, Delivered
from experiment.scene import Rendered
from experiment.session.sounding import Sounder, Sounding
from experiment.synthesis.crinkle import Synthesised

LEAD_NS = 10_000_000


class Aimed:
    """An actuator that takes every aim which leaves it its lead."""

    rate_hz = 1000
    lead_ns = LEAD_NS

    def __init__(self, clock: ManualClock) -> None:
        self._clock = clock
        self.aims: list[int] = []

    def prepare(self, waveform_m_s2: NDArray[np.float64]) -> Played:
        return Played(samples=waveform_m_s2.size, limited=0, peak_m_s2=0.0)

    def aim(self, onset_ns: int) -> bool:
        assert onset_ns >= self._clock.now_ns() + LEAD_NS
        self.aims.append(onset_ns)
        return True

    def landed(self, contact_ns: int) -> None: ...

    def withdraw(self) -> bool:
        return True

    def delivered(self) -> Delivered | None:
        return None

    def close(self) -> None: ...


def landing(ms: float) -> Landing:
    return Landing(us=ms * 1e3, standard_error_us=100.0, from_us=0)


def test_an_onset_is_put_off_only_where_that_brings_it_nearer_to_the_contact() -> None:
    clock = ManualClock(0)
    actuator = Aimed(clock)
    silence = Rendered(Synthesised(np.zeros(10), 0, False, 0), Computed(method="silence", relative_error=0.0))
    sounder = Sounder(lambda material, speed_mm_s, rate_hz: silence, actuator)
    sounding = Sounding(sounder, "copy paper", lambda us: round(us * 1e3), clock)
    sounding.prepare(Gate(top_us=0.0, bottom_us=1e4, speed_mm_s=100.0, given_us=1e4))
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
    onset = sounding.onset(Contact(us=14_400.0, given_us=14_400))
    assert (onset.scheduled_ns, onset.predicted_us) == (14_500_000, 14_500.0)
