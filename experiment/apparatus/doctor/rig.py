"""Checks of a rig file: the table it names, its reach, and how old its calibrations are.

Check of an actuator behind a raw PCM port: its server answers. Nothing is sent, so nothing moves.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import date
from pathlib import Path

from experiment.apparatus import rig as rig_audio
from experiment.apparatus import rig as rigs
from experiment.apparatus.doctor.verdict import Check, judged, refused, unchecked
from experiment.apparatus.panel import response_table as response
from experiment.apparatus.panel.pcm_actuator import PcmActuator
from experiment.apparatus.rig import ActuatorRig, Rig, response_table
from experiment.apparatus.tracker import calibration
from experiment.errors import ActuatorError, PalpateError
from experiment.protocol.models import Step


def table(rig: Rig, folder: Path) -> Check | None:
    """Whether the response table is the one whose hash the rig file states, and can be used; None without one.

    Args:
        rig: the rig.
        folder: which holds the rig file.
    """
    shaping = rig.actuator.shaping
    if shaping is None:
        return None
    name = "response table"
    try:
        response_table(folder, shaping)
        measured = response.read(folder / shaping.response)
    except PalpateError as error:
        return refused(name, error)
    low_hz, high_hz = measured.frequencies_hz[0], measured.frequencies_hz[-1]
    return Check(name, "green", f"{shaping.response}: {low_hz:g} to {high_hz:g} Hz, hash as stated")


def reach(rig: Rig, step: Step) -> Check:
    """Whether the calibrated heights reach past a protocol's gate and panel."""
    name = "gate"
    try:
        rigs.check(rig, step)
    except PalpateError as error:
        return refused(name, error)
    heights_mm = [point.mm for point in rig.tracker.calibration]
    lowest, highest = rigs.reach_mm(rig, step)
    return judged(
        name,
        True,
        f"calibrated from {min(heights_mm):g} to {max(heights_mm):g} mm",
        allowed=f"from at most {lowest:g} to at least {highest:g} mm",
        remedy="",
    )


def ages(rig: Rig, today: date) -> tuple[Check, ...]:
    """How old the calibrations are: of the tracker, of the audio device's latency, of the headphones.

    Args:
        rig: the rig; those of a simulated one do not age.
        today: the day of the session.
    """
    tracker, audio = rig.tracker, rig.audio
    found = [
        _age(
            "tracker calibration",
            rig,
            lambda: calibration.check_age(rig, today),
            tracker.calibrated_on,
            tracker.calibration_days,
            today,
        )
    ]
    if audio is not None:
        made, days = audio.latency.calibrated_on, audio.latency.calibration_days
        found.append(_age("audio calibration", rig, lambda: rig_audio.check_latency(audio, today), made, days, today))
        made, days = audio.headphones.calibrated_on, audio.headphones.calibration_days
        found.append(_age("headphones", rig, lambda: rig_audio.check_headphones(audio, today), made, days, today))
    return tuple(found)


def _age(name: str, rig: Rig, check: Callable[[], None], made: date | None, days: int | None, today: date) -> Check:
    if rig.rig.simulated:
        return unchecked(name, "calibrations of a simulated rig do not age")
    try:
        check()
    except PalpateError as error:
        return refused(name, error)
    age = (today - made).days if made is not None else 0
    heard = "; its level: not checked, for the machine cannot hear it" if name == "headphones" else ""
    return judged(name, True, f"{age} days old{heard}", allowed=f"0 to {days} days", remedy="")


def answers(address: str, settings: ActuatorRig) -> Check:
    """Whether a connection is accepted.

    Args:
        address: `host:port`.
        settings: of the rig.
    """
    name = "actuator"
    try:
        PcmActuator(
            address, rate_hz=settings.rate_hz, full_scale=settings.full_scale, limit_m_s2=settings.full_scale
        ).reach()
    except ActuatorError as error:
        return refused(name, error)
    return Check(name, "green", f"{address} accepts a connection; nothing was sent")
