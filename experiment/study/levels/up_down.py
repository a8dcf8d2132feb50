"""Transformed up-down (Levitt 1971): n right answers in a row lower the level by one place, a wrong one raises it.

A track converges to the level at which n right answers in a row are as likely as not, p^n = 1/2: 70.7 % right for n = 2
and 79.4 % for n = 3. A reversal is a trial after which the level would move the other way than it last did; at an end
of the grid, beyond which it cannot go, the direction counts all the same.

H. Levitt: Transformed up-down methods in psychoacoustics. J. Acoust. Soc. Am. 49, 467-477, 1971.
"""

from bisect import bisect_left
from dataclasses import dataclass

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
    """Implements `Method`."""

    levels: Levels

    def init(self) -> State:
        return State(self.levels.first)

    def step(self, state: State, *, level: float, right: bool) -> State:
        run = state.run + 1 if right else 0
        if right and run < self.levels.down:
            return State(level, run, state.way, state.reversals)
        way, grid = -1 if right else 1, self.levels.grid
        place = min(max(bisect_left(grid, level) + way, 0), len(grid) - 1)
        return State(grid[place], 0, way, state.reversals + (state.way == -way))

    def level(self, state: State) -> float | None:
        return state.level if state.reversals < self.levels.reversals else None


method = UpDown
