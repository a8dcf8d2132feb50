"""Materials that stand in no order of what was compared: how often each was named, as a table."""

from __future__ import annotations

from palpate.analysis.designs.comparison.results import AUTHORS, Compared, TaskComparisons, first_scale
from palpate.analysis.documents.tables import Column, Record, Table, count_of, ends, joined, tabulate

EACH = (
    Column("task", left=True), Column("of", "material", left=True), Column(("named", "trials"), show=count_of),
    Column("share", "", show=lambda share: "-" if share is None else f"{100 * share:.0f} %"),
    Column("value", decimals=2), Column(("low", "high"), "95 % CI", 2),
)  # fmt: skip


def each(results: Compared, mark: str) -> Table:
    """Return a table with a `mark` of how often each material was named over others, those with the most first."""
    records: list[Record] = []
    for task in results.tasks:
        scaled = first_scale(task)
        values = scaled.values if scaled else [None] * len(results.materials)
        rows: list[Record] = []
        for place, (name, value) in enumerate(zip(results.materials, values, strict=True)):
            named, trials = times_named(task, place)
            rows.append(
                {"task": task.task.id, "of": name, "named": named, "trials": trials,
                 "share": named / trials if trials else None, "law": scaled.law if scaled else None,
                 "value": value.value if value else None, **ends(value), "also_in": "pairs.csv, scales.csv"}
            )  # fmt: skip
        records += sorted(rows, key=lambda row: -(row["share"] or 0.0))
    laws = {str(row["law"]) for row in records if row["law"]}
    scale = f", and its value on the {joined([AUTHORS[law] for law in sorted(laws)])} scale" if laws else ""
    notes = (f"How often each material was chosen in a pair{scale}, with participants as the unit.",)
    return tabulate("Materials", EACH, records, notes, standing=mark)


def times_named(task: TaskComparisons, place: int) -> tuple[int, int]:
    """Return how often the material at a place was named over another one, and in how many trials it was with one."""
    over = [pair for pair in task.pairs if pair.high == place != pair.low]
    under = [pair for pair in task.pairs if pair.low == place != pair.high]
    named = sum(pair.right.count for pair in over)
    named += sum(pair.right.trials - pair.right.count - pair.ties for pair in under)
    return named, sum(pair.right.trials for pair in (*over, *under))
