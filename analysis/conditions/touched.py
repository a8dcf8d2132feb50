"""What the skin touched, as sidecars of sessions have it: a rig's contactor, and what was recorded before each task."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Iterator
from typing import Any

from palpate.analysis.documents.tables import Column, Record, Section, tabulate
from palpate.analysis.reading.study import Study

CONTACTOR = {
    "area_mm2": ("contact area", "mm²"),
    "gap_mm": ("gap to the surround", "mm"),
    "static_force_n": ("static force", "N"),
}
"""What a rig states of its contactor, in words, with units."""

COLUMNS = (
    Column("of", "what", left=True), Column("value", "", left=True), Column("sessions"), Column("mean", decimals=2),
    Column("sd", "SD", 2), Column("least", decimals=2), Column("most", decimals=2), Column("unit", left=True),
)  # fmt: skip


def touched_section(study: Study) -> tuple[Section, ...]:
    """Return what the skin touched in the sessions that count, over all tasks; none where no dataset says it."""
    records = [*_records(study)]
    if not records:
        return ()
    text = (
        "Only sessions with at least one analyzed trial are included. Numbers are means across sessions; any "
        "without an SD is from the rig file. Answers in free text are only in the dataset."
    )
    table = tabulate("What the skin touched", COLUMNS, records, standing="descriptive")
    return (Section("touched", "What the skin touched", (text,), (table,)),)


def _records(study: Study) -> Iterator[Record]:
    left = study.attempts[study.attempts["included"]]
    sessions = [
        study.touched.get(key, {}) for key in dict.fromkeys(zip(left["participant"], left["task"], strict=True))
    ]
    contactors = [one["Contactor"] for one in sessions if "Contactor" in one]
    for part, count in Counter(str(one.get("part")) for one in contactors).items():
        yield {"quantity": "contactor", "of": "contactor", "value": part, "sessions": count}
    for key, (words, unit) in CONTACTOR.items():
        for stated, count in Counter(one[key] for one in contactors if key in one).items():
            yield {"quantity": "contactor", "of": words, "sessions": count, "mean": stated, "unit": unit}
    answered: dict[tuple[str, str | None], list[Any]] = {}
    for one in sessions:
        for name, item in one.get("Touch", {}).items():
            if (value := item.get("Value")) is not None and ("Levels" in item or isinstance(value, int | float)):
                answered.setdefault((name.replace("_", " "), item.get("Units")), []).append(value)
    for (of, units), values in answered.items():
        if all(isinstance(value, int | float) for value in values):
            yield {"quantity": "number", "of": of, "sessions": len(values), "mean": statistics.fmean(values),
                   "sd": statistics.stdev(values) if len(values) > 1 else None, "least": float(min(values)),
                   "most": float(max(values)), "unit": units}  # fmt: skip
        else:
            for chosen, count in Counter(values).most_common():
                yield {"quantity": "choice", "of": of, "value": str(chosen), "sessions": count}
