"""Columns of the events tables made from journals, by kind of trial; shared with analysis."""

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, Literal

NO_ANSWER = "(none)"
"""How a trial without an answer stands in tables."""

Columns = Mapping[str, Mapping[str, object]]
"""Column -> what a sidecar says of it, in the order of the table."""


@cache
def columns_of(kind: Literal["footstep", "comparison", "further", "imported", "participants"]) -> Columns:
    """Return the columns of one kind, as events.json describes them and a sidecar does.

    `footstep` and `comparison` are those of `_events.tsv`, by the kind of trial. `further` are left out where a session
    knows nothing of them, as simulated time of durations. `imported` is what is said otherwise of answers that were
    measured elsewhere, and `participants` are the columns of `participants.tsv`. Where the name of
    another kind stands for a description, it is the one given there.
    """
    known: dict[str, dict[str, Any]] = json.loads(Path(__file__).with_suffix(".json").read_text("utf-8"))
    return {name: known[text][name] if isinstance(text, str) else text for name, text in known[kind].items()}
