"""The force device of a rig file, and whether a block may be rendered on it."""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import Field

from palpate.experiment.errors import RigError
from palpate.experiment.settings.load import Address, Confined, Rules, port_rules

if TYPE_CHECKING:
    from palpate.experiment.protocol.kinds.tapping import Tapping


class ServoRig(Confined):
    """What pushes the hand.

    Attributes:
        driver: a server that takes palpate's force messages over TCP.
        address: of that server.
        full_scale_n: the largest force that the device can make.
        damping_n_s_m: the device's own physical damping, as measured without any force; it decides how stiff a block
            may be.
        delay_ms: from the hand's being somewhere until its force is there.
        answer_ms: the device answers each message within this time, or nothing more is pushed.
    """

    RULES: ClassVar[Rules] = port_rules

    driver: Literal["force-tcp"]
    address: Address
    full_scale_n: Annotated[float, Field(gt=0, le=1000)]
    damping_n_s_m: Annotated[float, Field(ge=0, le=1e4)]
    delay_ms: Annotated[float, Field(ge=0, le=20)]
    answer_ms: Annotated[float, Field(gt=0, le=100)]


def judged(virtual: Tapping, device: ServoRig) -> tuple[bool, str]:
    """Return whether a device may render a protocol's block, and in sentences how stiff it may be, and why."""
    from palpate.experiment.synthesis.stepping import stability

    delay_s = device.delay_ms / 1e3
    bound = stability.allowed(
        rate_hz=virtual.rate_hz,
        mass_kg=inf if virtual.mass_kg is None else virtual.mass_kg,
        damping_n_s_m=virtual.damping_n_s_m,
        device_damping_n_s_m=device.damping_n_s_m,
        delay_s=delay_s,
    )
    needed = stability.needed_damping_n_s_m(
        stiffness_n_m=virtual.stiffness_n_m,
        damping_n_s_m=virtual.damping_n_s_m,
        period_s=1 / virtual.rate_hz,
        delay_s=delay_s,
    )
    fits = virtual.stiffness_n_m <= bound.stiffness_n_m
    return fits, (
        f"{bound.text} The block has {virtual.stiffness_n_m:g} N/m and {virtual.damping_n_s_m:g} N s/m at "
        f"{virtual.rate_hz} Hz, with forces {device.delay_ms:g} ms late: that is passive on a device with "
        f"{needed:.4g} N s/m of its own, and this one has {device.damping_n_s_m:g} N s/m."
    )


def refuse_beyond(virtual: Tapping, device: ServoRig, *, rig: str) -> None:
    """Refuse, with a `RigError`, a block that the device of that rig does not bear."""
    fits, why = judged(virtual, device)
    if not fits:
        raise RigError(
            f"rig '{rig}'",
            "got a block that may give energy to the hand",
            allowed=f"a passive one. {why} Take a softer block, less damping, a faster servo, or a device with more "
            "damping of its own",
        )
