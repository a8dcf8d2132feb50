"""What is on record of a stimulus: how it was computed and driven, how it met the contact, and what was delivered."""

from typing import Annotated, Literal

from pydantic import Field

from palpate.experiment.records.entries import Record


class Shaping(Record):
    """What frequency shaping could not reach: bins by cause, and the sum over them of amplitude asked minus reached.

    Asked is what the stimulus asked for, before `scale`; what `scale` alone takes from a bin is in no sum.
    `saturated`: above the highest drive level measured. `outside`: beyond the measured frequencies. `bounded`: held
    back by the rig's limit of volts per m/s^2. `scale`: factor by which the whole stimulus was taken down, so that what
    the rig's response makes of it stays within the limit of vibration; 1 where it need not be.
    """

    saturated_bins: int
    saturated_cost_m_s2: float
    outside_bins: int
    outside_cost_m_s2: float
    bounded_bins: int
    bounded_cost_m_s2: float
    scale: float


class Computed(Record):
    """How the samples that a device was handed were computed, and how far they are from what was asked for.

    `method`: what made them, with the band where bins outside it are left out. What equations (1) to (5) ask for is the
    measure: `relative_error` is the rms of the difference, and `left_out` that of what the rig did not carry, bins that
    got nothing and what others were held back by, both as parts of the rms asked for; `dissimilarity_m_s2` is that of
    equation (6) between the two. Where the device takes volts, what they make of the panel is what the rig's response
    says, with an estimate of what its table misses.

    In a journal from before, `left_out` and `dissimilarity_m_s2` are None, and `relative_error` is rounding alone.
    """

    method: str
    relative_error: float
    left_out: float | None = None
    dissimilarity_m_s2: float | None = None


class Stimulus(Record):
    """What was asked of the actuator for a step, what its device was handed, and what that makes of the panel.

    Asked for is an acceleration. `asked_sha256` is that of the amplitudes of its bins, m/s^2 with sign, as float64,
    little-endian; no waveform need be summed to know it. `floored_bins` counts those that extrapolation would have made
    negative.

    Handed to the device are samples, volts or accelerations as `handed_unit` says. `handed_sha256` is that of the
    samples as float32, little-endian, 1.0 being full scale; `handed_peak` the largest magnitude among them, in the
    unit; `limited` says how many the limiter changed.

    `reached_peak_m_s2`: no acceleration of the panel is larger in magnitude. Where the device takes volts it is what
    the rig's response makes of them, less than 1.3 % too high, and `shaping` says what is lost; where it takes
    accelerations it is `handed_peak`, and `shaping` is None.
    """

    asked_sha256: str
    floored_bins: int
    extrapolated: bool
    computed: Computed
    handed_sha256: str
    handed_unit: Literal["V", "m/s^2"]
    handed_peak: float
    samples: int
    rate_hz: Annotated[int, Field(ge=1)]
    limited: int
    reached_peak_m_s2: float
    shaping: Shaping | None = None


class Delivered(Record):
    """What the loopback heard of one stimulus, set beside what was intended; or a fault that its stream knows of.

    `requested_ns`: session time for which its first sample was asked, as reaching the panel. `onset_ns`: when it was
    measured to reach the panel; None where nothing of it was found, as are `onset_error_ms` (measured minus asked),
    `gain` (measured by intended) and `residual_db` (what gain and delay do not explain, relative to the intended
    waveform). `xruns`: of the stream while it sounded. `reason` says why it does not count as delivered.
    """

    requested_ns: int
    onset_ns: int | None = None
    onset_error_ms: float | None = None
    gain: float | None = None
    residual_db: float | None = None
    xruns: int
    delivered: bool
    reason: str = ""


class Onset(Record):
    """How a stimulus was brought together with the contact.

    `predicted_us`: contact as predicted last before the point of no return, device time, with its standard error and
    the newest sample it rests on; None where the foot came too fast to be predicted. `prediction_error_ms`: predicted
    minus actual contact. `contact_ns`: actual contact, session time. `scheduled_ns`: session time for which the onset
    was asked; None where the actuator cannot schedule, or was not aimed in time, so that it sounded after contact.
    `gate_to_scheduled_ms`: from the arrival of the frame that gave the gate until the onset was first scheduled; None
    where it never was, and in simulated time.
    `delivered`: what a loopback measured; None where there is none, unless the stream itself knows of a fault.
    """

    predicted_us: float | None
    standard_error_ms: float | None
    predicted_from_us: int | None
    prediction_error_ms: float | None
    contact_ns: int
    scheduled_ns: int | None
    gate_to_scheduled_ms: float | None
    delivered: Delivered | None
