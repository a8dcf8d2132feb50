"""What each kind of trial leaves in the journal: its `ENTRIES`.

A kind is imported when a journal of it is read, and never imports another.
"""

from importlib import import_module
from importlib.util import find_spec

from palpate.experiment.records.entries import Entry


def entries_of(task_kind: str) -> tuple[type[Entry], ...]:
    """Return the entries of a kind of trial, by its name in a header. Raises `ValueError` for an unknown kind."""
    module = f"{__name__}.{task_kind}"
    if not task_kind.isidentifier() or find_spec(module) is None:
        raise ValueError(f"got the kind of trial '{task_kind}', which this version of palpate does not have")
    entries: tuple[type[Entry], ...] = import_module(module).ENTRIES
    return entries
