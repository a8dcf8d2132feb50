"""The whole analysis of one dataset or several: read, compute, compare with print, write tables and report."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from palpate.analysis import published
from palpate.analysis.audit.audit import Comparison, compare
from palpate.analysis.documents import page
from palpate.analysis.documents.output import DERIVATIVES, MANIFEST, check, publish
from palpate.analysis.documents.tables import WIDTH, Section, text
from palpate.analysis.identification.results import Results, TaskResult, compute
from palpate.analysis.identification.time_course import TimeCourse
from palpate.analysis.reading.dataset import read_pooled
from palpate.analysis.reading.dissimilarities import NO_DISSIMILARITIES, from_file, printed_dissimilarities
from palpate.analysis.reading.study import Study, nothing_left
from palpate.analysis.report.sections import methods, sections
from palpate.analysis.statistics.anova import Anova
from palpate.experiment.errors import DatasetError
from palpate.experiment.records import software
from palpate.experiment.records.events import NO_ANSWER

if TYPE_CHECKING:
    from palpate.analysis.comparison.results import Compared
    from palpate.analysis.documents.drawing import Sheet

FIRST_IN_TERMINAL = ("overview", "exclusions", "comparison")
"""Sections that a terminal shows first, so that matrices and tests stay on the screen; what was found comes last."""

IN_SHORT = ("overview", "confusion", "tests", "pairs", "scales", "found")
"""Sections that a terminal shows unless it is asked for all; what is left out of the analysis is never passed over."""


@dataclass(frozen=True)
class Analysis:
    """The results of an analysis, and the files that hold them; `found` are those of a study's kind of trial."""

    study: Study
    found: Results | Compared
    comparison: Comparison | None
    sections: tuple[Section, ...]
    out: Path
    files: tuple[Path, ...]
    numbers: Mapping[str, Any]

    @property
    def results(self) -> Results:
        """Return the results of identifications. Raises `TypeError` for comparisons."""
        if not isinstance(self.found, Results):
            raise TypeError("comparisons have other results: compared")
        return self.found

    @property
    def compared(self) -> Compared:
        """Return the results of comparisons. Raises `TypeError` for identifications."""
        if isinstance(self.found, Results):
            raise TypeError("identifications have other results: results")
        return self.found

    @property
    def report(self) -> Path:
        """Return the path of the HTML report."""
        return self.out / page.REPORT

    def text(self, width: int = WIDTH, *, full: bool = False) -> str:
        """Return what a terminal shows, every section if `full`; only the last line, a path, may exceed `width`."""
        band = [textwrap.fill(self.study.label, width)] if self.study.label else []
        wanted = IN_SHORT + ("exclusions",) * bool(self.study.exclusions or self.study.unasked)
        parts = [self._in_terminal(section) for section in self.sections if full or section.slug in wanted]
        parts.sort(key=lambda section: (section.slug not in FIRST_IN_TERMINAL, section.slug == "found"))
        more = [] if full else [textwrap.fill("There is more: in the report, and here with --full.", width)]
        last = "\n".join([*more, f"Report: {self.report}"])
        return "\n\n\n".join([*band, *(text(part, width, full=full) for part in parts), *band, last])

    def _in_terminal(self, section: Section) -> Section:
        # The tables that the sentences sum up stand above them in a terminal.
        if section.slug == "found":
            return replace(section, tables=())
        # The numbers of a study that nobody expects to match the paper's stay in the report.
        if section.slug != "comparison" or self.study.origin == "RECONSTRUCTION":
            return section
        return replace(section, tables=(), paragraphs=(*section.paragraphs, "The report compares number by number."))

    def as_dict(self) -> dict[str, Any]:
        """Return everything for JSON, with None instead of NaN or infinity where something is not defined."""
        paths = {"out": str(self.out), "report": str(self.report), "files": [str(path) for path in self.files]}
        return {**self.numbers, **paths}


def analyse(
    datasets: Sequence[Path],
    out: Path | None = None,
    *,
    figures: bool = True,
    pictures: bool = True,
    titles: bool = False,
    dissimilarities: Path | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> Analysis:
    """Analyse these BIDS datasets, pooled if there are several, and write everything into `out`.

    `out` is by default `derivatives/palpate`. `pictures` are PNG files, with `titles` inside for slides.
    `dissimilarities` is a CSV file, see `reading/dissimilarities.py`. `say` gets progress. Raises `DatasetError` for a
    dataset, file or folder that cannot be used or has no trial, and `ProtocolError` for a broken protocol.
    """
    if out is None and len(datasets) > 1:
        raise DatasetError("--out", "got none", "name it", allowed="a folder for the results of several datasets")
    place = out or datasets[0] / DERIVATIVES / "palpate"
    check(place, (), "analyse")
    study = read_pooled(datasets)
    if not study.attempts["included"].any():
        raise nothing_left(", ".join(map(str, datasets)), study.exclusions)
    printed = published.load(study.id)
    say("Computing tables and models")
    found: Results | Compared
    comparison, further, drawn = None, tuple[Section, ...](), tuple["Sheet", ...]()
    if study.answers is not None:
        if dissimilarities is not None:
            raise DatasetError(study.id, "got --dissimilarities and comparisons", "leave it out", allowed="one of them")
        # Its scales need statsmodels, which no other analysis does.
        from palpate.analysis.comparison import results as comparisons
        from palpate.analysis.report import comparison_sections

        found = compared = comparisons.compute(study, printed)
        parts = comparison_sections.sections(study, compared, printed)
        formulas, numbers = comparison_sections.methods(), _compared(study, compared)
        if figures:
            from palpate.analysis.report import comparison_figures

            drawn = comparison_figures.sheets(compared, study.label, titles=titles)
    else:
        if dissimilarities is not None:
            alike = from_file(dissimilarities, study.materials)
        else:
            alike = printed_dissimilarities() if printed else NO_DISSIMILARITIES
        found = results = compute(study, printed.pairs() if printed else {}, alike)
        comparison = compare(printed, results, diagnose=study.origin == "RECONSTRUCTION") if printed else None
        parts = sections(study, results, comparison, printed)
        formulas, numbers, further = methods(), _numbers(study, results, comparison), (_counts(results),)
        say("Drawing figures and writing the report" if figures else "Writing the report")
        if figures:
            from palpate.analysis.report.figures import sheets

            drawn = sheets(results, study.label, titles=titles)
    # With the study in its caption each figure can stand alone.
    drawn = tuple(replace(one, caption=f"{one.caption} Study {study.id}.") for one in drawn)
    content = page.folder(study.title, study.label, parts, drawn, formulas, numbers, further=further, pictures=pictures)
    written = publish(place, content | _bids(study), study.label, "analyse")
    return Analysis(study, found, comparison, parts, place, written, numbers)


def _compared(study: Study, found: Compared) -> dict[str, Any]:
    return {**_facts(study), "quality": found.quality, "tasks": [_plain(task) for task in found.tasks]}


def _bids(study: Study) -> dict[str, bytes]:
    ours = software.this()
    description = {
        "Name": f"{study.name}: analysis",
        "BIDSVersion": "1.10.0",
        "DatasetType": "derivative",
        "GeneratedBy": [{"Name": "palpate", "Version": ours.version, "SourceSha256": ours.source_sha256}],
    }
    ignored = f"{page.REPORT}\nresults.json\n{MANIFEST}\ntables\nfigures\n"
    label = [study.label] if study.label else []
    readme = "\n\n".join([*label, "palpate analyse made these tables, figures and report.\n"])
    return {
        "dataset_description.json": (json.dumps(description, indent=2, ensure_ascii=False) + "\n").encode(),
        "README": readme.encode(),
        ".bidsignore": f"# {study.label or study.name}\n{ignored}".encode(),
    }


def _counts(results: Results) -> Section:
    keys = ("task", "participant", "presented", "answered", "count", "trials")
    records = tuple(
        dict(zip(keys, (task.task.id, f"sub-{who}", presented, answered or NO_ANSWER, count, total), strict=True))
        for task in results.tasks
        for who, presented, answered, count, total in task.confusion.cells()
    )
    return Section("counts", "Counts", further=records)


def _facts(study: Study) -> dict[str, Any]:
    return {
        "study": study.id, "name": study.name, "origin": study.origin, "label": study.label,
        "materials": list(study.materials), "participants": list(study.participants),
        "exclusions": [asdict(exclusion) for exclusion in study.exclusions],
        "unasked": [asdict(one) for one in study.unasked],
    }  # fmt: skip


def _numbers(study: Study, results: Results, comparison: Comparison | None) -> dict[str, Any]:
    return {
        **_facts(study), "tasks": [_task(task) for task in results.tasks],
        "identification": [_plain(found) for found in results.identifications],
        "one_way": [{**_plain(pair), "anova": _anova(pair.anova)} for pair in results.pairs],
        "two_way": [_anova(anova) for anova in results.two_way], "two_way_statement": results.two_way_statement,
        "beside": _plain(results.beside), "equivalence": _plain(results.equivalences),
        "marginal": {"found": _plain(results.marginal[0]), "statement": results.marginal[1]},
        "trials": _plain(results.trials), "course": _course(results.course),
        "icc": [asdict(reliability) for reliability in results.reliabilities],
        "variance_components": _plain(results.components), "comparison": _plain(comparison),
    }  # fmt: skip


def _task(task: TaskResult) -> dict[str, Any]:
    matrix = task.confusion
    count = len(matrix.materials)
    return {
        **asdict(task.task),
        "chance": task.chance,
        "participants": list(matrix.participants),
        "counts": matrix.counts.tolist(),
        "mean": [[matrix.mean(i, j) for j in range(count + 1)] for i in range(count)],
        "sd": [[matrix.sd(i, j) for j in range(count + 1)] for i in range(count)],
        "tests": [
            {"material": test.material, **asdict(test.result), "stars": task.stars(test), "p_holm": test.p_holm,
             "sign_flip": _plain(test.flip), "sign_flip_p_holm": test.flip_holm, "d_interval": _plain(test.d),
             "log_bf10": test.log_bf10}
            for test in task.tests
        ],
    }  # fmt: skip


def _anova(anova: Anova | None) -> dict[str, Any] | None:
    if anova is None:
        return None
    sizes = {effect.name: _plain(anova.eta_squared(effect)) for effect in anova.effects}
    return {**asdict(anova), "partial_eta_squared": sizes}


def _course(found: TimeCourse) -> dict[str, Any]:
    statements = [{"task": task, "of": of, "statement": why} for (task, of), why in found.statements.items()]
    return {**_plain(replace(found, statements={})), "statements": statements}


def _plain(value: Any) -> Any:
    """Return a value as JSON holds it: dataclasses as objects, arrays as lists, and None for what is not finite."""
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
