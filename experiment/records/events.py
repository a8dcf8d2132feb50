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
    """Return the columns of one kind, as a file of its name in `kinds/` and sidecars describe them.

    In events.json `further` are absent where a session does not know them, `imported` replace descriptions of imported
    answers, and `participants` are those of `participants.tsv`. `all` has what a text `all` stands for.
    """
    place = Path(__file__)
    known: dict[str, dict[str, Any]] = json.loads(place.with_suffix(".json").read_text("utf-8"))
    own = known.get(kind) or json.loads((place.parent / "kinds" / f"{kind}.json").read_text("utf-8"))
    return {name: known[text][name] if isinstance(text, str) else text for name, text in own.items()}
