"""The engine: the fastest way to compute a stimulus whose stated error, and memory, a scene allows.

Where memory is no limit, as in a session, the basis waveforms are always taken: no other way is faster at an error of
`EXACT`. `TAKEN` says when each of the others would be. Two are there for other callers than `choose`: first block
first claims no less error than the basis and holds more, and is for a driver that calls `begin`; and the printed sum
claims no less than the inverse DCT, and is the oracle of the others.
"""

from __future__ import annotations

from dataclasses import dataclass

from experiment.errors import SynthesisError
from experiment.synthesis.basis import Basis
from experiment.synthesis.crinkle import CrinkleSpectra
from experiment.synthesis.first_block import FirstBlockFirst
from experiment.synthesis.pruning import BandPruned
from experiment.synthesis.waveforms import Estimate, InverseDct, Method, PrintedSum, Renderer

EXACT = 1e-12
"""Relative error below which a method counts as exact."""

FASTEST_FIRST: tuple[Method, ...] = (Basis(), FirstBlockFirst(), Basis(single=True), InverseDct(), PrintedSum())
"""By the time from the speed to the complete waveform: `tests/benchmarks/synthesis.py` prints the order it measures.
The first three are within some 20 % of one another, and their order changes with what else fills the caches: single
precision is the faster of them in cold ones and the slower in warm ones. So the more exact comes before it."""

TAKEN = {
    "basis waveforms": "wherever its error and memory are allowed, as in a session",
    "first block first": "never by choice; for a driver that begins to play before the rest is there. Sessions limit "
    "and shape whole stimuli, and do not use it",
    "single precision": "where the memory allowed is below that of the basis, and the error allowed above 2e-6",
    "inverse DCT": "where the memory allowed is below both, or the error allowed below that of the basis",
    "printed sum": "never by choice; the oracle of the others",
}
"""When `choose` takes each of `FASTEST_FIRST`, by name. Pruned to a band each is taken before it is on all bins, where
the error allowed covers the bins left out."""


@dataclass(frozen=True)
class Choice:
    """What the engine decided.

    Attributes:
        method: the one taken.
        estimate: what it promises.
    """

    method: Method
    estimate: Estimate

    def prepare(self, spectra: CrinkleSpectra, *, output_rate_hz: int) -> Renderer:
        """As `Method.prepare`."""
        return self.method.prepare(spectra, output_rate_hz=output_rate_hz)


def methods(band_hz: tuple[float, float] | None = None) -> tuple[Method, ...]:
    """Every method, fastest first.

    Args:
        band_hz: what actuator and skin can pass, Hz; with it each method comes twice, first on that band alone, which
            takes no more time and holds less.
    """
    if band_hz is None:
        return FASTEST_FIRST
    return tuple(m for whole in FASTEST_FIRST for m in (BandPruned(whole, band_hz), whole))


def choose(
    spectra: CrinkleSpectra,
    *,
    output_rate_hz: int,
    allowed_relative_error: float = EXACT,
    allowed_memory_bytes: float = float("inf"),
    band_hz: tuple[float, float] | None = None,
) -> Choice:
    """The first of `methods` that promises an error and a size that are allowed. The same input, the same choice.

    Args:
        spectra: of one material.
        output_rate_hz: samples a second that the actuator expects, Hz.
        allowed_relative_error: largest relative error that the scene allows, as `waveforms.py` defines it.
        allowed_memory_bytes: largest size of the prepared renderer, bytes.
        band_hz: what actuator and skin can pass, Hz; None considers no pruning.

    Raises:
        SynthesisError: no method promises this little, or the rate or the band is none.
    """
    considered: list[Estimate] = []
    for method in methods(band_hz):
        estimate = method.estimate(spectra, output_rate_hz=output_rate_hz)
        if estimate.relative_error <= allowed_relative_error and estimate.memory_bytes <= allowed_memory_bytes:
            return Choice(method, estimate)
        considered.append(estimate)
    least = min(considered, key=lambda estimate: estimate.relative_error)
    raise SynthesisError(
        f"allowed_relative_error: got {allowed_relative_error:g} within {allowed_memory_bytes:g} bytes; allowed: "
        f"{least.relative_error:.1e} or more within {least.memory_bytes} bytes or more; allow that much"
    )
