"""Taps on samples or on virtual surfaces in a protocol: their table and their rules."""

from collections.abc import Iterator
from math import ceil, inf, pi
from typing import Annotated

from pydantic import Field

from palpate.experiment.protocol.kinds import ProtocolKind, number_at, table_at, tables_at
from palpate.experiment.protocol.models import KindTable, Protocol
from palpate.experiment.settings.load import Broken, Confined, Key, Name, Table

OF_STEPS = ("frames-lost", "speed-below", "speed-above", "undelivered")
"""What only a footstep has, for an exclusion rule to judge."""


NUMBERS = ("delay_ms", "crossover_hz")
"""What surfaces may vary beside their waveforms: all or none state it."""


class VirtualSurface(Confined):
    """How a virtual surface vibrates when tapped.

    Attributes:
        material: whose surface it is.
        attack_hz: f of Wellman and Howe.
        amplitude: L of Wellman and Howe: strength at 200 mm/s, relative to `tapping.full_m_s2`.
        delay_ms: start of the vibration relative to the touch; negative means before it, which requires a prediction
            and an actuator on the audio device; for all surfaces or none.
        crossover_hz: the block's force is felt below it and the vibration above it (first-order filters); at least `K /
            (2 pi C)`; for all surfaces or none. The block then pushes only along its normal.
    """

    material: Name
    attack_hz: Annotated[float, Field(gt=0, le=20_000)]
    amplitude: Annotated[float, Field(ge=0, le=1)]
    delay_ms: Annotated[float, Field(ge=-20, le=50)] | None = Field(None, json_schema_extra={"since": 7})
    crossover_hz: Annotated[float, Field(gt=0, le=1000)] | None = Field(None, json_schema_extra={"since": 7})

    @property
    def after_ms(self) -> float:
        """How long after the touch it begins to vibrate, ms; before it where negative."""
        return self.delay_ms or 0.0


class Tapping(KindTable):
    """One block for all surfaces, and a vibration for each.

    In formats 2 and 3, these are in `[comparison.virtual]`, and `attack_hz` and `amplitude` are in materials.

    Attributes:
        switch_key: switches to the other surface.
        rate_hz: forces per second.
        stiffness_n_m: K of the block.
        damping_n_s_m: C of the block.
        mass_kg: M of the block; without it the block is fixed.
        full_m_s2: amplitude of a surface with `amplitude` 1, at 200 mm/s.
        decay_per_s: B, decay of every vibration.
        fastest_mm_s: a lamp lights if the hand is faster.
        surfaces: how the surface of each material vibrates.
        force_error_max: largest force error (relative rms) at rest or when tapping; rigs that exceed it or were not
            measured are refused.
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
        stated = {one.material: {key: getattr(one, key) for key in NUMBERS} for one in self.surfaces}
        known = {name: {key: of for key, of in one.items() if of is not None} for name, one in stated.items()}
        return {name: one for name, one in known.items() if one}

    @property
    def crossovers_hz(self) -> tuple[float, ...]:
        """The crossovers of all surfaces, rising; none where the force is felt at all frequencies."""
        return tuple(sorted({one.crossover_hz for one in self.surfaces if one.crossover_hz is not None}))

    @property
    def ahead_ms(self) -> float:
        """How long before the touch the earliest surface begins to vibrate, ms."""
        return max((-one.after_ms for one in self.surfaces if one.after_ms < 0), default=0.0)


def rendered(protocol: Protocol) -> Tapping | None:
    """Return how a study's virtual surfaces are rendered; None in a study without any."""
    return protocol.find(Tapping) if protocol.renders else None


def _rules(table: Table) -> Iterator[Broken]:
    """Tasks of the kind `tapping` always have the design `comparison`.

    A task whose `stimulus` is `virtual` needs `[tapping]` with a surface for each material, and
    `exposure.force_peak_n`; `masker.probe` is omitted; exclusion rules apply only to answers and withdrawals. If one
    surface has `delay_ms` or `crossover_hz`, all do. With crossovers, there is no `mass_kg` and no `force_error_max`.
    """
    if table_at(table, "masker").get("probe") is not None:
        yield Broken(("masker", "probe"), "no table: there is no probe for real samples")
    for i, rule in tables_at(table, "exclusion"):
        if rule.get("when") in OF_STEPS:
            yield Broken(("exclusion", i, "when"), "one of: answers-below, withdrawn, in a study with taps")
    ids = [one.get("id") for _, one in tables_at(table, "materials")]
    surfaces = [one.get("material") for _, one in tables_at(table_at(table, "tapping"), "surfaces")]
    if any(task.get("stimulus") == "virtual" for _, task in tables_at(table, "tasks")):
        yield from _lacking(table, [str(one) for one in ids if one not in surfaces])
    for i, one in enumerate(surfaces):
        if one not in ids or one in surfaces[:i]:
            allowed = f"one of the materials, each once: {', '.join(map(str, ids))}"
            yield Broken(("tapping", "surfaces", i, "material"), allowed)
    for key in NUMBERS:
        of = [one.get(key) for _, one in tables_at(table_at(table, "tapping"), "surfaces")]
        if any(one is None for one in of) and any(one is not None for one in of):
            unit = "milliseconds (0 at the touch)" if key == "delay_ms" else "hertz"
            yield Broken(
                ("tapping", "surfaces", of.index(None), key), f"a number of {unit}, because other surfaces have it"
            )
    yield from _crossed(table_at(table, "tapping"))


def _crossed(tapping: Table) -> Iterator[Broken]:
    """Yield what no block with crossovers has."""
    stated = [(i, number_at(one, "crossover_hz")) for i, one in tables_at(tapping, "surfaces")]
    crossovers = [(i, hz) for i, hz in stated if hz]
    if not crossovers:
        return
    for key in ("mass_kg", "force_error_max"):
        if tapping.get(key) is not None:
            yield Broken(
                ("tapping", key), "no value: with crossovers, the block is fixed and the force error is not known"
            )
    least_hz = least_crossover_hz(
        number_at(tapping, "stiffness_n_m") or 0.0, number_at(tapping, "damping_n_s_m") or 0.0
    )
    if least_hz == inf:
        yield Broken(("tapping", "damping_n_s_m"), "a number above 0: without a damper, a crossover is not passive")
        return
    for i, hz in crossovers:
        if hz < least_hz:
            up_hz = ceil(least_hz * 1e3) / 1e3
            allowed = f"at least {up_hz:.10g} Hz, K / (2 pi C): with a lower crossover the block is not passive"
            yield Broken(("tapping", "surfaces", i, "crossover_hz"), allowed)


def least_crossover_hz(stiffness_n_m: float, damping_n_s_m: float) -> float:
    """Return the lowest crossover of a block that is passive, K / (2 pi C), Hz: filtered below it, it gives energy."""
    return stiffness_n_m / (2 * pi * damping_n_s_m) if damping_n_s_m else inf


def _lacking(table: Table, without: list[str]) -> Iterator[Broken]:
    """Yield what virtual surfaces lack; these materials are `without` one."""
    if table.get("tapping") is None:
        yield Broken(("tapping",), "a table, because a task with virtual surfaces needs it")
    elif without:
        allowed = (
            "one for each material, because a task with virtual surfaces renders them all; missing: "
            f"{', '.join(without)}"
        )
        yield Broken(("tapping", "surfaces"), allowed)
    if table_at(table, "exposure").get("force_peak_n") is None:
        yield Broken(("exposure", "force_peak_n"), "a number of newtons, because a task with virtual surfaces needs it")


KIND = ProtocolKind(
    table=Tapping,
    since=4,
    intervals=(2,),
    at_will=True,
    rules=_rules,
    keys=lambda table: [(("tapping", "switch_key"), table_at(table, "tapping").get("switch_key"))],
)
