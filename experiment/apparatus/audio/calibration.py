"""Latency and level of an audio device, measured through its loopback."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from datetime import date
from typing import Any

import numpy as np
import tomlkit
from numpy.typing import NDArray

from palpate.experiment.apparatus import opening
from palpate.experiment.apparatus.audio import actuator
from palpate.experiment.apparatus.audio.stream import AudioStream
from palpate.experiment.apparatus.rig import AudioRig, Rig
from palpate.experiment.clock import Clock
from palpate.experiment.errors import AudioError, RigError

SWEEP_S = 0.05
LOW_HZ, HIGH_HZ = 50.0, 2000.0
"""The probe: a sweep over what actuators are driven with, one frequency a moment, so that it is found to the sample."""

MOST_TIMES = 3
"""A measurement that was disturbed is made again, so often in all."""

LONGEST_S = 0.5
"""Longest way from output to input, s."""


def open_probing(
    rig: Rig, probed: Iterable[Rig], *, peak: float, clock: Clock, device: str | None = None
) -> AudioStream:
    """Open the rig's audio device, whatever its calibrations' age, with probes up to `peak`, 1.0 being full scale.

    Only the actuators of the views `probed` can be moved. Raises as `opening.open_audio`.
    """
    audio = opening.audio_of(rig)
    outputs, inputs = opening.open_channels(rig)
    ceilings = [0.0] * outputs
    for one in probed:
        ceilings[opening.audio_of(one).channels.actuator - 1] = peak
    sent = audio.channels.microphone is not None
    settings = opening.stream_settings(audio, ceilings, inputs=inputs, sent=sent, stimuli=True)
    return AudioStream(replace(settings, device=device or audio.device), clock)


@dataclass(frozen=True)
class Loopback:
    """What the loopback showed.

    Delay and gain are medians with full ranges; the residual is the worst probe's; `xruns` are the device's meanwhile.
    `as_reported`: the driver's latencies divide the round trip into `output_ms` and `input_ms`; else it is halved.
    """

    round_trip_frames: float
    spread_frames: int
    gain: float
    spread_db: float
    residual_db: float
    probes: int
    xruns: int
    output_ms: float
    input_ms: float
    as_reported: bool

    def table(self, today: date, days: int, site: str | None) -> str:
        """Return the table [audio.latency] of a rig file, or that of a site."""
        head = "[audio.latency]\n" if site is None else f"[sites.latency]  # {site}\n"
        return head + "".join(f"{key} = {value}\n" for key, value in self.values(today, days).items())

    def values(self, today: date, days: int) -> dict[str, str]:
        """Return the keys of [audio.latency] and what to write there."""
        return {
            "output_ms": f"{self.output_ms:.3f}",
            "input_ms": f"{self.input_ms:.3f}",
            "loopback_gain": str(float(f"{self.gain:.4g}")),
            "calibrated_on": today.isoformat(),
            "calibration_days": str(days),
        }


def probe(*, rate_hz: int, peak: float) -> NDArray[np.float32]:
    """Return the sweep that is played, shape (n,), of magnitude `peak` at most; it begins and ends at zero."""
    from scipy import signal

    t = np.arange(round(SWEEP_S * rate_hz)) / rate_hz
    wave: NDArray[np.float64] = signal.chirp(t, LOW_HZ, SWEEP_S, HIGH_HZ) * np.sin(np.pi * t / SWEEP_S)
    return (peak * wave).astype(np.float32)


def measure(stream: AudioStream, *, output: int, entry: int, peak: float, probes: int) -> Loopback:
    """Play so many probes, and return what was heard; `AudioError` if one was not or the stream stopped.

    `output` is the actuator's channel and `entry` that of the loopback, from 1; `peak` is of full scale, 1.0.
    """
    wave = probe(rate_hz=stream.rate_hz, peak=peak)
    reach = round(LONGEST_S * stream.rate_hz)
    xruns = stream.xruns
    lags, gains, residuals = [], [], []
    for number in range(1, probes + 1):
        cue = stream.schedule(wave, channel=output - 1, frame=stream.next_frame + 4 * stream.lead_frames)
        heard = stream.recorded_inputs(cue.frame, wave.size + reach)[:, entry - 1]
        found = actuator.align(heard, wave, gain=1.0)
        if cue.started is None or found is None:
            raise AudioError(
                "audio calibration",
                f"probe {number} of {probes} on output {output} did not arrive on input {entry}",
                "connect the loopback cable, turn up its level, and close other programs that load the machine",
            )
        lags.append(found.onset)
        gains.append(found.gain)
        residuals.append(found.residual_db - 20 * np.log10(abs(found.gain)))
    gain = float(np.median(gains))
    if gain <= 0:
        raise AudioError(
            "audio calibration", f"got a gain of {gain:.3g}", "reverse the cable's polarity", allowed="above 0"
        )
    round_trip = float(np.median(lags))
    round_trip_ms = 1e3 * round_trip / stream.rate_hz
    entry_s, output_s = stream.reported_latency_s
    as_reported = entry_s > 0 and output_s > 0
    output_ms = round_trip_ms * (output_s / (entry_s + output_s) if as_reported else 0.5)
    return Loopback(
        round_trip_frames=round_trip,
        spread_frames=max(lags) - min(lags),
        gain=gain,
        spread_db=20 * float(np.log10(max(gains) / min(gains))) if min(gains) > 0 else np.inf,
        residual_db=float(max(residuals)),
        probes=probes,
        xruns=stream.xruns - xruns,
        output_ms=output_ms,
        input_ms=round_trip_ms - output_ms,
        as_reported=as_reported,
    )


def steadily(measured: Callable[[], Loopback], audio: AudioRig, *, exact: bool) -> Loopback:
    """Measure until nothing disturbed it, and return the good measurement; `AudioError` after `MOST_TIMES`.

    The rig's `delivered` limits the probes' differences. An `exact` server loses nothing, so its under-runs do not
    count.
    """
    trouble = ""
    for _ in range(MOST_TIMES):
        found = measured()
        trouble = disturbed(found, audio, exact=exact)
        if not trouble:
            return found
    raise AudioError(
        "audio calibration",
        f"after {MOST_TIMES} attempts, still got {trouble}",
        "close other programs, check the cable and its level, or make audio.block larger, then start again",
    )


def disturbed(found: Loopback, audio: AudioRig, *, exact: bool) -> str:
    """Return what speaks against a measurement, and what is allowed; nothing for a good one. See `steadily`."""
    tolerance = audio.delivered
    spread_ms = 1e3 * found.spread_frames / audio.rate_hz
    for good, got, allowed in (
        (exact or found.xruns == 0, f"{found.xruns} xruns", "none"),
        (
            spread_ms <= tolerance.onset_ms,
            f"latencies that vary by {spread_ms:.2f} ms",
            f"{tolerance.onset_ms:g} ms (delivered.onset_ms)",
        ),
        (
            found.spread_db <= tolerance.gain_db,
            f"levels that vary by {found.spread_db:.2f} dB",
            f"{tolerance.gain_db:g} dB (delivered.gain_db)",
        ),
        (
            found.residual_db <= tolerance.residual_db,
            f"a residual of {found.residual_db:.0f} dB",
            f"{tolerance.residual_db:g} dB (delivered.residual_db)",
        ),
    ):
        if not good:
            return f"{got} in {found.probes} probes (allowed: {allowed})"
    return ""


def table_of(document: Any, site: str) -> Any:
    """Return the table of a site in a rig file; `RigError` if `[[sites]]` are not tables of their own."""
    found = [one for one in document.get("sites", ()) if one.get("name") == site]
    if not found:
        raise RigError("sites", f"got no table for {site}", "write each site as a table [[sites]]", allowed=site)
    return found[0]


def unremarked(item: Any, remark: str) -> None:
    """Take a remark away that stands behind a table's head or a value of a rig file."""
    if item.trivia.comment.startswith(remark):
        item.trivia.comment_ws = item.trivia.comment = ""


def rewritten(rig_text: str, values: dict[str, str], site: str | None = None) -> str:
    """Return a valid rig file with other values by key in [audio.latency], and without its remark NOT CALIBRATED.

    Those of a `site` are in its own table. Raises `RigError` if the table or a key is missing.
    """
    document = tomlkit.parse(rig_text)
    own = document.get("audio", {}) if site is None else table_of(document, site)
    table = own.get("latency", {})
    missing = sorted(set(values) - set(table))
    if missing:
        raise RigError(
            "audio.latency" if site is None else f"sites.latency of {site}",
            f"got no {', '.join(missing)}",
            "paste the printed table",
            allowed="the whole table",
        )
    unremarked(table, "# NOT CALIBRATED")
    for key, value in values.items():
        table[key] = tomlkit.value(value)
    return tomlkit.dumps(document)
