"""Error against run time of everything in `experiment.synthesis`, and what holds in extreme cases."""

from __future__ import annotations

import platform
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata

from analysis.numerics import cases
from analysis.numerics.cases import Outcome, settle
from analysis.numerics.measured import FULL, QUICK, Extent, Measured, measurements
from analysis.numerics.oracle import extended_epsilon

LABEL = "SIMULATED spectra"
"""No recording is measured here; stands on everything."""


@dataclass(frozen=True)
class Numerics:
    """What was measured, and what became of every case.

    `report.py` says it in words and figures.

    Attributes:
        software: name -> version, and the rounding of the oracle.
        measured: in the order of the tables.
        outcomes: of the extreme cases.
    """

    software: dict[str, str]
    measured: tuple[Measured, ...]
    outcomes: tuple[Outcome, ...]

    @property
    def failed(self) -> bool:
        """Whether an invariant is broken, or an error above what its way claims."""
        return bool(self.broken)

    @property
    def broken(self) -> tuple[str, ...]:
        """One line for each invariant and each claim that does not hold."""
        claims = [
            f"{one.subject}, {one.way}: error {one.error:.2g}, above {one.claimed:.2g} claimed"
            if one.claimed is not None
            else f"{one.subject}, {one.way}: error {one.error:.2g}"
            for one in self.measured
            if not one.holds
        ]
        invariants = [f"{one.group}, {one.given}: {one.seen}" for one in self.outcomes if not one.holds]
        return (*claims, *invariants)

    @property
    def verdict(self) -> str:
        """In one sentence, and a line for each thing that does not hold."""
        claimed = sum(one.claimed is not None for one in self.measured)
        every = f"{claimed} claimed bounds on errors and {len(self.outcomes)} invariants"
        if not self.failed:
            return f"All of {every} hold."
        return "\n".join([f"{len(self.broken)} of {every} do not hold:", *(f"  {line}" for line in self.broken)])


def run(
    *,
    quick: bool,
    total: Callable[[int], None] = lambda _: None,
    tick: Callable[[], None] = lambda: None,
) -> Numerics:
    """Measure everything, and find out what holds.

    Args:
        quick: fewer sizes and repeats.
        total: told how many steps there are.
        tick: called after each.
    """
    return compute(QUICK if quick else FULL, total=total, tick=tick)


def compute(
    extent: Extent,
    *,
    total: Callable[[int], None] = lambda _: None,
    tick: Callable[[], None] = lambda: None,
) -> Numerics:
    """The same to any extent; arguments as in `run`."""
    wanted = measurements(extent)
    extremes = cases.cases()
    total(len(wanted) + len(extremes))
    measured, outcomes = [], []
    for measure in wanted:
        measured.append(measure())
        tick()
    for case in extremes:
        outcomes.append(settle(case))
        tick()
    return Numerics(_software(), tuple(measured), tuple(outcomes))


def _software() -> dict[str, str]:
    packages = {name: metadata.version(name) for name in ("palpate", "numpy", "scipy")}
    return {**packages, "python": platform.python_version(), "oracle_epsilon": f"{extended_epsilon():.1e}"}
