"""What a session needs of the experimenter's screen and keys; each console is one file that implements it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from experiment.apparatus.ports import Rester


@dataclass(frozen=True)
class Noted:
    """The experimenter notes something about where the session is."""

    text: str


@dataclass(frozen=True)
class Corrected:
    """The experimenter corrects an answer of this session: `key` is what the participant said in truth."""

    trial: int
    key: str
    reason: str


Remark = Noted | Corrected
"""What the experimenter may say instead of answering a question."""


class Console(Rester, Protocol):
    """What the experimenter sees and keys. It never decides what comes next."""

    def show(self, text: str) -> None:
        """Show the experimenter a line."""
        ...

    def familiarise(self, *, instruction: str, min_s: float, max_s: float) -> None:
        """Return when the experimenter ends the participant's free handling of the real materials."""
        ...

    def level(self, *, level_db_a: float, limit_db_a: float, criterion: str, keys: dict[str, str]) -> str:
        """Return one of `keys`, to change the masker's level, or "" to keep it because `criterion` holds."""
        ...

    def place(self, *, trial: int, material: str) -> None:
        """Return when the real object has been laid out."""
        ...

    def arm(self, *, trial: int, attempt: int, trials: int) -> None:
        """Say that the next step is trial `trial` of `trials`; return at once, for the foot is watched from now on."""
        ...

    def rearm(self, *, trial: int, attempt: int, reason: str) -> None:
        """Say that a step broke off, why, and that the trial is armed again; return at once, as `arm` does."""
        ...

    def ask(self, *, trial: int, keys: dict[str, str]) -> str | Remark:
        """Wait for one of `keys` (key -> what it stands for), or a remark, and return it."""
        ...

    def confirm(self, *, key: str, meaning: str) -> bool:
        """Return whether the experimenter stands by the key that was chosen."""
        ...

    def confirmed(self, *, trial: int, answer: str | None) -> None:
        """Say that the answer is on disk."""
        ...

    def debrief(self) -> Remark | None:
        """Wait, once all trials are answered, for a remark, or for the end of the session: None."""
        ...

    def ignored(self) -> str:
        """Return what was typed before it was asked for, since this was called last; it answered nothing."""
        ...


RESTS = (
    "Zeroing: have the foot rest still on the bare panel. Then press Enter, or press Ctrl-C to pause; the same command "
    "continues: "
)
"""What sessions and recordings both ask of the experimenter before the tracker is zeroed."""
