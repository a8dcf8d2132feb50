"""Presented stimuli in a dataset: a row for each presentation, on the session's clock."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from palpate.experiment.dataset.build import Cells, DatasetKind, heard_cells
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
                    **_sites(names, entry.intervals),
                    "delivered": all_delivered(entry.intervals),
                    **(_played(entry.intervals, begun_ns - shift_ns) if entry.intervals else {}),
                    **({"redo_reason": entry.reason} if isinstance(entry, CutShort) else {}),
                },
            )


def _sites(names: Sequence[str], intervals: Sequence[Interval]) -> Cells:
    """Return the cells of where each stimulus was felt, in a study of several sites."""
    columns = ("site",) if len(names) == 1 else tuple(f"{name}_site" for name in names)
    felt = zip(columns, intervals, strict=False)
    return {column: one.site for column, one in felt if one.site is not None}


def _played(intervals: Sequence[Interval], begun_ns: int) -> Cells:
    """Return the cells of what a trial presented: times are of the last stimulus, each share of the worst."""
    last, heard = intervals[-1], intervals[-1].delivered
    worst = max((one.stimulus.computed for one in intervals), key=lambda made: made.relative_error)
    off_ms = None if heard is None else heard.onset_error_ms
    return {
        "onset": round((last.began_ns - begun_ns) / 1e9, 6),
        "duration": last.stimulus.lasts_s,
        "stimulus_method": worst.method,
        "stimulus_error": round(worst.relative_error, 9),
        "left_out": _most(one.stimulus.computed.left_out for one in intervals),
        "dissimilarity": _most(one.stimulus.computed.dissimilarity_m_s2 for one in intervals),
        **({} if off_ms is None else {"delivery_error": round(off_ms / 1e3, 6)}),
        **heard_cells(last.stimulus, last.material if len(intervals) > 1 else None),
    }


def _most(shares: Iterable[float | None]) -> float | None:
    """Return the largest share that is known, rounded; None for none."""
    known = [one for one in shares if one is not None]
    return round(max(known), 9) if known else None


DATASET = DatasetKind(_cells)
