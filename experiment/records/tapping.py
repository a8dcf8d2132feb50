"""Models of what a comparison of two materials leaves in the journal, and the words of its answers."""

from __future__ import annotations

from typing import Literal

from experiment.records.entries import Entry

FIRST, SECOND, TIE = "first", "second", "tie"
"""What an answer names: the material presented first, the one presented second, or neither."""


class PairLaidOut(Entry):
    """Both samples of a pair lay before the participant from the session time `laid_ns` on, ns.

    From then on the participant taps and changes between them at will; nothing of that is measured.
    """

    kind: Literal["pair"] = "pair"
    trial: int
    attempt: int
    presented: tuple[str, ...]
    laid_ns: int
