"""`palpate audit`: do a study's printed numbers agree with one another, or with a dataset of the study?

From print alone every statistic is recomputed as the interval that rounding or truncation of the other numbers allows.
Against a dataset it is one value. Where a number disagrees, the simplest mistake that gives it is named. A line stands
for a printed number, a row of the section for a printed cell or test.
"""

from __future__ import annotations

import statistics
import textwrap
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

from palpate.analysis import published
from palpate.analysis.audit.checks import Checks
from palpate.analysis.audit.evidence import FromResults
from palpate.analysis.audit.mistakes import Citation, Line
from palpate.analysis.audit.print_lines import print_lines
from palpate.analysis.documents.tables import Column, Record, Section, Table, blocks, plural, tabulate, text
from palpate.analysis.identification.results import Results, TaskResult, compute
from palpate.analysis.published import paper
from palpate.analysis.published.numbers import PrintedBlock, PrintedIcc, Published
from palpate.analysis.published.paper import Stated
from palpate.analysis.reading.dataset import read
from palpate.analysis.reading.study import Study, nothing_left
from palpate.experiment.errors import DatasetError, PublishedError

if TYPE_CHECKING:
    import pandas as pd

PRINT = "PRINT"
"""Stands for an origin where printed numbers are compared with one another, not with a dataset."""

OWN = {
    "PRACTICE": "practiced", "REHEARSAL": "rehearsed", "RECONSTRUCTION": "recomputed", "PARTICIPANT": "measured",
    "PILOT": "measured", "IMPORTED": "measured", PRINT: "recomputed",
}  # fmt: skip
"""Heading of the numbers with which the printed ones are compared, by origin."""

ABOUT = blocks(Path(__file__).with_name("about.md"))
"""What each origin means for a comparison."""

HELD = ("RECONSTRUCTION", PRINT)
"""Origins for which the printed numbers are asked whether they stand; new answers are only like or unlike them."""

OTHERWISE = {
    "differs": ("differs", "differ"),
    "fits no one rounding": ("fits no one rounding", "fit no one rounding"),
    "impossible": ("is impossible", "are impossible"),
    "cannot be decided": ("cannot be decided", "cannot be decided"),
    "not in this dataset": ("is not in this dataset", "are not in this dataset"),
}
"""How a sentence counts the verdicts other than agreement: of one number, and of more."""

UNDECIDED = ("cannot be decided", "not in this dataset")
"""Verdicts that accuse nothing."""

MARKS = {"mean": "", "SD": " ± ", "stars": ""}
"""What stands before each part of a cell."""

MOST_ALIKE = 4
"""So many numbers that differ for one reason have a sentence each; more, such as those of swapped rows, have one."""

SAME = {"agrees": "same", "agrees if truncated": "same if truncated"}
"""Verdicts in words that fit answers of one's own."""


@dataclass(frozen=True)
class Correlation:
    """Pearson's r between the printed and the recomputed mean ratios of one task's table, over `cells` cells."""

    task: str
    cells: int
    r: float | None
    statement: str = ""


@dataclass(frozen=True)
class Comparison:
    """Every printed number of one study beside one from a dataset or from print; `unread` cells were not read."""

    source: str
    lines: tuple[Line, ...]
    correlations: tuple[Correlation, ...]
    unread: int = 0


@dataclass(frozen=True)
class Audit:
    """What was found, the dataset's `label`, the `origin` as in `comparison_section`, and tables `passed_over`."""

    study: str
    origin: str
    label: str
    comparison: Comparison
    passed_over: tuple[str, ...] = ()
    blocks: tuple[str, ...] = ()
    """What virtual blocks in print ask of their devices, in sentences."""

    def __repr__(self) -> str:
        counts = Counter(line.verdict for line in self.comparison.lines)
        of = f"{self.study}, {self.label}" if self.label else self.study
        return f"<Audit {of}: {', '.join(f'{count} {verdict}' for verdict, count in counts.most_common())}>"

    def to_frame(self) -> pd.DataFrame:
        """Return a row for each printed number: its place, the recomputed one with its bounds, and the verdict."""
        import pandas as pd

        return pd.DataFrame([{**asdict(line), "agrees": line.agrees} for line in self.comparison.lines])

    def text(self, width: int = 80) -> str:
        """Return every line by its place in print, then again those that disagree, then those that are undecided.

        No line is longer than `width`.
        """
        band = [self.label] if self.label else []
        section = text(comparison_section(self.origin, self.comparison), width)
        passed = [textwrap.fill(sentence, width) for sentence in self.passed_over]
        blocks = [textwrap.fill(sentence, width) for sentence in self.blocks]
        return "\n\n".join([*band, section, *passed, *self._findings(width), *blocks])

    def as_dict(self) -> dict[str, Any]:
        """Return everything for JSON, without NaN or infinity; None stands where something is not a number."""
        return {
            "study": self.study, "source": self.comparison.source,
            "against": "print" if self.origin == PRINT else "dataset",
            "origin": None if self.origin == PRINT else self.origin, "label": self.label,
            "passed_over": list(self.passed_over), "blocks": list(self.blocks), "unread": self.comparison.unread,
            "lines": [{**asdict(line), "agrees": line.agrees} for line in self.comparison.lines],
        }  # fmt: skip

    def _findings(self, width: int) -> list[str]:
        if self.origin not in HELD:
            return []
        lines = self.comparison.lines
        undecided = [line for line in lines if line.verdict in UNDECIDED]
        found = [line for line in lines if line.verdict != "agrees" and line not in undecided]
        which = " and ".join(["was read"] * bool(self.passed_over) + ["can be checked"] * bool(undecided))
        texts = [] if found else [f"Every printed number{f' that {which}' if which else ''} agrees as rounded."]
        for title, held in (("Does not agree as rounded", found), ("Cannot be decided", undecided)):
            if held:
                told = (
                    textwrap.fill(one, width, subsequent_indent="  ", break_on_hyphens=False)
                    for one in _sentences(held)
                )
                texts += [f"{title}\n{'=' * len(title)}", "\n".join(told)]
        return texts


def _sentences(lines: Sequence[Line]) -> Iterator[str]:
    """Yield a sentence for each line, and one for neighbours that cannot be decided, or many, for the same reason."""
    for (place, verdict, reason), alike in groupby(lines, lambda one: (_place(one), one.verdict, one.reason)):
        same, why = list(alike), f"{verdict}: {reason}" if reason else verdict
        if len(same) > (1 if verdict in UNDECIDED else MOST_ALIKE if reason else len(same)):
            subjects = " to ".join(dict.fromkeys((same[0].subject, same[-1].subject)))
            cells = len({one.subject for one in same}) if {one.quantity for one in same} <= set(MARKS) else 0
            yield f"{place}, {subjects}: {len(same)} numbers{f' in {cells} cells' if cells > 1 else ''}; {why}"
            continue
        for one in same:
            found = "" if verdict in UNDECIDED else f"; recomputed {one.recomputed}"
            yield f"{place}, {one.subject}: {_with_name(one)}{found}; {why}"


def audit(target: str, against: Path | None = None, stated: Stated | None = None) -> Audit:
    """Return the audit of a study's printed numbers.

    `target` is the id of a study that palpate brings along, a file of printed numbers, a paper's HTML page or CSV
    tables, or a dataset's folder; `against` is the file of a dataset's paper, by default found by its id; `stated` is
    what a paper says outside of its tables. Raises `PublishedError` for a file that cannot be used, and `DatasetError`
    for a dataset that cannot be read or has no paper.
    """
    path = Path(target)
    is_paper = path.suffix.lower() in paper.SUFFIXES and not path.is_dir()
    if stated is not None and not is_paper:
        raise PublishedError(
            target,
            "got --participants, --trials or --chance",
            "leave them out",
            allowed="only with an HTML page or a CSV file, whose tables do not give these numbers",
        )
    if path.is_dir():
        return _dataset(path, against)
    if against is not None:
        raise PublishedError(
            f"--against {against}", f"{target} is not a dataset", "give the folder of a dataset, or leave it out"
        )
    if is_paper:
        from palpate.analysis.audit.sentences import sentence_lines

        found = paper.read(path, stated or Stated())
        lines = (*print_lines(found.printed), *sentence_lines(found.tests, one_tailed=found.one_tailed))
        if not lines:
            raise PublishedError(
                path,
                f"no printed number could be read; {' '.join(found.passed_over).rstrip('.')[:600]}",
                "state the decimal separator or the encoding, or write a TOML file",
                allowed="numbers such as 0.25 or 0,25",
            )
        comparison = Comparison(found.printed.source, lines, (), found.unread)
        return Audit(path.name, PRINT, "", comparison, found.passed_over)
    printed = published.load(target)
    if printed is None:
        if not path.exists() and path.suffix != ".toml":
            known = ", ".join(published.shipped())
            raise PublishedError(target, "got no study, file or folder", "name one", allowed=f"{known}, or a path")
        printed = published.read(path)
    blocks = tuple(_asks(one) for one in printed.block)
    return Audit(printed.study, PRINT, "", Comparison(printed.source, print_lines(printed), ()), (), blocks)


def _asks(block: PrintedBlock) -> str:
    """Return in sentences what a block asks: C v, and K T / 2 + C (Colgate and Schenkel 1997)."""
    asked_n = block.damping_n_s_m * block.fastest_mm_s * 1e-3
    needed = block.stiffness_n_m / block.rate_hz / 2 + block.damping_n_s_m
    verdict = "more than" if asked_n > block.force_n else "within"
    return (
        f"{block.where}: at a touch of {block.fastest_mm_s:g} mm/s, the damper needs {asked_n:.4g} N, {verdict} the "
        f"device's {block.force_n:g} N. If hand speed is the difference of two samples at {block.rate_hz:g} Hz, the "
        f"block is passive only on a device with at least {needed:.4g} N s/m of physical damping."
    )


def _dataset(root: Path, against: Path | None) -> Audit:
    study = read(root)
    printed = published.read(against) if against else published.load(study.id)
    if printed is None:
        raise DatasetError(
            f"palpate has no printed numbers for study {study.id}",
            remedy="write them to a file and give it as --against",
        )
    if not study.attempts["included"].any():
        raise nothing_left(str(root), study.exclusions)
    comparison = compare(printed, compute(study, printed.pairs()), diagnose=study.origin == "RECONSTRUCTION")
    return Audit(study.id, study.origin, study.label, comparison)


def compare(published: Published, results: Results, *, diagnose: bool) -> Comparison:
    """Return every printed number beside a dataset's; `diagnose`, for reconstructions, explains differences."""
    lines = [*Checks(published, FromResults(results), diagnose=diagnose).lines()]
    lines += [_icc(one, results) for one in published.icc]
    tasks = dict.fromkeys(cell.task for cell in published.tables())
    correlations = [_correlation(published, result) for task in tasks if (result := results.task(task))]
    return Comparison(published.source, tuple(lines), tuple(correlations))


def _icc(icc: PrintedIcc, results: Results) -> Line:
    statement = results.two_way_statement
    cited = Citation(icc.where, "both", "reliability of the two-way ANOVA", "not in this dataset", statement)
    if results.components is None:
        return cited.number("ICC", icc.value, ())
    k, _, value = results.components.by_k[0]
    forms = [form.value for table in results.reliabilities if table.icc for form in table.icc.forms]
    others = [form for form in forms if form is not None]
    spread = f"; the Shrout-Fleiss forms give {min(others):.2f} to {max(others):.2f}" if others else ""
    reason = f"no formula is printed; this is the variance-component ICC, mean of {k} participants{spread}"
    shown = "-" if value is None else f"{value:.3f}"
    return cited.text("ICC", icc.value.text, shown, "cannot be decided", reason, value)


def _correlation(published: Published, result: TaskResult) -> Correlation:
    printed, recomputed = [], []
    materials = result.confusion.materials
    for cell in published.tables():
        if cell.task != result.task.id or not {cell.presented, cell.answered} <= set(materials):
            continue
        mean = result.confusion.mean(materials.index(cell.presented), materials.index(cell.answered))
        if mean is not None:
            printed.append(cell.mean.value)
            recomputed.append(mean)
    if len(printed) < 3 or min(recomputed) == max(recomputed):
        return Correlation(result.task.id, len(printed), None, "the recomputed ratios do not vary, so r is not defined")
    return Correlation(result.task.id, len(printed), statistics.correlation(printed, recomputed))


def beside_print(study: Study, results: Results, printed: Published) -> tuple[Section, Comparison]:
    """Return what an analysis shows of the printed numbers, and every one of them beside the dataset's."""
    comparison = compare(printed, results, diagnose=study.origin == "RECONSTRUCTION")
    return comparison_section(study.origin, comparison), comparison


def comparison_section(origin: str, comparison: Comparison) -> Section:
    """Return every printed number beside the recomputed one; `origin`, a key of `OWN`, decides the wording."""
    places: dict[str, list[Line]] = {}
    for line in comparison.lines:
        places.setdefault(_place(line), []).append(line)
    tables = tuple(_table(place, lines, origin) for place, lines in places.items())
    counted = _counted(comparison.lines, origin)
    if comparison.unread:
        counted += f" {plural(comparison.unread, 'cell')} {'was' if comparison.unread == 1 else 'were'} not read."
    paragraphs = (
        counted,
        f"{comparison.source}. {ABOUT[origin].substitute()}",
        " ".join(map(_correlated, comparison.correlations)),
    )
    title = "Printed numbers compared with each other" if origin == PRINT else "Comparison with the paper"
    records = tuple(_record(line, origin) for line in comparison.lines)
    return Section("comparison", title, tuple(filter(None, paragraphs)), tables, records)


def _place(line: Line) -> str:
    """Return where a number stands, and of which task, unless the place has the same name."""
    return line.where if line.where.lower() == line.task.lower() else f"{line.where}, {line.task}"


def _record(line: Line, origin: str) -> Record:
    """Return a line as values; the dataset's number is under the word for its origin."""
    named = {OWN[origin] if key == "recomputed" else key: value for key, value in asdict(line).items()}
    return named | {"verdict": _verdict(line, origin)}


def _table(title: str, lines: Sequence[Line], origin: str) -> Table:
    groups = [list(group) for _, group in groupby(lines, key=lambda line: (line.subject, line.quantity in MARKS))]
    doubts = Counter(doubt for group in groups if (doubt := _doubt(group)))
    often = [doubt for doubt, count in doubts.items() if count > 1]
    shared = often[0] if len(often) == 1 else None
    notes = (f"{shared[0].capitalize()}, unless noted otherwise: {shared[1]}.",) if shared else ()
    held = origin in HELD
    marked = frozenset((i, 3) for i, group in enumerate(groups) if held and not all(line.agrees for line in group))
    columns = (
        Column("row", "quantity", show=lambda row: row[0].subject, left=True),
        Column("row", "printed", show=_printed, left=True),
        Column("row", OWN[origin], show=_recomputed, left=True),
        Column("row", "agrees?" if held else "same?", show=partial(_judged, origin=origin, shared=shared), left=True),
    )
    # The records of the lines stand in the order in which they were checked, not by place.
    return replace(tabulate(title, columns, [{"row": group} for group in groups], notes, marked=marked), records=())


def _correlated(one: Correlation) -> str:
    if one.r is not None:
        return (
            f"{one.task}: the {one.cells} cells of the printed table correlate with this dataset's at r = {one.r:.4f}."
        )
    why = f"because {one.statement}"
    return f"{one.task}: no correlation between the {one.cells} cells of the printed table and this dataset's, {why}."


def _counted(lines: Sequence[Line], origin: str) -> str:
    agreeing = sum(line.agrees for line in lines)
    words = ("agrees", "agree") if origin in HELD else ("is the same", "are the same")
    others = Counter(line.verdict for line in lines if not line.agrees)
    rest = [f"{count} {OTHERWISE[verdict][count > 1]}" for verdict, count in others.items()]
    *first, last = (f"{agreeing} {words[agreeing != 1]}", *rest)
    counted = "printed numbers and rows" if origin == PRINT else "printed numbers"
    said = f"Of {len(lines)} {counted}, {', '.join(first)}{' and ' if first else ''}{last}."
    # What one mistake gives has its own value at the end of each reason.
    causes = Counter((line.task, line.reason.partition(" = ")[0]) for line in lines if line.verdict == "differs")
    (task, cause), count = causes.most_common(1)[0] if causes else (("", ""), 0)
    return f"{said} In {task}, {cause} for {count} of them." if origin == "RECONSTRUCTION" and count > 1 else said


def _with_name(line: Line) -> str:
    """Return the printed number behind its name; a row needs no name."""
    return line.printed if line.quantity == "row" else f"{line.quantity} = {line.printed}"


def _verdict(line: Line, origin: str) -> str:
    return line.verdict if origin in HELD else SAME.get(line.verdict, line.verdict)


def _apart(lines: Sequence[Line]) -> Sequence[Line]:
    """Return the lines of a row without degrees of freedom that agree, which stand beside their t or F already."""
    return [line for line in lines if not (line.quantity.startswith("df") and line.agrees)] or lines


def _alike(lines: Sequence[Line]) -> bool:
    return all((line.verdict, line.reason) == (lines[0].verdict, lines[0].reason) for line in lines)


def _doubt(group: Sequence[Line]) -> tuple[str, str] | None:
    """Return the verdict and the reason of a row that cannot be decided, for one reason."""
    first, *_ = lines = _apart(group)
    return (first.verdict, first.reason) if first.verdict in UNDECIDED and first.reason and _alike(lines) else None


def _printed(row: Sequence[Line]) -> str:
    """Return the printed numbers of a row."""
    lines = _apart(row)
    if lines[0].quantity == "mean":
        return _cell([(line.quantity, line.printed) for line in lines])
    return ", ".join(map(_with_name, lines))


def _recomputed(row: Sequence[Line]) -> str:
    """Return the numbers of a row beside the printed ones."""
    lines = _apart(row)
    if lines[0].quantity == "mean":
        return _cell([(line.quantity, line.recomputed) for line in lines if line.recomputed != "-"]) or "-"
    return ", ".join(line.recomputed for line in lines)


def _judged(row: Sequence[Line], origin: str, shared: tuple[str, str] | None) -> str:
    """Return the verdict on a row with its reason; one that is `shared` stands in a note."""
    if shared and _doubt(row) == shared:
        return shared[0]
    lines = _apart(row)
    alike = _alike(lines)
    said = lines[:1] if alike else [line for line in lines if line.verdict != "agrees"]
    return "; ".join([_remark(line, origin, alone=alike) for line in said] or ["agrees"])


def _remark(line: Line, origin: str, *, alone: bool) -> str:
    subject = "" if alone else f"{line.quantity} "
    verdict = _verdict(line, origin)
    if line.quantity == "stars":
        verdict = verdict.replace("differs", "differ")
    explained = line.reason and (origin in HELD or line.verdict not in SAME)
    return f"{subject}{verdict}{f': {line.reason}' if explained else ''}"


def _cell(parts: Sequence[tuple[str, str]]) -> str:
    return "".join(f"{MARKS[quantity]}{text}" for quantity, text in parts if text != "none")
