"""From a stimulus in m/s^2 to the samples of a device, 1.0 being its full scale. Shared by the actuators' drivers.

A device that takes accelerations gets the limited stimulus. One that takes volts gets the shaped one. Where the panel
was measured, the protocol's limit is that of its movement, and the whole stimulus is scaled down to it. Elsewhere, in
simulation alone, samples in m/s^2 are limited, and shaping scales voltages down, by the response without phase. The
limiter stands last before the device, whatever was done before.
"""

import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from palpate.experiment.apparatus.panel.response_table import parse
from palpate.experiment.apparatus.rig import ActuatorRig, Rig, response_table
from palpate.experiment.errors import ActuatorError
from palpate.experiment.records import stimulus as records
from palpate.experiment.synthesis import budget
from palpate.experiment.synthesis.shaping import Shaped
from palpate.experiment.synthesis.voltages import Drive
from palpate.experiment.synthesis.waveforms import Basis, Waveform

MOVEMENT, INVERSE = (f"palpate.experiment.apparatus.panel.{name}" for name in ("movement", "inverse"))
"""How a measured panel moves, and what inverts it, which are imported for one alone."""

EVERY_HZ = (0.0, math.inf)
"""What a device carries of which nothing else is said, Hz."""


class Peak(NamedTuple):
    """The largest magnitude of a movement at any time, m/s^2, and what it is uncertain by."""

    peak_m_s2: float
    uncertainty_m_s2: float

    @property
    def highest_m_s2(self) -> float:
        return self.peak_m_s2 + self.uncertainty_m_s2


class Drifted(NamedTuple):
    """The most that a panel can have drifted in any third octave since it was measured, dB: upward, and either way."""

    louder_db: float
    off_db: float


class Movement(Protocol):
    """How a measured panel moves."""

    def peak(self, samples: NDArray[np.float32]) -> Peak:
        """Return the peak that finite samples, shape (n,), move the panel by."""

    def on_record(self, played: "Played", peak: Peak) -> records.Moved:
        """Return the record of a stimulus that moves the panel with this peak."""


class Inverse(Protocol):
    """What inverts a measured panel by samples that begin `ahead_s` before the stimulus; see `panel/inverse.py`."""

    ahead_s: float

    def __call__(self, stimulus: Waveform) -> tuple[NDArray[np.float64], float]: ...

    def budget(self, played: "Played") -> budget.Budget: ...


@dataclass(frozen=True)
class Played:
    """A stimulus as its device is given it: `samples`, little-endian float32, shape (n,), 1.0 being full scale.

    Full scale is in V with a `drive`, else in m/s^2. The limiter changed `limited` samples; shaping scaled all by
    `scale`, and the limit of a measured panel, whose peak is now `moved`, by `panel_scale`. `method` is for readers. A
    device that takes accelerations moves the panel at `carries_hz` alone. `heard` says what was heard of it, if asked.
    """

    stimulus: Waveform
    samples: NDArray[np.float32]
    full_scale: float
    limited: int
    method: str
    drive: Drive | None = None
    scale: float = 1.0
    carries_hz: tuple[float, float] = EVERY_HZ
    moved: Peak | None = None
    panel_scale: float = 1.0
    inverse: Inverse | None = None
    movement: Movement | None = None
    heard: Callable[[], records.Heard | None] = lambda: None

    @property
    def ahead(self) -> int:
        """How many samples come before the stimulus."""
        return 0 if self.inverse is None else round(self.inverse.ahead_s * self.stimulus.rate_hz)

    def budget(self) -> tuple[budget.Budget, Shaped | None]:
        """Return how the samples differ from the request, and what shaping did, None without; computed anew."""
        if self.inverse is not None:
            return self.inverse.budget(self), None
        handed = self.samples.astype(np.float64) * self.full_scale
        if self.drive is None:
            changed = self.limited + (self.panel_scale < 1)
            found = budget.of_accelerations(
                self.stimulus, handed_m_s2=handed, limited=changed, carries_hz=self.carries_hz
            )
            return found, None
        voltages_v, shaped = self.drive.worked_out(self.stimulus, self.scale)
        if (down := self.panel_scale) < 1:
            voltages_v, both = voltages_v * down, (shaped.coefficients_v * down, shaped.reached_m_s2 * down)
            shaped = replace(shaped, coefficients_v=both[0], reached_m_s2=both[1], scale=shaped.scale * down)
        found = budget.of_voltages(
            self.stimulus, handed_v=handed, voltages_v=voltages_v, shaped=shaped, response=self.drive.response
        )
        return found, shaped

    def on_record(self) -> records.Stimulus:
        """Return what goes on record of it. The budget is worked out for that, so ask after contact."""
        asked = self.stimulus
        peak = max(float(self.samples.max()), -float(self.samples.min())) * self.full_scale
        (error, shaped), reached = self.budget(), peak
        if self.drive is not None and shaped is not None:
            # The bound may lie above the peak, and so above a limit that is known to hold.
            reached = min(shaped.peak_m_s2, self.drive.limit_m_s2)
        if self.moved is not None:
            reached = self.moved.highest_m_s2
        return records.Stimulus(
            asked_sha256=hashlib.sha256(np.asarray(asked.exact, "<f8").tobytes()).hexdigest(),
            floored_bins=asked.floored_bins,
            extrapolated=asked.extrapolated,
            computed=records.Computed(
                method=self.method + asked.band,
                relative_error=error.total,
                left_out=error.left_out,
                dissimilarity_m_s2=error.dissimilarity_m_s2,
            ),
            handed_sha256=hashlib.sha256(self.samples.tobytes()).hexdigest(),
            handed_unit="m/s^2" if self.drive is None else "V",
            handed_peak=peak,
            samples=self.samples.size,
            rate_hz=asked.rate_hz,
            limited=self.limited,
            reached_peak_m_s2=reached,
            shaping=None if shaped is None else _lost(shaped, self.scale),
            moved=None if self.moved is None or self.movement is None else self.movement.on_record(self, self.moved),
            heard=self.heard(),
        )


class Conditioner:
    """Shapes, limits and scales every stimulus before its device."""

    def __init__(
        self,
        *,
        full_scale: float,
        limit_m_s2: float,
        drive: Drive | None = None,
        carries_hz: tuple[float, float] | None = None,
        movement: Movement | None = None,
        inverse: Inverse | None = None,
    ) -> None:
        """Set the limits; `ActuatorError` if the protocol's is negative or not finite.

        A device that takes volts has a `drive` and a full scale in V. Otherwise full scale and `limit_m_s2`, whichever
        is lower, limit accelerations, and `carries_hz` is the device's known range, for the record. With a `movement`
        full scale alone limits samples, and `limit_m_s2` what they move.
        """
        limit((), limit_m_s2)
        self._full_scale = full_scale
        self._movement, self._limit_m_s2, self._inverse = movement, limit_m_s2, inverse
        self.ahead_s = 0.0 if inverse is None else inverse.ahead_s
        self._limit = full_scale if drive is not None or movement is not None else min(limit_m_s2, full_scale)
        self._drive = drive
        self._carries_hz = carries_hz or EVERY_HZ
        highest = np.float32(self._limit / full_scale)
        # Rounding to float32 must not lift a sample over the limit.
        self._highest = np.nextafter(highest, np.float32(0)) if float(highest) * full_scale > self._limit else highest

    @property
    def ceiling(self) -> float:
        """No sample is larger in magnitude; 1.0 is full scale."""
        return float(self._highest)

    def __call__(self, stimulus: Waveform) -> Played:
        """Return a stimulus at the device's rate as its samples are played.

        Raises `ActuatorError` for nothing to play, and `SynthesisError` if the spectrum overflows.
        """
        wanted, scale, method = self._conditioned(stimulus)
        if np.ndim(wanted) != 1 or np.size(wanted) == 0:
            raise ActuatorError(
                "actuator", f"got a stimulus of shape {np.shape(wanted)}", allowed="one channel, one sample or more"
            )
        bounded, limited = limit(wanted, self._limit)
        samples = np.empty(bounded.shape, "<f4")
        np.divide(bounded, self._full_scale, out=samples, casting="same_kind")
        np.clip(samples, -self._highest, self._highest, out=samples)
        given = self._full_scale, limited, method, self._drive, scale, self._carries_hz
        played = Played(stimulus, samples, *given, inverse=self._inverse)
        return played if self._movement is None else self._limited(played, self._movement)

    def _limited(self, played: Played, movement: Movement) -> Played:
        """Return a stimulus taken down as a whole to where its panel moves by the protocol's limit at most."""
        peak, down = movement.peak(played.samples), 1.0
        if peak.highest_m_s2 > self._limit_m_s2:
            # Rounding to float32 must not lift it over the limit.
            down = self._limit_m_s2 / peak.highest_m_s2 * (1 - float(np.finfo(np.float32).eps))
        samples = played.samples if down == 1.0 else (played.samples * down).astype("<f4")
        moved = Peak(peak.peak_m_s2 * down, peak.uncertainty_m_s2 * down)
        return replace(played, samples=samples, moved=moved, panel_scale=down, movement=movement)

    def _conditioned(self, stimulus: Waveform) -> tuple[NDArray[np.float64], float, str]:
        """Return a stimulus in the device's unit, shape (n,), the scale it was taken down to, and how it was made."""
        if self._inverse is not None:
            made, scale = self._inverse(stimulus)
            return made * self._full_scale, scale, f"inverse, {self.ahead_s * 1e3:g} ms ahead"
        if self._drive is None:
            return stimulus.waveform_m_s2, 1.0, stimulus.method
        voltages_v, scale, prepared = self._drive(stimulus)
        return voltages_v, scale, "prepared voltages" if prepared else f"voltages shaped for the {stimulus.occasion}"


def limit(waveform: ArrayLike, peak: float) -> tuple[NDArray[np.float64], int]:
    """Return bounded samples, and how many were changed: the limiter, last before the device, for any input.

    Samples, m/s^2 or V, of any shape, are clipped to `peak` in magnitude, NaN to 0; unchanged ones are not copied.
    Raises `ActuatorError` if `peak` is negative or not finite.
    """
    if not (math.isfinite(peak) and peak >= 0):
        raise ActuatorError("limiter", f"got a limit of {peak} m/s^2", allowed="a finite number of zero or more")
    wanted = np.asarray(waveform, dtype=np.float64)
    lowest, highest = wanted.min(initial=0.0), wanted.max(initial=0.0)
    if -peak <= lowest and highest <= peak:
        return wanted, 0
    numbers = np.where(np.isnan(wanted), 0.0, wanted) if math.isnan(lowest) else wanted
    bounded = np.clip(numbers, -peak, peak)
    return bounded, int(np.count_nonzero(bounded != wanted))


def open_conditioner(
    rig: Rig, *, limit_m_s2: float, drive: Drive | None, drifted: Drifted | None = None
) -> Conditioner:
    """Return what conditions stimuli for a rig's actuator, with its `open_drive`. Raises `RigError` for the panel.

    `drifted` is from the session's comparison of the panel with its measurement; None without one.
    """
    actuator, movement, inverse = rig.actuator, None, None
    if actuator.measured is not None:
        module = import_module(MOVEMENT)
        movement = module.open_movement(rig.folder or Path(), actuator.measured, rate_hz=actuator.rate_hz)
        if drifted is not None:
            movement = replace(movement, drifted=drifted)
        if actuator.inverse_ahead_ms is not None:
            inverse = import_module(INVERSE).Inverse(movement, ahead_s=actuator.inverse_ahead_ms / 1e3)
    return Conditioner(
        full_scale=actuator.full_scale,
        limit_m_s2=limit_m_s2,
        drive=drive,
        carries_hz=actuator.carries_hz,
        movement=movement,
        inverse=inverse,
    )


def open_drive(
    folder: Path, actuator: ActuatorRig, *, limit_m_s2: float, materials: Mapping[str, Basis] | None = None
) -> Drive | None:
    """Return what turns accelerations into voltages for a rig's actuator; None for one that takes accelerations.

    `limit_m_s2` is the protocol's; that of a measured panel is kept behind the drive. The voltages of `materials`, by
    id, are prepared now. Raises `RigError` if the table in `folder` is not the rig file's, and `RecordingError` if it
    is unusable.
    """
    settings = actuator.shaping
    if settings is None:
        return None
    return Drive(
        (materials or {}) if actuator.inverse_ahead_ms is None else {},
        rate_hz=actuator.rate_hz,
        response=parse(folder / settings.response, response_table(folder, settings)),
        gain_limit_v_per_m_s2=settings.gain_limit_v_per_m_s2,
        limit_m_s2=limit_m_s2 if actuator.measured is None else math.inf,
        limit_v=settings.full_scale_v,
    )


def _lost(shaped: Shaped, scale: float) -> records.Shaping:
    return records.Shaping(
        saturated_bins=shaped.saturated.bins,
        saturated_cost_m_s2=shaped.saturated.cost_m_s2,
        outside_bins=shaped.outside.bins,
        outside_cost_m_s2=shaped.outside.cost_m_s2,
        bounded_bins=shaped.bounded.bins,
        bounded_cost_m_s2=shaped.bounded.cost_m_s2,
        scale=scale,
    )
