"""`palpate audit`: do a study's printed numbers agree with one another, or with a dataset of the study?

From print alone every statistic is recomputed as the interval that rounding or truncation of the other numbers allows.
Against a dataset it is one value. Where a number disagrees the simplest mistake that gives it is named.
"""

from __future__ import annotations

import textwrap
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from analysis import published
from analysis.audit.comparison import HELD, PRINT, Comparison, compare, comparison_section, with_name
from analysis.audit.mistakes import Line
from analysis.audit.print_lines import print_lines
from analysis.documents.tables import WIDTH, text
from analysis.identification.results import compute
from analysis.published.numbers import Published
from analysis.reading.dataset import read
from analysis.reading.study import nothing_left
from experiment.errors import DatasetError, PublishedError


@dataclass(frozen=True)
class Audit:
    """What was found; `label` is that of the dataset, `origin` as in `comparison_section`."""

    study: str
    origin: str
    label: str
    comparison: Comparison

    def text(self, width: int = WIDTH) -> str:
        """Every line, by where it stands in print, and again those that do not agree; no line longer than `width`."""
        band = [self.label] if self.label else []
        return "\n\n".join(
            [*band, text(comparison_section(self.origin, self.comparison), width), *self._findings(width)]
        )

    def as_dict(self) -> dict[str, Any]:
        """Everything for JSON: no NaN, no infinity; None where something is not a number."""
        lines = [{**asdict(line), "agrees": line.agrees} for line in self.comparison.lines]
        return {
            "study": self.study,
            "source": self.comparison.source,
            "against": "print" if self.origin == PRINT else "dataset",
            "origin": None if self.origin == PRINT else self.origin,
            "label": self.label,
            "lines": lines,
        }

    def _findings(self, width: int) -> list[str]:
        if self.origin not in HELD:
            return []
        found = [line for line in self.comparison.lines if line.verdict != "agrees"]
        if not found:
            return ["Every printed number agrees as rounded."]
        title = "What does not agree as rounded"
        return [f"{title}\n{'=' * len(title)}", "\n".join(_finding(line, width) for line in found)]


def _finding(line: Line, width: int) -> str:
    said = f"{line.where}, {line.task}, {line.subject}: {with_name(line)}; recomputed {line.recomputed}"
    reason = f": {line.reason}" if line.reason else ""
    return textwrap.fill(f"{said}; {line.verdict}{reason}", width, subsequent_indent="  ", break_on_hyphens=False)


def audit(target: str, against: Path | None = None) -> Audit:
    """Audit a study's printed numbers.

    Args:
        target: id of a study that palpate brings along, a file of printed numbers, or the folder of a dataset.
        against: for a dataset, the file of its paper's printed numbers; by default the study's own, by its id.

    Raises:
        PublishedError: for a file that cannot be used, with every problem at once.
        DatasetError: for a dataset that cannot be read or has no paper.
    """
    path = Path(target)
    if path.is_dir():
        return _dataset(path, against)
    if against is not None:
        raise PublishedError(f"--against {against}: {target} is no dataset; give the folder of one, or leave it out")
    printed = published.load(target)
    if printed is None:
        if not path.exists() and path.suffix != ".toml":
            known = ", ".join(published.shipped())
            raise PublishedError(f"{target}: got no study, file or folder; allowed: {known}, or a path; name one")
        printed = published.read(path)
    return Audit(printed.study, PRINT, "", Comparison(printed.source, print_lines(printed), ()))


def _dataset(root: Path, against: Path | None) -> Audit:
    study = read(root)
    printed = _paper(study.id, against)
    if not study.attempts["included"].any():
        raise nothing_left(str(root), study.exclusions)
    comparison = compare(printed, compute(study, printed.pairs()), diagnose=study.origin == "RECONSTRUCTION")
    return Audit(study.id, study.origin, study.label, comparison)


def _paper(study: str, against: Path | None) -> Published:
    if against is not None:
        return published.read(against)
    printed = published.load(study)
    if printed is None:
        raise DatasetError(f"study {study} has no printed numbers here; write them down and give the file to --against")
    return printed
