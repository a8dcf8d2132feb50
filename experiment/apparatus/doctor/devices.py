"""Checks of tracker and audio device, with nobody on the panel."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus.audio import calibration as audio_calibration
from palpate.experiment.apparatus.audio.stream import AudioStream, StreamHealth
from palpate.experiment.apparatus.doctor.checks import judged, passed, refused, unchecked
from palpate.experiment.apparatus.ports import Tracker
from palpate.experiment.apparatus.rig import CALIBRATE_AUDIO, AudioRig, at_site
from palpate.experiment.apparatus.tracker import zeroing
from palpate.experiment.apparatus.tracker.clock_map import DRIFT_LIMIT_PPM, ClockMap
from palpate.experiment.apparatus.tracker.frames import LinkCounts
from palpate.experiment.apparatus.tracker.settings import TrackerRig
from palpate.experiment.clock import Clock
from palpate.experiment.errors import AudioError, Finding, Remedy, TrackerError

LISTEN_S = 4.5
"""How long the tracker is listened to, s: three whole seconds tell the clock map drift to some ppm."""

CRYSTAL_PPM = 500.0
"""More than any crystal drifts, parts per million; a ceramic resonator may be ten times as far off."""

RATE_PART = 0.01
"""Part of the rig file's rate by which the device's own may differ."""

DELAY_P99_MS = 10.0
"""Within this 99 of 100 reads arrive, ms: a foot at 300 mm/s takes 33 ms from gate to panel, two thirds remain."""

NOISE_TIMES = 2.0
"""How many times the calibrated noise a sensor may have that sees nothing move."""


@dataclass(frozen=True)
class Heard:
    """What a tracker sent: n samples with device times, frames of the link, and of a planar one `along_mm`, shape (n,).

    `delay_ms` is by how much each of m reads came after the line of the clock map; `raw` are the bytes of all.
    """

    device_us: NDArray[np.int64]
    height_mm: NDArray[np.float64]
    delay_ms: NDArray[np.float64]
    link: LinkCounts
    clock_map: ClockMap
    along_mm: NDArray[np.float64] | None = None
    raw: bytes = b""


def listen(tracker: Tracker, *, clock: Clock, seconds: float = LISTEN_S) -> Heard:
    """Return what an opened tracker sends in so many seconds; the clock goes by itself. `TrackerError` if it fails."""
    tracker.drain()
    before, ends_ns = tracker.counts, clock.now_ns() + int(seconds * 1e9)
    reads = [tracker.read()]
    while clock.now_ns() < ends_ns:
        reads.append(tracker.read())
    mapped = tracker.clock_map
    if mapped is None:
        raise TrackerError(
            "tracker",
            "got samples without a clock map",
            "correct its driver",
            allowed="a clock map from the first sample on",
        )
    along_mm = [read.along_mm for read in reads if read.along_mm is not None]
    delay_ms = [(read.arrived_ns - mapped.session_ns(int(read.device_us[-1]))) / 1e6 for read in reads]
    return Heard(
        device_us=np.concatenate([read.device_us for read in reads]),
        height_mm=np.concatenate([read.height_mm for read in reads]),
        delay_ms=np.array(delay_ms),
        link=tracker.counts.since(before),
        clock_map=mapped,
        along_mm=np.concatenate(along_mm) if along_mm else None,
        raw=b"".join(read.raw for read in reads),
    )


def checks(tracker: Tracker, settings: TrackerRig, *, clock: Clock) -> tuple[Finding, ...]:
    """Return everything that an opened tracker shows; the session's clock must go by itself."""
    try:
        heard = listen(tracker, clock=clock)
    except TrackerError as error:
        return (refused("tracker frames", error),)
    pressed: tuple[Finding, ...] = ()
    if settings.force is not None:
        from palpate.experiment.apparatus.doctor import foot_force

        pressed = (foot_force.at_rest(heard.raw, settings),)
    return (
        frames(heard),
        rate(heard, settings),
        drift(heard),
        arrival(heard, settings),
        reading(tracker, settings),
        noise(heard, settings),
        *along(heard, settings),
        *pressed,
    )


def frames(heard: Heard) -> Finding:
    """Return whether the link loses or spoils frames."""
    link = heard.link
    return judged(
        "tracker frames",
        link.lost + link.damaged + link.repeated == 0,
        f"{link.received} received, {link.lost} lost, {link.damaged} damaged, {link.repeated} repeated",
        allowed="none lost, damaged or repeated",
        remedy="use a shorter cable or another USB port, without a hub; check that baud matches the device, and close "
        "other programs that load the machine",
    )


def rate(heard: Heard, settings: TrackerRig) -> Finding:
    """Return whether the device samples as often as the rig file says, by its own clock."""
    steps_us = np.diff(heard.device_us)
    measured_hz = 0.0
    if steps_us.size:
        # A gap where frames were lost counts as the samples that it holds.
        samples = np.rint(steps_us / np.median(steps_us)).sum()
        measured_hz = float(samples * 1e6 / steps_us.sum())
    wanted_hz = settings.rate_hz
    return judged(
        "tracker rate",
        abs(measured_hz - wanted_hz) <= RATE_PART * wanted_hz,
        f"{measured_hz:.1f} Hz by the device's clock",
        allowed=f"{(1 - RATE_PART) * wanted_hz:g} to {(1 + RATE_PART) * wanted_hz:g} Hz",
        remedy="set the device's firmware and tracker.rate_hz in the rig file to the same rate",
    )


def drift(heard: Heard) -> Finding:
    """Return whether the device's clock runs as this machine's does."""
    ppm, more = heard.clock_map.drift_ppm, " or more" if _strays(heard) else ""
    off = f"; typical of a resonator instead of a crystal: foot speeds are off by {abs(ppm) * 1e-4:.1f} %"
    return judged(
        "tracker clock",
        not more,
        f"drift {ppm:+.0f} ppm{more} relative to this machine's clock over {heard.clock_map.span_s:.1f} s"
        + (off if abs(ppm) >= CRYSTAL_PPM and not more else ""),
        allowed=f"less than {DRIFT_LIMIT_PPM:g} ppm in either direction",
        remedy="check that the firmware counts microseconds and the board has a crystal or a resonator; on a loaded "
        "machine, close other programs and check again",
    )


def _strays(heard: Heard) -> bool:
    """Return whether a device's clock drifts by as much as a clock map believes, or by more, which it cannot tell."""
    return abs(heard.clock_map.drift_ppm) >= DRIFT_LIMIT_PPM


def arrival(heard: Heard, settings: TrackerRig) -> Finding:
    """Return how late reads come, by a clock that can be relied on."""
    if _strays(heard):
        return unchecked("tracker arrival", "the delays depend on the tracker's clock, which is not reliable")
    median, p99, longest = (float(np.quantile(heard.delay_ms, q)) for q in (0.5, 0.99, 1.0))
    return judged(
        "tracker arrival",
        p99 <= DELAY_P99_MS and longest <= settings.stall_ms,
        f"delay median {median:.2f} ms, p99 {p99:.2f} ms, longest {longest:.2f} ms",
        allowed=f"p99 at most {DELAY_P99_MS:g} ms, longest at most {settings.stall_ms} ms",
        remedy="close other programs; with a USB adapter, set its latency timer to 1 ms",
    )


def reading(tracker: Tracker, settings: TrackerRig) -> Finding:
    """Return whether the sensor reads inside its calibration; as `palpate run` asks before a session."""
    name = "tracker reading"
    try:
        zeroing.check_reading(tracker, settings)
    except TrackerError as error:
        return refused(name, error)
    calibrated_mm = [point.mm for point in settings.calibration]
    return passed(name, "inside the calibration", f"{min(calibrated_mm):g} to {max(calibrated_mm):g} mm")


def noise(heard: Heard, settings: TrackerRig) -> Finding:
    """Return whether a sensor that sees nothing move is as quiet as when it was calibrated."""
    name = "tracker noise"
    measured_mm = float(np.std(heard.height_mm))
    measured = f"{measured_mm:.3f} mm at {float(np.median(heard.height_mm)):.1f} mm"
    if settings.noise_mm is None:
        reason = f"{measured}; the rig file does not state tracker.noise_mm"
        return unchecked(name, reason, Remedy("run {}, which adds it", zeroing.CALIBRATE))
    if settings.noise_mm > 0 and np.ptp(heard.height_mm) == 0:
        return judged(
            name,
            False,
            f"{measured}, the same in every frame",
            allowed=f"some noise, because the noise was {settings.noise_mm:g} mm during calibration",
            remedy="check that the sensor detects the panel and is not stuck at one reading",
        )
    return judged(
        name,
        measured_mm <= NOISE_TIMES * settings.noise_mm,
        measured,
        allowed=f"at most {NOISE_TIMES * settings.noise_mm:g} mm, {NOISE_TIMES:g} times tracker.noise_mm",
        remedy=Remedy(
            "make sure nothing moves above the panel, try another cable or power supply for the sensor, or run {}",
            zeroing.CALIBRATE,
            suffices=False,
        ),
    )


def along(heard: Heard, settings: TrackerRig) -> tuple[Finding, ...]:
    """Return whether a planar sensor reads inside its calibration along the face; nothing of others."""
    if heard.along_mm is None:
        return ()
    calibrated_mm = [point.mm for point in settings.along_calibration or ()]
    low_mm, high_mm = min(calibrated_mm), max(calibrated_mm)
    held = (heard.along_mm <= low_mm) | (heard.along_mm >= high_mm)
    found = judged(
        "tracker along",
        float(held.mean()) <= zeroing.HELD_PART,
        f"{np.std(heard.along_mm):.3f} mm at {np.median(heard.along_mm):.1f} mm along the face",
        allowed=f"{low_mm:g} to {high_mm:g} mm",
        remedy="check that the sensor is in place, or add points to tracker.along_calibration",
    )
    return (found,)


PEAK = 0.05
"""Of the probes, 1.0 being full scale: half of what `palpate calibrate audio` plays."""

PROBES = 5

RUN_S = 1.0
"""A stream is watched at least this long before it is judged, s."""

LOOPBACK = "loopback"


def opened(stream: AudioStream, audio: AudioRig) -> Finding:
    """Return a stream that could be opened as a green check."""
    found = f"{audio.channels.inputs} inputs, {audio.channels.outputs} outputs, {stream.rate_hz} Hz"
    return passed("audio device", f"{audio.device}: {found}")


def steady(stream: AudioStream, audio: AudioRig, *, since: StreamHealth, exact: bool) -> tuple[Finding, ...]:
    """Watch a stream for `RUN_S` or longer since `since`, which follows opening and wiring; see `health`."""
    try:
        stream.wait(since.frames + round(RUN_S * audio.rate_hz))
    except AudioError as error:
        return (refused("audio stream", error),)
    return health(since, stream.health, audio, exact=exact)


def health(since: StreamHealth, until: StreamHealth, audio: AudioRig, *, exact: bool) -> tuple[Finding, ...]:
    """Return whether a stream had no gap between two states, and callbacks in time; `exact` servers lose nothing."""
    seconds = (until.frames - since.frames) / audio.rate_hz
    gaps, xruns = until.gaps - since.gaps, until.xruns - since.xruns
    fit, quarter_ms = until.fit, 1e3 * audio.block / audio.rate_hz / 4
    return (
        judged(
            "audio stream",
            gaps == 0 and (exact or xruns == 0),
            f"{seconds:.1f} s: gaps: {gaps}, xruns: {xruns}",
            allowed="no gaps; this card loses nothing in xruns" if exact else "no gaps and no xruns",
            remedy="close other programs, or make audio.block larger and calibrate again",
        ),
        judged(
            "audio timeline",
            fit.median_ms <= quarter_ms,
            f"callbacks are late by {fit.median_ms:.2f} ms (median), {fit.p95_ms:.2f} ms (p95), {fit.worst_ms:.2f} ms "
            "(worst)",
            allowed=f"median at most {quarter_ms:.2f} ms, a quarter of a block",
            remedy="close other programs, or let this user run with real-time priority",
        ),
    )


def microphone(stream: AudioStream, audio: AudioRig) -> tuple[Finding, ...]:
    """Return whether the microphone hears anything, and not too much; nothing where the rig has none."""
    if audio.channels.microphone is None:
        return ()
    from palpate.experiment.apparatus.audio import microphone as microphones

    loud = microphones.AudioMicrophone(stream, audio).loudness()
    return (
        judged(
            "microphone",
            not microphones.objection(loud),
            f"{loud.rms_db:.0f} dB re full scale{', clipped' if loud.clipped else ''}",
            allowed=f"above {microphones.SILENT_DB:g} dB, without clipping",
            remedy="plug it in, switch it on, set its level, and enter its input as audio.channels.microphone",
        ),
    )


def loopback(stream: AudioStream, audio: AudioRig, site: str | None = None) -> tuple[Finding, ...]:
    """Return whether the running stream's loopback is on time, as loud and as clean as the rig's `delivered` asks.

    The actuator moves meanwhile, with up to `PEAK` on its channel.
    """
    entry, tolerance = audio.channels.loopback, audio.delivered
    if entry is None:
        return (unchecked(LOOPBACK, "the rig has no audio.channels.loopback", "connect a cable, and add its input"),)
    try:
        found = audio_calibration.measure(stream, output=audio.channels.actuator, entry=entry, peak=PEAK, probes=PROBES)
    except AudioError as error:
        return (refused(LOOPBACK, error),)
    command = at_site(CALIBRATE_AUDIO, site)
    anew = "plug in the cable and restore the levels, then run {}"
    to_ms = 1e3 / audio.rate_hz
    calibrated_ms = audio.latency.output_ms + audio.latency.input_ms
    round_trip_ms, spread_ms = found.output_ms + found.input_ms, found.spread_frames * to_ms
    off_db = 20 * math.log10(found.gain / audio.latency.loopback_gain)
    return (
        judged(
            "loopback latency",
            abs(round_trip_ms - calibrated_ms) <= tolerance.onset_ms and spread_ms <= tolerance.onset_ms,
            f"round trip {round_trip_ms:.3f} ms, range {spread_ms:.3f} ms in {found.probes} probes",
            allowed=f"within {tolerance.onset_ms:g} ms (delivered.onset_ms) of the calibrated {calibrated_ms:.3f} ms",
            remedy=Remedy(f"restore audio.block and the device's buffer, {anew}", command, suffices=False),
        ),
        judged(
            "loopback level",
            abs(off_db) <= tolerance.gain_db and found.spread_db <= tolerance.gain_db,
            f"gain {found.gain:.4g} ({off_db:+.2f} dB), range {found.spread_db:.2f} dB",
            allowed=f"within {tolerance.gain_db:g} dB (delivered.gain_db) of the calibrated "
            f"{audio.latency.loopback_gain:g}",
            remedy=Remedy(anew, command, suffices=False),
        ),
        judged(
            "loopback residual",
            found.residual_db <= tolerance.residual_db,
            f"{found.residual_db:.0f} dB (worst of {found.probes} probes)",
            allowed=f"at most {tolerance.residual_db:g} dB (delivered.residual_db)",
            remedy="stop other playback, lower a level that clips, try another cable, or ground all devices together",
        ),
    )
