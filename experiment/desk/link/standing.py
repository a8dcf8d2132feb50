"""How far a session is, what it measured, and once they are revealed its results, as a console shows them."""

from collections import Counter
from collections.abc import Iterator

from palpate.experiment.desk.link.wire import RECENT, SERIES, TALLIES, Standing, Tally, Told, Track
from palpate.experiment.desk.questions import NO_ANSWER, REVEALED
from palpate.experiment.records.entries import Answer, Outcome
from palpate.experiment.records.progress import Progress


def standing(done: Progress) -> Standing:
    """Return what a view says of a session of which so much is done."""
    revealed = REVEALED in done.visited
    return Standing(
        task=done.header.task,
        purpose=done.header.purpose,
        trials=done.trials,
        answered=len(done.answered),
        remaining=len(done.remaining),
        recent=tuple(
            Told(trial=trial, words=said or NO_ANSWER, corrected=trial in done.corrected)
            for trial, said in done.said[-RECENT:]
        ),
        responses_s=_responses_s(done)[-SERIES:],
        speeds_mm_s=tuple(_speeds_mm_s(done))[-SERIES:],
        revealed=revealed,
        tracks=tuple(_tracks(done)) if revealed else (),
        tallies=tuple(_tallies(done))[:TALLIES] if revealed else (),
    )


def _responses_s(done: Progress) -> tuple[float, ...]:
    """Return the response times of the newest answers that count, in order."""
    newest = {one.trial: one.response_time_s for one in done.measured if isinstance(one, Answer)}
    return tuple(newest[trial] for trial in done.answered if trial in newest)


def _speeds_mm_s(done: Progress) -> Iterator[float]:
    """Yield the speeds of the newest steps, one a trial."""
    newest = {one.trial: getattr(one, "speed_mm_s", None) for one in done.measured if isinstance(one, Outcome)}
    yield from (speed for speed in newest.values() if speed is not None)


def _tracks(done: Progress) -> Iterator[Track]:
    """Yield the levels of answered trials by track, the one that was answered last first."""
    of = {one.trial: one.track for one in done.header.order}
    leveled = [trial for trial in done.answered if trial in done.levels]
    for name in dict.fromkeys(of[trial] for trial in reversed(leveled)):
        levels = tuple(done.levels[trial] for trial in leveled if of[trial] == name)
        yield Track(name=name, levels=levels[-SERIES:])


def _tallies(done: Progress) -> Iterator[Tally]:
    """Yield how often each answer was given to what was presented, in the order of names."""
    of = {one.trial: one.track for one in done.header.order}
    counts = Counter((of[trial], said or NO_ANSWER) for trial, said in done.said).most_common()
    for name in sorted({about for (about, _), _ in counts}):
        yield Tally(presented=name, answers=tuple((said, times) for (about, said), times in counts if about == name))
