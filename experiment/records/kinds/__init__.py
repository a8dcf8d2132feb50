"""What each kind of trial leaves in the journal: its entries, and `LINES`, what makes the line of each in a transcript.

A kind is imported when a journal of it is read, and never imports another.
"""

from importlib import import_module
from importlib.util import find_spec

from palpate.experiment.records.entries import Lines


def lines_of(task_kind: str) -> Lines:
    """Return the entries of a kind of trial, by its name in a header. Raises `ValueError` for an unknown kind."""
    module = f"{__name__}.{task_kind}"
    if not task_kind.isidentifier() or find_spec(module) is None:
        raise ValueError(f"got the kind of trial '{task_kind}', which this palpate does not have")
    lines: Lines = import_module(module).LINES
    return lines
