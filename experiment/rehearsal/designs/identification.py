"""Identification by a simulated participant: the similarity-choice rule (Shepard 1957, Luce 1963)."""

from collections.abc import Sequence

import numpy as np

from palpate.experiment.errors import SessionError
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.rehearsal.designs import Judged, Percept


def judge(protocol: Protocol, percepts: Sequence[Percept], rng: np.random.Generator) -> Judged:
    """Return the material that a stimulus is judged to be, any alike where nothing was noticed.

    Raises `SessionError` for a kind of trial that does not give how like each material a stimulus felt.
    """
    (felt,), names = percepts, protocol.materials
    if felt.alike is None:
        raise SessionError("identification", "got a stimulus that is not compared with any material", "set its `alike`")
    if not felt.alike.size:
        named = names[int(rng.integers(len(names)))]
    else:
        # The largest of such sums is distributed as the similarity-choice rule (Yellott 1977).
        named = names[int(np.argmax(rng.gumbel(size=len(names)) + felt.alike))]
    return Judged(named.key or "", named.spoken[0])
