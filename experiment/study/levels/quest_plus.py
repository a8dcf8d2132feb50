"""QUEST+: the level whose answer is expected to leave the least entropy of threshold, spread and lapses.

What is known of a track is a probability for each of the protocol's thresholds, spreads and lapses, all equally
probable at first. With x and t the level and the threshold in dB, an answer is right with
psi(x) = guess + (1 - guess - lapse) Phi((x - t) / spread). The entropy expected after an answer at x is that before
less the information I(x) = h(E psi(x)) - E h(psi(x)), where h is the entropy of a choice of two (Watson 2017, equations
3 to 8, for two outcomes). The lowest level within `TIE` of the greatest information is presented.

A track's state is how often each level had a right and a wrong answer, of which its probabilities are a function: the
order of answers does not matter, and nothing is rounded on the way.

A. B. Watson: QUEST+: A general multidimensional Bayesian adaptive psychometric method. J. Vision 17(3):10, 2017.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import entr, ndtr

from palpate.experiment.protocol.models import Levels

TIE = 1e-9
"""Expected entropies, in nats, that differ by no more are equal; ours, far above rounding and below any use."""

LEAST = 1e-12
"""No answer is less probable than this, so that no answer is impossible; ours."""

Array = NDArray[np.float64]
State = tuple[tuple[int, int], ...]
"""Right and wrong answers at each level of the grid."""


@dataclass(frozen=True)
class QuestPlus:
    """Implements `Method`; the protocol's rules give `levels` what it needs."""

    levels: Levels
    beside_lapses: bool = False
    """Whether only the entropy of threshold and spread counts, whatever the lapses (psi)."""
    ends: ClassVar[Literal["precision"]] = "precision"

    def init(self) -> State:
        return ((0, 0),) * len(self.levels.grid)

    def step(self, state: State, *, level: float, right: bool) -> State:
        place = self.levels.grid.index(level)
        n_right, n_wrong = state[place]
        moved = (n_right + 1, n_wrong) if right else (n_right, n_wrong + 1)
        return (*state[:place], moved, *state[place + 1 :])

    def level(self, state: State) -> float | None:
        if self._is_known(state):
            return None
        return self.levels.grid[int(np.argmax(_most_telling(self, state)))]

    def allows(self, state: State, level: float) -> bool:
        """Return whether a level is one of those that tell most, to `TIE`, as another machine may compute them."""
        grid = self.levels.grid
        return level in grid and not self._is_known(state) and bool(_most_telling(self, state)[grid.index(level)])

    def threshold_db(self, state: State) -> tuple[float, float]:
        """Return mean and standard deviation of what is known of the threshold, dB above level 1."""
        t_db, known = _db(self.levels.thresholds or ()), _posterior(self.levels, state).sum(axis=(1, 2))
        mean = float(known @ t_db)
        return mean, float(np.sqrt(known @ (t_db - mean) ** 2))

    def _is_known(self, state: State) -> bool:
        wanted = self.levels.precision_db
        return wanted is not None and self.threshold_db(state)[1] <= wanted


@lru_cache(maxsize=64)
def _most_telling(of: QuestPlus, state: State) -> NDArray[np.bool_]:
    """Return which levels of the grid tell most, shape (levels,); the newest states of the tracks are remembered."""
    told = information(of, state)
    near: NDArray[np.bool_] = told >= told.max() - TIE
    return near


def information(of: QuestPlus, state: State) -> Array:
    """Return how much less entropy is expected after an answer at each level of the grid, nats, shape (levels,)."""
    known, (right, entropy, _) = _posterior(of.levels, state), _right(of.levels)
    mean = np.tensordot(right, known, 3)
    if not of.beside_lapses:
        left = np.tensordot(entropy, known, 3)
    else:
        each = known.sum(axis=2)
        with np.errstate(invalid="ignore", divide="ignore"):
            of_lapses = np.where(each[..., None] > 0, known / each[..., None], 0.0)
        left = np.tensordot(_choice((right * of_lapses).sum(axis=3)), each, 2)
    told: Array = _choice(mean) - left
    return told


def _choice(p: Array) -> Array:
    """Return the entropy of a choice of two, nats."""
    both: Array = entr(p) + entr(1 - p)
    return both


def _db(levels: tuple[float, ...]) -> Array:
    found: Array = 20 * np.log10(np.asarray(levels))
    return found


@lru_cache(maxsize=8)
def _right(levels: Levels) -> tuple[Array, Array, Array]:
    """Return how probably an answer is right at each level, threshold, spread and lapse, and the entropy of that.

    The third has the logarithms of an answer that is right and of one that is wrong at each level.
    """
    x, t = _db(levels.grid), _db(levels.thresholds or ())
    s, lapse, guess = np.asarray(levels.spreads_db), np.asarray(levels.lapses), levels.guess or 0.0
    felt = ndtr((x[:, None, None] - t[:, None]) / s)[..., None]
    right: Array = np.clip(guess + (1 - guess - lapse) * felt, LEAST, 1 - LEAST)
    return right, _choice(right), np.stack([np.log(right), np.log1p(-right)], axis=1)


def _posterior(levels: Levels, state: State) -> Array:
    """Return the probability of each threshold, spread and lapse, shape (thresholds, spreads, lapses)."""
    log: Array = np.tensordot(np.asarray(state, dtype=np.float64), _right(levels)[2], 2)
    weight: Array = np.exp(log - log.max())
    weight /= weight.sum()
    return weight


method = QuestPlus
