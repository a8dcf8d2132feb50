"""Taps on two materials in a dataset: a row for each pair that was laid out."""

from collections.abc import Iterator
from pathlib import Path

from palpate.experiment.dataset.build import Cells, DatasetKind
from palpate.experiment.protocol.designs.comparison import FIRST, SECOND, TIE, Comparison
from palpate.experiment.records.entries import Outcome
from palpate.experiment.records.journal import Contents
from palpate.experiment.records.kinds.tapping import PairLaidOut

ANSWERS = {FIRST: "the material presented first", SECOND: "the one presented second", TIE: "neither of the two"}
"""What each answer names, as the sidecar tells it."""


def _cells(_: Path, contents: Contents) -> Iterator[tuple[Outcome, Cells]]:
    begun_ns = contents.lines[0].t_ns
    for entry in contents.entries:
        if isinstance(entry, PairLaidOut):
            first, second = entry.presented
            yield entry, {"onset": round((entry.laid_ns - begun_ns) / 1e9, 6), "first": first, "second": second}


DATASET = DatasetKind(
    _cells,
    lambda protocol, task: (
        f"{len(protocol.presentations(task))} pairs of {len(protocol.materials_of(task))} materials, compared by their "
        f"{protocol.table(Comparison).quality}"
    ),
    lambda protocol: {answer: ANSWERS[answer] for answer in protocol.table(Comparison).answers.values()},
)
