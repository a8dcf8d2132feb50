"""The numbers that published studies print, with where each stands.

A TOML file of a paper comes in (`README.md` here says how to write one), checked with every error at once; `Published`
comes out, each number with its text, so that its last digit is known. The room knows what a printed number can stand
for, and nothing of how it is recomputed.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

from analysis.published.numbers import (
    PrintedCell,
    PrintedChoices,
    PrintedClaim,
    PrintedF,
    PrintedIcc,
    PrintedLevel,
    PrintedSource,
    PrintedSources,
    PrintedT,
    PrintedTable,
    PrintedTask,
    Published,
    Scale,
)
from analysis.published.printed import Printed
from experiment.errors import ProtocolError, PublishedError

if TYPE_CHECKING:
    from analysis.published.models import Document


def shipped() -> dict[str, Path]:
    """Study -> the file of its printed numbers, for the studies that palpate brings along."""
    folder = Path(str(resources.files(__name__)))
    return {path.stem: path for path in sorted(folder.glob("*.toml")) if not path.stem.endswith("_spectra")}


def load(study: str) -> Published | None:
    """The printed numbers of a study, by its id; None when none are held."""
    file = shipped().get(study)
    return read(file) if file else None


def read(path: Path) -> Published:
    """The printed numbers in the file at `path`.

    Raises:
        PublishedError: with every problem of the file at once.
    """
    from analysis.published.models import Document
    from experiment.settings import load as files

    try:
        document = files.read(path, Document)
    except ProtocolError as error:
        raise PublishedError(str(error)) from error
    return of_document(document)


def of_document(document: Document) -> Published:
    """The printed numbers of a file, as read."""
    levels = [PrintedLevel(Printed(level.p).value, level.stars, level.above) for level in document.levels]
    return Published(
        study=document.study,
        source=document.source,
        chance=Fraction(document.chance) if document.chance else None,
        levels=tuple(sorted(levels, key=lambda level: level.p)),
        tasks=tuple(PrintedTask(task.id, task.participants, task.trials) for task in document.task),
        cells=tuple(_cells(document)),
        confusions=tuple(_tables(document)),
        tests=tuple(_tests(document)),
        one_way=tuple(
            PrintedF(one.where, one.task, one.pair, (one.df[0], one.df[1]), Printed(one.f), Printed(one.p))
            for one in document.one_way
        ),
        two_way=tuple(
            PrintedF(one.where, None, (one.effect,), (one.df[0], one.df[1]), Printed(one.f), Printed(one.p))
            for one in document.two_way
        ),
        sources=tuple(
            PrintedSources(
                table.where,
                tuple(
                    PrintedSource(one.name, one.df, _number(one.ss), _number(one.ms), _number(one.f), _number(one.p))
                    for one in table.lines
                ),
            )
            for table in document.anova
        ),
        icc=tuple(PrintedIcc(one.where, Printed(one.value)) for one in document.icc),
        claims=tuple(PrintedClaim(one.where, one.task, one.significant, one.of) for one in document.claim),
        choices=tuple(
            PrintedChoices(
                one.where,
                one.task,
                one.participants,
                one.trials,
                tuple(((cell.pair[0], cell.pair[1]), Printed(cell.correct)) for cell in one.cells),
            )
            for one in document.choices
        ),
    )


def _tables(document: Document) -> Iterator[PrintedTable]:
    for table in document.table:
        scale, starred = _ratios(document, table.task), any(cell.stars for cell in table.cells)
        cells = tuple(
            PrintedCell(
                table.where, table.task, cell.presented, cell.answered, Printed(cell.mean), _number(cell.sd),
                cell.stars if starred else None, scale,
            )
            for cell in table.cells
        )  # fmt: skip
        yield PrintedTable(table.where, table.task, table.complete, cells)


def _cells(document: Document) -> Iterator[PrintedCell]:
    for table in _tables(document):
        yield from table.cells
    for scores in document.score:
        scale = Scale(scores.items, scores.low, scores.high) if scores.items else None
        starred = any(score.stars for score in scores.cells)
        for score in scores.cells:
            name, mean = score.name, Printed(score.mean)
            sd, stars = _number(score.sd), score.stars if starred else None
            yield PrintedCell(scores.where, scores.task, name, name, mean, sd, stars, scale, is_score=True)
    for text in document.text:
        scale = _ratios(document, text.task)
        for cell in text.cells:
            shown, said, mean = cell.presented, cell.answered, Printed(cell.mean)
            yield PrintedCell(text.where, text.task, shown, said, mean, _number(cell.sd), None, scale, in_table=False)


def _tests(document: Document) -> Iterator[PrintedT]:
    for group in document.t:
        for test in group.tests:
            null = Fraction(test.null or document.chance or 0)
            yield PrintedT(group.where, test.task, test.of, test.df, Printed(test.t), _number(test.p), null)


def _ratios(document: Document, task: str) -> Scale | None:
    trials = next((one.trials for one in document.task if one.id == task), None)
    return Scale(trials) if trials else None


def _number(text: str | None) -> Printed | None:
    return Printed(text) if text else None
