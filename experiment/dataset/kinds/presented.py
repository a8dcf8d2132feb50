"""Presented stimuli in a dataset: a row for each presentation, on the session's clock."""

from collections.abc import Iterator
from pathlib import Path

from palpate.experiment.dataset.build import Cells, DatasetKind
from palpate.experiment.records import bridging
from palpate.experiment.records.entries import Outcome
from palpate.experiment.records.events import PLACES
from palpate.experiment.records.journal import Contents
from palpate.experiment.records.kinds.presented import CutShort, Interval, Presentation, all_delivered


def _cells(_: Path, contents: Contents) -> Iterator[tuple[Outcome, Cells]]:
    begun_ns = contents.lines[0].t_ns
    for entry, shift_ns in bridging.shifted(contents):
        if isinstance(entry, Presentation | CutShort):
            names = PLACES if len(entry.presented) > 1 else ("presented",)
            yield (
                entry,
                {
                    **dict(zip(names, entry.presented, strict=False)),
                    "delivered": all_delivered(entry.intervals),
                    **(_last(entry.intervals[-1], begun_ns - shift_ns) if entry.intervals else {}),
                    **({"redo_reason": entry.reason} if isinstance(entry, CutShort) else {}),
                },
            )


def _last(played: Interval, begun_ns: int) -> Cells:
    """Return the cells of the last stimulus of a trial."""
    made, heard = played.stimulus.computed, played.delivered
    off_ms = None if heard is None else heard.onset_error_ms
    return {
        "onset": round((played.began_ns - begun_ns) / 1e9, 6),
        "duration": played.stimulus.lasts_s,
        "stimulus_method": made.method,
        "stimulus_error": round(made.relative_error, 9),
        "left_out": None if made.left_out is None else round(made.left_out, 9),
        "dissimilarity": None if made.dissimilarity_m_s2 is None else round(made.dissimilarity_m_s2, 9),
        **({} if off_ms is None else {"delivery_error": round(off_ms / 1e3, 6)}),
    }


DATASET = DatasetKind(_cells)
