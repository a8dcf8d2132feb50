"""A SIMULATED participant's touch: it answers from the vibration that reached it, and from nothing else.

Before a task it crinkles each real material at several speeds and remembers their spectra. In a trial it compares what
it felt with what it remembers by equation (6) of Okamoto et al., and answers by the similarity-choice rule (Shepard
1957, Luce 1963): the probability of an answer falls exponentially with the dissimilarity. The rule knows no material
by name: which materials are confused follows from the waveforms alone.

The parameters are few and the same for all materials:

- bands of a third of an octave, 10 to 500 Hz: the Weber fraction of frequency is 0.18 to 0.25 (Israr and Tan 2006,
  index finger), and the paper sums to 500 Hz;
- `NOTICEABLE`: 2.5 dB, the threshold of amplitude discrimination (same source). What was felt counts as more than the
  bare panel when its sum exceeds the remembered panel's by that; otherwise the participant guesses;
- `MEMORY_NOISE`: remembered bands are off by half a decibel, anew before each task;
- `SENSITIVITY`: of the choice, per unit of the largest dissimilarity between two remembered materials, as Table 3 is
  normalised; `SPREAD` is the standard deviation of its logarithm among participants;
- `CONCURRENCE` lowers the sensitivity in task `virtual`, by a factor that spreads by `CONCURRENCE_SPREAD` in its
  logarithm: participants said that feeling the panel and the stimulus at once impeded them (section 6.2).

Noise, sensitivity, concurrence and the two spreads were chosen so that simulated accuracies and their standard
deviations among participants are about those that Tables 1 and 2 print.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from experiment.errors import SessionError, SynthesisError
from experiment.rehearsal.footstep.materials import SimulatedMaterials, known
from experiment.synthesis.spectra import spectrum

NOTICEABLE = 10 ** (2.5 / 20)
MEMORY_NOISE = 0.06
SENSITIVITY = 5.0
SPREAD = 0.2
CONCURRENCE = 0.7
CONCURRENCE_SPREAD = 0.4

FAMILIAR_SPEEDS_MM_S = (80.0, 150.0, 250.0, 350.0)
FAMILIAR_TAKES = 3

SATURATION_M_S2 = 1e3
"""Far beyond any actuator; garbage above it feels no stronger."""


@dataclass(frozen=True)
class Bands:
    """Bands into which touch smooths a spectrum.

    Attributes:
        averages: weights that average the bins of each band, shape (B, bins); bins are evenly spaced from 0 Hz.
        bins: how many bins each band holds, shape (B,).
    """

    averages: NDArray[np.float64]
    bins: NDArray[np.float64]

    def felt(self, amplitudes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Mean magnitude in each band, m/s^2, shape (B,), of a spectrum of shape (bins,)."""
        return self.averages @ np.abs(amplitudes)

    def total(self, felt: NDArray[np.float64]) -> float:
        """Sum over all bins of the bands, m/s^2."""
        return float(self.bins @ felt)

    def dissimilarity(self, felt: NDArray[np.float64], remembered: NDArray[np.float64]) -> NDArray[np.float64]:
        """Equation (6) between smoothed spectra of shapes (..., B): every bin counts, as in the paper."""
        return np.abs(felt - remembered) @ self.bins


def third_octaves(*, bin_hz: float, low_hz: float = 10.0, high_hz: float = 500.0) -> Bands:
    """Bands of a third of an octave from `low_hz` up to `high_hz`; bands without a bin are left out.

    Args:
        bin_hz: spacing of a spectrum's bins, Hz.
        low_hz: lower edge of the lowest band, Hz.
        high_hz: no bin above this counts, Hz.

    Raises:
        SynthesisError: the bins are so wide that none lies in a band; takes this short cannot be felt.
    """
    frequencies_hz = np.arange(int(high_hz / bin_hz) + 1) * bin_hz
    band = np.floor(3 * np.log2(np.maximum(frequencies_hz, bin_hz / 2) / low_hz) + 1e-9).astype(int)
    felt = np.unique(band[frequencies_hz >= low_hz])
    if not felt.size:
        raise SynthesisError(
            f"bins: got {bin_hz:g} Hz wide; allowed: one between {low_hz:g} and {high_hz:g} Hz; make the takes longer"
        )
    rows = np.array([band == b for b in felt], dtype=np.float64)
    bins = rows.sum(axis=1)
    return Bands(averages=rows / bins[:, None], bins=bins)


class Observer:
    """One simulated participant.

    Args:
        materials: the simulated materials that it can lay hands (feet) on.
        material_ids: the answers it may give.
        rng: draws what sets this participant apart.

    Raises:
        RecordingError: a material that has no simulation.
    """

    def __init__(self, materials: SimulatedMaterials, material_ids: Sequence[str], *, rng: np.random.Generator) -> None:
        for material in material_ids:
            known(material)
        self._materials = materials
        self._ids = tuple(material_ids)
        self._window_s = materials.samples / materials.rate_hz
        self._bands = third_octaves(bin_hz=1 / (2 * self._window_s))
        self._sensitivity = SENSITIVITY * float(np.exp(SPREAD * rng.normal()))
        self._concurrence = CONCURRENCE * float(np.exp(CONCURRENCE_SPREAD * rng.normal()))
        self._remembered: NDArray[np.float64] | None = None

    def familiarise(self, *, rng: np.random.Generator) -> None:
        """Crinkle every material, and step on the bare panel, at several speeds; remember what that felt like.

        Args:
            rng: chance of these takes and of memory.
        """
        remembered = []
        for material in (None, *self._ids):
            blur = np.exp(MEMORY_NOISE * rng.normal(size=self._bands.bins.size))
            for speed in FAMILIAR_SPEEDS_MM_S:
                takes = [self._felt(self._take(material, speed, rng)) for _ in range(FAMILIAR_TAKES)]
                remembered.append(np.mean(takes, axis=0) * blur)
        shape = (1 + len(self._ids), len(FAMILIAR_SPEEDS_MM_S), self._bands.bins.size)
        self._remembered = np.reshape(remembered, shape)

    def judge_real(self, take: NDArray[np.float64], *, speed_mm_s: float, rng: np.random.Generator) -> str:
        """Name the material of a real cylinder.

        Args:
            take: acceleration of the panel under the cylinder, m/s^2, shape (n,), at the materials' rate.
            speed_mm_s: of the foot, mm/s.
            rng: chance of this answer.

        Returns:
            One of the material ids.

        Raises:
            SessionError: not familiarised yet.
        """
        return self._answer(self._felt(take), speed_mm_s=speed_mm_s, sensitivity=self._sensitivity, rng=rng)

    def judge_virtual(
        self,
        panel_take: NDArray[np.float64],
        delivered: NDArray[np.float64] | None,
        *,
        rate_hz: int,
        speed_mm_s: float,
        rng: np.random.Generator,
    ) -> str:
        """Name the material of a virtual stimulus, felt together with the panel on which the foot lands.

        Args:
            panel_take: acceleration of the bare panel under this step, m/s^2, shape (n,), at the materials' rate.
            delivered: what the actuator added from contact on, m/s^2, shape (m,), at `rate_hz`; None for nothing.
                Samples that are not numbers move nothing.
            rate_hz: of `delivered`, Hz.
            speed_mm_s: of the foot, mm/s.
            rng: chance of this answer.

        Returns:
            One of the material ids.

        Raises:
            SessionError: not familiarised yet.
        """
        coefficients = self._coefficients(panel_take, self._materials.rate_hz)
        if delivered is not None:
            moved = np.clip(np.nan_to_num(delivered), -SATURATION_M_S2, SATURATION_M_S2)
            coefficients = coefficients + self._coefficients(moved, rate_hz)
        return self._answer(
            self._bands.felt(coefficients),
            speed_mm_s=speed_mm_s,
            sensitivity=self._sensitivity * self._concurrence,
            rng=rng,
        )

    def _take(self, material: str | None, speed_mm_s: float, rng: np.random.Generator) -> NDArray[np.float64]:
        if material is None:
            return self._materials.panel_take(speed_mm_s=speed_mm_s, rng=rng)
        return self._materials.crinkle_take(material, speed_mm_s=speed_mm_s, rng=rng)

    def _felt(self, take: NDArray[np.float64]) -> NDArray[np.float64]:
        return self._bands.felt(self._coefficients(take, self._materials.rate_hz))

    def _coefficients(self, samples: NDArray[np.float64], rate_hz: int) -> NDArray[np.float64]:
        """Spectrum of the window after contact up to the highest band, whatever rate and length `samples` has."""
        window = np.zeros(round(self._window_s * rate_hz))
        kept = samples[: window.size]
        window[: kept.size] = kept
        below_top = np.zeros(self._bands.averages.shape[1])
        got = spectrum(window)[: below_top.size]
        below_top[: got.size] = got
        return below_top

    def _at_speed(self, speed_mm_s: float) -> NDArray[np.float64]:
        """What is remembered of panel and materials at this speed, linear between familiar ones, shape (1 + M, B)."""
        if self._remembered is None:
            raise SessionError("the simulated participant has not met the materials; let it familiarise itself first")
        speeds = FAMILIAR_SPEEDS_MM_S
        lower = int(np.clip(np.searchsorted(speeds, speed_mm_s) - 1, 0, len(speeds) - 2))
        part = (speed_mm_s - speeds[lower]) / (speeds[lower + 1] - speeds[lower])
        between = (1 - part) * self._remembered[:, lower] + part * self._remembered[:, lower + 1]
        return np.maximum(between, 0.0)

    def _answer(
        self, felt: NDArray[np.float64], *, speed_mm_s: float, sensitivity: float, rng: np.random.Generator
    ) -> str:
        panel, *known_materials = self._at_speed(speed_mm_s)
        if self._bands.total(felt) <= NOTICEABLE * self._bands.total(panel):
            return self._ids[int(rng.integers(len(self._ids)))]
        templates = np.array(known_materials)
        scale = self._bands.dissimilarity(templates[:, None], templates[None, :]).max()
        dissimilarities = self._bands.dissimilarity(felt, templates) / scale
        # The largest of such sums is distributed as the similarity-choice rule (Yellott 1977).
        return self._ids[int(np.argmax(rng.gumbel(size=len(self._ids)) - sensitivity * dissimilarities))]
