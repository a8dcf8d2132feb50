"""Up-down: n right answers in a row lower the level by one step, a wrong one raises it by so many.

With steps down and up of one length (Levitt 1971) a track converges to the level at which n right answers in a row are
as likely as not, p^n = 1/2: 70.7 % right for n = 2 and 79.4 % for n = 3. With `up` steps up for one down it is where
the two are in balance, p^n = up / (up + 1) (Kaernbach 1991, equation 1, for n = 1): 75 % for n = 1 and `up` = 3.

A reversal is a trial after which the level would move the other way than it last did; at an end of the grid, beyond
which it cannot go, the direction counts all the same. It shortens the very step that makes it, as in PsychoPy.

H. Levitt: Transformed up-down methods in psychoacoustics. J. Acoust. Soc. Am. 49, 467-477, 1971.
C. Kaernbach: Simple adaptive testing with the weighted up-down method. Percept. Psychophys. 49, 227-229, 1991.
"""

from bisect import bisect_left
from dataclasses import dataclass
from typing import ClassVar, Literal

from palpate.experiment.protocol.models import Levels


@dataclass(frozen=True)
class State:
    """Where a track stands: its next level, right answers in a row since that moved, how it moved, and reversals.

    `way` is -1 after a step down, 1 after one up, and 0 before the first.
    """

    level: float
    run: int = 0
    way: int = 0
    reversals: int = 0


@dataclass(frozen=True)
class UpDown:
    """Implements `Method`; the protocol's rules give `levels` what it needs."""

    levels: Levels
    ends: ClassVar[Literal["reversals"]] = "reversals"

    def init(self) -> State:
        return State(self.levels.first or 0.0)

    def step(self, state: State, *, level: float, right: bool) -> State:
        run = state.run + 1 if right else 0
        if right and run < (self.levels.down or 0):
            return State(level, run, state.way, state.reversals)
        way, grid, steps = -1 if right else 1, self.levels.grid, self.levels.steps or (1,)
        reversals = state.reversals + (state.way == -way)
        moved = way * steps[min(reversals, len(steps) - 1)] * (1 if right else self.levels.up or 1)
        place = min(max(bisect_left(grid, level) + moved, 0), len(grid) - 1)
        return State(grid[place], 0, way, reversals)

    def level(self, state: State) -> float | None:
        return state.level if state.reversals < (self.levels.reversals or 0) else None

    def allows(self, state: State, level: float) -> bool:
        return level == self.level(state)


method = UpDown
