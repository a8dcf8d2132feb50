"""What a design adds to an analysis: results, sections, figures, formulas, exported tables, and what power simulates.

A design is what a trial asks. Each has a module or a room here with one `AnalysisDesign` called `DESIGN`. A study's
tasks name their design, and its module is imported when it is looked up, so that an analysis imports no other one, and
an installation may lack it. Audits and power are named here by their modules, and are imported where one is asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from palpate.analysis.documents.tables import Section
from palpate.analysis.published.numbers import Published
from palpate.analysis.reading.dataset import Say
from palpate.analysis.reading.study import Study, nothing_left
from palpate.experiment.errors import DatasetError

if TYPE_CHECKING:
    import pandas as pd

    from palpate.experiment.protocol.models import Protocol

Described = Mapping[str, Mapping[str, tuple[str, str]]]
"""File -> its columns: name -> what it contains, and its unit or kind."""


@dataclass(frozen=True)
class AnalysisDesign:
    """What one design computes and shows of a study; results are of a class of its own."""

    name: str
    trials: str
    """What its trials are called."""
    function: str
    """The library's function that returns its results."""
    compute: Callable[[Study, Published | None, Path | None, Say], Any]
    """Study, what was printed of it, a file of dissimilarities, and what gets progress -> results."""
    sections: Callable[[Study, Any, Published | None, Section | None], tuple[Section, ...]]
    """Study, results, what was printed, and an audit of that -> the sections of the report, in reading order."""
    numbers: Callable[[Any], Mapping[str, Any]]
    """Results -> what `results.json` has of them."""
    further: Callable[[Any], tuple[Section, ...]]
    """Results -> tables of which the report shows nothing."""
    methods: Callable[[], tuple[tuple[str, str], ...]]
    """Names and formulas, in the order of the report."""
    export: Callable[[Study, pd.DataFrame, pd.DataFrame], tuple[Mapping[str, pd.DataFrame], Described]]
    """Study, attempts, what was left out -> exported tables by file, and columns that the file of its name lacks."""
    figures: str
    """The module whose `sheets` draws results."""
    power: str = ""
    """The module that makes models of answers, if any does."""
    thresholds: str = ""
    """The module that simulates tracks of levels, if thresholds come of them."""
    audit: str = ""
    """The module whose `beside_print` compares results with print, if any does."""


def named(name: str) -> AnalysisDesign:
    """Return a design. Raises `ModuleNotFoundError` where this installation lacks it."""
    found: AnalysisDesign = import_module(f"{__name__}.{name}").DESIGN
    return found


def design_of(study: Study) -> AnalysisDesign:
    """Return the design of a study's tasks."""
    return named(study.design)


def planned_design(protocol: Protocol) -> AnalysisDesign:
    """Return the design of a protocol's tasks."""
    return named(protocol.tasks[0].design)


def optional(module: str) -> Any:
    """Return a module, or None where this installation lacks it."""
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if f"{module}.".startswith(f"{error.name}."):
            return None
        raise


def check_design(study: Study, name: str) -> None:
    """Raise `DatasetError` unless the trials of a study are of this design, and one of them counts."""
    if study.design != name:
        other = design_of(study)
        raise DatasetError(
            f"study {study.id}", f"its trials are {other.trials}", f"pass it to palpate.{other.function}"
        )
    if not study.attempts["included"].any():
        raise nothing_left(study.id, study.exclusions)
