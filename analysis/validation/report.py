"""The report of a validation: sections, numbers for JSON, figures (6, 7, 12 and 13 of Okamoto et al.), and files."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from palpate.analysis.documents import drawing, page
from palpate.analysis.documents.output import check, publish
from palpate.analysis.documents.tables import WIDTH, Column, Record, Section, count_of, tabulate, text
from palpate.analysis.reading import dissimilarities
from palpate.analysis.report.figures import against_dissimilarity
from palpate.analysis.validation.validate import Classified, Overlay, Recorded, Validation, compute
from palpate.experiment.synthesis.crinkle import Average
from palpate.experiment.synthesis.spectra import BAND_HZ

METHODS = (
    ("Spectrum", "C_k = (2/N) sum of y_i cos(pi k (i + 1/2) / N), at F k / (2 N) hertz. Equation (1)."),
    ("Panel", "C'_k = max(|C_k| - mean |C_k| of the bare panel at the same speed, 0). Equation (2)."),
    ("Synthesis", "C'_k is linear in speed between neighboring recorded speeds, and floored at zero. Equation (3)."),
    ("Dissimilarity", "The differences of two magnitudes are summed over 0 to 500 Hz. Equation (6)."),
)


@dataclass(frozen=True)
class Validated:
    """The validation, and the files that hold it."""

    validation: Validation
    sections: tuple[Section, ...]
    out: Path
    files: tuple[Path, ...]

    @property
    def report(self) -> Path:
        """Return the path of the HTML report."""
        return self.out / page.REPORT

    def text(self, width: int = WIDTH) -> str:
        """Return everything for a terminal; the last line is the report's path."""
        band = [self.validation.label] if self.validation.label else []
        parts = (text(part, width) for part in self.sections)
        return "\n\n\n".join([*band, *parts, *band, f"Report: {self.report}"])

    def as_dict(self) -> dict[str, Any]:
        """Return every number but the spectra, and the paths, for JSON."""
        paths = {"out": str(self.out), "report": str(self.report), "files": [str(path) for path in self.files]}
        return {**numbers(self.validation), **paths}


def validate(
    recorded: Recorded, fresh: Recorded, out: Path, *, average: Average = "magnitude", figures: bool = True
) -> Validated:
    """Validate recordings against fresh takes, and write tables, figures and the report into `out`.

    The fresh takes are of the same materials, rate and length. Takes are averaged as the protocol states; the result of
    the other average stands beside it. Drawing the figures takes most of the time. Raises `RecordingError` for
    recordings at a single speed, or fresh takes that do not compare with them, and `DatasetError` for a folder within a
    dataset, or a file in the way.
    """
    check(out, (), "validate")
    validation = compute(recorded, fresh, average=average)
    parts = sections(validation)
    label = validation.label
    drawn = sheets(validation) if figures else ()
    files = page.folder("Validation of the synthesis", label, parts, drawn, METHODS, numbers(validation))
    return Validated(validation, parts, out, publish(out, files, label, "validate"))


def sections(validation: Validation) -> tuple[Section, ...]:
    """Return every section, in reading order."""
    overlaid = (_overlay(validation),) if validation.overlays else ()
    return (_classification(validation), *overlaid, _dissimilarity(validation))


def numbers(validation: Validation) -> dict[str, Any]:
    """Return every number but the spectra, for JSON."""
    return {
        "label": validation.label,
        "recordings": validation.recordings,
        "fresh": validation.fresh,
        "fitted": validation.fitted,
        "average": validation.average,
        "holds": validation.holds,
        "classification": [
            {"material": one.material, "observed_mm_s": one.observed_mm_s.tolist(),
             "candidates_mm_s": one.candidates_mm_s.tolist(), "counts": one.counts.tolist(),
             "same_or_neighbouring": one.close.tolist(), "takes": one.takes}
            for one in validation.classified
        ],
        "overlay": [
            {"material": one.material, "speed_mm_s": one.speed_mm_s, "dissimilarity_m_s2": one.dissimilarity}
            for one in validation.overlays
        ],
        "reference_mm_s": validation.reference_mm_s,
        "reference_extrapolated": validation.extrapolated,
        "pairs": [{"materials": list(pair), "dissimilarity": value} for pair, value in validation.pairs.items()],
        "rank_correlation": validation.rank_correlation,
        "other_average": {
            "average": validation.other.average,
            "same_or_neighbouring": {one.material: int(one.close.sum()) for one in validation.other.classified},
            "pairs": [{"materials": list(pair), "dissimilarity": d} for pair, d in validation.other.pairs.items()],
            "rank_correlation": validation.other.rank_correlation,
        },
    }  # fmt: skip


def _classification(validation: Validation) -> Section:
    tables = []
    verdicts = []
    for one in validation.classified:
        close, total = int(one.close.sum()), one.takes
        enough = "" if 2 * close >= total else ": fewer than half"
        verdicts.append(f"{one.material}: {close} of {total}{enough}")
        per_speed = one.chosen.shape[1]
        candidates = [f"{speed:g}" for speed in one.candidates_mm_s]
        speeds: list[Record] = [
            {"observed_mm_s": v, **dict(zip(candidates, counts, strict=True)), "near": near}
            for v, counts, near in zip(one.observed_mm_s, one.counts, one.close, strict=True)
        ]
        columns = (
            Column("observed_mm_s", "observed mm/s", show="{:g}".format, left=True),
            *(Column(speed, show=lambda n: str(n) if n else "") for speed in candidates),
            Column("near", "same or neighbor", show=partial(count_of, total=per_speed)),
        )
        marked = frozenset(
            (row, 1 + column)
            for row, v in enumerate(one.observed_mm_s)
            for column, candidate in enumerate(one.candidates_mm_s)
            if candidate == v
        )
        table = tabulate(f"{one.material}: takes assigned to each speed", columns, speeds, marked=marked)
        tables.append(replace(table, records=tuple(_takes(one))))
    text = "; ".join(
        f"{material} at {observed:g} mm/s, {n} assigned to {chosen:g} mm/s"
        for material, observed, chosen, n in dissimilarities.load().counts
    )
    head = "At least half" if validation.holds else "NOT everywhere at least half"
    others = "; ".join(f"{one.material}: {int(one.close.sum())} of {one.takes}" for one in validation.other.classified)
    paragraphs = (
        *([validation.fitted] if validation.fitted else []),
        f"The recordings are {validation.recordings}. The fresh takes are {validation.fresh}.",
        f"{head} of every material's takes were assigned to the same or a neighboring speed: {'; '.join(verdicts)}.",
        "The candidates are all recorded and observed speeds; neighbors are adjacent in this list. Each take is "
        "compared separately, minus the average panel. Single takes appear slower than they were: a sum of absolute "
        "differences is smallest at the median of a random magnitude, but syntheses use means.",
        f"Takes are averaged by {validation.average}. Averaged by {validation.other.average}, the counts would be: "
        f"{others}.",
        f"The paper's text reports, for ten takes each: {text}.",
    )
    return Section("classification", "Takes assigned to speeds", paragraphs, tuple(tables))


def _takes(one: Classified) -> list[Record]:
    return [
        {
            "material": one.material,
            "observed_mm_s": float(v),
            "take": j + 1,
            "chosen_mm_s": float(one.candidates_mm_s[one.chosen[i, j]]),
            **{
                f"dissimilarity_{c:g}_mm_s": float(d)
                for c, d in zip(one.candidates_mm_s, one.dissimilarities[i, j], strict=True)
            },
        }
        for i, v in enumerate(one.observed_mm_s)
        for j in range(one.chosen.shape[1])
    ]


OVERLAID = (
    Column("material", left=True), Column("speed_mm_s", "mm/s", show="{:g}".format),
    Column("dissimilarity", "dissimilarity m/s^2", 2),
)  # fmt: skip


def _overlay(validation: Validation) -> Section:
    shown = tabulate("Synthesized spectra and averages of observed spectra", OVERLAID, map(asdict, validation.overlays))
    records: list[Record] = [
        {"material": one.material, "speed_mm_s": one.speed_mm_s, "frequency_hz": float(f),
         "observed_m_s2": float(observed), "synthesised_m_s2": float(synthesised)}
        for one in validation.overlays
        for f, observed, synthesised in zip(validation.frequencies_hz, one.observed, one.synthesised, strict=True)
        if f <= BAND_HZ[1]
    ]  # fmt: skip
    paragraphs = ("Each spectrum is the average of all takes recorded at its speed, minus the panel.",)
    table = replace(shown, records=tuple(records))
    return Section("overlay", "Synthesized and observed spectra", paragraphs, (table,))


def _dissimilarity(validation: Validation) -> Section:
    printed = dissimilarities.load().pairs
    other = validation.other
    ratios = {(point.presented, point.answered): point.ratio for point in validation.confusable}
    records: list[Record] = [
        {"material_a": a, "material_b": b, "dissimilarity": value,
         f"dissimilarity_{other.average}": other.pairs[a, b],
         "printed_dissimilarity": there.value if (there := printed.get(frozenset((a, b)))) else None,
         "a_answered_b": ratios.get((a, b)), "b_answered_a": ratios.get((b, a))}
        for (a, b), value in validation.pairs.items()
    ]  # fmt: skip
    columns = (
        Column("material_a", "a", left=True), Column("material_b", "b", left=True), Column("dissimilarity", "here", 2),
        Column(f"dissimilarity_{other.average}", other.average, 2), Column("printed_dissimilarity", "Table 3", 2),
        Column("a_answered_b", "a taken for b", 2), Column("b_answered_a", "b taken for a", 2),
    )  # fmt: skip
    notes = (
        f"Takes are averaged by {validation.average}, and in the next column by {other.average}.",
        "The last two columns are the answer ratios that Table 2 prints for real materials.",
    )
    table = tabulate(f"Normalized dissimilarity at {validation.reference_mm_s:g} mm/s", columns, records, notes)
    outside = (
        f"{validation.reference_mm_s:g} mm/s, at which the paper compares materials, is outside the recorded speeds: "
        "these spectra are EXTRAPOLATED."
    )
    rho, swapped = validation.rank_correlation, other.rank_correlation
    found = "The paper has no answer ratios for these materials, or too few for a correlation."
    if rho is not None:
        also = f" ({swapped:.2f} averaged by {other.average})" if swapped is not None else ""
        found = (
            f"Spearman's rank correlation between ratio and dissimilarity is {rho:.2f} across {len(ratios)} "
            f"ratios{also}."
        )
    paragraphs = (
        *([validation.fitted] if validation.fitted else []),
        *([outside] if validation.extrapolated else []),
        f"Materials with more similar spectra should be confused more often. {found}",
    )
    return Section("dissimilarity", "Dissimilarity of materials", paragraphs, (table,))


def sheets(validation: Validation) -> tuple[drawing.Sheet, ...]:
    """Return every figure for which the validation has numbers."""
    with mpl.rc_context(drawing.COLUMN_STYLE):
        return tuple(_sheets(validation))


def _sheets(validation: Validation) -> Iterator[drawing.Sheet]:
    label, f = validation.label, validation.frequencies_hz
    figure, panels = drawing.sheet([1.5] * len(validation.classified), "Speeds assigned to fresh takes", label)
    for axes, of_it in zip(panels, validation.classified, strict=True):
        classification(axes, of_it)
    drawing.common_key(figure, panels[0])
    said = "The speeds assigned to fresh takes (as in Fig. 7 of Okamoto et al.). The tables give the numbers."
    yield drawing.Sheet("classification", "classification", said, figure)

    if validation.overlays:
        figure, panels = drawing.sheet(
            [1.4] * len(validation.overlays), "Synthesized and observed, minus the panel", label
        )
        for axes, one in zip(panels, validation.overlays, strict=True):
            overlay(axes, one, f)
        drawing.common_key(figure, panels[0])
        said = "Synthesized spectra and averages of observed spectra, minus the panel (as in Fig. 6 of Okamoto et al.)."
        yield drawing.Sheet("overlay", "overlay", said, figure)

    figure, (axes,) = drawing.sheet([2.6], f"Materials at {validation.reference_mm_s:g} mm/s, minus the panel", label)
    spectra(axes, validation.spectra, f)
    said = "Amplitude spectra of the materials, minus the panel (as in Fig. 12 of Okamoto et al.)."
    yield drawing.Sheet("spectra", "dissimilarity", said, figure)

    if validation.confusable:
        made = ", of materials that were fitted to Table 3" if validation.fitted else ""
        title = f"Confusions of real materials (Table 2 of the paper) and dissimilarity in this study{made}"
        figure, (axes,) = drawing.sheet([3.1], title, label)
        against_dissimilarity(axes, _confusions(validation), "these recordings, normalized")
        said = "How often a material was confused with another (Table 2 of Okamoto et al.) against the dissimilarity "
        said += "of their spectra here (as in Fig. 13)."
        yield drawing.Sheet("confusions", "dissimilarity", said, figure)


def classification(axes: Axes, one: Classified) -> None:
    """Draw how many takes of each observed speed were put on each candidate (Figure 7)."""
    places = np.arange(one.candidates_mm_s.size)
    width = 0.8 / one.observed_mm_s.size
    for i, v in enumerate(one.observed_mm_s):
        axes.bar(
            places + (i - (one.observed_mm_s.size - 1) / 2) * width,
            one.counts[i],
            width * 0.92,
            facecolor=drawing.colour(i),
            edgecolor="black",
            linewidth=0.5,
            hatch=drawing.HATCHES[i % len(drawing.HATCHES)],
            label=f"observed at {v:g} mm/s",
        )
    axes.set_xticks(places, [f"{v:g}" for v in one.candidates_mm_s])
    axes.set_ylim(0, one.chosen.shape[1] + 0.5)
    axes.set_title(f"{drawing.short(one.material, 24)}: {int(one.close.sum())} of {one.takes} same or next")
    axes.set_xlabel("synthesized speed (mm/s)")
    axes.set_ylabel("takes")


def overlay(axes: Axes, one: Overlay, frequencies_hz: NDArray[np.float64]) -> None:
    """Draw the synthesised and the averaged observed spectrum of a material (Figure 6)."""
    band = frequencies_hz <= BAND_HZ[1]
    f = frequencies_hz[band]
    axes.plot(f, one.observed[band], color="black", linewidth=0.6, label="observed, average")
    axes.plot(f, one.synthesised[band], drawing.LINES[1], color=drawing.colour(1), linewidth=0.9, label="synthesised")
    axes.set_title(f"{drawing.short(one.material, 24)}, {one.speed_mm_s:g} mm/s")
    _amplitudes(axes)


def spectra(axes: Axes, of: dict[str, NDArray[np.float64]], frequencies_hz: NDArray[np.float64]) -> None:
    """Draw the amplitudes of the materials at one speed (Figure 12)."""
    band = frequencies_hz <= BAND_HZ[1]
    for i, (material, amplitudes) in enumerate(of.items()):
        line, name = drawing.LINES[i % len(drawing.LINES)], drawing.short(material, 22)
        axes.plot(frequencies_hz[band], amplitudes[band], line, color=drawing.colour(i), linewidth=0.7, label=name)
    _amplitudes(axes)
    drawing.key(axes)


def _amplitudes(axes: Axes) -> None:
    axes.set_xlabel("frequency (Hz)")
    axes.set_ylabel("amplitude (m/s²)")
    axes.set_xlim(0, BAND_HZ[1])
    axes.set_ylim(bottom=0)


def _confusions(validation: Validation) -> dict[str, list[tuple[float, float]]]:
    """Return both ratios of every pair of materials with its dissimilarity (Figure 13)."""
    found: dict[str, list[tuple[float, float]]] = {}
    for a, b in validation.pairs:
        points = [(p.dissimilarity, p.ratio) for p in validation.confusable if {p.presented, p.answered} == {a, b}]
        if points:
            found[f"{drawing.short(a, 22)} / {drawing.short(b, 22)}"] = points
    return found
