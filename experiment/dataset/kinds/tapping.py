"""Taps on two materials in a dataset: a row for each pair that was laid out."""

from collections.abc import Iterator
from pathlib import Path

from palpate.experiment.dataset.build import Cells, DatasetKind
from palpate.experiment.records import bridging
from palpate.experiment.records.entries import Outcome
from palpate.experiment.records.journal import Contents
from palpate.experiment.records.kinds.tapping import PairLaidOut


def _cells(_: Path, contents: Contents) -> Iterator[tuple[Outcome, Cells]]:
    begun_ns = contents.lines[0].t_ns
    for entry, shift_ns in bridging.shifted(contents):
        if isinstance(entry, PairLaidOut):
            first, second = entry.presented
            yield (
                entry,
                {"onset": round((entry.laid_ns + shift_ns - begun_ns) / 1e9, 6), "first": first, "second": second},
            )


DATASET = DatasetKind(_cells)
