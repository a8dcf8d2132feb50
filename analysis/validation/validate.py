"""The validation of section 3.3 of Okamoto et al., and what section 6.1 makes of the same spectra, by equation (6).

A take's own spectrum is |C_k| of the take less the mean |C_k| of the bare panel's takes at the same speed, floored at
zero (equation (2), for one take). It is put on the speed whose synthesised spectrum is the least dissimilar.

The candidates are every speed that was recorded or observed. Seven of them occur in Okamoto et al., section 3: 50, 100,
200 and 300 mm/s recorded, 150, 250 and 400 mm/s observed. Neighbours are those next to one another in that list.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from analysis import published
from analysis.reading import dissimilarities
from experiment.errors import RecordingError
from experiment.synthesis.crinkle import Average, CrinkleSpectra, at_speed, subtract
from experiment.synthesis.spectra import bin_frequencies_hz, dissimilarity, dissimilarity_matrix, spectrum


class Recorded(Protocol):
    """Takes of materials and of the bare panel, as arrays."""

    @property
    def label(self) -> str: ...

    @property
    def simulated(self) -> bool: ...

    @property
    def rate_hz(self) -> int: ...

    @property
    def speeds_mm_s(self) -> NDArray[np.float64]:
        """Rising, shape (S,)."""
        ...

    @property
    def panel(self) -> NDArray[np.float64]:
        """Bare panel, m/s^2, shape (S, T, N)."""
        ...

    @property
    def objects(self) -> Mapping[str, NDArray[np.float64]]:
        """Each material on the panel, m/s^2, shape (S, T, N)."""
        ...


@dataclass(frozen=True)
class Classified:
    """Where the fresh takes of one material were put (Okamoto et al., Figure 7).

    Attributes:
        material: its id.
        observed_mm_s: speeds of the fresh takes, shape (O,); each is among the candidates.
        candidates_mm_s: speeds of the syntheses, rising, shape (C,).
        dissimilarities: of each take to each synthesis, m/s^2, shape (O, T, C).
    """

    material: str
    observed_mm_s: NDArray[np.float64]
    candidates_mm_s: NDArray[np.float64]
    dissimilarities: NDArray[np.float64]

    @property
    def chosen(self) -> NDArray[np.intp]:
        """Index of the candidate that each take was put on (of equals, the slowest), shape (O, T)."""
        return np.asarray(self.dissimilarities.argmin(axis=-1))

    @property
    def counts(self) -> NDArray[np.int64]:
        """How many takes of each observed speed were put on each candidate, shape (O, C)."""
        size = self.candidates_mm_s.size
        return np.array([np.bincount(row, minlength=size) for row in self.chosen], dtype=np.int64)

    @property
    def close(self) -> NDArray[np.int64]:
        """How many takes of each observed speed were put on the same or a neighbouring speed, shape (O,)."""
        own = np.searchsorted(self.candidates_mm_s, self.observed_mm_s)
        return np.asarray((np.abs(self.chosen - own[:, None]) <= 1).sum(axis=1))

    @property
    def takes(self) -> int:
        """How many takes there were."""
        return int(self.chosen.size)


@dataclass(frozen=True)
class Overlay:
    """A synthesised spectrum and the average of as many observed ones (Figure 6).

    Attributes:
        material: its id.
        speed_mm_s: of both, mm/s.
        observed: average magnitude less the panel's, m/s^2, shape (N,).
        synthesised: magnitude, m/s^2, shape (N,).
        dissimilarity: of the two, equation (6), m/s^2.
    """

    material: str
    speed_mm_s: float
    observed: NDArray[np.float64]
    synthesised: NDArray[np.float64]
    dissimilarity: float


def check_comparable(recorded: Recorded, fresh: Recorded) -> None:
    """Refuse fresh takes that cannot be compared with the recordings.

    Raises:
        RecordingError: another rate, another length, or materials without fresh takes.
    """
    got = (fresh.rate_hz, fresh.panel.shape[-1])
    allowed = (recorded.rate_hz, recorded.panel.shape[-1])
    if got != allowed:
        raise RecordingError(
            f"fresh takes: got {got[1]} samples at {got[0]} Hz; allowed: {allowed[1]} at {allowed[0]} Hz, as the "
            "recordings have; record the fresh takes anew"
        )
    missing = [material for material in recorded.objects if material not in fresh.objects]
    if missing:
        raise RecordingError(
            f"fresh takes: got none of {', '.join(missing)}; allowed: every material that was recorded; "
            "record what is missing"
        )


def known_spectra(recorded: Recorded, *, average: Average = "magnitude") -> dict[str, CrinkleSpectra]:
    """Equation (2) for each material, averaged over takes as `crinkle.subtract` does; the panel subtracted.

    Raises:
        RecordingError: fewer than two speeds.
    """
    if recorded.speeds_mm_s.size < 2:
        raise RecordingError(
            f"recordings: got takes at one speed, {recorded.speeds_mm_s[0]:g} mm/s; allowed: two speeds or more, for "
            "syntheses lie between them; record the materials at other speeds too, or name other recordings"
        )
    return {
        material: subtract(
            speeds_mm_s=recorded.speeds_mm_s,
            rate_hz=recorded.rate_hz,
            panel_object_takes=takes,
            panel_takes=recorded.panel,
            average=average,
        )
        for material, takes in recorded.objects.items()
    }


def own_spectra(fresh: Recorded, material: str, *, average: Average = "magnitude") -> NDArray[np.float64]:
    """Equation (2) for every single take of a material, less the average panel of its speed.

    Returns:
        m/s^2, shape (S, T, N).
    """
    panel = _averaged(fresh.panel, average)[..., None, :]
    own: NDArray[np.float64] = np.maximum(np.abs(spectrum(fresh.objects[material])) - panel, 0.0)
    return own


def classify(
    material: str, *, known: CrinkleSpectra, own: NDArray[np.float64], observed_mm_s: NDArray[np.float64]
) -> Classified:
    """Put each take on the speed whose synthesis is the least dissimilar.

    Args:
        material: its id.
        known: of the recordings, from `known_spectra`.
        own: of the fresh takes, from `own_spectra`, m/s^2, shape (O, T, N).
        observed_mm_s: speeds of the fresh takes, shape (O,).

    Source: Okamoto et al., section 3.3, equation (6) and Figure 7.
    """
    candidates_mm_s = np.union1d(known.speeds_mm_s, observed_mm_s)
    syntheses = np.array([at_speed(known, speed_mm_s=float(v)).coefficients for v in candidates_mm_s])
    frequencies_hz = bin_frequencies_hz(bins=own.shape[-1], rate_hz=known.rate_hz)
    scores = [dissimilarity(takes[:, None, :], syntheses, frequencies_hz=frequencies_hz) for takes in own]
    return Classified(material, observed_mm_s, candidates_mm_s, np.array(scores))


def overlay(
    material: str,
    *,
    known: CrinkleSpectra,
    fresh: Recorded,
    speed_mm_s: float,
    takes: int,
    average: Average = "magnitude",
) -> Overlay:
    """Synthesis beside the average of the first `takes` fresh takes at one speed.

    Args:
        material: its id.
        known: of the recordings.
        fresh: which hold this speed.
        speed_mm_s: one of the fresh speeds, mm/s.
        takes: how many were averaged for a recorded spectrum; of fewer fresh ones, all are.
        average: over takes, as in `known_spectra`.

    Source: Okamoto et al., section 3.3 and Figure 6.
    """
    place = int(np.flatnonzero(fresh.speeds_mm_s == speed_mm_s)[0])
    panel = _averaged(fresh.panel[place, :takes], average)
    observed = np.maximum(_averaged(fresh.objects[material][place, :takes], average) - panel, 0.0)
    synthesised = np.abs(at_speed(known, speed_mm_s=speed_mm_s).coefficients)
    frequencies_hz = bin_frequencies_hz(bins=observed.size, rate_hz=known.rate_hz)
    score = float(dissimilarity(observed, synthesised, frequencies_hz=frequencies_hz))
    return Overlay(material, speed_mm_s, observed, synthesised, score)


def _averaged(takes: NDArray[np.float64], average: Average) -> NDArray[np.float64]:
    """Magnitude of the average spectrum of takes, shape (..., T, N) -> (..., N), as `crinkle.subtract` averages."""
    coefficients = spectrum(takes)
    if average == "signed":
        return np.asarray(np.abs(coefficients.mean(axis=-2)))
    return np.asarray(np.abs(coefficients).mean(axis=-2))


def normalised_pairs(spectra: Mapping[str, NDArray[np.float64]], *, rate_hz: int) -> dict[tuple[str, str], float]:
    """Dissimilarity of each pair of materials, divided by the highest, in the order of `spectra`.

    Args:
        spectra: magnitudes of each material at one speed, m/s^2, shape (N,).
        rate_hz: sampling rate of the recordings, Hz.

    Source: Okamoto et al., section 6.1 and Table 3.
    """
    names = list(spectra)
    rows = np.array([spectra[name] for name in names])
    frequencies_hz = bin_frequencies_hz(bins=rows.shape[-1], rate_hz=rate_hz)
    matrix = dissimilarity_matrix(rows, frequencies_hz=frequencies_hz)
    return {(names[i], names[j]): float(matrix[i, j]) for i in range(len(names)) for j in range(i + 1, len(names))}


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
