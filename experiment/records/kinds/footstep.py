"""Models of what a footstep leaves in the journal: where the foot rested, and each step with its stimulus."""

from typing import Literal

from palpate.experiment.records.entries import Entry, Outcome, Trace
from palpate.experiment.records.stimulus import Begun, DeviceUs, Onset, Stimulus
from palpate.experiment.records.tracker import Link, Pressed, TrackerClock, WholeUs


class Zeroed(Entry):
    """From now on heights count from where the foot rested on the panel.

    `offset_mm`: how far above the protocol's contact that was, median of `samples`; `spread_mm`: standard deviation.
    """

    kind: Literal["zeroed"] = "zeroed"
    offset_mm: float
    spread_mm: float
    samples: int


class Probed(Entry):
    """The probe of the masker is played: on record before it can be felt, as made for a foot at `speed_mm_s`."""

    kind: Literal["probed"] = "probed"
    material: str
    speed_mm_s: float
    stimulus: Stimulus


class FootStep(Outcome):
    """One step of the foot, in device time, with its stimulus.

    `contact_us`: when the foot met the panel, by all readings until then; `contact_standard_error_ms` covers noise and
    movement, None in an older journal, whose contact is the root of a line through the last 3 mm. `dead_time_ms`: from
    the confirmed answer to the trial before until arming, less the laying out of the object; None without such an
    answer, and in simulated time. `force` is None where the protocol does not record it.
    """

    kind: Literal["step"] = "step"
    clock: TrackerClock
    dead_time_ms: float | None
    gate_top_us: DeviceUs
    gate_bottom_us: DeviceUs
    contact_us: DeviceUs
    contact_standard_error_ms: float | None = None
    speed_mm_s: float
    link: Link
    trace: Trace
    stimulus: Stimulus | None
    onset: Onset | None
    force: Pressed | None = None


class BrokenOff(Outcome):
    """A step that ended before the foot had landed, or before its landing was saved; its stimulus was withdrawn if
    possible.

    `gate_top_us`, `gate_bottom_us` and `speed_mm_s` are None where the foot had not passed the gate, `at_us` (device
    time of the newest sample) and `clock` before any sample. `felt`: something may have been felt, so the trial moves
    to the end of its block; otherwise it is armed again. `silent` and `dead_time_ms` are as in `Footer` and `FootStep`.
    `stimulus` and `begun` are of a scheduled one that played.
    """

    asks = False

    kind: Literal["broken-off"] = "broken-off"
    reason: str
    felt: bool
    silent: bool | None = None
    clock: TrackerClock | None
    dead_time_ms: float | None
    at_us: WholeUs | None
    gate_top_us: DeviceUs | None
    gate_bottom_us: DeviceUs | None
    speed_mm_s: float | None
    link: Link
    trace: Trace
    stimulus: Stimulus | None = None
    begun: Begun | None = None

    @property
    def put_off(self) -> bool:
        return self.felt


ENTRIES: tuple[type[Entry], ...] = (Zeroed, Probed, FootStep, BrokenOff)
