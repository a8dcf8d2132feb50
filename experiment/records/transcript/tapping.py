"""The lines of the entries of tapping."""

from palpate.experiment.records.kinds.tapping import Changed, PairLaidOut, Pushed, Tapped
from palpate.experiment.records.transcript import Lines
from palpate.experiment.records.transcript.stimulus import onset_line, played_line


def _laid_out(entry: PairLaidOut) -> str:
    return f"{entry.label}: {' and '.join(entry.presented)} have been laid out"


def _changed(entry: Changed) -> str:
    return f"{entry.label}: changed to the {entry.place} surface, {entry.material}"


def _tapped(entry: Tapped) -> str:
    return (
        f"{entry.label}: tapped the {entry.place} surface, {entry.material}, at "
        f"{entry.speed_mm_s:.1f} mm/s{' (too fast)' if entry.fast else ''}; "
        f"{played_line(entry.stimulus, entry.onset)}{onset_line(entry.onset)}"
    )


def _pushed(entry: Pushed) -> str:
    return f"the force was recorded for {entry.cycles} servo cycles and lost for {entry.lost}"


LINES: Lines = {PairLaidOut: _laid_out, Changed: _changed, Tapped: _tapped, Pushed: _pushed}
