"""What `palpate numerics` prints and writes: tables, JSON, and the plot of error against run time."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from itertools import groupby
from math import ceil, floor, log10
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from analysis.documents.drawing import STYLE, colour, marker, png, svg
from analysis.documents.output import check, publish
from analysis.documents.tables import WIDTH, Section, Table, comma_separated, markdown
from analysis.documents.tables import text as section_text
from analysis.numerics import contact, contact_report
from analysis.numerics.cases import Outcome
from analysis.numerics.numerics import BETWEEN_MM_S, LABEL, OUTPUT_RATE_HZ, Measured, Numerics, usual_length
from experiment.errors import DatasetError
from experiment.synthesis.noise import CLAIMED_DB, CLAIMED_FROM_S
from experiment.synthesis.stepping.stability import of_the_paper

FILES = (
    *(f"{slug}.csv" for slug in ("synthesis", "resampling", "shaping", "noise", "contact", "cases")),
    *(f"numerics.{kind}" for kind in ("md", "svg", "png")),
    *(f"contact.{kind}" for kind in ("svg", "png")),
)
"""The files that `write` writes."""

TITLES = {
    "synthesis": "Synthesis: equations (3) to (5)",
    "resampling": "Resampling of a recording",
    "shaping": "Frequency shaping: the inverse (7) of a response",
    "noise": "Noise of the masker",
    "contact": "Contact with a virtual block: equations (4) and (5) of Wellman and Howe",
}
SAYS = {
    "synthesis": "The error is the rms of the difference from the oracle, divided by the rms of the exact stimulus. "
    "Preparation is done once for each material; the table gives its time and the memory that it holds.",
    "resampling": "The error is the same, at samples between both ends. palpate uses the inverse DCT; the two other "
    "ways are there for comparison.",
    "shaping": "The error is the rms of the relative difference from the closed inverse of a response that saturates "
    "softly and peaks at 360 Hz, at the bins from 10 to 600 Hz. It comes from the straight lines between the values of "
    "a table, and no bound is claimed.",
    "noise": "The error is the largest deviation, in dB, of an octave band from 31.5 Hz to 16 kHz from its colour, "
    "relative to the band at 1 kHz. It is bounded for noise of half a second or longer.",
    "contact": "A mass is thrown back by a block with a damping ratio of "
    f"{contact.DAMPING_RATIO:g}. The error is that of the speed of rebound, relative to the closed form in extended "
    "precision, the largest over the phase of the touch within a step; 1 is all of it, and stands for no release too. "
    "The time is that of the whole impact.",
}
HEADS = {
    "samples": "N",
    "output_rate_hz": "output rate (Hz)",
    "speed_mm_s": "speed (mm/s)",
    "frequencies": "frequencies",
    "drive_levels": "drive levels",
    "bins": "bins",
    "length_s": "length (s)",
    "stiffness_n_m": "K (N/m)",
    "mass_kg": "M (kg)",
    "step_s": "step (s)",
    "release_error": "of release",
    "penetration_error": "of penetration",
    "energy_error": "of energy",
}


def sections(result: Numerics) -> tuple[Section, ...]:
    """Return the measurements by subject, then the cases."""
    by_subject = groupby(result.measured, key=lambda one: one.subject)
    measured = [_measured(subject, list(rows), result) for subject, rows in by_subject]
    return (*measured, _cases(result.outcomes))


def text(result: Numerics, width: int = WIDTH) -> str:
    """Return everything for a terminal, with the verdict at the end."""
    verdict = (textwrap.fill(line, width, subsequent_indent="    ") for line in result.verdict.splitlines())
    return "\n\n\n".join([LABEL, *(section_text(one, width) for one in sections(result)), "\n".join(verdict)])


def as_dict(result: Numerics) -> dict[str, Any]:
    """Return every number and outcome, for JSON."""
    rows = {section.slug: [dict(record) for record in section.records] for section in sections(result)}
    return {"label": LABEL, "software": result.software, "failed": result.failed, "broken": list(result.broken), **rows}


def check_out(out: Path) -> None:
    """Refuse, before anything is measured, a folder that `write` could not write into.

    Raises:
        DatasetError: the folder is within a dataset, a file is in the way, or the file system refuses.
    """
    check(out, FILES, "numerics")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DatasetError(f"cannot write {error.filename or out}: {error.strerror}; choose another --out") from error


def write(result: Numerics, out: Path) -> tuple[Path, ...]:
    """Write tables (CSV, Markdown) and the plot (PNG, SVG) into a folder; return the files. Errors as `check_out`."""
    parts = sections(result)
    files = {f"{part.slug}.csv": comma_separated(part, LABEL).encode() for part in parts}
    page = [f"**{LABEL}**\n", *(markdown(part, "") for part in parts), result.verdict, ""]
    files["numerics.md"] = "\n".join(page).encode()
    drawn, diagrams = figure(result), contact_report.diagrams(_subject(result, "contact"))
    files["numerics.svg"], files["numerics.png"] = svg(drawn), png(drawn)
    files["contact.svg"], files["contact.png"] = svg(diagrams), png(diagrams)
    return publish(out, files, LABEL, "numerics")


def time_text(seconds: float | None) -> str:
    """Return a time to three digits; `-` for None."""
    if seconds is None:
        return "-"
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds * 1e6:.3g} µs"


def usual(rows: list[Measured]) -> list[Measured]:
    """Return the rows of synthesis at one length, one output rate and one speed, which stand for all."""
    length = usual_length(one.given["samples"] for one in rows)
    wanted = {"samples": length, "output_rate_hz": OUTPUT_RATE_HZ, "speed_mm_s": BETWEEN_MM_S}
    return [one for one in rows if one.given == wanted]


def _subject(result: Numerics, subject: str) -> list[Measured]:
    return [one for one in result.measured if one.subject == subject]


def _measured(subject: str, rows: list[Measured], result: Numerics) -> Section:
    paragraphs = [SAYS[subject]]
    if subject == "synthesis":
        software = ", ".join(f"{name} {version}" for name, version in result.software.items() if "oracle" not in name)
        paragraphs.append(
            f"Times are medians of repeats on one machine ({software}) and should only be compared with one another. "
            f"The oracle's numbers near 1 are {result.software['oracle_epsilon']} apart."
        )
    tables = [_table("", rows, given=True)]
    brief: tuple[Table, ...] = ()
    if subject == "synthesis":
        shown = usual(rows)
        size = "N = {samples:g} at {output_rate_hz:g} Hz, {speed_mm_s:g} mm/s".format(**shown[0].given)
        brief = (_table(f"{size} (all {len(rows)} rows: --out)", shown, given=False),)
        tables = [_table(size, shown, given=False), replace(tables[0], title="Every size, rate and speed")]
    if subject == "contact":
        paragraphs += [contact_report.orders(rows), of_the_paper()]
        shown = [one for one in rows if one.given["step_s"] == contact.SERVO_S]
        title = f"At the servo's step of {contact.SERVO_S * 1e6:g} µs (all {len(rows)} rows: --out)"
        brief = (_table(title, shown, given=True),)
    records = tuple(_record(one) for one in rows)
    return Section(subject, TITLES[subject], tuple(paragraphs), tuple(tables), records, brief)


def _table(title: str, rows: list[Measured], *, given: bool) -> Table:
    sizes = tuple(rows[0].given) if given else ()
    prepared = any(one.prepared_s is not None for one in rows)
    unit = "error (dB)" if rows[0].subject == "noise" else "error"
    claims = any(one.claimed is not None for one in rows)
    others = tuple(rows[0].others)
    header = ["way", *(HEADS[name] for name in sizes), "median time", unit, *(["claimed"] * claims)]
    header += [HEADS[name] for name in others]
    header += ["prepared in", "memory"] * prepared
    kibibytes = ["-" if one.memory_bytes is None else f"{one.memory_bytes / 1024:.0f} KiB" for one in rows]
    cells = [
        [
            one.way,
            *(f"{one.given[name]:.3g}" if name == "step_s" else f"{one.given[name]:g}" for name in sizes),
            time_text(one.timed.median_s),
            _error(one, one.error),
            *([_error(one, one.claimed)] * claims),
            *(_error(one, one.others[name]) for name in others),
            *([time_text(one.prepared_s), held] * prepared),
        ]
        for one, held in zip(rows, kibibytes, strict=True)
    ]
    broken = frozenset((i, header.index(unit)) for i, one in enumerate(rows) if not one.holds)
    return Table(title, tuple(header), tuple(map(tuple, cells)), marked=broken)


def _error(one: Measured, value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.2f}" if one.subject == "noise" else f"{value:.1e}"


def _record(one: Measured) -> dict[str, object]:
    low, high = one.timed.quartiles_s
    return {
        "way": one.way,
        **one.given,
        "median_s": one.timed.median_s,
        "lower_quartile_s": low,
        "upper_quartile_s": high,
        "repeats": one.timed.repeats,
        "error": one.error,
        "claimed_error": one.claimed,
        **one.others,
        "holds": one.holds,
        "prepared_s": one.prepared_s,
        "memory_bytes": one.memory_bytes,
    }


def _cases(outcomes: tuple[Outcome, ...]) -> Section:
    full, brief = [], []
    for group, members in groupby(outcomes, key=lambda one: one.group):
        rows = list(members)
        broken = frozenset((i, 2) for i, one in enumerate(rows) if not one.holds)
        cells = tuple((one.given, one.invariant, _outcome(one), one.seen) for one in rows)
        title = f"{group[0].upper()}{group[1:]}"
        header = ("given", "must hold", "outcome", "seen")
        full.append(Table(title, header, cells, left=frozenset({0, 1, 2, 3}), marked=broken))
        brief.append(_brief(title, rows))
    about = (
        "The cases test every way at every output rate, what a stimulus states about itself, and the oracle against "
        "itself."
    )
    return Section("cases", "Extreme cases", (about,), tuple(full), tuple(map(asdict, outcomes)), tuple(brief))


def _outcome(one: Outcome) -> str:
    return "holds" if one.holds else "FAILS"


def _brief(title: str, rows: list[Outcome]) -> Table:
    """Return the table for a terminal; an invariant that all rows share stands in its title."""
    shared = len({one.invariant for one in rows}) == 1
    if shared:
        title = f"{title}: {rows[0].invariant}"
    seen = "seen" if shared else "must hold -> seen"
    cells = tuple((one.given, _outcome(one), one.seen if shared else f"{one.invariant} -> {one.seen}") for one in rows)
    return Table(title, ("given", "outcome", seen), cells, left=frozenset({0, 1, 2}))


QUIET = "#57606a"
RULE: Any = {"color": "#d5d9de", "linewidth": 0.6}


def figure(result: Numerics) -> Figure:
    """Return the plot: synthesis above; resampling, shaping and noise below it."""
    with mpl.rc_context(STYLE):
        drawn = Figure(figsize=(8.4, 7.4))
        drawn.suptitle(f"{LABEL}: error against median run time", fontsize=10, fontweight="bold", y=0.985)
        synthesis = _subject(result, "synthesis")
        above = drawn.add_gridspec(1, 1, left=0.09, right=0.985, top=0.9, bottom=0.47)
        _synthesis(drawn.add_subplot(above[0]), synthesis)
        below = drawn.add_gridspec(1, 3, left=0.09, right=0.985, top=0.36, bottom=0.075, wspace=0.34)
        for place, panel in enumerate((_resampling, _shaping, _noise)):
            panel(drawn.add_subplot(below[place]), result.measured)
        return drawn


def _synthesis(axes: Axes, rows: Sequence[Measured]) -> None:
    point = {"output_rate_hz": OUTPUT_RATE_HZ, "speed_mm_s": BETWEEN_MM_S}
    shown = [one for one in rows if point.items() <= one.given.items()]
    _curves(axes, shown)
    decades = [log10(one.error) for one in shown if one.error > 0]
    _logarithmic(axes)
    if decades:
        axes.set_ylim(10.0 ** floor(min(decades)), 10.0 ** ceil(max(decades)))
    axes.grid(visible=True, **RULE)
    axes.tick_params(labelsize=8)
    _times(axes, "from the speed of the foot to the waveform")
    axes.set_ylabel("relative error", fontsize=9)
    axes.legend(loc="upper center", frameon=False, fontsize=9)
    lengths = ", ".join(f"{n:g}" for n in sorted({one.given["samples"] for one in shown}))
    axes.set_title(f"Synthesis at 48 kHz; points: N = {lengths}", fontsize=9, loc="left", pad=5)


def _resampling(axes: Axes, measured: Sequence[Measured]) -> None:
    _curves(axes, _below(axes, measured, "resampling", "Resampling, 44.1 to 192 kHz"))
    _times(axes, "median run time")
    axes.set_ylabel("relative error", fontsize=9)
    axes.legend(loc="center", frameon=False, fontsize=8)


def _shaping(axes: Axes, measured: Sequence[Measured]) -> None:
    rows = _below(axes, measured, "shaping", "")
    _curves(axes, rows, x=lambda one: one.given["frequencies"])
    taken = [one.timed.median_s for one in rows]
    axes.set_title(f"Shaping: {time_text(min(taken))} to {time_text(max(taken))}", fontsize=9)
    axes.set_xlabel("frequencies in the table", fontsize=9)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.legend(loc="lower left", frameon=False, fontsize=8)


def _noise(axes: Axes, measured: Sequence[Measured]) -> None:
    rows = _below(axes, measured, "noise", "Noise: octave bands")
    _curves(axes, rows)
    first = [one for one in rows if one.way == rows[0].way]
    for one in (first[0], first[-1]):
        length, at = f"{one.given['length_s']:g} s", (one.timed.median_s, one.error)
        axes.annotate(length, at, (0, 6), textcoords="offset points", ha="center", fontsize=8)
    axes.margins(x=0.12)
    axes.set_ylim(top=4.0)
    axes.axhline(CLAIMED_DB, color=QUIET, linestyle=":", linewidth=1.2)
    bound, beside = f"bound from {CLAIMED_FROM_S:g} s on", axes.get_yaxis_transform()
    axes.text(0.98, CLAIMED_DB, bound, transform=beside, ha="right", va="bottom", fontsize=8, color=QUIET)
    _times(axes, "median run time")
    axes.set_ylabel("error (dB)", fontsize=9, labelpad=1)
    axes.legend(loc="upper right", frameon=False, fontsize=8)


def _below(axes: Axes, measured: Sequence[Measured], subject: str, title: str) -> list[Measured]:
    axes.set_xscale("log")
    _logarithmic(axes)
    axes.grid(visible=True, **RULE)
    axes.set_title(title, fontsize=9)
    axes.tick_params(labelsize=8)
    return [one for one in measured if one.subject == subject]


def _logarithmic(axes: Axes) -> None:
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(FuncFormatter(lambda error, _: f"{error:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def _curves(
    axes: Axes, rows: Sequence[Measured], x: Callable[[Measured], float] = lambda one: one.timed.median_s
) -> None:
    """Draw the error of each way over `x`."""
    for i, way in enumerate(dict.fromkeys(one.way for one in rows)):
        points = [one for one in rows if one.way == way]
        errors = [one.error for one in points]
        style: Any = {"marker": marker(i), "color": colour(i), "linewidth": 1.1, "markersize": 4.5}
        axes.plot([x(one) for one in points], errors, label=way, **style)


def _times(axes: Axes, label: str) -> None:
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(numticks=12))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda seconds, _: time_text(seconds)))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel(label, fontsize=9)
