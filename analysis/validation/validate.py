"""The validation of Okamoto et al., sections 3.3 and 6.1, by equation (6).

A take is put on the least dissimilar speed among those recorded (50, 100, 200, 300 mm/s there) and observed (150, 250,
400).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from palpate.analysis import published
from palpate.analysis.reading import dissimilarities
from palpate.experiment.errors import RecordingError
from palpate.experiment.synthesis.crinkle import Average, CrinkleSpectra, at_speed, subtract
from palpate.experiment.synthesis.signals.dissimilarity import dissimilarity, dissimilarity_matrix
from palpate.experiment.synthesis.spectra import bin_frequencies_hz, spectrum


class Recorded(Protocol):
    """Takes of the bare panel, and of each material on it, m/s^2, shape (S, T, N), at rising speeds, shape (S,)."""

    @property
    def label(self) -> str: ...

    @property
    def simulated(self) -> bool: ...

    @property
    def rate_hz(self) -> int: ...

    @property
    def speeds_mm_s(self) -> NDArray[np.float64]: ...

    @property
    def panel(self) -> NDArray[np.float64]: ...

    @property
    def objects(self) -> Mapping[str, NDArray[np.float64]]: ...


@dataclass(frozen=True)
class Classified:
    """Where fresh takes of a material were put: `dissimilarities`, m/s^2, (O observed, T takes, C candidates)."""

    material: str
    observed_mm_s: NDArray[np.float64]
    candidates_mm_s: NDArray[np.float64]
    dissimilarities: NDArray[np.float64]

    @property
    def chosen(self) -> NDArray[np.intp]:
        """Return the index of the candidate that each take was put on (of equals, the slowest), shape (O, T)."""
        return np.asarray(self.dissimilarities.argmin(axis=-1))

    @property
    def counts(self) -> NDArray[np.int64]:
        """Return how many takes of each observed speed were put on each candidate, shape (O, C)."""
        size = self.candidates_mm_s.size
        return np.array([np.bincount(row, minlength=size) for row in self.chosen], dtype=np.int64)

    @property
    def close(self) -> NDArray[np.int64]:
        """Return how many takes of each observed speed were put on the same or a neighbouring speed, shape (O,)."""
        own = np.searchsorted(self.candidates_mm_s, self.observed_mm_s)
        return np.asarray((np.abs(self.chosen - own[:, None]) <= 1).sum(axis=1))

    @property
    def takes(self) -> int:
        """Return the number of takes."""
        return int(self.chosen.size)


@dataclass(frozen=True)
class Overlay:
    """A synthesised spectrum and the average of as many observed ones, less the panel, m/s^2, shape (N,) (Figure 6)."""

    material: str
    speed_mm_s: float
    observed: NDArray[np.float64]
    synthesised: NDArray[np.float64]
    dissimilarity: float


def check_comparable(recorded: Recorded, fresh: Recorded) -> None:
    """Refuse fresh takes of another rate or length, or that lack a material of the recordings."""
    got = (fresh.rate_hz, fresh.panel.shape[-1])
    allowed = (recorded.rate_hz, recorded.panel.shape[-1])
    if got != allowed:
        raise RecordingError(
            "fresh takes",
            f"got {got[1]} samples at {got[0]} Hz",
            "record the fresh takes again",
            allowed=f"{allowed[1]} at {allowed[0]} Hz, as the recordings have",
        )
    missing = [material for material in recorded.objects if material not in fresh.objects]
    if missing:
        raise RecordingError(
            "fresh takes",
            f"got none of {', '.join(missing)}",
            "record what is missing",
            allowed="every material that was recorded",
        )


def known_spectra(recorded: Recorded, *, average: Average = "magnitude") -> dict[str, CrinkleSpectra]:
    """Return equation (2) for each material, averaged over takes, less the panel; RecordingError below two speeds."""
    if recorded.speeds_mm_s.size < 2:
        raise RecordingError(
            "recordings",
            f"got takes at one speed, {recorded.speeds_mm_s[0]:g} mm/s",
            "record the materials at other speeds too, or name other recordings",
            allowed="two or more speeds, because stimuli are synthesized between them",
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
    """Return equation (2) for each take of a material, less its speed's panel, m/s^2, shape (S, T, N)."""
    panel = _averaged(fresh.panel, average)[..., None, :]
    return np.asarray(np.maximum(np.abs(spectrum(fresh.objects[material])) - panel, 0.0))


def classify(
    material: str, *, known: CrinkleSpectra, own: NDArray[np.float64], observed_mm_s: NDArray[np.float64]
) -> Classified:
    """Put each take, `own` of shape (O, T, N) in m/s^2, on the speed whose synthesis is the least dissimilar."""
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
    """Return the synthesis beside the average of the first `takes` fresh takes at one of their speeds."""
    place = int(np.flatnonzero(fresh.speeds_mm_s == speed_mm_s)[0])
    panel = _averaged(fresh.panel[place, :takes], average)
    observed = np.maximum(_averaged(fresh.objects[material][place, :takes], average) - panel, 0.0)
    synthesised = np.abs(at_speed(known, speed_mm_s=speed_mm_s).coefficients)
    frequencies_hz = bin_frequencies_hz(bins=observed.size, rate_hz=known.rate_hz)
    score = float(dissimilarity(observed, synthesised, frequencies_hz=frequencies_hz))
    return Overlay(material, speed_mm_s, observed, synthesised, score)


def _averaged(takes: NDArray[np.float64], average: Average) -> NDArray[np.float64]:
    """Return the magnitude of the average spectrum, shape (..., T, N) -> (..., N), as `crinkle.subtract` averages."""
    coefficients = spectrum(takes)
    return np.asarray(np.abs((coefficients if average == "signed" else np.abs(coefficients)).mean(axis=-2)))


def normalised_pairs(spectra: Mapping[str, NDArray[np.float64]], *, rate_hz: int) -> dict[tuple[str, str], float]:
    """Return the dissimilarity of each pair of spectra, magnitudes in m/s^2, shape (N,), over the highest (Table 3)."""
    names = list(spectra)
    rows = np.array([spectra[name] for name in names])
    frequencies_hz = bin_frequencies_hz(bins=rows.shape[-1], rate_hz=rate_hz)
    matrix = dissimilarity_matrix(rows, frequencies_hz=frequencies_hz)
    return {(names[i], names[j]): float(matrix[i, j]) for i, j in combinations(range(len(names)), 2)}


FITTED = (
    "SIMULATED: these materials were fitted to Table 3. Sessions with the paper's rate, length and takes were drawn "
    "at random until they matched it, and growth with speed was chosen to match section 3.3. Agreement with Table "
    "3, with Figure 7, and with the rank correlation of Table 2 was therefore built in, not found."
)
"""The sentence that stands wherever simulated recordings are set beside published numbers."""


@dataclass(frozen=True)
class Confusable:
    """One way to take a material for another: the ratio in Table 2, and their dissimilarity here (Figure 13)."""

    presented: str
    answered: str
    ratio: float
    dissimilarity: float


@dataclass(frozen=True)
class Other:
    """The results with the other way to average takes; attributes as in `Validation`."""

    average: Average
    classified: tuple[Classified, ...]
    pairs: dict[tuple[str, str], float]
    rank_correlation: float | None


@dataclass(frozen=True)
class Validation:
    """Every number of the validation; `label` is empty for real recordings.

    `classified` is Figure 7, `overlays` Figure 6 at the first fresh speed between recorded ones. At `reference_mm_s`,
    perhaps `extrapolated`, are the `spectra`, m/s^2, shape (N,) (Figure 12), normalised dissimilarities (Table 3), and
    `confusable` (Figure 13) with Spearman's `rank_correlation` or None.
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
        """Return what was fitted or chosen in simulated recordings; empty for real ones."""
        return FITTED if self.label else ""

    @property
    def holds(self) -> bool:
        """Return whether at least half of the takes of every material are on the same or a neighbouring speed."""
        return all(2 * int(one.close.sum()) >= one.takes for one in self.classified)


def compute(recorded: Recorded, fresh: Recorded, *, average: Average = "magnitude") -> Validation:
    """Return every number of the validation.

    Raises `RecordingError` for recordings at a single speed, or fresh takes that do not compare with them.
    """
    if recorded.simulated != fresh.simulated:
        kinds = {True: "SIMULATED", False: "real"}
        raise RecordingError(
            f"got {kinds[recorded.simulated]} recordings and {kinds[fresh.simulated]} fresh takes",
            remedy="name other fresh takes",
            allowed="both of one kind",
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
        label="SIMULATED" if recorded.simulated else "", recordings=recorded.label, fresh=fresh.label,
        frequencies_hz=bin_frequencies_hz(bins=recorded.panel.shape[-1], rate_hz=recorded.rate_hz),
        classified=classified, overlays=overlays, reference_mm_s=reference_mm_s, spectra=spectra, pairs=pairs,
        confusable=confusable, rank_correlation=_spearman(confusable), average=average,
        other=Other(swapped, others, other_pairs, _spearman(_confusable(other_pairs))),
        extrapolated=not slowest <= reference_mm_s <= fastest,
    )  # fmt: skip


def _compared(
    known: Mapping[str, CrinkleSpectra], fresh: Recorded, reference_mm_s: float, average: Average
) -> tuple[tuple[Classified, ...], dict[str, NDArray[np.float64]], dict[tuple[str, str], float]]:
    classified = tuple(
        classify(name, known=of_it, own=own_spectra(fresh, name, average=average), observed_mm_s=fresh.speeds_mm_s)
        for name, of_it in known.items()
    )
    spectra = {name: np.abs(at_speed(of_it, speed_mm_s=reference_mm_s).coefficients) for name, of_it in known.items()}
    return classified, spectra, normalised_pairs(spectra, rate_hz=fresh.rate_hz)


def _confusable(pairs: dict[tuple[str, str], float]) -> tuple[Confusable, ...]:
    study = published.load("okamoto2012")
    cells = study.tables() if study is not None else ()
    ratios = {(cell.presented, cell.answered): cell.mean.value for cell in cells if cell.task == "real"}
    both = ((ways, value) for (a, b), value in pairs.items() for ways in ((a, b), (b, a)))
    return tuple(Confusable(*ways, ratios[ways], value) for ways, value in both if ways in ratios)


def _spearman(points: tuple[Confusable, ...]) -> float | None:
    ratios, scores = [point.ratio for point in points], [point.dissimilarity for point in points]
    if len(set(ratios)) < 2 or len(set(scores)) < 2:
        return None
    return float(stats.spearmanr(ratios, scores).statistic)
