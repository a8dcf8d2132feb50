"""The force device of a rig file."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, ClassVar

from pydantic import Field

from palpate.experiment.settings.load import ONE_LINE, Broken, Confined, Line, Rules, driver_key, port_rules


def _servo_rules(table: Any) -> Iterator[Broken]:
    """`hand_damping_n_s_m` and `hand_damping_source` need each other, and both need `tip_mass_kg`."""
    yield from port_rules(table)
    hand, source = table.get("hand_damping_n_s_m"), table.get("hand_damping_source")
    if (hand is None) != (source is None):
        yield Broken(("hand_damping_source",), "hand_damping_n_s_m and its source, both or neither")
    if hand is not None and table.get("tip_mass_kg") is None:
        yield Broken(("tip_mass_kg",), "the mass of the device's tip, kg, together with hand_damping_n_s_m")


class ServoRig(Confined):
    """The device that pushes the hand.

    Attributes:
        driver: a server for palpate's force messages over TCP, or a class of a module as for the tracker.
        address: of the server, or for your own driver to open.
        full_scale_n: largest force of the device.
        damping_n_s_m: its measured damping; limits the stiffness of blocks.
        delay_ms: from the hand's position to its force.
        answer_ms: longest time to answer a message; after this time, the force ends.
        tip_mass_kg: moving mass, weighed; without it, speed is the difference between two samples.
        hand_damping_n_s_m: damping that a finger adds; 0 if omitted.
        hand_damping_source: who measured it.
        band_hz: frequency at which the force is 3 dB down; unlimited if omitted.
    """

    RULES: ClassVar[Rules] = _servo_rules

    driver: Annotated[str, driver_key("force-tcp"), ONE_LINE]
    address: Line
    full_scale_n: Annotated[float, Field(gt=0, le=1000)]
    damping_n_s_m: Annotated[float, Field(ge=0, le=1e4)]
    delay_ms: Annotated[float, Field(ge=0, le=20)]
    answer_ms: Annotated[float, Field(gt=0, le=100)]
    tip_mass_kg: Annotated[float, Field(gt=0, le=10)] | None = Field(None, json_schema_extra={"since": 6})
    hand_damping_n_s_m: Annotated[float, Field(ge=0, le=100)] | None = Field(None, json_schema_extra={"since": 6})
    hand_damping_source: Line | None = Field(None, json_schema_extra={"since": 6})
    band_hz: Annotated[float, Field(gt=0, le=1e5)] | None = Field(None, json_schema_extra={"since": 6})

    @property
    def borne_n_s_m(self) -> float:
        """The damping of the device and what is counted on from the hand, N s/m."""
        return self.damping_n_s_m + (self.hand_damping_n_s_m or 0.0)


def largest_force_n(allowed_n: float | None, device: ServoRig | None) -> float:
    """Return the largest force that a device gives where a protocol allows so much, N; none without a device."""
    return 0.0 if device is None else min(allowed_n or 0.0, device.full_scale_n)
