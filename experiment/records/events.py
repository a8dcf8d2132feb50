"""Columns of the events tables made from journals, by kind of trial; shared with analysis."""

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

NO_ANSWER = "(none)"
"""How a trial without an answer stands in tables."""

PLACES = ("first", "second")
"""Columns of what a trial presents where it presents several."""

Columns = Mapping[str, Mapping[str, object]]
"""Column -> what a sidecar says of it, in the order of the table."""


@cache
def columns_of(kind: str, intervals: int = 1) -> Columns:
    """Return the columns of one kind, as a file of its name in `kinds/` and sidecars describe them.

    A kind that has `presented` and `PLACES` has the one where a trial presents one material, else as many of the others
    as there are `intervals`.

    In events.json `further`, `force` of a foot, `sites` of the body, `heard` by an accelerometer and `heard_of` what,
    and `answers` of participants are absent where a session does not know them, `imported` replace descriptions of
    imported answers, and `participants` are those of `participants.tsv`. `all` has what a text `all` stands for.
    """
    place = Path(__file__)
    known: dict[str, dict[str, Any]] = json.loads(place.with_suffix(".json").read_text("utf-8"))
    own = known.get(kind) or json.loads((place.parent / "kinds" / f"{kind}.json").read_text("utf-8"))
    places = {"presented", *PLACES}
    left = places - {*(PLACES[:intervals] if intervals > 1 else ("presented",))} if places <= own.keys() else set()
    return {
        name: known[text][name] if isinstance(text, str) else text for name, text in own.items() if name not in left
    }
