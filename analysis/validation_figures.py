"""Figures of the validation: Figures 6, 7, 12 and 13 of Okamoto et al. from the recordings at hand."""

from __future__ import annotations

import textwrap
from math import ceil

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.figures import COLOURS, HATCHES, MARKERS, STYLE
from analysis.validation import Validation
from experiment.synthesis.spectra import BAND_HZ

LINES = ("-", "--", "-.", ":")


def figures(validation: Validation) -> dict[str, Figure]:
    """Every figure that the validation has numbers for, by the name of its files."""
    with mpl.rc_context(STYLE):
        drawn = {"classification": classification(validation), "spectra": spectra(validation)}
        if validation.overlays:
            drawn["overlay"] = overlay(validation)
        if validation.confusable:
            drawn["confusions"] = confusions(validation)
        return drawn


def classification(validation: Validation) -> Figure:
    """How many takes of each observed speed were put on each candidate, a panel for each material (Figure 7)."""
    figure, panels = _panels(len(validation.classified), height=2.7)
    for axes, one in zip(panels, validation.classified, strict=True):
        places = np.arange(one.candidates_mm_s.size)
        width = 0.8 / one.observed_mm_s.size
        for i, v in enumerate(one.observed_mm_s):
            axes.bar(
                places + (i - (one.observed_mm_s.size - 1) / 2) * width,
                one.counts[i],
                width * 0.92,
                facecolor=COLOURS[i % len(COLOURS)],
                edgecolor="black",
                linewidth=0.6,
                hatch=HATCHES[i % len(HATCHES)],
                label=f"observed at {v:g} mm/s",
            )
        axes.set_xticks(places, [f"{v:g}" for v in one.candidates_mm_s])
        axes.set_ylim(0, one.chosen.shape[1] + 0.5)
        axes.set_title(f"{one.material}: {int(one.close.sum())} of {one.takes} same or next", fontsize=10)
        axes.set_xlabel("synthesised speed (mm/s)")
        axes.set_ylabel("takes")
    panels[0].legend(frameon=False, fontsize=8)
    _head(figure, "Speeds on which fresh takes were put", validation.label)
    return figure


def overlay(validation: Validation) -> Figure:
    """Synthesised and averaged observed spectra, a panel for each material (Figure 6)."""
    figure, panels = _panels(len(validation.overlays), height=2.5)
    band = validation.frequencies_hz <= BAND_HZ[1]
    for axes, one in zip(panels, validation.overlays, strict=True):
        f = validation.frequencies_hz[band]
        axes.plot(f, one.observed[band], color="black", linewidth=0.7, label="observed, average")
        axes.plot(f, one.synthesised[band], color=COLOURS[1], linewidth=1.0, alpha=0.85, label="synthesised")
        axes.set_title(f"{one.material}, {one.speed_mm_s:g} mm/s", fontsize=10)
        axes.set_xlabel("frequency (Hz)")
        axes.set_ylabel("amplitude (m/s²)")
    panels[0].legend(frameon=False, fontsize=8)
    _head(figure, "Synthesised and observed spectra, the panel subtracted", validation.label)
    return figure


def spectra(validation: Validation) -> Figure:
    """Spectra of the materials at the reference speed (Figure 12)."""
    figure, panels = _panels(1, height=4.0)
    band = validation.frequencies_hz <= BAND_HZ[1]
    for i, (material, amplitudes) in enumerate(validation.spectra.items()):
        panels[0].plot(
            validation.frequencies_hz[band],
            amplitudes[band],
            linestyle=LINES[i % len(LINES)],
            color=COLOURS[i % len(COLOURS)],
            linewidth=0.9,
            label=material,
        )
    panels[0].set_xlabel("frequency (Hz)")
    panels[0].set_ylabel("amplitude (m/s²)")
    panels[0].legend(frameon=False, fontsize=9)
    _head(figure, f"Materials at {validation.reference_mm_s:g} mm/s, the panel subtracted", validation.label)
    return figure


def confusions(validation: Validation) -> Figure:
    """Published confusing answer ratios against dissimilarity, a marker for each pair (Figure 13)."""
    figure, panels = _panels(1, height=4.0)
    axes = panels[0]
    pairs = [
        pair for pair in validation.pairs if any({p.presented, p.answered} == {*pair} for p in validation.confusable)
    ]
    for i, (a, b) in enumerate(pairs):
        points = [point for point in validation.confusable if {point.presented, point.answered} == {a, b}]
        axes.plot(
            [point.dissimilarity for point in points],
            [point.ratio for point in points],
            MARKERS[i % len(MARKERS)],
            color=COLOURS[i % len(COLOURS)],
            label=f"{a} / {b}",
        )
    axes.set_xlim(0, 1.05)
    axes.set_ylim(bottom=-0.01)
    axes.set_xlabel("normalised dissimilarity of spectra")
    axes.set_ylabel("confusing answer ratio (Table 2)")
    axes.legend(frameon=False, fontsize=8)
    made = ", of materials that were fitted to Table 3" if validation.fitted else ""
    _head(figure, f"Confusions of real materials, as published, and dissimilarity here{made}", validation.label)
    return figure


def _panels(count: int, *, height: float) -> tuple[Figure, list[Axes]]:
    columns = min(count, 2)
    rows = ceil(count / columns)
    figure = Figure(figsize=(4.4 * columns if columns > 1 else 7.0, height * rows + 0.6), layout="constrained")
    return figure, [figure.add_subplot(rows, columns, i + 1) for i in range(count)]


def _head(figure: Figure, title: str, label: str) -> None:
    head = "\n".join([*([label] if label else []), *textwrap.wrap(title, int(figure.get_figwidth() * 11))])
    figure.suptitle(head, fontsize=10, fontweight="bold" if label else "normal")
