"""Taps on samples or on virtual surfaces in a protocol: their rules, and what a board's page says of them."""

from collections.abc import Iterator
from math import log
from typing import Annotated

from pydantic import Field

from palpate.experiment.protocol.blocks import Block, Item, Said, named, number
from palpate.experiment.protocol.kinds import ProtocolKind, table_at, tables_at
from palpate.experiment.protocol.models import KindTable, Protocol, Task
from palpate.experiment.settings.load import Broken, Confined, Key, Name, Table

OF_STEPS = ("frames-lost", "speed-below", "speed-above", "undelivered")
"""What only a footstep has, for an exclusion rule to judge."""


class VirtualSurface(Confined):
    """How a virtual surface vibrates at a tap, as a material rings.

    Attributes:
        material: whose surface it is.
        attack_hz: the frequency at which a tap on it rings: f of Wellman and Howe.
        amplitude: how strongly it rings at 200 mm/s, as a part of `tapping.full_m_s2`: L of Wellman and Howe.
    """

    material: Name
    attack_hz: Annotated[float, Field(gt=0, le=20_000)]
    amplitude: Annotated[float, Field(ge=0, le=1)]


class Tapping(KindTable):
    """How surfaces are rendered: one block for all of them, and a vibration at the touch that is each one's own.

    A file of format 2 or 3 has it as `[comparison.virtual]`, and `attack_hz` and `amplitude` of each surface in its
    material.

    Attributes:
        switch_key: the experimenter's key for the participant's change to the other surface.
        rate_hz: forces a second.
        stiffness_n_m: K of the block, along its normal.
        damping_n_s_m: C of the block.
        mass_kg: M of the block; left out, the block is held.
        full_m_s2: the amplitude of a surface with an `amplitude` of 1, at 200 mm/s.
        decay_per_s: B, how fast every vibration fades.
        fastest_mm_s: a lamp says when the hand is faster.
        surfaces: how the surface of each material vibrates.
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


def rendered(protocol: Protocol) -> Tapping | None:
    """Return how a study's virtual surfaces are rendered; None in a study without any."""
    return protocol.find(Tapping) if protocol.renders else None


def _rules(table: Table) -> Iterator[Broken]:
    """The kind `tapping` is of the design `comparison`.

    A task whose `stimulus` is `virtual` needs `[tapping]` with a surface for each material, and
    `exposure.force_peak_n`; `masker.probe` is left out; exclusion rules judge answers and withdrawals.
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


def _lacking(table: Table, without: list[str]) -> Iterator[Broken]:
    """Yield what virtual surfaces lack; these materials are `without` one."""
    if table.get("tapping") is None:
        yield Broken(("tapping",), "a table: a task with virtual surfaces needs it")
    elif without:
        allowed = f"one for each material, also for {', '.join(without)}: a task with virtual surfaces renders them all"
        yield Broken(("tapping", "surfaces"), allowed)
    if table_at(table, "exposure").get("force_peak_n") is None:
        yield Broken(("exposure", "force_peak_n"), "a number of newtons: a task with virtual surfaces needs it")


def _stimuli(protocol: Protocol) -> Iterator[Block]:
    if any(task.stimulus == "real" for task in protocol.tasks):
        yield Said(
            "Two real samples lie before the participant in each trial, who tries them as often as they wish, and "
            "changes from one to the other as often as they wish. No device moves or vibrates, and nobody tells the "
            "participant whether an answer was right."
        )
    if (virtual := rendered(protocol)) is not None:
        yield from _rendered(protocol, virtual)


def _rendered(protocol: Protocol, virtual: Tapping) -> Iterator[Block]:
    mass = "is held" if virtual.mass_kg is None else f"has a mass of {number(virtual.mass_kg)} kg"
    yield Said(
        "In a task with virtual surfaces the hand moves a device, which pushes it back where a block begins. All "
        f"surfaces have one block: a spring of {number(virtual.stiffness_n_m)} N/m and a damper of "
        f"{number(virtual.damping_n_s_m)} N s/m, and it {mass}. The force is computed {virtual.rate_hz} times a second "
        f"and is never above {number(protocol.exposure.force_peak_n or 0.0)} N. It falls to zero, as does the "
        "vibration, where the device, the tracker or the program fails."
    )
    yield Said(
        "At the touch the finger is vibrated as a tap rings: a sinusoid that fades by exp(-t B), with B = "
        f"{number(virtual.decay_per_s)} /s, and grows with the speed of the tap. Its frequency, and its amplitude at "
        "200 mm/s:"
    )
    for one in virtual.surfaces:
        ring = round(one.amplitude * virtual.full_m_s2, 6)
        yield Item(f"{named(one.material)}: {number(one.attack_hz)} Hz, {number(ring)} m/s^2.")
    yield Said(
        "The participant changes from one surface of a pair to the other as often as they wish: they say so, and the "
        f"experimenter presses [{virtual.switch_key}]. No answer is taken before both were tapped. A lamp says when "
        f"the hand is faster than {number(virtual.fastest_mm_s)} mm/s. Nobody tells the participant whether an answer "
        "was right."
    )


def _felt(protocol: Protocol, task: Task) -> str:
    if (virtual := rendered(protocol)) is None:
        return ""
    faded_ms = 1e3 * log(1e3) / virtual.decay_per_s
    told = f"In task {task.id} the finger vibrates at every tap, and nothing limits taps but the time."
    return f"{told} Each time it has faded to a thousandth after {faded_ms:.0f} ms."


def _recorded(protocol: Protocol) -> str:
    if rendered(protocol) is None:
        return ""
    return "the time and the speed of each tap on a virtual surface, each change from one to the other, "


KIND = ProtocolKind(
    table=Tapping,
    since=4,
    intervals=(2,),
    at_will=True,
    rules=_rules,
    keys=lambda table: [(("tapping", "switch_key"), table_at(table, "tapping").get("switch_key"))],
    sources={
        "virtual": "virtual: surfaces that the rig renders",
        "real": "real: the experimenter lays out both samples before each trial",
    },
    recorded=_recorded,
    stimuli=_stimuli,
    felt=_felt,
)
