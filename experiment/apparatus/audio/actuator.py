"""An actuator on an output of the session's audio stream: scheduled to the sample, and measured by loopback."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus.audio.mixer import AT_ONCE, SOMETIME, Cue
from palpate.experiment.apparatus.audio.stream import AudioStream
from palpate.experiment.apparatus.panel.conditioning import Conditioner, Played
from palpate.experiment.apparatus.rig import AudioRig, DeliveredRig
from palpate.experiment.errors import ActuatorError
from palpate.experiment.records.stimulus import Delivered
from palpate.experiment.synthesis.waveforms import Waveform

FOUND = 0.5
"""Correlation from which on something heard is the intended waveform; noise of any length stays far below."""

TAKEN_BACK = "it was canceled before it began"

LEAST_DB = -200.0
"""Residual of a waveform that came back bit for bit: less than any converter leaves."""


@dataclass(frozen=True)
class Alignment:
    """Where and how the intended waveform was heard, its first sample at sample `onset` of what was heard.

    `gain`, heard by intended, is negative for reversed polarity; the residual is what delay and gain do not explain,
    relative to the intended waveform, dB, at least `LEAST_DB`.
    """

    onset: int
    gain: float
    residual_db: float


def align(heard: NDArray[np.floating[Any]], intended: NDArray[np.floating[Any]], *, gain: float) -> Alignment | None:
    """Return where the intended waveform lies in what was heard; None where nothing heard resembles it.

    The onset is the maximum of the cross-correlation, most likely in white noise: there a multiple of the waveform
    leaves the least unexplained. Heard are m samples, intended n <= m, not all zero. `gain` is the loopback's.
    """
    wanted, found = intended.astype(np.float64), heard.astype(np.float64)
    energy = float(wanted @ wanted)
    length = found.size + wanted.size - 1
    products = np.fft.irfft(np.fft.rfft(found, length) * np.fft.rfft(wanted, length).conj(), length)
    products = products[: found.size - wanted.size + 1]
    onset = int(np.argmax(np.abs(products)))
    part = found[onset : onset + wanted.size]
    # The FFT gives only the place; what is reported is summed anew.
    product, present = float(part @ wanted), float(part @ part)
    if present == 0 or abs(product) < FOUND * np.sqrt(energy * present):
        return None
    rest = found.copy()
    rest[onset : onset + wanted.size] -= product / energy * wanted
    unexplained = float(rest @ rest) / (gain**2 * energy)
    return Alignment(
        onset=onset, gain=product / energy, residual_db=10 * float(np.log10(max(unexplained, 10 ** (LEAST_DB / 10))))
    )


def silence_objection(heard: NDArray[np.floating[Any]], *, gain: float, tolerance: DeliveredRig) -> str:
    """Return why an intended silence was not delivered, or "": by its loudest sample, shape (m,), over `gain`."""
    loudest = float(np.max(np.abs(heard))) / gain
    if loudest <= 10 ** (tolerance.residual_db / 20):
        return ""
    return (
        f"the loopback recorded {20 * np.log10(loudest):.1f} dB re full scale where silence was intended; "
        f"allowed: {tolerance.residual_db:g} dB"
    )


def objection(
    alignment: Alignment, *, onset_error_ms: float, contact_error_ms: float, gain: float, tolerance: DeliveredRig
) -> str:
    """Return why what was heard does not count as delivered; empty where it does.

    Errors are measured minus requested, and minus contact, ms; `gain` is what the loopback makes of a sample of 1.0.
    """
    if alignment.gain <= 0:
        return "its polarity is reversed"
    off_db = 20 * float(np.log10(alignment.gain / gain))
    if abs(off_db) > tolerance.gain_db:
        return f"its level was off by {off_db:+.1f} dB; allowed: {tolerance.gain_db:g} dB"
    if alignment.residual_db > tolerance.residual_db:
        return f"the loopback residual is {alignment.residual_db:.1f} dB; allowed: {tolerance.residual_db:g} dB"
    if abs(onset_error_ms) > tolerance.onset_ms:
        return f"its onset was off by {onset_error_ms:+.2f} ms; allowed: {tolerance.onset_ms:g} ms"
    if tolerance.contact_ms is not None and abs(contact_error_ms) > tolerance.contact_ms:
        return f"it began {contact_error_ms:+.2f} ms from contact; allowed: {tolerance.contact_ms:g} ms"
    return ""


REACH_S = 0.05
"""How far from where it is expected a stimulus is looked for, s."""


class AudioActuator:
    """Implements `Actuator`."""

    def __init__(self, stream: AudioStream, audio: AudioRig, condition: Conditioner) -> None:
        """Take an output of the session's running stream, which stays open when the actuator is closed."""
        self._stream = stream
        self._audio = audio
        self._condition = condition
        self._output_ns, self._ahead_ns = audio.latency.output_ms * 1e6, condition.ahead_s * 1e9
        self._tolerance = audio.delivered
        self._samples: NDArray[np.float32] = np.zeros(0, np.float32)
        self._cue: Cue | None = None
        self._requested_ns: int | None = None
        self._channel = audio.channels.actuator - 1
        self._xruns = self._limited = 0

    @property
    def rate_hz(self) -> int:
        return self._stream.rate_hz

    @property
    def lead_ns(self) -> int:
        # Within a block nobody knows how much of it has passed.
        frames = self._stream.lead_frames + self._audio.block
        return round(self._output_ns + self._ahead_ns + frames / self._stream.rate_hz * 1e9)

    def prepare(self, stimulus: Waveform) -> Played:
        """Prepare a stimulus at `rate_hz`; nothing sounds yet. Raises `AudioError` if too long or without a stream."""
        self.withdraw()
        self._requested_ns = None
        played = self._condition(stimulus)
        self._samples = played.samples
        self._cue = self._stream.schedule(self._samples, channel=self._channel, frame=SOMETIME)
        self._xruns, self._limited = self._stream.xruns, self._stream.limited(self._channel)
        return played

    def aim(self, onset_ns: int) -> bool:
        """Have the first sample reach the panel at `onset_ns`; see `Actuator.aim`."""
        frame = self._stream.frame_at(round(onset_ns - self._output_ns - self._ahead_ns))
        if self._cue is None or frame < self._stream.next_frame + self._stream.lead_frames:
            return False
        if not self._stream.move(self._cue, frame):
            return False
        self._requested_ns = onset_ns
        return True

    def landed(self, contact_ns: int) -> None:
        """Play with the next block what was never aimed; see `Actuator.landed`."""
        if self._cue is not None and self._requested_ns is None and self._stream.move(self._cue, AT_ONCE):
            self._requested_ns = contact_ns

    def withdraw(self) -> bool:
        # It stays known, for another thread may ask whether it was delivered.
        return self._cue is None or self._stream.withdraw(self._cue)

    def is_silent(self) -> bool:
        cue = self._cue
        ended = cue is None or cue.started is None or self._stream.next_frame >= cue.started + cue.samples
        return cue is None or (cue.done and ended)

    def delivered(self, contact_ns: int) -> Delivered | None:
        """Wait until the stimulus has ended, and compare what the loopback heard with it; see `Actuator.delivered`.

        Without a loopback only faults of the stream are returned. Raises `ActuatorError` if nothing was aimed or has
        landed, `AudioError` if the stream has stopped.
        """
        cue, requested_ns = self._cue, self._requested_ns
        if cue is not None and cue.withdrawn:
            return self._delivery(requested_ns or contact_ns, TAKEN_BACK)
        if cue is None or requested_ns is None:
            raise ActuatorError(
                "actuator",
                "got a request for a stimulus that was never started",
                "aim it, or report the landing first",
            )
        self._stream.wait(max(cue.frame, 0))
        while not cue.done:
            self._stream.wait(self._stream.next_frame + 1)
        if cue.withdrawn:
            return self._delivery(requested_ns, TAKEN_BACK)
        if cue.cut:
            over = self._stream.ends_ns <= self._stream.ns_of(self._stream.next_frame) + self._output_ns
            why = "the session's sound had ended" if over else "the servo or the device had stopped responding"
            return self._delivery(requested_ns, f"it was cut off because {why}")
        if cue.started is None:
            return self._delivery(requested_ns, "the audio stream was too late to play it")
        self._stream.wait(cue.started + cue.samples)
        changed = self._stream.limited(self._channel) - self._limited
        fault = f"the stream's limiter changed its output ({changed} samples during playback)" if changed else ""
        if self._audio.channels.loopback is None:
            return self._delivery(requested_ns, fault) if fault else None
        latency, rate_hz = self._audio.latency, self._stream.rate_hz
        behind = round((latency.output_ms + latency.input_ms) / 1e3 * rate_hz)
        reach = round(REACH_S * rate_hz)
        first = max(cue.started + behind - reach, 0)
        end = cue.started + behind + cue.samples + reach
        heard = self._stream.recorded_inputs(first, end - first)[:, self._audio.channels.loopback - 1]
        gain = latency.loopback_gain
        if not self._samples.any():
            return self._delivery(requested_ns, silence_objection(heard, gain=gain, tolerance=self._tolerance))
        found = align(heard, self._samples, gain=gain)
        if found is None:
            return self._delivery(requested_ns, "the loopback did not record it")
        onset_ns = self._stream.ns_of(first + found.onset) - round(latency.input_ms * 1e6 - self._ahead_ns)
        reason = fault or objection(
            found,
            onset_error_ms=(onset_ns - requested_ns) / 1e6,
            contact_error_ms=(onset_ns - contact_ns) / 1e6,
            gain=gain,
            tolerance=self._tolerance,
        )
        return self._delivery(requested_ns, reason, onset_ns, found)

    def close(self) -> None:
        """Withdraw what has not begun."""
        self.withdraw()

    def _delivery(
        self, requested_ns: int, reason: str, onset_ns: int | None = None, found: Alignment | None = None
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
