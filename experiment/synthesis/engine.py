"""The engine: the fastest way to compute a stimulus whose stated error, and memory, a scene allows."""

from __future__ import annotations

from dataclasses import dataclass

from experiment.errors import SynthesisError
from experiment.synthesis.basis import Basis
from experiment.synthesis.crinkle import CrinkleSpectra
from experiment.synthesis.first_block import FirstBlockFirst
from experiment.synthesis.methods import Estimate, InverseDct, Method, PrintedSum, Renderer
from experiment.synthesis.pruning import BandPruned

EXACT = 1e-12
"""Relative error below which a method counts as exact."""

FASTEST_FIRST: tuple[Method, ...] = (Basis(), FirstBlockFirst(), Basis(single=True), InverseDct(), PrintedSum())
"""By the time from the speed to the complete waveform, as `tests/benchmarks/synthesis.py` measures it."""


@dataclass(frozen=True)
class Considered:
    """A method, what it promised, and why it was not taken (empty where it was).

    Attributes:
        method: with its name.
        estimate: for the material and the output rate in question.
        refused: in words.
    """

    method: Method
    estimate: Estimate
    refused: str


@dataclass(frozen=True)
class Choice:
    """What the engine decided.

    Attributes:
        method: the one taken.
        estimate: what it promises.
        considered: all up to it, fastest first, with the one taken as the last.
    """

    method: Method
    estimate: Estimate
    considered: tuple[Considered, ...]

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
        allowed_relative_error: largest relative error that the scene allows, as `methods.py` defines it.
        allowed_memory_bytes: largest size of the prepared renderer, bytes.
        band_hz: what actuator and skin can pass, Hz; None considers no pruning.

    Raises:
        SynthesisError: no method promises this little, or the rate or the band is none.
    """
    considered: list[Considered] = []
    for method in methods(band_hz):
        estimate = method.estimate(spectra, output_rate_hz=output_rate_hz)
        refused = ""
        if not estimate.relative_error <= allowed_relative_error:
            refused = f"relative error up to {estimate.relative_error:.1e}, above {allowed_relative_error:.1e}"
        elif not estimate.memory_bytes <= allowed_memory_bytes:
            refused = f"{estimate.memory_bytes} bytes, above {allowed_memory_bytes:.0f}"
        considered.append(Considered(method, estimate, refused))
        if not refused:
            return Choice(method, estimate, tuple(considered))
    least = min(considered, key=lambda c: c.estimate.relative_error).estimate
    raise SynthesisError(
        f"allowed_relative_error: got {allowed_relative_error:g} within {allowed_memory_bytes:g} bytes; allowed: "
        f"{least.relative_error:.1e} or more within {least.memory_bytes} bytes or more; allow that much"
    )
