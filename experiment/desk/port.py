"""What a session needs of the experimenter's screen and keys; each console is one file that implements it.

Words that sessions and recordings put to the experimenter alike.
"""

from __future__ import annotations

from typing import Protocol

from experiment.apparatus.ports import Rester


class Console(Rester, Protocol):
    """What the experimenter sees and keys. It never decides what comes next."""

    def show(self, text: str) -> None:
        """Put a line before the experimenter."""
        ...

    def familiarise(self, *, instruction: str, min_s: float, max_s: float) -> None:
        """Wait while the participant handles the real materials; returns when the experimenter ends it."""
        ...

    def level(self, *, level_db_a: float, limit_db_a: float, criterion: str, keys: dict[str, str]) -> str:
        """Have the masker's level judged by `criterion`: one of `keys` to change it, or nothing to keep it."""
        ...

    def place(self, *, trial: int, material: str) -> None:
        """Have the real object laid out; returns when it lies."""
        ...

    def arm(self, *, trial: int, attempt: int, trials: int) -> None:
        """Say that the next step is trial `trial` of `trials`; returns at once, for the foot is watched from now on."""
        ...

    def rearm(self, *, trial: int, attempt: int, reason: str) -> None:
        """Say that a step broke off, why, and that the trial is armed again; returns at once, as `arm` does."""
        ...

    def ask(self, *, trial: int, keys: dict[str, str]) -> str:
        """Wait for one of `keys` (key -> what it stands for) and return it."""
        ...

    def confirmed(self, *, trial: int, answer: str | None) -> None:
        """The answer is on disk."""
        ...


RESTS = (
    "Zeroing: the foot rests on the bare panel, still. Press Enter when it does, or Ctrl-C to pause; the same command "
    "goes on: "
)
