"""What a kill took from raw data without which a dataset is built all the same: the force of some cycles.

The trace of a foot is of one step, and is whole or refused.
"""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.errors import Finding
from palpate.experiment.protocol.blocks import count
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Entry, Header, Trace


def cut_off(path: Path, recorded: Iterable[Entry]) -> tuple[dict[int, Trace], int]:
    """Return the traces of which a file of raw data has the beginning at most, by the places of their entries, and how
    many bytes no entry names: a kill left them.

    The file of a journal, at this path, ends before such a trace, or did when the session went on with it. Of a file
    that is not there, or that is not `lossy`, nothing is returned.
    """
    named = _named(recorded)
    if not named or not (file := storage.raw_path(path, named[0][1].file)).exists():
        return {}, 0
    cut, unnamed, end = dict[int, Trace](), 0, storage.size(file)
    for place, trace in reversed(named):
        if trace.offset + trace.length > end:
            cut[place] = trace
        else:
            unnamed += end - trace.offset - trace.length
        end = min(end, trace.offset)
    return cut, unnamed + end


def without_lost(path: Path, recorded: Iterable[Entry]) -> list[Entry]:
    """Return the entries of a journal, at this path, but for those whose raw data are lost and may be."""
    recorded = tuple(recorded)
    cut, _ = cut_off(path, recorded)
    return [entry for place, entry in enumerate(recorded) if place not in cut]


def losses(sessions: Iterable[tuple[Path, Header]]) -> Iterator[Finding]:
    """Yield what the file of each journal has lost that tables and traces are made without."""
    for path, _ in sessions:
        if any(storage.raw_path(path, end).exists() for end in storage.RAW[1:]):
            yield from _loss(path, journal.read(path).entries)


def _loss(path: Path, recorded: Sequence[Entry]) -> Iterator[Finding]:
    named = _named(recorded)
    cut, unnamed = cut_off(path, recorded)
    if not cut and not unnamed:
        return
    (what, size), (_, part) = _unit(named[0][1]), named[0][1].of_what
    lost = sum(trace.length for trace in cut.values()) // size
    parts = f"{len(cut)} of {count(len(named), part)}"
    told = [f"ends too early and has lost {count(lost, what)}, {parts}"] if cut else []
    if unnamed:
        torn = f"has {count(unnamed, 'byte')} not recorded in any line, e.g., after an interrupted {part}"
        told.append(f"{torn}: {count(-(-unnamed // size), what)} lost")
    remedy = "restore it from a backup if the backup is more complete" if cut else ""
    file = storage.raw_path(path, named[0][1].file)
    yield Finding("; it ".join(told), file, remedy=remedy, verdict="warns")


def _named(recorded: Iterable[Entry]) -> list[tuple[int, Trace]]:
    """Return the traces that may lose their end, each with the place of its entry."""
    traces = ((place, entry.frames) for place, entry in enumerate(recorded))
    return [(place, trace) for place, trace in traces if trace is not None and _unit(trace)[1]]


def _unit(trace: Trace) -> tuple[str, int]:
    """Return what the file of a trace consists of, and the bytes of each, 0 of one that is whole or refused."""
    unit: tuple[str, int] = getattr(trace, "lossy", ("", 0))
    return unit
