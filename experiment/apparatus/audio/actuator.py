"""An actuator on an output of the session's audio stream: scheduled to the sample, and measured by loopback."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from experiment.apparatus.audio import delivered as measure
from experiment.apparatus.audio.cues import AT_ONCE, Cue
from experiment.apparatus.audio.stream import AudioStream
from experiment.apparatus.conditioning import Conditioner
from experiment.apparatus.ports import Drive, Played, Wanted
from experiment.apparatus.rig_audio import AudioRig
from experiment.errors import ActuatorError
from experiment.stimulus_record import Delivered

SOMETIME = 2**62
"""A frame that never comes: a stimulus that is ready and not aimed yet."""

REACH_S = 0.05
"""How far from where it is expected a stimulus is looked for, s."""


class AudioActuator:
    """Implements `Actuator`."""

    def __init__(
        self,
        stream: AudioStream,
        audio: AudioRig,
        *,
        full_scale: float,
        limit_m_s2: float,
        drive: Drive | None = None,
    ) -> None:
        """Take an output of a running stream.

        Args:
            stream: the session's stream; it stays open when the actuator is closed.
            audio: the device in the rig file.
            full_scale: what a sample of 1.0 is: V where there is a `drive`, else m/s^2.
            limit_m_s2: the protocol's limit.
            drive: frequency shaping, for a device that takes volts; None for one that takes accelerations.
        """
        self._stream = stream
        self._audio = audio
        self._condition = Conditioner(full_scale=full_scale, limit_m_s2=limit_m_s2, drive=drive)
        self._output_ns = audio.latency.output_ms * 1e6
        self._tolerance = measure.Tolerance(**audio.delivered.model_dump())
        self._samples: NDArray[np.float32] = np.zeros(0, np.float32)
        self._cue: Cue | None = None
        self._requested_ns: int | None = None
        self._xruns = 0

    @property
    def rate_hz(self) -> int:
        return self._stream.rate_hz

    @property
    def lead_ns(self) -> int:
        # Within a block nobody knows how much of it has passed.
        frames = self._stream.lead_frames + self._audio.block
        return round(self._output_ns + frames / self._stream.rate_hz * 1e9)

    def prepare(self, wanted: Wanted) -> Played:
        """Limit and shape a stimulus and lay it ready; nothing sounds yet.

        Args:
            wanted: the stimulus, at `rate_hz`.

        Raises:
            ActuatorError: there is nothing to play.
            AudioError: it is too long, or the stream has stopped.
        """
        self.withdraw()
        self._requested_ns = None
        self._samples, played = self._condition(wanted)
        self._cue = self._stream.schedule(self._samples, channel=self._audio.channels.actuator - 1, frame=SOMETIME)
        self._xruns = self._stream.xruns
        return played

    def aim(self, onset_ns: int) -> bool:
        """Have the first sample reach the panel at `onset_ns`; see `Actuator.aim`."""
        frame = self._stream.frame_at(round(onset_ns - self._output_ns))
        if self._cue is None or frame < self._stream.next_frame + self._stream.lead_frames:
            return False
        if not self._stream.move(self._cue, frame):
            return False
        self._requested_ns = onset_ns
        return True

    def landed(self, contact_ns: int) -> None:
        """What was never aimed sounds with the next block; see `Actuator.landed`."""
        if self._cue is not None and self._requested_ns is None and self._stream.move(self._cue, AT_ONCE):
            self._requested_ns = contact_ns

    def withdraw(self) -> bool:
        if self._cue is not None and self._stream.withdraw(self._cue):
            self._cue = None
        return self._cue is None

    def delivered(self, contact_ns: int) -> Delivered | None:
        """Wait until the stimulus has ended, and compare what the loopback heard with it; see `Actuator.delivered`.

        Returns:
            None where the rig has no loopback, unless the stimulus is known to have been missed.

        Raises:
            ActuatorError: nothing was aimed, and nothing has landed.
            AudioError: the stream has stopped.
        """
        cue, requested_ns = self._cue, self._requested_ns
        if cue is None or requested_ns is None:
            raise ActuatorError(
                "actuator: got a question for a stimulus that nothing set off; aim it, or say it landed"
            )
        self._stream.wait(max(cue.frame, 0))
        while not cue.done:
            self._stream.wait(self._stream.next_frame + 1)
        if cue.started is None:
            return self._said(requested_ns, "the stream came too late for it")
        if self._audio.channels.loopback is None:
            return None
        latency, rate_hz = self._audio.latency, self._stream.rate_hz
        behind = round((latency.output_ms + latency.input_ms) / 1e3 * rate_hz)
        reach = round(REACH_S * rate_hz)
        first = max(cue.started + behind - reach, 0)
        end = cue.started + behind + cue.samples + reach
        heard = self._stream.kept(first, end - first)[:, self._audio.channels.loopback - 1]
        gain = latency.loopback_gain
        if not self._samples.any():
            return self._said(requested_ns, measure.silence_objection(heard, gain=gain, tolerance=self._tolerance))
        found = measure.align(heard, self._samples, gain=gain)
        if found is None:
            return self._said(requested_ns, "the loopback did not hear it")
        onset_ns = self._stream.ns_of(first + found.onset) - round(latency.input_ms * 1e6)
        onset_error_ms = (onset_ns - requested_ns) / 1e6
        reason = measure.objection(
            found,
            onset_error_ms=onset_error_ms,
            contact_error_ms=(onset_ns - contact_ns) / 1e6,
            gain=gain,
            tolerance=self._tolerance,
        )
        return self._said(requested_ns, reason, onset_ns, found)

    def close(self) -> None:
        """Nothing of it will sound that has not begun."""
        self.withdraw()

    def _said(
        self, requested_ns: int, reason: str, onset_ns: int | None = None, found: measure.Alignment | None = None
    ) -> Delivered:
        return Delivered(
            requested_ns=requested_ns,
            onset_ns=onset_ns,
            onset_error_ms=None if onset_ns is None else (onset_ns - requested_ns) / 1e6,
            gain=None if found is None else found.gain,
            residual_db=None if found is None else found.residual_db,
            xruns=self._stream.xruns - self._xruns,
            delivered=not reason,
            reason=reason,
        )
