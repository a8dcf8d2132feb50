"""What a recording is of: materials, speeds and takes, in the order of the walk."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from experiment.errors import RecordingError
from experiment.protocol import approval
from experiment.protocol.models import Protocol

SLOWEST_MM_S = 10.0
FASTEST_MM_S = 10_000.0
"""No foot that steps is slower, and none is faster."""


@dataclass(frozen=True)
class Condition:
    """What one take is of.

    Attributes:
        material: on the panel; None for the bare panel.
        speed_mm_s: target of the foot, mm/s.
        number: from 1, among takes of one material at one speed.
    """

    material: str | None
    speed_mm_s: float
    number: int


@dataclass(frozen=True)
class Plan:
    """What is recorded; kept on disk while it is under way.

    Attributes:
        source: the rig, or the simulation with its seed.
        protocol_sha256: of the protocol's canonical form.
        rig_sha256: of what the rig file states.
        simulated: whether a simulation makes the takes.
        materials: ids, after the bare panel.
        speeds_mm_s: targets, rising, mm/s.
        takes: of each condition.
        rate_hz: of the takes, Hz.
        samples: length of a take.
    """

    source: str
    protocol_sha256: str
    rig_sha256: str
    simulated: bool
    materials: tuple[str, ...]
    speeds_mm_s: tuple[float, ...]
    takes: int
    rate_hz: int
    samples: int

    def conditions(self) -> tuple[Condition, ...]:
        """Every take, in order: the bare panel first, then the materials; slow to fast."""
        return tuple(
            Condition(material, speed_mm_s, number)
            for material in (None, *self.materials)
            for speed_mm_s in self.speeds_mm_s
            for number in range(1, self.takes + 1)
        )


def plan(
    protocol: Protocol,
    *,
    source: str,
    simulated: bool,
    rig_sha256: str = "",
    speeds_mm_s: tuple[float, ...] = (),
    takes: int | None = None,
) -> Plan:
    """What a protocol has recorded.

    Args:
        protocol: materials, rate and length; speeds and takes unless given.
        source: see `Plan`.
        simulated: see `Plan`.
        rig_sha256: see `Plan`; empty where no rig records.
        speeds_mm_s: instead of the protocol's, such as those of fresh takes; empty for the protocol's.
        takes: instead of the protocol's.

    Raises:
        RecordingError: speeds that do not rise or that no foot has, or no take.
    """
    speeds = tuple(float(v) for v in speeds_mm_s) or protocol.footstep.synthesis.speeds_mm_s
    if not (all(SLOWEST_MM_S <= v <= FASTEST_MM_S for v in speeds) and all(np.diff(speeds) > 0)):
        raise RecordingError(
            f"speeds: got {', '.join(f'{v:g}' for v in speeds)} mm/s; allowed: {SLOWEST_MM_S:g} to {FASTEST_MM_S:g}, "
            "each above the one before; give such speeds in rising order"
        )
    count = protocol.footstep.synthesis.takes if takes is None else takes
    if not 1 <= count <= 100:
        raise RecordingError(f"takes: got {count}; allowed: 1 to 100; give another number")
    return Plan(
        source=source,
        protocol_sha256=approval.sha256(protocol),
        rig_sha256=rig_sha256,
        simulated=simulated,
        materials=tuple(material.id for material in protocol.materials),
        speeds_mm_s=speeds,
        takes=count,
        rate_hz=protocol.footstep.synthesis.rate_hz,
        samples=protocol.footstep.synthesis.samples,
    )
