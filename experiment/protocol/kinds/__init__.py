"""What a protocol file says of each kind of trial; and how rules read plain tables.

A kind is what sets a stimulus off and what plays it: a module that is named as in a protocol file and has a `KIND`; it
never imports another. It stands above the models, and is imported when it is looked up.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Literal, get_args

from palpate.experiment.settings.load import Broken, Confined, Table

Kind = Literal["footstep", "tapping", "presented"]
"""Every kind."""

NAMES: tuple[Kind, ...] = get_args(Kind)


@dataclass(frozen=True, kw_only=True)
class ProtocolKind:
    """A kind of trial. What is called with a table gets a plain one.

    Attributes:
        table: the model of the table with its name, which stands in a study of the kind where it is needed.
        since: the format of protocols that has the table first, so that seals of older ones stay valid; 0 for all.
        intervals: how many materials one trial may present.
        at_will: whether what a trial presents is felt at will, until the answer.
        rules: what a file breaks, beyond what every file must keep.
        keys: places of keys that must be unlike all others, each with its key.
        silent: the materials of which nothing is felt.
        floor_m_s2: the rms that a participant of a protocol, or None for all, was measured not to feel; None without.
    """

    table: type[Confined]
    since: int
    intervals: tuple[int, ...]
    at_will: bool = False
    rules: Callable[[Table], Iterator[Broken]]
    keys: Callable[[Table], Sequence[tuple[tuple[str, ...], object]]] = lambda _: ()
    silent: Callable[[Table], Sequence[object]] = lambda _: ()
    floor_m_s2: Callable[[Any, str | None], float | None] = lambda *_: None


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
