"""What each kind of trial leaves in the journal: its entries, each with its line in a transcript.

A kind is a module with `RECORDS`, which the list in `transcript.py` names. It never imports another kind.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from palpate.experiment.records.entries import Entry


@dataclass(frozen=True)
class RecordsKind:
    """A kind of trial in the journal: each of its entries, with what makes its line in a transcript."""

    name: str
    lines: Mapping[type[Entry], Callable[[Any], str]]
