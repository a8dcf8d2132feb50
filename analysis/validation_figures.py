"""Figures of the validation: Figures 6, 7, 12 and 13 of Okamoto et al. from the recordings at hand. One function a
figure, or a panel of it; each draws into the axes it is given.
"""

from __future__ import annotations

from collections.abc import Iterator

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from analysis.answer_figures import against_dissimilarity
from analysis.dissimilarity import Classified, Overlay
from analysis.figures import (
    COLUMN_STYLE,
    HATCHES,
    LINES,
    Sheet,
    colour,
    common_key,
    key,
    sheet,
    short,
)
from analysis.validation import Validation
from experiment.synthesis.spectra import BAND_HZ


def sheets(validation: Validation) -> tuple[Sheet, ...]:
    """Every figure that the validation has numbers for."""
    with mpl.rc_context(COLUMN_STYLE):
        return tuple(_sheets(validation))


def _sheets(validation: Validation) -> Iterator[Sheet]:
    label, f = validation.label, validation.frequencies_hz
    figure, panels = sheet([1.5] * len(validation.classified), "Speeds on which fresh takes were put", label)
    for axes, of_it in zip(panels, validation.classified, strict=True):
        classification(axes, of_it)
    common_key(figure, panels[0])
    said = "Speeds on which fresh takes were put (as Fig. 7 of Okamoto et al.). The numbers stand in the tables here."
    yield Sheet("classification", "classification", said, figure)

    if validation.overlays:
        figure, panels = sheet([1.4] * len(validation.overlays), "Synthesised and observed, less the panel", label)
        for axes, one in zip(panels, validation.overlays, strict=True):
            overlay(axes, one, f)
        common_key(figure, panels[0])
        said = "Synthesised spectra and averages of observed ones, the panel subtracted (as Fig. 6 of Okamoto et al.)."
        yield Sheet("overlay", "overlay", said, figure)

    figure, (axes,) = sheet([2.6], f"Materials at {validation.reference_mm_s:g} mm/s, the panel subtracted", label)
    spectra(axes, validation.spectra, f)
    said = "Amplitude spectra of the materials, the panel subtracted (as Fig. 12 of Okamoto et al.)."
    yield Sheet("spectra", "dissimilarity", said, figure)

    if validation.confusable:
        made = ", of materials that were fitted to Table 3" if validation.fitted else ""
        title = f"Confusions of real materials, as Table 2 prints them, and dissimilarity here{made}"
        figure, (axes,) = sheet([3.1], title, label)
        against_dissimilarity(axes, _confusions(validation), "these recordings, normalised")
        said = "How often a material was taken for another (Table 2 of Okamoto et al.) against the dissimilarity of "
        said += "their spectra here (as Fig. 13)."
        yield Sheet("confusions", "dissimilarity", said, figure)


def classification(axes: Axes, one: Classified) -> None:
    """How many takes of each observed speed were put on each candidate (Figure 7)."""
    places = np.arange(one.candidates_mm_s.size)
    width = 0.8 / one.observed_mm_s.size
    for i, v in enumerate(one.observed_mm_s):
        axes.bar(
            places + (i - (one.observed_mm_s.size - 1) / 2) * width,
            one.counts[i],
            width * 0.92,
            facecolor=colour(i),
            edgecolor="black",
            linewidth=0.5,
            hatch=HATCHES[i % len(HATCHES)],
            label=f"observed at {v:g} mm/s",
        )
    axes.set_xticks(places, [f"{v:g}" for v in one.candidates_mm_s])
    axes.set_ylim(0, one.chosen.shape[1] + 0.5)
    axes.set_title(f"{short(one.material, 24)}: {int(one.close.sum())} of {one.takes} same or next")
    axes.set_xlabel("synthesised speed (mm/s)")
    axes.set_ylabel("takes")


def overlay(axes: Axes, one: Overlay, frequencies_hz: NDArray[np.float64]) -> None:
    """The synthesised and the averaged observed spectrum of a material (Figure 6)."""
    band = frequencies_hz <= BAND_HZ[1]
    f = frequencies_hz[band]
    axes.plot(f, one.observed[band], color="black", linewidth=0.6, label="observed, average")
    axes.plot(f, one.synthesised[band], LINES[1], color=colour(1), linewidth=0.9, label="synthesised")
    axes.set_title(f"{short(one.material, 24)}, {one.speed_mm_s:g} mm/s")
    _amplitudes(axes)


def spectra(axes: Axes, of: dict[str, NDArray[np.float64]], frequencies_hz: NDArray[np.float64]) -> None:
    """Amplitudes of the materials at one speed (Figure 12)."""
    band = frequencies_hz <= BAND_HZ[1]
    for i, (material, amplitudes) in enumerate(of.items()):
        axes.plot(
            frequencies_hz[band],
            amplitudes[band],
            LINES[i % len(LINES)],
            color=colour(i),
            linewidth=0.7,
            label=short(material, 22),
        )
    _amplitudes(axes)
    key(axes)


def _amplitudes(axes: Axes) -> None:
    axes.set_xlabel("frequency (Hz)")
    axes.set_ylabel("amplitude (m/s²)")
    axes.set_xlim(0, BAND_HZ[1])
    axes.set_ylim(bottom=0)


def _confusions(validation: Validation) -> dict[str, list[tuple[float, float]]]:
    """Both ratios of every pair of materials against its dissimilarity (Figure 13)."""
    found: dict[str, list[tuple[float, float]]] = {}
    for a, b in validation.pairs:
        points = [(p.dissimilarity, p.ratio) for p in validation.confusable if {p.presented, p.answered} == {a, b}]
        if points:
            found[f"{short(a, 22)} / {short(b, 22)}"] = points
    return found
