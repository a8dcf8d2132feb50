"""A study's printed numbers, each with where it stands: what a file of them holds, ready to be recomputed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction

from analysis.published.printed import Printed


@dataclass(frozen=True)
class Scale:
    """The values that one participant can have: multiples of 1 / `items` from `low` to `high`; None: no end."""

    items: int
    low: int | None = 0
    high: int | None = 1


@dataclass(frozen=True)
class PrintedLevel:
    """Stars, and the P below which they are given; `above`: to means above the null alone."""

    p: float
    stars: str
    above: bool = False


@dataclass(frozen=True)
class PrintedTask:
    """Who did a task: participants, and trials behind each ratio, where the study says so."""

    id: str
    participants: int
    trials: int | None


@dataclass(frozen=True)
class PrintedCell:
    """A cell of a confusion matrix, or a score, which is `presented` and `answered` alike.

    `sd` is None where none is printed, `stars` where the place shows none at all, `scale` where values have no known
    steps. `in_table`: not one that the text repeats.
    """

    where: str
    task: str
    presented: str
    answered: str
    mean: Printed
    sd: Printed | None
    stars: str | None
    scale: Scale | None
    in_table: bool = True
    is_score: bool = False

    @property
    def subject(self) -> str:
        """What it is about, in words."""
        return self.presented if self.is_score else f"{self.presented} -> {self.answered}"

    @property
    def key(self) -> tuple[str, str, str]:
        """What it is about, wherever it stands."""
        return self.task, self.presented, self.answered


@dataclass(frozen=True)
class PrintedTable:
    """The cells of one confusion table; `complete`: its rows hold every answer."""

    where: str
    task: str
    complete: bool
    cells: tuple[PrintedCell, ...]

    def rows(self) -> Iterator[tuple[str, tuple[PrintedCell, ...]]]:
        """The material presented, and its cells."""
        for presented in dict.fromkeys(cell.presented for cell in self.cells):
            yield presented, tuple(cell for cell in self.cells if cell.presented == presented)


@dataclass(frozen=True)
class PrintedT:
    """A one-sample t-test of a material's correct answers, or of a score, against `null`."""

    where: str
    task: str
    material: str
    df: int
    t: Printed
    p: Printed | None
    null: Fraction


@dataclass(frozen=True)
class PrintedF:
    """An F: `subject` is the effect's name, or the pair of materials."""

    where: str
    task: str | None
    subject: tuple[str, ...]
    df: tuple[int, int]
    f: Printed
    p: Printed


@dataclass(frozen=True)
class PrintedSource:
    """One line of an ANOVA table."""

    name: str
    df: int
    ss: Printed | None
    ms: Printed | None
    f: Printed | None
    p: Printed | None


@dataclass(frozen=True)
class PrintedSources:
    """An ANOVA table; its last line is the residual."""

    where: str
    lines: tuple[PrintedSource, ...]


@dataclass(frozen=True)
class PrintedIcc:
    """An intraclass correlation without a formula."""

    where: str
    value: Printed


@dataclass(frozen=True)
class PrintedClaim:
    """How many of a task's materials are called significantly above chance."""

    where: str
    task: str
    significant: int
    of: int


@dataclass(frozen=True)
class PrintedChoices:
    """Percentages of pairs without denominators; `trials` are a participant's, or all: the study does not say."""

    where: str
    task: str
    participants: int
    trials: int
    cells: tuple[tuple[tuple[str, str], Printed], ...]


@dataclass(frozen=True)
class Published:
    """Everything that one study prints about answers.

    `levels` stand with the most stars first; there are none for a study that gives none.
    """

    study: str
    source: str
    chance: Fraction | None
    levels: tuple[PrintedLevel, ...]
    tasks: tuple[PrintedTask, ...]
    cells: tuple[PrintedCell, ...]
    confusions: tuple[PrintedTable, ...]
    tests: tuple[PrintedT, ...]
    one_way: tuple[PrintedF, ...]
    two_way: tuple[PrintedF, ...]
    sources: tuple[PrintedSources, ...]
    icc: tuple[PrintedIcc, ...]
    claims: tuple[PrintedClaim, ...]
    choices: tuple[PrintedChoices, ...]

    def tables(self) -> tuple[PrintedCell, ...]:
        """The cells that stand in tables, without those that the text repeats."""
        return tuple(cell for cell in self.cells if cell.in_table)

    def pairs(self) -> dict[str, tuple[str, str]]:
        """Task -> the two materials whose ratios the one-way ANOVA compares."""
        return {test.task: (test.subject[0], test.subject[1]) for test in self.one_way if test.task}

    def task(self, task: str) -> PrintedTask | None:
        """The task with this id; None when the file names none."""
        return next((one for one in self.tasks if one.id == task), None)
