"""Footsteps in a protocol: their table and their rules."""

from collections.abc import Iterator
from importlib import import_module
from itertools import pairwise
from typing import Annotated, ClassVar, Literal, cast

from pydantic import Field

from palpate.experiment.protocol.kinds import ProtocolKind, is_number, list_at, number_at
from palpate.experiment.protocol.models import KindTable, Protocol, Step
from palpate.experiment.settings.load import ONE_LINE, Broken, Confined, Rules, Table, Text


def _synthesis_rules(table: Table) -> Iterator[Broken]:
    """Each of `speeds_mm_s` is greater than the one before it."""
    for i, (slower, faster) in enumerate(pairwise(list_at(table, "speeds_mm_s")), start=1):
        if is_number(slower) and is_number(faster) and faster <= slower:
            yield Broken(("speeds_mm_s", i), f"a number greater than the previous one ({slower})")


def _tactile_rules(table: Table) -> Iterator[Broken]:
    """`high_hz` is greater than `low_hz`."""
    low, high = number_at(table, "low_hz"), number_at(table, "high_hz")
    if low is not None and high is not None and high <= low:
        yield Broken(("high_hz",), f"a number greater than low_hz ({low})")


SLOWEST_MM_S, FASTEST_MM_S = 10.0, 10_000.0
"""No stepping foot is slower or faster."""


class Synthesis(Confined):
    """Recordings for virtual stimuli (section 3.1 of the source).

    Attributes:
        rate_hz: sampling rate.
        samples: length of a take.
        takes: takes per condition.
        speeds_mm_s: foot speeds, ascending.
        average: averaged are magnitudes of spectra, or signed coefficients.
        left_out_max: largest share (rms) of a vibration that a rig may leave out; rigs that leave out more or were not
            measured are refused.
    """

    RULES: ClassVar[Rules] = _synthesis_rules

    rate_hz: Annotated[int, Field(ge=100, le=192_000)]
    samples: Annotated[int, Field(ge=2, le=1_000_000)]
    takes: Annotated[int, Field(ge=1, le=100)]
    speeds_mm_s: Annotated[tuple[Annotated[float, Field(ge=SLOWEST_MM_S, le=FASTEST_MM_S)], ...], Field(min_length=2)]
    average: Literal["magnitude", "signed"] = "magnitude"
    left_out_max: Annotated[float, Field(gt=0, le=1)] | None = None


class Measured(Confined):
    """Thresholds measured on the participants' skin.

    Attributes:
        file: `thresholds.csv` that `palpate export` wrote for a study such as `sole.toml`, in the protocol's folder.
        sha256: its hash.
        whose: the floor is the lowest threshold of all participants, or of each one, matched by equal labels in both
            studies.
    """

    file: Annotated[str, Field(pattern=r"^[^/\\\s.][^/\\\s]*\.csv$", description="a .csv file beside it"), ONE_LINE]
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$", description="64 hexadecimal digits, as sha256sum prints")]
    whose: Literal["everybody", "participant"]


class Tactile(Confined):
    """Frequencies that skin and actuator can transmit.

    Attributes:
        low_hz: lowest frequency that counts.
        high_hz: highest.
        floor_m_s2: rms outside the band that is not felt, for any material; with `measured`, an upper limit.
        source: source of band and floor.
        measured: thresholds of the participants, whose lowest is the floor.
    """

    RULES: ClassVar[Rules] = _tactile_rules

    low_hz: Annotated[float, Field(ge=0)]
    high_hz: Annotated[float, Field(gt=0)]
    floor_m_s2: Annotated[float, Field(gt=0)]
    source: Text
    measured: Measured | None = Field(None, json_schema_extra={"since": 7})

    @property
    def band_hz(self) -> tuple[float, float]:
        """Lowest and highest frequency that count, Hz."""
        return self.low_hz, self.high_hz


class Footstep(KindTable):
    """Settings for trials of the kind `footstep`.

    Attributes:
        step: how the step is read.
        synthesis: what virtual stimuli are made of.
        tactile: which frequencies count.
        force: record each step's force with a sensor under the panel (`tracker.force` of the rig).
    """

    step: Step
    synthesis: Synthesis
    tactile: Tactile
    force: bool = Field(False, json_schema_extra={"since": 7})

    @property
    def gate(self) -> Step:
        return self.step

    @property
    def companions(self) -> dict[str, str]:
        return {} if (one := self.tactile.measured) is None else {one.file: one.sha256}


def _rules(table: Table) -> Iterator[Broken]:
    """Tasks of the kind `footstep` need `[footstep]` and always have the design `identification`."""
    if table.get("footstep") is None:
        yield Broken(("footstep",), "a table, because tasks of the kind 'footstep' need it")


def _floor_m_s2(protocol: Protocol, participant: str | None) -> float | None:
    if protocol.table(Footstep).tactile.measured is None:
        return None
    return cast("float", import_module("palpate.experiment.protocol.kinds.floor").floor_m_s2(protocol, participant))


KIND = ProtocolKind(table=Footstep, since=0, intervals=(1,), rules=_rules, floor_m_s2=_floor_m_s2)
