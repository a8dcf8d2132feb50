"""Figures of the validation: legible at the width of a column, and what they show is what was found."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from palpate.analysis.documents.drawing import Sheet
from palpate.analysis.validation import report, validate
from tests.analysis.legible import check
from tests.analysis.validation.test_dissimilarity import FRESH, SPEEDS, Takes, linear
from tests.analysis.validation.test_validation import of_the_paper

LONG = "a sheet of very thin and crackling aluminum foil"


def _sheets(recorded: Takes, fresh: Takes) -> dict[str, Sheet]:
    return {one.name: one for one in report.sheets(validate.compute(recorded, fresh))}


@pytest.mark.parametrize("simulated", [True, False])
def test_the_papers_materials(simulated: bool) -> None:
    found = _sheets(of_the_paper(SPEEDS, 3, simulated=simulated), of_the_paper(FRESH, 10, simulated=simulated))
    assert list(found) == ["classification", "overlay", "spectra", "confusions"]
    check(list(found.values()))


def test_materials_of_any_name_and_number() -> None:
    one = linear(SPEEDS, 3)
    named = {f"{LONG} {number}": (1 + number) * one.objects["card"] for number in range(7)}
    fresh = linear(np.array([100.0, 400.0]), 2)
    others = {name: (1 + place) * fresh.objects["card"] for place, name in enumerate(named)}
    found = _sheets(Takes(SPEEDS, one.panel, named), Takes(fresh.speeds_mm_s, fresh.panel, others))
    assert list(found) == ["classification", "spectra"]
    check(list(found.values()))


def test_bars_are_the_counts_of_takes() -> None:
    made = validate.compute(of_the_paper(SPEEDS, 3), of_the_paper(FRESH, 10))
    axes = Figure().add_subplot()
    report.classification(axes, made.classified[0])
    heights = [[bar.get_height() for bar in bars] for bars in axes.containers]
    assert heights == made.classified[0].counts.tolist()


def test_every_confusing_ratio_of_table_2_is_a_point_and_its_pair_is_told() -> None:
    """Okamoto et al., Table 2, of the real materials: typing paper was taken for aluminum foil with ratio 0.36."""
    found = _sheets(of_the_paper(SPEEDS, 3), of_the_paper(FRESH, 10))
    (axes,) = found["confusions"].figure.axes
    points = {str(line.get_label()): sorted(np.asarray(line.get_ydata()).tolist()) for line in axes.lines}
    assert len(points) == 6
    assert 0.36 in points["aluminum foil / typing paper"]
    assert sum(map(len, points.values())) == 12
    looks = {(line.get_marker(), to_hex(line.get_color())) for line in axes.lines}
    assert len(looks) == 6
