"""The validation of section 3.3 of Okamoto et al., and what section 6.1 makes of the same spectra."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from analysis import published
from analysis.reading import dissimilarities
from analysis.validation.spectra import (
    Classified,
    Overlay,
    Recorded,
    check_comparable,
    classify,
    known_spectra,
    normalised_pairs,
    overlay,
    own_spectra,
)
from experiment.errors import RecordingError
from experiment.synthesis.crinkle import Average, CrinkleSpectra, at_speed
from experiment.synthesis.spectra import bin_frequencies_hz

FITTED = (
    "SIMULATED: these materials were fitted to Table 3, sessions with the paper's rate, length and takes are drawn "
    "until they meet it, and growth with speed was chosen with section 3.3 in view. Agreement with Table 3, with "
    "Figure 7, and of the rank correlation with Table 2 is made, not found."
)
"""What stands on simulated recordings wherever they are set beside published numbers."""


@dataclass(frozen=True)
class Confusable:
    """One way to take a material for another (Figure 13).

    Attributes:
        presented: the real material.
        answered: what it was taken for.
        ratio: of answers, as Table 2 prints it.
        dissimilarity: of their spectra here, normalised.
    """

    presented: str
    answered: str
    ratio: float
    dissimilarity: float


@dataclass(frozen=True)
class Other:
    """What the other way to average takes gives; attributes as in `Validation`."""

    average: Average
    classified: tuple[Classified, ...]
    pairs: dict[tuple[str, str], float]
    rank_correlation: float | None


@dataclass(frozen=True)
class Validation:
    """Every number of the validation.

    Attributes:
        label: stands on everything; empty for real recordings.
        recordings: what was validated, as its manifest calls it.
        fresh: what it was validated with.
        frequencies_hz: of each bin, Hz, shape (N,).
        classified: each material's takes on speeds (Figure 7).
        overlays: each material at the first fresh speed between recorded ones (Figure 6); empty where there is none.
        reference_mm_s: speed at which materials are compared, mm/s.
        spectra: of each material there, m/s^2, shape (N,) (Figure 12).
        pairs: normalised dissimilarity of each pair there (Table 3).
        confusable: the same against Table 2, for pairs that it has (Figure 13).
        rank_correlation: Spearman's, of ratio and dissimilarity; None for fewer than three points or no variation.
        average: over takes, as `crinkle.subtract` defines it.
        other: what the other average gives.
        extrapolated: whether `reference_mm_s` lies outside the recorded speeds.
    """

    label: str
    recordings: str
    fresh: str
    frequencies_hz: NDArray[np.float64]
    classified: tuple[Classified, ...]
    overlays: tuple[Overlay, ...]
    reference_mm_s: float
    spectra: dict[str, NDArray[np.float64]]
    pairs: dict[tuple[str, str], float]
    confusable: tuple[Confusable, ...]
    rank_correlation: float | None
    average: Average
    other: Other
    extrapolated: bool

    @property
    def fitted(self) -> str:
        """What was fitted or chosen in the recordings so that they are as published; empty for real ones."""
        return FITTED if self.label else ""

    @property
    def holds(self) -> bool:
        """Whether at least half of the takes of every material are on the same or a neighbouring speed."""
        return all(2 * int(one.close.sum()) >= one.takes for one in self.classified)


def compute(recorded: Recorded, fresh: Recorded, *, average: Average = "magnitude") -> Validation:
    """Every number of the validation, from arrays alone.

    Raises:
        RecordingError: as `validate`.
    """
    if recorded.simulated != fresh.simulated:
        raise RecordingError(
            f"got {_kind(recorded)} recordings and {_kind(fresh)} fresh takes; allowed: both of one kind; "
            "name other fresh takes"
        )
    check_comparable(recorded, fresh)
    known = known_spectra(recorded, average=average)
    reference_mm_s = dissimilarities.load().speed_mm_s
    classified, spectra, pairs = _compared(known, fresh, reference_mm_s, average)
    confusable = _confusable(pairs)
    swapped: Average = "signed" if average == "magnitude" else "magnitude"
    others, _, other_pairs = _compared(known_spectra(recorded, average=swapped), fresh, reference_mm_s, swapped)
    slowest, fastest = recorded.speeds_mm_s[[0, -1]]
    between = [float(v) for v in fresh.speeds_mm_s if slowest < v < fastest and not np.any(recorded.speeds_mm_s == v)]
    overlays = tuple(
        overlay(material, known=of_it, fresh=fresh, speed_mm_s=v, takes=recorded.panel.shape[1], average=average)
        for v in between[:1]
        for material, of_it in known.items()
    )
    return Validation(
        label="SIMULATED" if recorded.simulated else "",
        recordings=recorded.label,
        fresh=fresh.label,
        frequencies_hz=bin_frequencies_hz(bins=recorded.panel.shape[-1], rate_hz=recorded.rate_hz),
        classified=classified,
        overlays=overlays,
        reference_mm_s=reference_mm_s,
        spectra=spectra,
        pairs=pairs,
        confusable=confusable,
        rank_correlation=_spearman(confusable),
        average=average,
        other=Other(swapped, others, other_pairs, _spearman(_confusable(other_pairs))),
        extrapolated=not slowest <= reference_mm_s <= fastest,
    )


def _compared(
    known: Mapping[str, CrinkleSpectra], fresh: Recorded, reference_mm_s: float, average: Average
) -> tuple[tuple[Classified, ...], dict[str, NDArray[np.float64]], dict[tuple[str, str], float]]:
    """Takes on speeds; spectra at the reference speed; and how much these differ."""
    classified = tuple(
        classify(name, known=of_it, own=own_spectra(fresh, name, average=average), observed_mm_s=fresh.speeds_mm_s)
        for name, of_it in known.items()
    )
    spectra = {name: np.abs(at_speed(of_it, speed_mm_s=reference_mm_s).coefficients) for name, of_it in known.items()}
    return classified, spectra, normalised_pairs(spectra, rate_hz=fresh.rate_hz)


def _kind(recorded: Recorded) -> str:
    return "SIMULATED" if recorded.simulated else "real"


def _confusable(pairs: dict[tuple[str, str], float]) -> tuple[Confusable, ...]:
    study = published.load("okamoto2012")
    cells = study.tables() if study is not None else ()
    ratios = {(cell.presented, cell.answered): cell.mean.value for cell in cells if cell.task == "real"}
    return tuple(
        Confusable(*ways, ratios[ways], value)
        for (a, b), value in pairs.items()
        for ways in ((a, b), (b, a))
        if ways in ratios
    )


def _spearman(points: tuple[Confusable, ...]) -> float | None:
    ratios = [point.ratio for point in points]
    scores = [point.dissimilarity for point in points]
    if len(set(ratios)) < 2 or len(set(scores)) < 2:
        return None
    return float(stats.spearmanr(ratios, scores).statistic)
