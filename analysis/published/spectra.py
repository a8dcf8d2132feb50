"""What a published study prints about spectra: dissimilarities of materials, and takes put on speeds."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib import resources

from analysis.published import Printed


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
