"""The panel's own devices in a rig file: what shakes it, and what measures it."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, cast

from pydantic import Field

from experiment.errors import RigError
from experiment.protocol.models import Confined
from experiment.protocol.rules import Broken, Rules

REHEARSAL = "rehearsal"
"""Stands for a port or an address that `palpate rehearse` fills in; only simulated rigs may say it."""


Address = Annotated[
    str,
    Field(
        pattern=r"^(rehearsal|(\[[0-9A-Fa-f:.]+\]|[^\s:\[\]/]+):[0-9]{1,5})$",
        description="host:port, such as 127.0.0.1:4711",
    ),
]


def _port_rules(table: Any) -> Iterator[Broken]:
    address = table.get("address")
    port = address.rpartition(":")[2] if isinstance(address, str) else ""
    if port.isdecimal() and not 1 <= int(port) <= 65535:
        yield Broken(("address",), "host:port with a port from 1 to 65535")


def _actuator_rules(table: Any) -> Iterator[Broken]:
    yield from _port_rules(table)
    driver, address = table.get("driver"), table.get("address")
    if driver == "pcm-tcp" and address is None:
        yield Broken(("address",), "host:port of its server, such as 127.0.0.1:4711")
    elif driver == "audio" and address is not None:
        yield Broken(("address",), "no address with driver 'audio': [audio] names the device")
    takes = [key for key in ("full_scale_m_s2", "shaping") if table.get(key) is not None]
    if len(takes) != 1:
        yield Broken(
            ("full_scale_m_s2",),
            "this key for a device that takes accelerations, the table [actuator.shaping] for one that takes volts; "
            "exactly one of them",
        )


class ShapingRig(Confined):
    """How a device that takes volts moves the panel, as measured: frequency shaping (Okamoto et al., equation (7)).

    `response` is a table of `experiment/recordings/response.py`, in the folder of the rig file; its hash stands here,
    so that the rig's own hash names one measurement. No bin of a stimulus takes more than `gain_limit_v_per_m_s2`:
    near a null of the response the voltage would grow without bound.
    """

    response: Annotated[
        str, Field(pattern=r"^[^/\\\s]+\.csv$", description="the name of a .csv file in the folder of the rig file")
    ]
    response_sha256: Annotated[
        str, Field(pattern=r"^[0-9a-f]{64}$", description="64 hexadecimal digits, as sha256sum prints them")
    ]
    full_scale_v: Annotated[float, Field(gt=0, le=1000)]
    gain_limit_v_per_m_s2: Annotated[float, Field(gt=0, le=1000)]


class ActuatorRig(Confined):
    """What shakes the panel: a raw PCM port of its own, or a channel of the rig's audio device.

    A device that takes accelerations has `full_scale_m_s2`, one that takes volts has `shaping` with `full_scale_v`.
    Samples go out divided by it, so that 1.0 is the device's full scale.
    """

    RULES: ClassVar[Rules] = _actuator_rules

    driver: Literal["pcm-tcp", "audio"]
    address: Address | None = None
    rate_hz: Annotated[int, Field(ge=1000, le=192_000)]
    full_scale_m_s2: Annotated[float, Field(gt=0, le=1000)] | None = None
    shaping: ShapingRig | None = None

    @property
    def full_scale(self) -> float:
        """What a sample of 1.0 is: V where there is `shaping`, else m/s^2."""
        if self.shaping is not None:
            return self.shaping.full_scale_v
        # The rules refuse a rig with neither.
        return cast("float", self.full_scale_m_s2)


def _accelerometer_rules(table: Any) -> Iterator[Broken]:
    yield from _port_rules(table)
    full_scale, trigger = table.get("full_scale_m_s2"), table.get("trigger_m_s2")
    if isinstance(full_scale, int | float) and isinstance(trigger, int | float) and trigger >= full_scale:
        yield Broken(("trigger_m_s2",), f"less than full_scale_m_s2 ({full_scale})")


class AccelerometerRig(Confined):
    """What measures the panel while takes are recorded; a sample of 1.0 stands for `full_scale_m_s2`.

    A take begins where a magnitude reaches `trigger_m_s2`: above the noise of the panel at rest, below what matters.
    """

    RULES: ClassVar[Rules] = _accelerometer_rules

    driver: Literal["pcm-tcp"]
    address: Address
    rate_hz: Annotated[int, Field(ge=100, le=192_000)]
    full_scale_m_s2: Annotated[float, Field(gt=0, le=10_000)]
    trigger_m_s2: Annotated[float, Field(gt=0)]


def response_table(folder: Path, shaping: ShapingRig) -> bytes:
    """The response table that a rig file names, as it stands on disk.

    Args:
        folder: which holds the rig file.
        shaping: of the rig.

    Raises:
        RigError: it cannot be read, or is not the one whose hash the rig file states.
    """
    path = folder / shaping.response
    try:
        content = path.read_bytes()
    except OSError as error:
        raise RigError(
            f"{path}: cannot be read ({error.strerror}); allowed: the response table of the rig file; restore it"
        ) from error
    digest = hashlib.sha256(content).hexdigest()
    if digest != shaping.response_sha256:
        raise RigError(
            f"{path}: got a table with sha256 {digest}; allowed: {shaping.response_sha256}, as the rig file says; "
            "restore the table, or write its sha256 into the rig file after measuring anew"
        )
    return content
