"""Dissimilarities of materials to compare confusions with: those that a paper prints, or those of recordings."""

from __future__ import annotations

import csv
import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from analysis.published.printed import Printed
from experiment.errors import DatasetError


@dataclass(frozen=True)
class PrintedSpectra:
    """Attributes:
    speed_mm_s: of the spectra that `pairs` compares, mm/s.
    pairs: normalised dissimilarity of two materials.
    counts: (material, observed mm/s, chosen mm/s, takes of ten), as far as the text gives numbers.
    """

    speed_mm_s: float
    pairs: dict[frozenset[str], Printed]
    counts: tuple[tuple[str, float, float, int], ...]


def load() -> PrintedSpectra:
    """The numbers of Okamoto et al., Table 3 and section 3.3."""
    file = resources.files("analysis.published").joinpath("okamoto2012_spectra.toml")
    content = tomllib.loads(file.read_text(encoding="utf-8"))
    return PrintedSpectra(
        speed_mm_s=float(content["table_3"]["speed_mm_s"]),
        pairs={frozenset((a, b)): Printed(value) for a, b, value in content["table_3"]["pairs"]},
        counts=tuple((m, float(v), float(chosen), int(n)) for m, v, chosen, n in content["figure_7"]["counts"]),
    )


COLUMNS = ("material_a", "material_b", "dissimilarity")
"""Of the file; `palpate validate` writes them into tables/dissimilarity.csv."""


@dataclass(frozen=True)
class Dissimilarities:
    """One value a pair of materials, and where they come from."""

    pairs: Mapping[frozenset[str], float]
    source: str

    def table(self, materials: Sequence[str]) -> NDArray[np.float64] | None:
        """Symmetric, shape (M, M), diagonal 0; None where a pair is missing."""
        if any(frozenset(pair) not in self.pairs for pair in combinations(materials, 2)):
            return None
        return np.array([[self.pairs[frozenset((a, b))] if a != b else 0.0 for b in materials] for a in materials])


NO_DISSIMILARITIES = Dissimilarities({}, "")


def printed_dissimilarities() -> Dissimilarities:
    """Those of Okamoto et al., Table 3."""
    return Dissimilarities({pair: value.value for pair, value in load().pairs.items()}, "Table 3 of the paper")


def from_file(path: Path, materials: Sequence[str]) -> Dissimilarities:
    """Read a CSV file with the columns material_a, material_b and dissimilarity, one row a pair of `materials`.

    Raises:
        DatasetError: for a file that cannot be read, a pair that is missing, twice there, or no number from 0.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DatasetError(f"{path} cannot be read ({error}); give a CSV file with {', '.join(COLUMNS)}") from error
    pairs: dict[frozenset[str], float] = {}
    for number, row in enumerate(rows, start=2):
        first, second, text = (row.get(column) for column in COLUMNS)
        pair = frozenset((first or "", second or ""))
        value = _number(text)
        if value is None or len(pair) < 2 or pair in pairs:
            raise DatasetError(
                f"{path}: line {number}: got {first!r}, {second!r}, {text!r}; allowed: two materials, each pair once, "
                "and a number from 0; mend the line"
            )
        pairs[pair] = value
    for pair in map(frozenset, combinations(materials, 2)):
        if pair not in pairs:
            raise DatasetError(f"{path}: no dissimilarity of {' and '.join(sorted(pair))}; add the line")
    labels = sorted({label for row in rows if (label := row.get("dataset")) and label != "measured"})
    return Dissimilarities(pairs, " - ".join([path.name, *labels]))


def _number(text: str | None) -> float | None:
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if math.isfinite(value) and value >= 0 else None
