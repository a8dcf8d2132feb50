"""Footsteps in a protocol: their rules, and what a board's page says of them."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from palpate.experiment.protocol.blocks import Block, Quoted, Said, count, number
from palpate.experiment.protocol.kinds import ProtocolKind, is_number, list_at, number_at
from palpate.experiment.protocol.models import KindTable, Protocol, Step, Task
from palpate.experiment.settings.load import Broken, Confined, Rules, Table, Text


def _synthesis_rules(table: Table) -> Iterator[Broken]:
    """Each of `speeds_mm_s` is greater than the one before it."""
    for i, (slower, faster) in enumerate(pairwise(list_at(table, "speeds_mm_s")), start=1):
        if is_number(slower) and is_number(faster) and faster <= slower:
            yield Broken(("speeds_mm_s", i), f"a number greater than the one before it ({slower})")


def _tactile_rules(table: Table) -> Iterator[Broken]:
    """`high_hz` is greater than `low_hz`."""
    low, high = number_at(table, "low_hz"), number_at(table, "high_hz")
    if low is not None and high is not None and high <= low:
        yield Broken(("high_hz",), f"a number greater than low_hz ({low})")


SLOWEST_MM_S, FASTEST_MM_S = 10.0, 10_000.0
"""No stepping foot is slower or faster."""


class Synthesis(Confined):
    """Recordings from which virtual stimuli are made (section 3.1 of the source).

    Attributes:
        rate_hz: the sampling rate of the recordings.
        samples: how long each take is, in samples.
        takes: how often each condition is recorded.
        speeds_mm_s: the speeds of the foot at which recordings are made.
        average: what of the takes is averaged: the magnitudes of their spectra, or signed coefficients.
        left_out_max: the largest share of a vibration (rms) that a rig may leave out: frequencies beyond its band, and
            what it holds back of others; no participant is run on one that leaves out more, or of which nobody knows.
    """

    RULES: ClassVar[Rules] = _synthesis_rules

    rate_hz: Annotated[int, Field(ge=100, le=192_000)]
    samples: Annotated[int, Field(ge=2, le=1_000_000)]
    takes: Annotated[int, Field(ge=1, le=100)]
    speeds_mm_s: Annotated[tuple[Annotated[float, Field(ge=SLOWEST_MM_S, le=FASTEST_MM_S)], ...], Field(min_length=2)]
    average: Literal["magnitude", "signed"] = "magnitude"
    left_out_max: Annotated[float, Field(gt=0, le=1)] | None = None


class Tactile(Confined):
    """What skin and actuator can pass; what lies outside may be left out where it stays below the floor.

    Attributes:
        low_hz: the lowest frequency that counts.
        high_hz: the highest frequency that counts.
        floor_m_s2: rms of all that lies outside the band together, below which it is not felt, in any material of a
            task.
        source: where band and floor come from.
    """

    RULES: ClassVar[Rules] = _tactile_rules

    low_hz: Annotated[float, Field(ge=0)]
    high_hz: Annotated[float, Field(gt=0)]
    floor_m_s2: Annotated[float, Field(gt=0)]
    source: Text

    @property
    def band_hz(self) -> tuple[float, float]:
        """Lowest and highest frequency that count, Hz."""
        return self.low_hz, self.high_hz


class Footstep(KindTable):
    """What trials of the kind `footstep` need.

    Attributes:
        step: how the step is read.
        synthesis: what virtual stimuli are made of.
        tactile: which frequencies count.
    """

    step: Step
    synthesis: Synthesis
    tactile: Tactile

    @property
    def gate(self) -> Step:
        return self.step


_AVERAGED = {"magnitude": "magnitudes of their spectra", "signed": "signed coefficients of their spectra"}


def _rules(table: Table) -> Iterator[Broken]:
    """The kind `footstep` needs `[footstep]` and is of the design `identification`."""
    if table.get("footstep") is None:
        yield Broken(("footstep",), "a table: tasks of the kind 'footstep' need it")


def _stimuli(protocol: Protocol) -> Iterator[Block]:
    yield from _synthesised(protocol.table(Footstep)) if protocol.renders else ()
    yield from _steps(protocol.table(Footstep).step)


def _synthesised(footstep: Footstep) -> Iterator[Block]:
    synthesis, tactile = footstep.synthesis, footstep.tactile
    speeds = ", ".join(map(number, synthesis.speeds_mm_s))
    yield Said(
        f"Virtual stimuli are made from recordings of the real materials: {count(synthesis.takes, 'take')} at each of "
        f"the speeds {speeds} mm/s, each of {synthesis.samples} samples at {synthesis.rate_hz} Hz "
        f"({number(synthesis.samples / synthesis.rate_hz)} s). The average over takes is that of the "
        f"{_AVERAGED[synthesis.average]}."
    )
    yield Said(
        f"Frequencies outside {number(tactile.low_hz)} to {number(tactile.high_hz)} Hz are left out of every stimulus "
        f"of a task if together they stay below {number(tactile.floor_m_s2)} m/s^2 (rms) in every material; otherwise "
        "they all stay in. Source:"
    )
    yield Quoted(tactile.source)
    yield Said(
        "The protocol sets no limit to what a rig may leave out of a stimulus because it cannot carry those "
        "frequencies. Each trial's record says what share was left out."
        if synthesis.left_out_max is None
        else f"No session is run on a rig that leaves out more than {synthesis.left_out_max * 100:.10g} % of the "
        "vibration (rms) of any material, at any speed that counts, because it cannot carry those frequencies, or of "
        "which nobody knows what it carries."
    )


def _steps(step: Step) -> Iterator[Block]:
    yield Said(
        f"The speed of the foot is measured while it moves down from {number(step.gate_top_mm)} to "
        f"{number(step.gate_bottom_mm)} mm above the panel, and the stimulus starts when it reaches "
        f"{number(step.contact_mm)} mm. If the foot stops, turns back or hesitates on the way, no stimulus is played "
        "and the trial is at once made ready (armed) for another step."
    )


def _felt(protocol: Protocol, task: Task) -> str:
    synthesis = protocol.table(Footstep).synthesis
    total_s = number(round(protocol.trials(task) * synthesis.samples / synthesis.rate_hz, 1))
    return f"In task {task.id} the panel vibrates for {total_s} s in all, if no trial is repeated."


def _odd(protocol: Protocol) -> Iterator[tuple[str, str, str]]:
    high_hz, rate_hz = protocol.table(Footstep).tactile.high_hz, protocol.table(Footstep).synthesis.rate_hz
    if high_hz > rate_hz / 2:
        half = f"as a rule at most {rate_hz / 2:g}, half of footstep.synthesis.rate_hz"
        yield "footstep.tactile.high_hz", f"{high_hz:g}", f"{half}: recordings hold no frequency above"


KIND = ProtocolKind(
    table=Footstep,
    intervals=(1,),
    rules=_rules,
    sources={
        "virtual": "virtual: vibration of the panel, synthesised from recordings",
        "real": "real: the experimenter lays out the real object before each trial",
    },
    recorded=lambda _: "the height of the foot over time, the speed and time of each step, ",
    stimuli=_stimuli,
    felt=_felt,
    odd=_odd,
)
