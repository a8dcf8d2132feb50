"""What is on record of a stimulus: how it was computed and driven, how it met the contact, and what was delivered."""

from typing import Annotated, Literal

from pydantic import Field

from palpate.experiment.records.entries import Record

MOST_US = 2**63 // 1000
"""No device time is farther from zero, microseconds: session times are 64-bit nanoseconds."""

DeviceUs = Annotated[float, Field(ge=-MOST_US, le=MOST_US)]


class Shaping(Record):
    """What frequency shaping could not reach: bins by cause, and their sum of amplitudes requested minus reached.

    Requested is before `scale`, whose own effect is in no sum. `saturated`: above the highest drive level measured.
    `outside`: beyond the measured frequencies. `bounded`: limited by the rig's volts per m/s^2. `scale`: factor that
    keeps the whole stimulus within the limit of vibration, at most 1.
    """

    saturated_bins: int
    saturated_cost_m_s2: float
    outside_bins: int
    outside_cost_m_s2: float
    bounded_bins: int
    bounded_cost_m_s2: float
    scale: float


class Computed(Record):
    """How the samples handed to a device were computed, and how far they are from equations (1) to (5).

    `method`: what made them, with the band where bins outside are omitted. `relative_error` is the rms of the
    difference and `left_out` that of what the rig omits or limits, as shares of the rms requested; `dissimilarity_m_s2`
    is equation (6). Acceleration from volts follows the rig's response, with an estimate of its table's error. In an
    older journal the last two are None, and `relative_error` is rounding alone.
    """

    method: str
    relative_error: float
    left_out: float | None = None
    dissimilarity_m_s2: float | None = None


class Moved(Record):
    """The panel's peak by its measured complex response, m/s^2, and what that is uncertain by.

    `scale`: factor, at most 1, by which the whole stimulus was taken down so that their sum keeps the limit. The
    worst errors of third octaves and envelope, dB, are in these intervals for 95 of 100 stimuli if the panel has
    drifted by `drift_db` at most: by the session's comparison, or a plan's 1 dB without one. All are None in older
    journals.
    """

    peak_m_s2: float
    uncertainty_m_s2: float
    scale: float
    drift_db: float | None = None
    third_octave_between_db: tuple[float, float] | None = None
    envelope_between_db: tuple[float, float] | None = None


class Heard(Record):
    """What an accelerometer on the panel heard around a stimulus, a foot's or hand's own impact included.

    `peak_m_s2` is the largest magnitude; `thirds_db` are levels of the third octaves from 10 to 500 Hz, dB beside
    1 m/s^2 rms over the stimulus, and `sent_thirds_db` those of the movement that the measured panel makes of the
    samples. That was found best `delay_ms` after it was due, latencies of both ports included, and `gain` of it; None
    where nothing resembles it. `lost_ms` has where samples were lost, and 0 stands for them: from how long after it was
    due on, and for how long. `problem` says why nothing was heard.
    """

    peak_m_s2: float | None = None
    thirds_db: tuple[float, ...] = ()
    sent_thirds_db: tuple[float, ...] = ()
    delay_ms: float | None = None
    gain: float | None = None
    lost_ms: tuple[tuple[float, float], ...] = ()
    problem: str = ""


class Stimulus(Record):
    """What was requested of the actuator for a step, what its device was handed, and the panel's acceleration.

    `asked_sha256` is the hash of the requested amplitudes of all bins, m/s^2 with sign, as float64, little-endian.
    `floored_bins` counts those that extrapolation would have made negative. `handed_sha256` is that of the samples as
    float32, little-endian, 1.0 being full scale; `handed_peak` their largest magnitude, in `handed_unit`; `limited` how
    many the limiter changed. `reached_peak_m_s2` is the panel's largest magnitude: where `moved` has a measured panel's
    peak, that with its uncertainty; otherwise for volts by the rig's response without phase, less than 1.3 % too high,
    and for accelerations `handed_peak`. Losses of volts are in `shaping`. `heard` is None where nothing listened.
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
    moved: Moved | None = None
    heard: Heard | None = None

    @property
    def lasts_s(self) -> float:
        """How long it lasts, s."""
        return self.samples / self.rate_hz


class Delivered(Record):
    """What the loopback measured of one stimulus beside what was intended; or a fault of its stream.

    Times are of the panel, in session time: `requested_ns` of the first sample, `onset_ns` as measured. That,
    `onset_error_ms` (measured minus requested), `gain` (measured by intended) and `residual_db` (unexplained by gain
    and delay, relative to the intended waveform) are None if nothing was found. `xruns`: of the stream during it.
    `reason`: why it does not count as delivered.
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
    """How a stimulus met the contact.

    `predicted_us`: the last prediction of contact before the point of no return, device time, with its standard error
    and newest sample; None if the foot came too fast. `prediction_error_ms`: predicted minus actual contact.
    `contact_ns`: actual contact, session time. `scheduled_ns`: scheduled onset, session time; None if the actuator
    cannot schedule or was late. `gate_to_scheduled_ms`: from the arrival of the gate's frame to the first scheduling;
    None without, and in simulated time. `delivered`: the loopback's result; None without one or a known fault.
    `ahead_ms`: how long before contact it was to begin; None at contact.
    """

    predicted_us: float | None
    standard_error_ms: float | None
    predicted_from_us: int | None
    prediction_error_ms: float | None
    contact_ns: int
    scheduled_ns: int | None
    gate_to_scheduled_ms: float | None
    delivered: Delivered | None
    ahead_ms: float | None = None

    @property
    def off_ms(self) -> float:
        """How long after its time it was scheduled, ms, by actual contact; what was not came at contact."""
        begun_ns = self.contact_ns if self.scheduled_ns is None else self.scheduled_ns
        return (begun_ns - self.contact_ns) / 1e6 + (self.ahead_ms or 0.0)


class Begun(Record):
    """What a stimulus was aimed at that a step which broke off could not take back, or was not to.

    `predicted_us`: the contact last predicted, device time, with its standard error; `scheduled_ns`: its onset, session
    time.
    """

    predicted_us: float
    standard_error_ms: float
    scheduled_ns: int
