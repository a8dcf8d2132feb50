"""Columns of the events tables made from journals, by kind of trial; shared with analysis."""

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

NO_ANSWER = "(none)"
"""How a trial without an answer stands in tables."""

Columns = Mapping[str, Mapping[str, object]]
"""Column -> what a sidecar says of it, in the order of the table."""


@cache
def columns_of(kind: str) -> Columns:
    """Return the columns of one kind, as events.json and sidecars describe them.

    `further` are absent where a session does not know them, `imported` replace descriptions of imported answers, and
    `participants` are those of `participants.tsv`. Another kind's name as a description stands for its description.
    """
    known: dict[str, dict[str, Any]] = json.loads(Path(__file__).with_suffix(".json").read_text("utf-8"))
    return {name: known[text][name] if isinstance(text, str) else text for name, text in known[kind].items()}
