"""Dissimilarities of materials, from a paper or from recordings, to compare confusions with."""

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from palpate.analysis.published.printed import Printed
from palpate.experiment.errors import DatasetError, PalpateError
from palpate.experiment.settings.delimited import read_table


@dataclass(frozen=True)
class PrintedSpectra:
    """Printed normalised dissimilarities of `pairs` at `speed_mm_s`, and `counts`: material, speeds, takes of ten."""

    speed_mm_s: float
    pairs: dict[frozenset[str], Printed]
    counts: tuple[tuple[str, float, float, int], ...]


def load() -> PrintedSpectra:
    """Return the numbers of Okamoto et al., Table 3 and section 3.3."""
    file = resources.files("palpate.analysis.published").joinpath("okamoto2012_spectra.toml")
    content = tomllib.loads(file.read_text(encoding="utf-8"))
    return PrintedSpectra(
        speed_mm_s=float(content["table_3"]["speed_mm_s"]),
        pairs={frozenset((a, b)): Printed(value) for a, b, value in content["table_3"]["pairs"]},
        counts=tuple((m, float(v), float(chosen), int(n)) for m, v, chosen, n in content["figure_7"]["counts"]),
    )


COLUMNS = ("material_a", "material_b", "dissimilarity")
"""The columns of the file; `palpate validate` writes them into tables/dissimilarity.csv."""


@dataclass(frozen=True)
class Dissimilarities:
    """One value for each pair of materials, and where the values come from."""

    pairs: Mapping[frozenset[str], float]
    source: str

    def table(self, materials: Sequence[str]) -> NDArray[np.float64] | None:
        """Return them symmetric, shape (M, M), with diagonal 0; None where a pair is missing."""
        if any(frozenset(pair) not in self.pairs for pair in combinations(materials, 2)):
            return None
        return np.array([[self.pairs[frozenset((a, b))] if a != b else 0.0 for b in materials] for a in materials])


NO_DISSIMILARITIES = Dissimilarities({}, "")


def printed_dissimilarities() -> Dissimilarities:
    """Return those of Okamoto et al., Table 3."""
    return Dissimilarities({pair: value.value for pair, value in load().pairs.items()}, "Table 3 of the paper")


def from_file(path: Path, materials: Sequence[str]) -> Dissimilarities:
    """Read a table with the columns material_a, material_b and dissimilarity, one row for each pair of `materials`.

    Raises `DatasetError`: the file cannot be read, a pair is missing or there twice, or a value is not a number from 0.
    """
    try:
        table = read_table(path, COLUMNS, COLUMNS[2:])
    except PalpateError as error:
        # The command that this file is handed to states nothing of how it is written.
        remedy = "save it as CSV in UTF-8, with decimal points"
        raise DatasetError.at(replace(error.finding, remedy=remedy)) from error
    pairs: dict[frozenset[str], float] = {}
    rows = [(row.line, dict(zip(table.header, map(str.strip, row.cells), strict=False))) for row in table.rows]
    for line, row in rows:
        first, second, text = (row.get(column) for column in COLUMNS)
        pair = frozenset((first or "", second or ""))
        value = table.number(text or "")
        if not 0 <= value < math.inf or len(pair) < 2 or pair in pairs:
            raise DatasetError(
                path,
                f"got {first!r}, {second!r}, {text!r}",
                "correct the line",
                allowed="two materials, each pair once, and a number of 0 or more",
                line=line,
            )
        pairs[pair] = value
    for pair in map(frozenset, combinations(materials, 2)):
        if pair not in pairs:
            raise DatasetError(path, f"got no dissimilarity for {' and '.join(sorted(pair))}", "add the line")
    labels = sorted({label for _, row in rows if (label := row.get("dataset")) and label != "measured"})
    return Dissimilarities(pairs, " - ".join([path.name, *labels]))
