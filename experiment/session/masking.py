"""The masker of one session: the participant's level is chosen before the first trial and journaled with every change.

It plays from then to the session's end, pauses between trials included. `+` and `-` change it whenever an answer is
asked for; no protocol has these keys for anything else.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from datetime import UTC, datetime

from experiment.apparatus.ports import Masker
from experiment.console.port import Console
from experiment.protocol.rules import LOUDER_KEY, SOFTER_KEY
from experiment.records import MaskerSet
from experiment.session.journal import Contents

STEP_DB = 2.0
"""One key changes the level by this much, dB."""

FIRST_DB_A = 50.0
"""Level at which the first choice begins, dB(A): soft, so that it is turned up and not down."""

KEYS = {LOUDER_KEY: "masker louder", SOFTER_KEY: "masker softer"}


class Masking:
    """Drives a masker and puts its levels on disk."""

    def __init__(self, masker: Masker, console: Console, write: Callable[[MaskerSet], None]) -> None:
        """Silence, so far.

        Args:
            masker: noise on the headphones.
            console: where the level is chosen.
            write: puts an entry into the journal and returns when it is on disk.
        """
        self._masker = masker
        self._console = console
        self._write = write

    def choose(self, criterion: str, begin_db_a: float | None) -> None:
        """Start the noise and have its level set until the participant is content.

        Args:
            criterion: what must hold at the level chosen.
            begin_db_a: level to begin with; None for the first choice of a session.

        Raises:
            AudioError: the dose of the day is used up.
        """
        self._masker.start(FIRST_DB_A if begin_db_a is None else begin_db_a)
        self._note()
        while True:
            level_db_a = self._masker.level_db_a
            key = self._console.level(
                level_db_a=level_db_a if level_db_a is not None else FIRST_DB_A,
                limit_db_a=self._masker.limit_db_a,
                criterion=criterion,
                keys=KEYS,
            )
            if not self.change(key):
                return

    def change(self, key: str) -> bool:
        """Whether `key` was one of the masker's; then the level has changed by a step, within the limit.

        Raises:
            AudioError: the dose of the day is used up.
        """
        level_db_a = self._masker.level_db_a
        if key not in KEYS or level_db_a is None:
            return False
        set_db_a = self._masker.set_level(level_db_a + (STEP_DB if key == LOUDER_KEY else -STEP_DB))
        self._note()
        at_limit = " (the limit)" if set_db_a >= self._masker.limit_db_a else ""
        self._console.show(f"Masker at {set_db_a:.0f} dB(A){at_limit}.")
        return True

    def end(self, *, note: bool) -> None:
        """Silence; `note` puts what it came to on disk."""
        self._masker.stop()
        if note:
            self._note()

    def _note(self) -> None:
        exposure = self._masker.exposure()
        self._write(
            MaskerSet(level_db_a=exposure.level_db_a, dose=exposure.dose, daily_level_db_a=exposure.daily_level_db_a)
        )


def dose_today(journals: Iterable[Contents], now_ns: int) -> float:
    """What a participant's sessions used up of the dose of the day (UTC) so far.

    Args:
        journals: of the participant.
        now_ns: session time, ns.
    """
    today = datetime.fromtimestamp(now_ns // 10**9, tz=UTC).date()
    spent = [
        (line.t_ns, line.entry.dose)
        for contents in journals
        for line in contents.lines
        if isinstance(line.entry, MaskerSet) and datetime.fromtimestamp(line.t_ns // 10**9, tz=UTC).date() == today
    ]
    return max(spent)[1] if spent else 0.0
