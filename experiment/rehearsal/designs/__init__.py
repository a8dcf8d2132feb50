"""What a simulated participant answers by what was felt.

What is felt is the kind's, what is answered the design's: each design has a module of its name here, with `judge`, and
is imported when it is looked up.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, cast

from palpate.experiment.protocol.models import Protocol, Task

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True)
class Percept:
    """What one stimulus of a trial felt like; a kind gives what its designs judge by.

    `alike` is how like each material it was, as remembered, in the order of the file, shape (n,), or (0,) where nothing
    was noticed, and None of a kind that gives none. `strength` has a standard deviation of `error` x `told_apart`, the
    difference that is just told apart; `favour` is what being presented first adds to it in an answer.
    """

    alike: NDArray[np.float64] | None = None
    strength: float = 0.0
    error: float = 1.0
    told_apart: float = 1.0
    favour: float = 0.0


@dataclass(frozen=True)
class Judged:
    """An answer: its key, the words for it, and how many `told_apart` the stimuli of the trial differed by."""

    key: str
    words: str
    apart: float = 0.0


Judge = Callable[[Protocol, Sequence[Percept], "np.random.Generator"], Judged]


def judge_of(task: Task) -> Judge:
    """Return what answers a trial of a task's design, by what each stimulus felt like; a generator draws the answer."""
    module: Any = import_module(f"{__name__}.{task.design}")
    return cast("Judge", module.judge)
