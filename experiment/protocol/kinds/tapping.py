"""Taps on samples or on virtual surfaces in a protocol: their table and their rules."""

from collections.abc import Iterator
from typing import Annotated

from pydantic import Field

from palpate.experiment.protocol.kinds import ProtocolKind, table_at, tables_at
from palpate.experiment.protocol.models import KindTable, Protocol
from palpate.experiment.settings.load import Broken, Confined, Key, Name, Table

OF_STEPS = ("frames-lost", "speed-below", "speed-above", "undelivered")
"""What only a footstep has, for an exclusion rule to judge."""


class VirtualSurface(Confined):
    """How a virtual surface rings at a tap.

    Attributes:
        material: whose surface it is.
        attack_hz: f of Wellman and Howe.
        amplitude: L of Wellman and Howe: strength at 200 mm/s, as a part of `tapping.full_m_s2`.
        delay_ms: so long after the touch it begins to vibrate; below zero before it, which takes a prediction and an
            actuator on the audio device; all surfaces or none state it.
    """

    material: Name
    attack_hz: Annotated[float, Field(gt=0, le=20_000)]
    amplitude: Annotated[float, Field(ge=0, le=1)]
    delay_ms: Annotated[float, Field(ge=-20, le=50)] | None = Field(None, json_schema_extra={"since": 7})

    @property
    def after_ms(self) -> float:
        """How long after the touch it begins to vibrate, ms; before it where negative."""
        return self.delay_ms or 0.0


class Tapping(KindTable):
    """One block for all surfaces, and a vibration for each.

    Formats 2 and 3 have it as `[comparison.virtual]`, `attack_hz` and `amplitude` in materials.

    Attributes:
        switch_key: changes to the other surface.
        rate_hz: forces a second.
        stiffness_n_m: K of the block.
        damping_n_s_m: C of the block.
        mass_kg: M of the block; without it the block is held.
        full_m_s2: amplitude of a surface with `amplitude` 1, at 200 mm/s.
        decay_per_s: B, decay of every vibration.
        fastest_mm_s: a lamp shows faster hands.
        surfaces: how the surface of each material vibrates.
        force_error_max: largest error of the force (rms, as a part of the law) at rest or tapping; other rigs, and
            unmeasured ones, are refused.
    """

    switch_key: Key
    rate_hz: Annotated[int, Field(ge=500, le=5000)]
    stiffness_n_m: Annotated[float, Field(ge=0, le=1e6)]
    damping_n_s_m: Annotated[float, Field(ge=0, le=1e4)]
    mass_kg: Annotated[float, Field(gt=0, le=1000)] | None = None
    full_m_s2: Annotated[float, Field(gt=0, le=1000)]
    decay_per_s: Annotated[float, Field(ge=20, le=10_000)]
    fastest_mm_s: Annotated[float, Field(gt=0, le=1000)]
    surfaces: tuple[VirtualSurface, ...] = ()
    force_error_max: Annotated[float, Field(gt=0, le=1)] | None = Field(None, json_schema_extra={"since": 7})

    @property
    def numbers(self) -> dict[str, dict[str, float]]:
        delays = ((one.material, one.delay_ms) for one in self.surfaces)
        return {material: {"delay_ms": delay_ms} for material, delay_ms in delays if delay_ms is not None}

    @property
    def ahead_ms(self) -> float:
        """How long before the touch the earliest surface begins to vibrate, ms."""
        return max((-one.after_ms for one in self.surfaces if one.after_ms < 0), default=0.0)


def rendered(protocol: Protocol) -> Tapping | None:
    """Return how a study's virtual surfaces are rendered; None in a study without any."""
    return protocol.find(Tapping) if protocol.renders else None


def _rules(table: Table) -> Iterator[Broken]:
    """The kind `tapping` is of the design `comparison`.

    A task whose `stimulus` is `virtual` needs `[tapping]` with a surface for each material, and
    `exposure.force_peak_n`; `masker.probe` is left out; exclusion rules judge answers and withdrawals; where one
    surface has `delay_ms`, all have.
    """
    if table_at(table, "masker").get("probe") is not None:
        yield Broken(("masker", "probe"), "no table: real samples play no probe")
    for i, rule in tables_at(table, "exclusion"):
        if rule.get("when") in OF_STEPS:
            yield Broken(("exclusion", i, "when"), "one of: answers-below, withdrawn, with taps")
    ids = [one.get("id") for _, one in tables_at(table, "materials")]
    surfaces = [one.get("material") for _, one in tables_at(table_at(table, "tapping"), "surfaces")]
    if any(task.get("stimulus") == "virtual" for _, task in tables_at(table, "tasks")):
        yield from _lacking(table, [str(one) for one in ids if one not in surfaces])
    for i, one in enumerate(surfaces):
        if one not in ids or one in surfaces[:i]:
            allowed = f"one of the materials, each once: {', '.join(map(str, ids))}"
            yield Broken(("tapping", "surfaces", i, "material"), allowed)
    delays = [one.get("delay_ms") for _, one in tables_at(table_at(table, "tapping"), "surfaces")]
    if any(one is None for one in delays) and any(one is not None for one in delays):
        allowed = "a number of milliseconds, 0 at the touch: other surfaces state it"
        yield Broken(("tapping", "surfaces", delays.index(None), "delay_ms"), allowed)


def _lacking(table: Table, without: list[str]) -> Iterator[Broken]:
    """Yield what virtual surfaces lack; these materials are `without` one."""
    if table.get("tapping") is None:
        yield Broken(("tapping",), "a table: a task with virtual surfaces needs it")
    elif without:
        allowed = f"one for each material, also for {', '.join(without)}: a task with virtual surfaces renders them all"
        yield Broken(("tapping", "surfaces"), allowed)
    if table_at(table, "exposure").get("force_peak_n") is None:
        yield Broken(("exposure", "force_peak_n"), "a number of newtons: a task with virtual surfaces needs it")


KIND = ProtocolKind(
    table=Tapping,
    since=4,
    intervals=(2,),
    at_will=True,
    rules=_rules,
    keys=lambda table: [(("tapping", "switch_key"), table_at(table, "tapping").get("switch_key"))],
)
