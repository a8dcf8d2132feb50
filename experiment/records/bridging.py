"""Bridges a clock that was set back while a session was paused, so that its times rise all the same.

Each runner of a session has a clock of its own that never goes back, set by the machine's when it starts. A runner that
starts before its predecessor's last line, by these, is moved: by the machine's uptime where both ran since the same
start of the machine, and otherwise to that line, as if the pause had taken no time.
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise

from palpate.experiment.records.entries import Entry, Exposure, Resumed
from palpate.experiment.records.journal import Contents, Line


def shifted(contents: Contents) -> Iterator[tuple[Entry, int]]:
    """Yield each entry of a journal with what is added to its session times, ns; 0 where no clock was set back."""
    last_ns = 0
    before: Sequence[Line] = ()
    for lines in _runners(contents):
        shift_ns = 0
        if before and lines[0].t_ns < last_ns:
            shift_ns = max(last_ns - lines[0].t_ns, _by_uptime(before, lines))
        yield from ((line.entry, shift_ns) for line in lines)
        before = [Line(line.t_ns + shift_ns, line.entry) for line in lines] if shift_ns else lines
        # Whoever notes something in a pause has a clock of their own.
        last_ns = max([last_ns, *(line.t_ns for line in before)])


def set_back_ns(contents: Contents) -> int:
    """Return how far the clock was set back at least while a session was paused, all times together, ns."""
    shifts = [0, *(shift_ns for entry, shift_ns in shifted(contents) if isinstance(entry, Resumed))]
    return sum(max(0, after - before) for before, after in pairwise(shifts))


def _by_uptime(before: Sequence[Line], after: Sequence[Line]) -> int:
    """Return the shift of a runner by the machine's uptime, ns; 0 where that says nothing."""
    last, first = (_uptimes(lines)[at : at + 1 or None] for lines, at in ((before, -1), (after, 0)))
    for (boot, up_ns, t_ns), (other, up_then_ns, then_ns) in zip(last, first, strict=False):
        if boot == other:
            return t_ns + up_then_ns - up_ns - then_ns
    return 0


def _uptimes(lines: Sequence[Line]) -> list[tuple[str, int, int]]:
    return [
        (line.entry.boot, line.entry.up_ns, line.t_ns)
        for line in lines
        if isinstance(line.entry, Exposure) and line.entry.boot is not None and line.entry.up_ns is not None
    ]


def _runners(contents: Contents) -> list[Sequence[Line]]:
    resumed = [n for n, entry in enumerate(contents.entries) if n and isinstance(entry, Resumed)]
    return [contents.lines[first:last] for first, last in pairwise([0, *resumed, len(contents.lines)])]
