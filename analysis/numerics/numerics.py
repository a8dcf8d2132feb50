"""Error against run time of everything in `experiment.synthesis`, and what holds in extreme cases."""

from __future__ import annotations

import platform
import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from analysis.documents.output import check, publish
from analysis.documents.tables import WIDTH, Section, comma_separated, markdown, text
from analysis.numerics import cases, refusals
from analysis.numerics.cases import Outcome, settle
from analysis.numerics.measured import FULL, QUICK, Extent, Measured, measurements
from analysis.numerics.oracle import extended_epsilon
from analysis.numerics.refusals import Limit
from experiment.errors import DatasetError

LABEL = "SIMULATED spectra"
"""No recording is measured here; stands on everything."""


FILES = (
    *(f"{slug}.csv" for slug in ("synthesis", "resampling", "shaping", "noise", "cases")),
    *(f"numerics.{kind}" for kind in ("md", "svg", "png")),
)
"""What `write` writes."""


@dataclass(frozen=True)
class Numerics:
    """What was measured, and what became of every case.

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

    def sections(self) -> tuple[Section, ...]:
        """The report's parts."""
        from analysis.numerics.report import sections

        return sections(self)

    def text(self, width: int = WIDTH) -> str:
        """Everything for a terminal; the verdict stands at the end."""
        verdict = (textwrap.fill(line, width, subsequent_indent="    ") for line in self.verdict.splitlines())
        return "\n\n\n".join([LABEL, *(text(section, width) for section in self.sections()), "\n".join(verdict)])

    def as_dict(self) -> dict[str, Any]:
        """Every number and outcome, for JSON."""
        rows = {section.slug: [dict(record) for record in section.records] for section in self.sections()}
        return {
            "label": LABEL,
            "software": self.software,
            "failed": self.failed,
            "broken": list(self.broken),
            **rows,
        }


def run(
    *,
    quick: bool,
    limit: Limit,
    total: Callable[[int], None] = lambda _: None,
    tick: Callable[[], None] = lambda: None,
) -> Numerics:
    """Measure everything, and find out what holds.

    Args:
        quick: fewer sizes and repeats.
        limit: the limiter (`experiment.synthesis.limiter.limit`).
        total: told how many steps there are.
        tick: called after each.
    """
    return compute(QUICK if quick else FULL, limit=limit, total=total, tick=tick)


def compute(
    extent: Extent,
    *,
    limit: Limit,
    total: Callable[[int], None] = lambda _: None,
    tick: Callable[[], None] = lambda: None,
) -> Numerics:
    """The same to any extent; arguments as in `run`."""
    wanted = measurements(extent)
    extremes = [*cases.cases(), *refusals.cases(limit)]
    total(len(wanted) + len(extremes))
    measured, outcomes = [], []
    for measure in wanted:
        measured.append(measure())
        tick()
    for case in extremes:
        outcomes.append(settle(case))
        tick()
    return Numerics(_software(), tuple(measured), tuple(outcomes))


def check_out(out: Path) -> None:
    """Refuse, before anything is measured, a folder that `write` could not write into.

    Raises:
        DatasetError: a folder within a dataset, a file in the way, or the file system refuses.
    """
    check(out, FILES, "numerics")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DatasetError(f"cannot write {error.filename or out}: {error.strerror}; choose another --out") from error


def write(result: Numerics, out: Path) -> tuple[Path, ...]:
    """Write tables (CSV, Markdown) and the plot (PNG, SVG) into a folder.

    Args:
        result: of `run`.
        out: the folder; replaced there is only what this wrote before.

    Returns:
        The files.

    Raises:
        DatasetError: a folder within a dataset, a file in the way, or the file system refuses.
    """
    from analysis.documents import drawing
    from analysis.numerics import report

    sections = result.sections()
    files = {f"{section.slug}.csv": comma_separated(section, LABEL).encode() for section in sections}
    parts = (markdown(section, "") for section in sections)
    files["numerics.md"] = "\n".join([f"**{LABEL}**\n", *parts, result.verdict, ""]).encode()
    figure = report.figure(result, LABEL)
    files["numerics.svg"], files["numerics.png"] = drawing.svg(figure), drawing.png(figure)
    return publish(out, files, LABEL, "numerics")


def _software() -> dict[str, str]:
    packages = {name: metadata.version(name) for name in ("palpate", "numpy", "scipy")}
    return {**packages, "python": platform.python_version(), "oracle_epsilon": f"{extended_epsilon():.1e}"}
