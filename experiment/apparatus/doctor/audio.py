"""Checks of the audio device: it is there, runs without a gap, and its loopback answers as it was calibrated."""

from __future__ import annotations

import math

from experiment.apparatus.audio import calibration
from experiment.apparatus.audio.stream import AudioStream, StreamHealth
from experiment.apparatus.doctor.verdict import Check, judged, refused, unchecked
from experiment.apparatus.rig import AudioRig
from experiment.errors import AudioError

PEAK = 0.05
"""Of the probes, 1.0 being full scale: half of what `palpate calibrate audio` plays."""

PROBES = 5

RUN_S = 1.0
"""A stream is watched at least this long before it is judged, s."""

LOOPBACK = "loopback"


def opened(stream: AudioStream, audio: AudioRig) -> Check:
    """What a stream that could be opened is."""
    channels = audio.channels
    return Check(
        "audio device",
        "green",
        f"{audio.device}: {channels.inputs} inputs, {channels.outputs} outputs, {stream.rate_hz} Hz",
    )


def steady(stream: AudioStream, audio: AudioRig, *, since: StreamHealth, exact: bool) -> tuple[Check, ...]:
    """Watch a stream for `RUN_S` or longer.

    Args:
        stream: running.
        audio: of the rig.
        since: how it was when it began to be watched; opening and wiring a stream may cost an under-run.
        exact: as in `health`.
    """
    try:
        stream.wait(since.frames + round(RUN_S * audio.rate_hz))
    except AudioError as error:
        return (refused("audio stream", error),)
    return health(since, stream.health, audio, exact=exact)


def health(since: StreamHealth, until: StreamHealth, audio: AudioRig, *, exact: bool) -> tuple[Check, ...]:
    """Whether a stream ran without a gap, and callbacks kept to their times.

    Args:
        since: how it was at first.
        until: how it was at last.
        audio: of the rig.
        exact: of a server that waits for its clients and loses nothing, so that under-runs it tells of are none.
    """
    seconds = (until.frames - since.frames) / audio.rate_hz
    gaps, xruns = until.gaps - since.gaps, until.xruns - since.xruns
    fit, quarter_ms = until.fit, 1e3 * audio.block / audio.rate_hz / 4
    return (
        judged(
            "audio stream",
            gaps == 0 and (exact or xruns == 0),
            f"{seconds:.1f} s: {gaps} gaps, {xruns} xruns",
            allowed="no gaps" + ("; this card waits, and loses nothing in an xrun" if exact else " and no xruns"),
            remedy="close other programs, or make audio.block larger and calibrate anew",
        ),
        judged(
            "audio timeline",
            fit.median_ms <= quarter_ms,
            f"callbacks late by {fit.median_ms:.2f} ms (median), {fit.p95_ms:.2f} ms (p95), {fit.worst_ms:.2f} ms "
            "(worst)",
            allowed=f"median at most {quarter_ms:.2f} ms, a quarter of a block",
            remedy="close other programs, or let this user run with real-time priority",
        ),
    )


def loopback(stream: AudioStream, audio: AudioRig) -> tuple[Check, ...]:
    """Whether what leaves the actuator's channel comes back when, as loud and as clean as it should.

    The actuator moves meanwhile. What is allowed is what the rig allows of a stimulus that counts as delivered.

    Args:
        stream: running; its actuator's channel lets `PEAK` pass.
        audio: of the rig.
    """
    entry, tolerance = audio.channels.loopback, audio.delivered
    if entry is None:
        return (unchecked(LOOPBACK, "the rig has no audio.channels.loopback", "lay a cable, and name its input"),)
    try:
        found = calibration.measure(stream, output=audio.channels.actuator, entry=entry, peak=PEAK, probes=PROBES)
    except AudioError as error:
        return (refused(LOOPBACK, error),)
    anew = "see to cable and levels, then run palpate calibrate audio"
    to_ms = 1e3 / audio.rate_hz
    calibrated_ms = audio.latency.output_ms + audio.latency.input_ms
    round_trip_ms, spread_ms = found.output_ms + found.input_ms, found.spread_frames * to_ms
    off_db = 20 * math.log10(found.gain / audio.latency.loopback_gain)
    return (
        judged(
            "loopback latency",
            abs(round_trip_ms - calibrated_ms) <= tolerance.onset_ms and spread_ms <= tolerance.onset_ms,
            f"{round_trip_ms:.3f} ms out and in, spread {spread_ms:.3f} ms in {found.probes} probes",
            allowed=f"{calibrated_ms:.3f} ms as calibrated, within {tolerance.onset_ms:g} ms (delivered.onset_ms)",
            remedy=f"set audio.block and the device's buffer as they were; {anew}",
        ),
        judged(
            "loopback level",
            abs(off_db) <= tolerance.gain_db and found.spread_db <= tolerance.gain_db,
            f"gain {found.gain:.4g} ({off_db:+.2f} dB), spread {found.spread_db:.2f} dB",
            allowed=f"{audio.latency.loopback_gain:g} as calibrated, within {tolerance.gain_db:g} dB "
            "(delivered.gain_db)",
            remedy=anew,
        ),
        judged(
            "loopback residual",
            found.residual_db <= tolerance.residual_db,
            f"{found.residual_db:.0f} dB, the worst of {found.probes} probes",
            allowed=f"at most {tolerance.residual_db:g} dB (delivered.residual_db)",
            remedy="see to noise and distortion on the way: cable, levels, earth; and that nothing else plays",
        ),
    )
