"""Check of an actuator behind a raw PCM port: its server answers. Nothing is sent, so nothing moves."""

from __future__ import annotations

from experiment.apparatus.pcm_actuator import PcmActuator
from experiment.apparatus.rig_panel import ActuatorRig
from experiment.checks.verdict import Check, refused
from experiment.errors import ActuatorError


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
