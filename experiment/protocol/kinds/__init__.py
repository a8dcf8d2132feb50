"""What a protocol file says of each kind of trial, and what a board's page says of it; and how rules read plain tables.

A kind is what sets a stimulus off and what plays it: a module that is named as in a protocol file and has a `KIND`; it
never imports another. It stands above the models, and is imported when it is looked up.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Literal, get_args

from palpate.experiment.protocol.blocks import Block
from palpate.experiment.settings.load import Broken, Confined, Table

Kind = Literal["footstep", "tapping"]
"""Every kind."""

NAMES: tuple[Kind, ...] = get_args(Kind)


@dataclass(frozen=True, kw_only=True)
class ProtocolKind:
    """A kind of trial. What is called with a protocol or a task gets models, the rest plain tables.

    Attributes:
        table: the model of the table with its name, which stands in a study of the kind where it is needed.
        since: the format of protocols that has the table first.
        intervals: how many materials one trial may present.
        at_will: whether what a trial presents is felt at will, until the answer.
        rules: what a file breaks, beyond what every file must keep.
        keys: places of keys that must be unlike all others, each with its key.
        sources: what the stimuli of a task are, by its `stimulus`.
        recorded: what is recorded of a trial, before what is of any.
        stimuli: how stimuli are made, and what starts them.
        felt: how long a task with virtual stimuli is felt.
        odd: legal but odd settings, each as its field, what it is, and what it would be as a rule.
    """

    table: type[Confined]
    since: int = 0
    intervals: tuple[int, ...]
    at_will: bool = False
    rules: Callable[[Table], Iterator[Broken]]
    sources: Mapping[str, str]
    recorded: Callable[[Any], str]
    stimuli: Callable[[Any], Iterator[Block]]
    felt: Callable[[Any, Any], str]
    keys: Callable[[Table], Sequence[tuple[tuple[str, ...], object]]] = lambda _: ()
    odd: Callable[[Any], Iterator[tuple[str, str, str]]] = lambda _: iter(())


def kind_of(name: str) -> ProtocolKind:
    """Return a kind by its name."""
    kind: ProtocolKind = import_module(f"{__name__}.{name}").KIND
    return kind


def is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def number_at(table: Table, key: str) -> float | None:
    value = table.get(key)
    return value if is_number(value) else None


def list_at(table: Table, key: str) -> Sequence[Any]:
    found = table.get(key)
    return found if isinstance(found, tuple) else ()


def table_at(table: Table, key: str) -> Table:
    found = table.get(key)
    return found if isinstance(found, Mapping) else {}


def tables_at(table: Table, key: str) -> list[tuple[int, Table]]:
    return [(i, entry) for i, entry in enumerate(list_at(table, key)) if isinstance(entry, Mapping)]
