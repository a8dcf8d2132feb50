"""Rating by a simulated participant: how much of the quality was felt, on the scale, with an error.

SIMULATED participants take the materials to stand in the file from the least of the quality to the most.
"""

from collections.abc import Sequence

import numpy as np
from scipy.special import softmax

from palpate.experiment.protocol.designs.rating import Rating, words
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.rehearsal.designs import Judged, Percept

ERROR = 0.08
"""The standard deviation of a rating, as a part of the whole scale. Ours."""


def judge(protocol: Protocol, percepts: Sequence[Percept], rng: np.random.Generator) -> Judged:
    """Return the place of the scale that is nearest to what was felt; the lowest where nothing was noticed."""
    (felt,), scale = percepts, protocol.table(Rating).scale
    much = felt.strength
    if felt.alike is not None:
        much = float(softmax(felt.alike) @ np.linspace(0, 1, len(felt.alike))) if felt.alike.size else 0.0
    place = round((much + ERROR * rng.normal()) * (len(scale) - 1))
    chosen = scale[min(max(place, 0), len(scale) - 1)]
    return Judged(chosen.key, words(chosen))
