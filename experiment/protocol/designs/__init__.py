"""What a protocol file says of each design.

A design is what a trial is made of and what is asked about that: a module that is named as in a protocol file and has a
`DESIGN`; it never imports another. It stands above the models, and is imported when it is looked up.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from typing import Any, Literal, get_args

from palpate.experiment.settings.load import Broken, Confined, Table

Design = Literal["identification", "comparison", "rating", "detection"]
"""Every design."""

NAMES: tuple[Design, ...] = get_args(Design)

ANY, TWO, SEVERAL = range(1, 1000), range(2, 3), range(2, 1000)


@dataclass(frozen=True, kw_only=True)
class PlannableTest:
    """What a protocol states of a planned test: fields that it `needs`, and `takes`, each with the format it is from.

    It is of so many `tasks` and `materials`; each task presents so many, `common` to it if one, and to all if several.
    `leveled` ones are of tasks with levels too.
    """

    needs: tuple[str, ...] = ()
    takes: Mapping[str, int] = field(default_factory=dict)
    tasks: range = ANY
    materials: range = ANY
    each: int = 1
    common: tuple[int, int] = (0, 0)
    since: int = 2
    leveled: bool = False


@dataclass(frozen=True)
class Meaning:
    """What an answer key stands for: what goes on record, and the words for the experimenter."""

    answer: str
    words: str


@dataclass(frozen=True, kw_only=True)
class ProtocolDesign:
    """A design. What is called with a protocol gets models, the rest plain tables.

    Attributes:
        table: the model of the table with its name; None for a design that needs none.
        since: the format of protocols that has the table first, so that seals of older ones stay valid; 0 for all.
        intervals: how many materials one trial presents; of several, the one that its table has as `intervals`.
        tests: the tests that it offers to be planned, by name.
        rules: what a file breaks, beyond what every file must keep.
        answers: what each answer key stands for in a trial; of one that is laid out, with what lies there in order.
        named: what each answer names that is no material, as a dataset says it.
        presents: what a task presents, as a dataset says it.
        right: whether an answer is right, to what was presented in this order; None where none is right or wrong.
        shown: the answers that the participant's screen names.
        keys: places of keys that must be unlike all others, each with its key.
        presentations: what a block presents; None where that is each material, or every pair of two, once.
        asks: what participants are asked in each trial, unless their task says it; empty for what they felt.
        catches: whether what is presented has no signal, so that the trial is of no track.
    """

    table: type[Confined] | None = None
    since: int
    intervals: tuple[int, ...]
    tests: Mapping[str, PlannableTest]
    rules: Callable[[Table], Iterator[Broken]]
    answers: Callable[[Any, Sequence[str]], Mapping[str, Meaning]]
    named: Callable[[Any], Mapping[str, str]] = lambda _: {}
    presents: Callable[[Any, Any], str]
    right: Callable[[Any, Sequence[str], str], bool] | None = None
    shown: Callable[[Any], tuple[str, ...]]
    keys: Callable[[Table], Sequence[tuple[tuple[str | int, ...], object]]] = lambda _: ()
    presentations: Callable[[Any, Any], tuple[tuple[str, ...], ...]] | None = None
    catches: Callable[[Any, Sequence[str]], bool] = lambda *_: False
    asks: Callable[[Any], str] = lambda _: ""

    def shown_together(self, own: object) -> int:
        """Return how many materials one trial presents by the design's table: a model, a plain one, or none."""
        stated = own.get("intervals") if isinstance(own, Mapping) else getattr(own, "intervals", None)
        return next((one for one in self.intervals if one == stated), self.intervals[0])


@cache
def design_of(name: str) -> ProtocolDesign:
    """Return a design by its name."""
    design: ProtocolDesign = import_module(f"{__name__}.{name}").DESIGN
    return design


def plannable_tests() -> dict[str, PlannableTest]:
    """Return the tests of every design, by name."""
    return {name: test for design in NAMES for name, test in design_of(design).tests.items()}
