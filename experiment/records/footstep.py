"""Models of what a footstep leaves in the journal: where the foot rested, and each step with its stimulus."""

from typing import Annotated, Literal

from pydantic import Field

from palpate.experiment.records.entries import Entry, OfAttempt, Record, Trace
from palpate.experiment.records.stimulus import Onset, Stimulus

MOST_US = 2**63 // 1000
"""No device time is farther from zero, microseconds: session times are 64-bit nanoseconds."""

MOST_PPM = 1e6
"""No clock runs twice as fast as another."""

DeviceUs = Annotated[float, Field(ge=-MOST_US, le=MOST_US)]
WholeUs = Annotated[int, Field(ge=-MOST_US, le=MOST_US)]


class Zeroed(Entry):
    """Heights count from where the foot rested on the panel, from now on.

    `offset_mm`: how far above the protocol's contact the calibration had it, median of `samples`; `spread_mm`: their
    standard deviation.
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


class Link(Record):
    """Frames of the tracker between arming and contact; `received` counts those up to contact."""

    received: int
    lost: int
    damaged: int
    repeated: int


class TrackerClock(Record):
    """Which session time a device time is, as it was known at the end of a step: a straight line.

    `anchor_us` was at `anchor_ns`, and since then the session's clock ran ahead of the device's by `drift_ppm`.
    """

    anchor_us: WholeUs
    anchor_ns: int
    drift_ppm: Annotated[float, Field(ge=-MOST_PPM, le=MOST_PPM)]


class FootStep(OfAttempt):
    """One step of the foot, in device time, with the stimulus it set off.

    `contact_us`: when the foot met the panel, as all its readings until then have it; `contact_standard_error_ms`: the
    standard error of that, by the sensor's noise and what is not known of the movement. It is None in a journal from
    before, whose contact is the root of a straight line through the last 3 mm.
    `dead_time_ms`: from the confirmed answer to the trial before until this one was armed, without the time in which
    its object was laid out; None where no answer came just before, and in simulated time.
    """

    kind: Literal["step"] = "step"
    presented: tuple[str, ...]
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


class BrokenOff(OfAttempt):
    """A step that ended before the foot had landed, or before its landing was on file; its stimulus was withdrawn
    where it still could be.

    `gate_top_us`, `gate_bottom_us` and `speed_mm_s` are None where the foot had not passed the gate, `at_us` (device
    time of the newest sample) and `clock` where none had come. `felt`: something may have been felt, so the trial is
    put off to the end of its block; otherwise it is armed again at once. `silent`: as in `Footer`, when the step was
    written down. `dead_time_ms`: as in `FootStep`.
    """

    kind: Literal["broken-off"] = "broken-off"
    presented: tuple[str, ...]
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
