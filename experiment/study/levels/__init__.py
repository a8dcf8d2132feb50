"""Levels that follow from answers: what goes on record before each attempt, and whether a record follows its rule.

A session asks `Tracks.upcoming` before every attempt, and a dataset's check replays a journal by the same function. The
next level is a fold over the answers that count, each with the level that is on record for its trial, so that neither a
correction nor a newer version changes what was. Catch trials are of no track: they have no level, and move none. A
method is a module that is named as in a protocol file and has a `method`; it is imported when a task with it is run or
checked.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, Protocol

from palpate.experiment.findings import Finding
from palpate.experiment.protocol import models
from palpate.experiment.protocol.designs import design_of
from palpate.experiment.records.entries import Armed, Entry, Footer, Header, LevelChosen, PlannedTrial, TrackEnded
from palpate.experiment.records.progress import Progress, progress
from palpate.experiment.study.levels.constant import levels_by_trial

RESTORE = "restore the journal from a backup"


class Method(Protocol):
    """How the levels of one track follow from its answers; a state is immutable, and its own."""

    @property
    def ends(self) -> Literal["reversals", "precision", "trials"]:
        """Why it ends a track that has trials left."""

    def init(self) -> Any:
        """Return the state before the first answer."""

    def step(self, state: Any, *, level: float, right: bool) -> Any:
        """Return the state after an answer to a trial at a level."""

    def level(self, state: Any) -> float | None:
        """Return the level of the next trial; None after the last one."""

    def allows(self, state: Any, level: float) -> bool:
        """Return whether a level that is on record may be that of the next trial."""


@dataclass(frozen=True)
class Tracks:
    """The tracks of a task with levels."""

    protocol: models.Protocol
    task: models.Task

    def upcoming(self, done: Progress) -> Iterator[LevelChosen | TrackEnded]:
        """Yield what goes on record before the next attempt: each track that has ended, then the attempt's level."""
        method, states, catches = method_of(self.task), self._states(done), self._catches(done.header)
        grid = self.task.levels.grid if self.task.levels is not None and method.ends == "trials" else ()
        fixed = levels_by_trial(done.header, grid, catches)
        for track, state in states.items():
            if track in done.ended:
                continue
            is_over = method.level(state) is None
            if is_over or all(planned.track != track for planned in done.remaining):
                entry = TrackEnded(track=track, why=method.ends if is_over else "trials")
                yield entry
                done = done.after(entry)
        if states.keys() <= done.ended and any(method.level(state) is None for state in states.values()):
            for name in sorted({*catches.values()} - done.ended):
                entry = TrackEnded(track=name, why="tracks")
                yield entry
                done = done.after(entry)
        for planned in done.remaining[:1]:
            if planned.trial in catches:
                continue
            attempt, level = done.attempts.get(planned.trial, 0) + 1, method.level(states[planned.track])
            level = fixed.get(planned.trial, level)
            if level is not None:
                yield LevelChosen(trial=planned.trial, attempt=attempt, track=planned.track, level=level)

    def findings(self, path: Path, recorded: Sequence[Entry]) -> Iterator[Finding]:
        """Yield the first entry of a journal, the header first, that is not what the ones before it lead to."""
        done, chosen = progress(recorded[:1]), (0, 0)
        catches = self._catches(done.header)
        for line, entry in enumerate(recorded[1:], start=2):
            if isinstance(entry, LevelChosen | TrackEnded):
                expected = next(self.upcoming(done), None)
                if not self._follows(entry, expected, done):
                    allowed = "nothing" if expected is None else _described(expected)
                    what = f"has {_described(entry)}, which does not follow from the earlier answers"
                    yield Finding(what, path, line=line, allowed=allowed, remedy=RESTORE)
                    return
            if isinstance(entry, LevelChosen):
                chosen = entry.trial, entry.attempt
            if isinstance(entry, Armed) and chosen != (entry.trial, entry.attempt) and entry.trial not in catches:
                yield Finding(f"has {entry.label} without a recorded level", path, line=line, remedy=RESTORE)
                return
            if isinstance(entry, Footer) and entry.reason == "complete" and (left := next(self.upcoming(done), None)):
                yield Finding(f"ends without {_described(left)}", path, line=line, remedy=RESTORE)
            done = done.after(entry)

    def _follows(self, entry: Entry, expected: LevelChosen | TrackEnded | None, done: Progress) -> bool:
        if entry == expected:
            return True
        if not isinstance(entry, LevelChosen) or not isinstance(expected, LevelChosen):
            return False
        is_same = entry.model_copy(update={"level": expected.level}) == expected
        return is_same and method_of(self.task).allows(self._states(done)[entry.track], entry.level)

    def _catches(self, header: Header) -> dict[int, str]:
        """Return the trials that are of no track, each with the name of what it presents."""
        catches, every = design_of(self.task.design).catches, {one.presented for one in header.order}
        without = {presented for presented in every if catches(self.protocol, presented)}
        return {one.trial: one.track for one in header.order if one.presented in without}

    def _states(self, done: Progress) -> dict[str, Any]:
        """Return the state of each track, in the order of their names."""
        method = method_of(self.task)
        catches = self._catches(done.header)
        tracks = {planned.track for planned in done.header.order if planned.trial not in catches}
        states = {track: method.init() for track in sorted(tracks)}
        right, planned = design_of(self.task.design).right, {one.trial: one for one in done.header.order}
        for trial, answered in done.said:
            if right is not None and answered is not None and trial in done.levels and trial not in catches:
                one: PlannedTrial = planned[trial]
                is_right = right(self.protocol, one.presented, answered)
                states[one.track] = method.step(states[one.track], level=done.levels[trial], right=is_right)
        return states


def method_of(task: models.Task) -> Method:
    """Return the method of a task with levels. Raises `ValueError` for one without."""
    if task.levels is None:
        raise ValueError(f"got task {task.id} without levels")
    made: Method = import_module(f"{__name__}.{task.levels.method.replace('-', '_')}").method(task.levels)
    return made


def methods(protocol: models.Protocol) -> dict[str, Method]:
    """Return the method of each task with levels, by its id."""
    return {task.id: method_of(task) for task in protocol.tasks if task.levels is not None}


def _described(entry: LevelChosen | TrackEnded) -> str:
    if isinstance(entry, TrackEnded):
        return f"the end of track {entry.track} ({entry.why})"
    return f"level {entry.level!r} of track {entry.track} for {entry.label}"
