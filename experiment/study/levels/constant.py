"""Constant stimuli: each level of the grid as often as any other, drawn before the first trial, whatever is answered.

A track has each level once in every so many of its trials as there are levels, in an order that is drawn from the
session's seed, so that a trial which is done again has the level that it had. Of two such passes the second has each
level in the other order of what a trial presents.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

from palpate.experiment.study.schedule import Draws

if TYPE_CHECKING:
    from palpate.experiment.protocol.models import Levels
    from palpate.experiment.records.entries import Header


@dataclass(frozen=True)
class Constant:
    """Implements `Method`; `levels_by_trial` has the level of each trial."""

    levels: Levels
    ends: ClassVar[Literal["trials"]] = "trials"

    def init(self) -> None:
        return None

    def step(self, state: None, *, level: float, right: bool) -> None:  # noqa: ARG002
        return state

    def level(self, state: None) -> float:  # noqa: ARG002
        return self.levels.grid[0]

    def allows(self, state: None, level: float) -> bool:  # noqa: ARG002
        return False


def levels_by_trial(header: Header, grid: Sequence[float], catches: Collection[int]) -> dict[int, float]:
    """Return the level of every trial of a session by its number, but of `catches`, which have none.

    Without a grid no level is drawn.
    """
    found: dict[int, float] = {}
    turned: dict[float, tuple[str, ...]] = {}
    for track in sorted({one.track for one in header.order}):
        draws = Draws("constant levels", header.seed, header.participant, header.task, track)
        trials = [one for one in header.order if one.track == track and one.trial not in catches]
        for place, one in enumerate(trials if grid else ()):
            if place % len(grid) == 0:
                left = draws.shuffled(grid)
            if place % (2 * len(grid)) == 0:
                turned = {}
            level = next((level for level in left if turned.get(level) != one.presented), left[0])
            left.remove(level)
            turned[level], found[one.trial] = one.presented, level
    return found


method = Constant
