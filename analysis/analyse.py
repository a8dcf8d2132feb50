"""The whole analysis of one dataset or several: read, compute, compare with print, write tables and report."""

from __future__ import annotations

import json
import shlex
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from importlib import import_module
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from palpate.analysis import designs, published
from palpate.analysis.conditions import control
from palpate.analysis.conditions.touched import touched_section
from palpate.analysis.documents import page
from palpate.analysis.documents.output import DERIVATIVES, MANIFEST, check, publish
from palpate.analysis.documents.tables import WIDTH, Section, text
from palpate.analysis.reading.dataset import COMPUTING, Say, silent
from palpate.analysis.reading.pooled import read_pooled
from palpate.analysis.reading.study import Study, nothing_left
from palpate.analysis.report import prose
from palpate.experiment.errors import DatasetError
from palpate.experiment.records import software

FIRST_IN_TERMINAL = ("overview", "exclusions", "comparison")
"""Sections that a terminal shows first, so that matrices and tests stay on the screen; answers come last."""


@dataclass(frozen=True)
class Analysis:
    """The results of an analysis, and the files that hold them; the study's design has the class of `results`."""

    study: Study
    results: Any
    sections: tuple[Section, ...]
    datasets: tuple[Path, ...]
    out: Path
    files: tuple[Path, ...]
    numbers: Mapping[str, Any]

    @property
    def next_command(self) -> str:
        """Return the command that checks a dataset, or compares a reconstruction with its paper."""
        verb = "audit" if self.study.origin == "RECONSTRUCTION" else "verify"
        return shlex.join(["palpate", verb, *map(str, self.datasets[:1])])

    @property
    def report(self) -> Path:
        """Return the path of the HTML report."""
        return self.out / page.REPORT

    def text(self, width: int = WIDTH, *, full: bool = False) -> str:
        """Return what a terminal shows: questions and answers, after every other section if `full`.

        Only the last lines, a path and the next command, may exceed `width`.
        """
        band = [textwrap.fill(self.study.label, width)] if self.study.label else []
        answers, *others = self.sections
        parts = [self._in_terminal(section) for section in others if full]
        parts.sort(key=lambda section: section.slug not in FIRST_IN_TERMINAL)
        last = f"Report: {self.report}\nNext: {self.next_command}"
        return "\n\n".join([*band, *(text(part, width, full=full) for part in (*parts, answers)), last])

    def write_up(self, width: int) -> str:
        """Return the methods and results paragraphs of a paper, each number with its row in a table."""
        return prose.write_up(self.study, self.sections, width)

    def _in_terminal(self, section: Section) -> Section:
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
    say: Say = silent,
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
    study, controlled = control.apart(read_pooled(datasets, say))
    if not study.attempts["included"].any():
        raise nothing_left(", ".join(map(str, datasets)), study.exclusions)
    printed = published.load(study.id)
    design = designs.design_of(study)
    say(COMPUTING)
    found = design.compute(study, printed, dissimilarities, say)
    audit = designs.optional(design.audit) if design.audit and printed else None
    section, comparison = audit.beside_print(study, found, printed) if audit else (None, None)
    first, *others = design.sections(study, found, printed, section)
    rebuilt = printed if study.origin == "RECONSTRUCTION" else None
    *said, last = first.paragraphs
    last = f"{section.paragraphs[0]} {last}" if section and rebuilt else last
    # Whether the sound was masked stands before the answers that it may explain.
    first = replace(first, paragraphs=(*(one.sentence for one in controlled), *said, last))
    parts = (first, *others, *control.control_section(controlled), *touched_section(study))
    audited = {"comparison": comparison} if design.audit else {}
    masked = {"control": controlled} if controlled else {}
    numbers = _plain({**_facts(study), **design.numbers(found), **audited, **masked})
    say("Drawing figures and writing the report" if figures else "Writing the report")
    drawn = import_module(design.figures).sheets(found, study.label, titles=titles) if figures else ()
    # With the study in its caption each figure can stand alone.
    drawn = tuple(replace(one, caption=f"{one.caption} Study {study.id}.") for one in drawn)
    further, formulas = design.further(found), design.methods()
    about = study.title, study.label
    source = rebuilt.source if rebuilt else ""
    content = page.folder(*about, parts, drawn, formulas, numbers, further=further, pictures=pictures, source=source)
    written = publish(place, content | _bids(study), study.label, "analyse")
    return Analysis(study, found, parts, tuple(datasets), place, written, numbers)


def _bids(study: Study) -> dict[str, bytes]:
    ours = software.this()
    description = {
        "Name": f"{study.name}: analysis",
        "BIDSVersion": "1.11.0",
        "DatasetType": "derivative",
        "GeneratedBy": [{"Name": "palpate", "Version": ours.version, "SourceSha256": ours.source_sha256}],
    }
    ignored = f"{page.REPORT}\n{page.METHODS}\nresults.json\n{MANIFEST}\ntables\nfigures\n"
    label = [study.label] if study.label else []
    readme = "\n\n".join([*label, "These tables, figures and the report were written by palpate analyse.\n"])
    return {
        "dataset_description.json": (json.dumps(description, indent=2, ensure_ascii=False) + "\n").encode(),
        "README": readme.encode(),
        ".bidsignore": f"# {study.label or study.name}\n{ignored}".encode(),
    }


def _facts(study: Study) -> dict[str, Any]:
    return {
        "study": study.id, "name": study.name, "origin": study.origin, "label": study.label,
        "materials": list(study.materials), "participants": list(study.participants),
        "exclusions": [asdict(exclusion) for exclusion in study.exclusions],
        "unasked": [asdict(one) for one in study.unasked],
    }  # fmt: skip


def _plain(value: Any) -> Any:
    """Return a value as JSON holds it: dataclasses as objects, arrays as lists, and None for what is not finite."""
    if isinstance(value, float):
        return value if isfinite(value) else None
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value
