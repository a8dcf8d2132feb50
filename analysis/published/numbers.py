"""The content of a file of printed numbers: its keys are the fields, and unknown keys are refused."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal, TypeVar

from pydantic import AfterValidator, Field, GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from palpate.analysis.published.printed import POSITIVE, Printed
from palpate.experiment.settings.load import Broken, Confined, Label, Name, Rules, Text


@dataclass(frozen=True)
class _Read:
    """Marks a field that holds `made(value)`, where the file holds a value of type `stands`."""

    stands: Any
    made: Callable[[Any], Any]

    def __get_pydantic_core_schema__(self, _source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        unchanged = core_schema.plain_serializer_function_ser_schema(lambda value: value)
        stands = handler.generate_schema(self.stands)
        return core_schema.no_info_after_validator_function(self.made, stands, serialization=unchanged)


def _text(pattern: str, description: str, made: Callable[[str], Any] = Printed) -> _Read:
    return _Read(Annotated[str, Field(pattern=pattern, description=description)], made)


Number = Annotated[
    Printed, _text(rf"^-?{POSITIVE}$", 'a number as printed, in quotes, such as "0.20", "-1.5" or "15%"')
]
Size = Annotated[Printed, _text(rf"^{POSITIVE}$", 'a number as printed, not negative, in quotes, such as "0.20"')]
Probability = Annotated[
    Printed, _text(rf"^< ?{POSITIVE}$|^{POSITIVE}$", 'P as printed, in quotes, such as "0.016", "5.02e-7" or "<0.001"')
]
Percentage = Annotated[
    Printed,
    _text(
        r"^(100(\.0{1,2})?|[0-9]{1,2}(\.[0-9]{1,2})?)%$",
        'a percentage as printed, from 0 to 100, with at most two decimals, in quotes, such as "43%"',
    ),
]
Share = Annotated[
    Fraction,
    _text(
        r"^-?([0-9]+(\.[0-9]+)?|[0-9]+/[1-9][0-9]*)$", 'an exact number, in quotes, such as "0.25" or "1/3"', Fraction
    ),
]
Stars = Annotated[str, Field(pattern=r"^\**$", description='stars as printed, such as "**"; "" for no stars')]
Count = Annotated[int, Field(ge=1, le=100_000)]
Df = Annotated[int, Field(ge=1, le=1_000_000)]
TwoDf = Annotated[tuple[int, int], _Read(Annotated[tuple[Df, ...], Field(min_length=2, max_length=2)], tuple)]
Two = Annotated[tuple[str, str], _Read(Annotated[tuple[Name, ...], Field(min_length=2, max_length=2)], tuple)]


@dataclass(frozen=True)
class Scale:
    """The values that one participant can have: multiples of 1 / `items` from `low` to `high`, where None is no end."""

    items: int
    low: int | None = 0
    high: int | None = 1


Key = tuple[str, str, str]
"""What a cell is about, wherever it stands: its task, and what was presented and answered."""


@dataclass(frozen=True)
class PrintedCell:
    """A mean with all that its place says about it: a ratio of one answer to one material, or a score.

    `presented` and `answered` are both the name of a score. `stars` is None where the place shows no stars at all,
    `scale` where the steps of the values are not known. `in_table` is false for a cell that the text repeats.
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
        return self.presented if self.is_score else f"{self.presented} -> {self.answered}"

    @property
    def key(self) -> Key:
        return self.task, self.presented, self.answered


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

    @property
    def key(self) -> Key:
        """The key of the cell that is tested."""
        return self.task, self.material, self.material


Keyed = TypeVar("Keyed", PrintedCell, PrintedT)


def _by_key(held: Iterable[Keyed]) -> Mapping[Key, tuple[Keyed, ...]]:
    found: dict[Key, list[Keyed]] = {}
    for one in held:
        found.setdefault(one.key, []).append(one)
    return {key: tuple(group) for key, group in found.items()}


class PrintedLevel(Confined):
    """Stars and the P below which they are given, to every mean or those above the null, where stars are shown."""

    stars: Annotated[str, Field(pattern=r"^\*+$", description='stars, such as "**"')]
    p: Size
    above: bool = False


class PrintedTask(Confined):
    """A task or group: its participants, and the whole trials behind each of their ratios where these are known."""

    id: Name
    participants: Count
    trials: Annotated[int | None, Field(ge=1, le=10_000)] = None


class PrintedRatio(Confined):
    """A mean ratio of one answer to one material; its `stars` count only in tables."""

    presented: Name
    answered: Name
    mean: Number
    sd: Size | None = None
    stars: Stars = ""


class PrintedPassage(Confined):
    """Cells of a table that the text repeats."""

    where: Text
    task: Name
    cells: Annotated[tuple[PrintedRatio, ...], Field(min_length=1)]


class PrintedTable(PrintedPassage):
    """A confusion table; it is `complete` where its rows hold every answer that could be given."""

    complete: bool = True


class PrintedScore(Confined):
    """A mean of something other than ratios."""

    name: Name
    mean: Number
    sd: Size | None = None
    stars: Stars = ""

    @property
    def presented(self) -> str:
        return self.name

    @property
    def answered(self) -> str:
        return self.name


def _list(value: object) -> tuple[Any, ...]:
    return tuple(value) if isinstance(value, tuple | list) else ()


def _scores_rules(table: Any) -> Iterator[Broken]:
    low, high = table.get("low"), table.get("high")
    if isinstance(low, int) and isinstance(high, int) and high <= low:
        yield Broken(("high",), f"a whole number greater than low ({low})")


class PrintedScores(Confined):
    """Means of whole numbers on a scale, or of means of `items` of them; values without `items` have no steps."""

    RULES: ClassVar[Rules] = _scores_rules

    where: Text
    task: Name
    items: Annotated[int | None, Field(ge=1, le=1000)] = None
    low: Annotated[int | None, Field(ge=-1000, le=1000)] = None
    high: Annotated[int | None, Field(ge=-1000, le=1000)] = None
    cells: Annotated[tuple[PrintedScore, ...], Field(min_length=1)]


class PrintedTest(Confined):
    """One t-test as the file has it: the test is against chance where `null` is left out."""

    task: Name
    of: Name
    df: Df
    t: Number
    p: Probability | None = None
    null: Share | None = None


class PrintedTests(Confined):
    """The t-tests of one place."""

    where: Text
    tests: Annotated[tuple[PrintedTest, ...], Field(min_length=1)]


class PrintedOneWay(Confined):
    """A one-way ANOVA of the four ratios of two materials that were taken for one another."""

    where: Text
    task: Name
    pair: Two
    df: TwoDf
    f: Size
    p: Probability

    @property
    def subject(self) -> tuple[str, ...]:
        return self.pair


class PrintedTwoWay(Confined):
    """One effect of the two-way ANOVA of all correct ratios by task and material."""

    where: Text
    task: ClassVar[None] = None
    effect: Literal["task", "material"]
    df: TwoDf
    f: Size
    p: Probability

    @property
    def subject(self) -> tuple[str, ...]:
        return (self.effect,)


PrintedF = PrintedOneWay | PrintedTwoWay


class PrintedSource(Confined):
    """One line of an ANOVA table."""

    name: Name
    ss: Size | None = None
    df: Df
    ms: Size | None = None
    f: Size | None = None
    p: Probability | None = None


class PrintedSources(Confined):
    """An ANOVA table, line by line; its last line is the residual."""

    where: Text
    lines: Annotated[tuple[PrintedSource, ...], Field(min_length=2)]


class PrintedIcc(Confined):
    """An intraclass correlation whose formula the study does not print."""

    where: Text
    value: Number


class PrintedClaim(Confined):
    """How many of a task's materials the text calls significantly above chance."""

    where: Text
    task: Name
    significant: Annotated[int, Field(ge=0, le=1000)]
    of: Count


class PrintedChoice(Confined):
    """The percentage of correct answers to one pair."""

    pair: Two
    correct: Percentage


def _choices_rules(table: Any) -> Iterator[Broken]:
    trials, people, pairs = table.get("trials"), table.get("participants"), len(_list(table.get("cells")))
    if isinstance(trials, int) and isinstance(people, int) and trials * people < pairs:
        yield Broken(("trials",), f"enough for {people} participants to have one for each of the {pairs} pairs")


class PrintedChoices(Confined):
    """Percentages of pairs without denominators; the study leaves open whether `trials` are a participant's or all."""

    RULES: ClassVar[Rules] = _choices_rules

    where: Text
    task: Name
    participants: Count
    trials: Count
    cells: Annotated[tuple[PrintedChoice, ...], Field(min_length=1)]


Quantity = Annotated[float, Field(gt=0, le=1e9)]


class PrintedBlock(Confined):
    """A virtual block that a device renders up to its largest force, and the fastest hand that may touch it."""

    where: Text
    stiffness_n_m: Quantity
    damping_n_s_m: Quantity
    rate_hz: Quantity
    fastest_mm_s: Quantity
    force_n: Quantity


def _dicts(table: object, *keys: str) -> Iterator[tuple[tuple[str | int, ...], dict[str, Any]]]:
    """Yield the tables that stand in lists under these keys, one within the other, each with its path."""
    for i, one in enumerate(_list(table.get(keys[0])) if isinstance(table, dict) else ()):
        if isinstance(one, dict) and len(keys) == 1:
            yield (keys[0], i), one
        elif isinstance(one, dict):
            yield from (((keys[0], i, *path), inner) for path, inner in _dicts(one, *keys[1:]))


MOST_PRINTED = 1000
"""The most cells, tests, lines and other entries of one file; a study has hundreds."""

MOST_LINES = 50
"""The most lines of one ANOVA table."""

ENTRIES: Mapping[str, tuple[str, ...]] = {
    **dict.fromkeys(("table", "text", "score", "choices"), ("cells",)),
    **dict.fromkeys(("task", "levels", "one_way", "two_way", "icc", "claim", "block"), ()),
    "t": ("tests",),
    "anova": ("lines",),
}
"""The key of each kind of entry, and of the entries within it."""


def _not_too_many(table: Any) -> Iterator[Broken]:
    counted = {key: sum(1 for _ in _dicts(table, key, *within)) for key, within in ENTRIES.items()}
    if sum(counted.values()) > MOST_PRINTED:
        allowed = f"at most {MOST_PRINTED} cells, tests and other entries in one file; split the file"
        yield Broken((max(counted, key=counted.__getitem__),), allowed)
    for path, block in _dicts(table, "anova"):
        if len(_list(block.get("lines"))) > MOST_LINES:
            yield Broken((*path, "lines"), f"at most {MOST_LINES} lines")


def _tasks_known(table: Any) -> Iterator[Broken]:
    known = {task.get("id") for _, task in _dicts(table, "task")}
    for keys in (("table",), ("text",), ("score",), ("one_way",), ("claim",), ("t", "tests")):
        for path, block in _dicts(table, *keys):
            if isinstance(block.get("task"), str) and block["task"] not in known:
                yield Broken((*path, "task"), f"one of: {', '.join(sorted(map(str, known)))}")


def _cells_once(table: Any) -> Iterator[Broken]:
    for key in ("table", "text", "score", "choices"):
        for path, block in _dicts(table, key):
            seen = set()
            for place, cell in _dicts(block, "cells"):
                named = str([cell.get(part) for part in ("presented", "answered", "name", "pair")])
                if named in seen:
                    yield Broken((*path, *place), "each cell once; remove one of them")
                seen.add(named)


def _scores_named_apart(table: Any) -> Iterator[Broken]:
    """A test is `of` a material or of a score, so that no score of a task may have the name of a material."""
    blocks = [block for key in ("table", "text") for _, block in _dicts(table, key)]
    cells = ((block, cell) for block in blocks for _, cell in _dicts(block, "cells"))
    materials = {str((block.get("task"), cell.get("presented"))) for block, cell in cells}
    for path, block in _dicts(table, "score"):
        for place, cell in _dicts(block, "cells"):
            if str((block.get("task"), cell.get("name"))) in materials:
                allowed = "a name other than the task's materials, such as 'ease of glass'"
                yield Broken((*path, *place, "name"), allowed)


def _something_printed(table: Any) -> Iterator[Broken]:
    keys = ("table", "score", "t", "one_way", "two_way", "anova", "choices", "icc")
    if not any(table.get(key) for key in keys):
        yield Broken(("table",), f"at least one of: {', '.join(keys)}")


def _levels_stated(table: Any) -> Iterator[Broken]:
    """Stars and claims of significance mean something only beside the level of each."""
    cells = [cell for key in ("table", "score") for _, cell in _dicts(table, key, "cells")]
    if not _list(table.get("levels")) and (table.get("claim") or any(cell.get("stars") for cell in cells)):
        yield Broken(("levels",), "the P below which each number of stars is given, if there are stars or claims")


def _nulls_stated(table: Any) -> Iterator[Broken]:
    """Chance is that of ratios: a score has none."""
    scores = {
        (block.get("task"), one.get("name")) for _, block in _dicts(table, "score") for _, one in _dicts(block, "cells")
    }
    for path, test in _dicts(table, "t", "tests"):
        if test.get("null") is not None:
            continue
        if (test.get("task"), test.get("of")) in scores:
            yield Broken((*path, "null"), "a number, if the test is of a score")
        elif table.get("chance") is None:
            yield Broken((*path, "null"), "a number, if the file states no chance")


def _published_rules(table: Any) -> Iterator[Broken]:
    rules = _not_too_many, _tasks_known, _cells_once, _scores_named_apart, _something_printed, _levels_stated
    for rule in (*rules, _nulls_stated):
        yield from rule(table)


class Published(Confined):
    """Everything that one study prints about answers; `levels` stand with the most stars first."""

    RULES: ClassVar[Rules] = _published_rules

    study: Label
    source: Text
    chance: Share | None = None
    levels: Annotated[
        tuple[PrintedLevel, ...], AfterValidator(lambda levels: tuple(sorted(levels, key=lambda level: level.p.value)))
    ] = ()
    task: tuple[PrintedTask, ...] = ()
    table: tuple[PrintedTable, ...] = ()
    text: tuple[PrintedPassage, ...] = ()
    score: tuple[PrintedScores, ...] = ()
    t: tuple[PrintedTests, ...] = ()
    one_way: tuple[PrintedOneWay, ...] = ()
    two_way: tuple[PrintedTwoWay, ...] = ()
    anova: tuple[PrintedSources, ...] = ()
    icc: tuple[PrintedIcc, ...] = ()
    claim: tuple[PrintedClaim, ...] = ()
    choices: tuple[PrintedChoices, ...] = ()
    block: tuple[PrintedBlock, ...] = ()

    @cached_property
    def cells(self) -> tuple[PrintedCell, ...]:
        """The cells of tables, then the scores, then the cells that the text repeats."""
        blocks: tuple[PrintedPassage | PrintedScores, ...] = (*self.table, *self.score, *self.text)
        return tuple(cell for block in blocks for cell in self.cells_of(block))

    @cached_property
    def tests(self) -> tuple[PrintedT, ...]:
        """Every t-test, each against its own null or else against chance."""
        chance = self.chance or Fraction(0)
        return tuple(
            PrintedT(group.where, one.task, one.of, one.df, one.t, one.p, chance if one.null is None else one.null)
            for group in self.t
            for one in group.tests
        )

    @cached_property
    def cells_by_key(self) -> Mapping[Key, tuple[PrintedCell, ...]]:
        """The cells that are about the same, wherever they stand."""
        return _by_key(self.cells)

    @cached_property
    def tests_by_key(self) -> Mapping[Key, tuple[PrintedT, ...]]:
        """The t-tests of each cell."""
        return _by_key(self.tests)

    @property
    def anovas(self) -> tuple[PrintedF, ...]:
        """Every F outside of ANOVA tables: one-way, then two-way."""
        return (*self.one_way, *self.two_way)

    def cells_of(self, block: PrintedPassage | PrintedScores) -> tuple[PrintedCell, ...]:
        """Return the cells of one table, one list of scores or one passage of the text."""
        is_score, in_table = isinstance(block, PrintedScores), isinstance(block, PrintedTable | PrintedScores)
        if isinstance(block, PrintedScores):
            scale = Scale(block.items, block.low, block.high) if block.items else None
        else:
            task = self.task_named(block.task)
            scale = Scale(task.trials) if task and task.trials else None
        starred = in_table and any(cell.stars for cell in block.cells)
        return tuple(
            PrintedCell(
                block.where, block.task, cell.presented, cell.answered, cell.mean, cell.sd,
                cell.stars if starred else None, scale, in_table, is_score,
            )
            for cell in block.cells
        )  # fmt: skip

    def tables(self) -> tuple[PrintedCell, ...]:
        """Return the cells that stand in tables, without those that the text repeats."""
        return tuple(cell for cell in self.cells if cell.in_table)

    def pairs(self) -> dict[str, tuple[str, str]]:
        """Return, by task, the two materials whose ratios the one-way ANOVA compares."""
        return {test.task: test.pair for test in self.one_way}

    def task_named(self, task: str) -> PrintedTask | None:
        """Return the task with this id, or None where the file names no such task."""
        return next((one for one in self.task if one.id == task), None)
