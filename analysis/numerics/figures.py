"""The figures of `palpate numerics`: error against run time, contact for each stiffness, the budget, and one impact."""

from collections.abc import Callable, Sequence
from math import ceil, floor, log10, nan
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray

from palpate.analysis.documents.drawing import COLOURS, STYLE, colour, marker, pdf, png, svg
from palpate.analysis.numerics import contact
from palpate.analysis.numerics.numerics import (
    BETWEEN_MM_S,
    LABEL,
    NO_ANSWER,
    OUTPUT_RATE_HZ,
    Measured,
    Numerics,
    dominated,
    order,
)
from palpate.analysis.numerics.played import PREPARED, Played
from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis.noticing import FINGERTIP, SOLE, unnoticed_share
from palpate.experiment.synthesis.signals.noise import CLAIMED_DB, CLAIMED_FROM_S
from palpate.experiment.synthesis.stepping.impact import Collision, Course, closed_form, in_steps
from palpate.experiment.synthesis.stepping.steppers import EXACT, STEPPERS

KINDS: dict[str, Callable[[Figure], bytes]] = {".svg": svg, ".png": png, ".pdf": pdf}
"""What a figure can be written as."""

COLOUR = {**dict(zip([name for name in STEPPERS if name != EXACT], COLOURS, strict=True)), EXACT: "#000000"}
MARKER = dict(zip(STEPPERS, ("o", "^", "s", "D", "v", "P", "*"), strict=True))
"""Of each method."""

QUIET, BEATEN = "#57606a", "#b8bec6"
"""Of what is told beside the curves, and of ways that are dominated."""

UNNOTICED = unnoticed_share(SOLE), unnoticed_share(FINGERTIP)
"""Smaller errors are noticed by nobody at the sole, and at the fingertip."""

RULE: Any = {"color": "#e3e6ea", "linewidth": 0.6}

SHORT = 5.0
"""A contact that is shorter than a step by this is drawn on a scale of its own."""

FINE = 400
"""Points by which the exact motion is drawn."""


def course(of: Collision, *, rate_hz: float) -> Figure:
    """Return the plot of an impact: r, dr/dt and force over time, by every method in steps of a rate, Hz.

    Below is the distance from the exact r until release. Methods that leave the picture end in marks; one with too many
    steps is left out.
    """
    exact = closed_form(of)
    lasts = exact.release_s or 4 * (exact.peak_s or 5 / rate_hz)
    fine = in_steps(of, rate_hz=FINE / lasts)
    panels: tuple[tuple[str, float, Callable[[Course], NDArray[np.float64]]], ...] = (
        ("penetration r (mm)", 1e3, lambda one: one.deep_m),
        ("rate dr/dt (m/s)", 1.0, lambda one: one.deep_m_s),
        ("force (N)", 1.0, lambda one: one.force_n),
    )
    with mpl.rc_context(STYLE):
        drawn = Figure(figsize=(8.4, 9.0), layout="constrained")
        axes: list[Axes] = list(drawn.subplots(4, 1, sharex=True))
        off = axes.pop()
        off.set_yscale("log")
        off.set_ylabel("r off from exact (mm)", fontsize=9)
        off.yaxis.set_major_formatter(FuncFormatter(lambda mm, _: f"{mm:g}"))
        off.yaxis.set_minor_formatter(NullFormatter())
        sampled = in_steps(of, rate_hz=rate_hz).deep_m
        for place, (label, unit, of_course) in zip(axes, panels, strict=True):
            values = of_course(fine) * unit
            place.plot(fine.times_s * 1e3, values, color=COLOUR[EXACT], linewidth=1.6, label="exact", zorder=1)
            low, high = float(values.min()), float(values.max())
            room = 0.3 * max(high - low, 1e-12)
            place.set_ylim(low - room, high + room)
            place.set_ylabel(label, fontsize=9)
            place.axhline(0.0, color="#d5d9de", linewidth=0.8, zorder=0)
        axes[0].set_xlim(-0.05 * lasts * 1e3, 1e3 * max(1.1 * lasts, 1.5 / rate_hz))
        left_out = []
        for name in STEPPERS:
            try:
                made = in_steps(of, method=name, rate_hz=rate_hz)
            except SynthesisError:
                left_out.append(name)
                continue
            _steps(axes, made, name, [(unit, of_course) for _, unit, of_course in panels])
            both = min(sampled.size, made.deep_m.size)
            apart = np.clip(np.abs(made.deep_m[:both] - sampled[:both]) * 1e3, 0.0, 1e9)
            if np.any(apart > 0):
                style: Any = {"color": COLOUR[name], "marker": MARKER[name], "markersize": 3, "linewidth": 0.9}
                off.plot(made.times_s[:both] * 1e3, np.where(apart > 0, apart, nan), **style)
        label = "time since the touch (ms)"
        if 1 / rate_hz > SHORT * lasts:
            # A contact between two samples would be a line at 0.
            axes[0].set_xscale("symlog", linthresh=2e3 * lasts, linscale=2.0)
            axes[0].xaxis.set_major_formatter(FuncFormatter(lambda ms, _: f"{ms:g}"))
            axes[0].xaxis.set_minor_formatter(NullFormatter())
            label += f", by its logarithm beyond {2e3 * lasts:.2g}"
        off.set_xlabel(label, fontsize=9)
        drawn.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
        title = (
            f"{of.mass_kg:g} kg at {of.speed_m_s:g} m/s on {of.stiffness_n_m:g} N/m and {of.damping_n_s_m:g} N s/m"
            + (f" under {of.force_n:g} N" if of.force_n else "")
            + f", law '{of.law}', steps of {1e6 / rate_hz:.4g} µs\nmarks at an upper or lower edge are off the scale"
        )
        if left_out:
            title += f"\nleft out, because they need too many steps: {', '.join(left_out)}"
        axes[0].set_title(title, fontsize=9, loc="left")
    return drawn


def _steps(axes: Sequence[Axes], made: Course, name: str, panels: Sequence[tuple[float, Any]]) -> None:
    style: Any = {"color": COLOUR[name], "marker": MARKER[name], "markersize": 4, "linewidth": 0.9}
    # Markers of many samples would hide the lines: about thirty are drawn, those of each method at other samples.
    apart = max(1, made.times_s.size // 30)
    style["markevery"] = (list(STEPPERS).index(name) * apart // len(STEPPERS), apart)
    if name == EXACT:
        style |= {"linestyle": "none"}
    for place, (unit, of_course) in zip(axes, panels, strict=True):
        values = np.clip(of_course(made) * unit, -1e9, 1e9)
        label = f"{name}, at its samples" if name == EXACT else name
        place.plot(made.times_s * 1e3, values, label=label, **style)
        at_edge = np.clip(values, *place.get_ylim())
        beyond = (at_edge != values) & np.isfinite(values) & (made.times_s * 1e3 <= place.get_xlim()[1])
        mark: Any = {"marker": MARKER[name], "color": COLOUR[name], "markersize": 5, "linestyle": "none"}
        if beyond.any():
            mark |= {"clip_on": False, "in_layout": False, "zorder": 4}
            place.plot(made.times_s[beyond] * 1e3, at_edge[beyond], **mark)


def orders(rows: Sequence[Measured]) -> str:
    """Return the orders of convergence, fitted over the steps of every diagram, in whole sentences."""
    told = []
    for name in STEPPERS:
        found = []
        for stiffness in dict.fromkeys(one.given["stiffness_n_m"] for one in rows):
            points = [one for one in rows if one.way == name and one.given["stiffness_n_m"] == stiffness]
            points = [one for one in points if one.given["step_s"] != contact.SERVO_S]
            fitted = order([one.given["step_s"] for one in points], [one.error for one in points])
            if fitted is not None:
                found.append(fitted)
        told.append(f"{name} {min(found):.1f} to {max(found):.1f}" if found else f"{name} none")
    return (
        "Orders of convergence (fitted if at least three errors are neither rounding errors nor above 0.3), lowest "
        f"and highest across the diagrams: {'; '.join(told)}. Methods that do not locate touch and release exactly "
        "drop to about first order there, whatever their order elsewhere."
    )


def diagrams(rows: Sequence[Measured]) -> Figure:
    """Return error against run time, a panel for each stiffness and a curve for each method.

    Dominated points are grey; a ring marks the servo's step, at the edge where its error is above the panel.
    """
    stiffnesses = list(dict.fromkeys((one.given["stiffness_n_m"], one.given["mass_kg"]) for one in rows))
    down = -(-(len(stiffnesses) + 1) // 3)
    with mpl.rc_context(STYLE):
        drawn = Figure(figsize=(10.4, 0.6 + 3.8 * down), layout="constrained")
        drawn.suptitle("SIMULATED impacts: error of the rebound against run time", fontsize=10, fontweight="bold")
        axes: list[Axes] = list(np.ravel(drawn.subplots(down, 3, squeeze=False, sharey=True)))
        for place, (stiffness, mass) in zip(axes, stiffnesses, strict=False):
            here = [one for one in rows if one.given["stiffness_n_m"] == stiffness]
            for name in STEPPERS:
                _curve(place, [one for one in here if one.way == name], here, name)
            place.axhline(contact.CLAIMED, color=COLOUR[EXACT], linestyle="--", linewidth=0.9)
            place.axvline(contact.SERVO_S, color=QUIET, linestyle=":", linewidth=1.2)
            _logarithmic(place)
            _times(place, "median run time", ticks=5)
            place.set_ylim(1e-17, 3.0)
            place.set_title(f"{stiffness:g} N/m, {mass:g} kg", fontsize=9)
        axes[0].set_ylabel("relative error", fontsize=9)
        beside = axes[len(stiffnesses)]
        for place in axes[len(stiffnesses) :]:
            place.axis("off")
        handles = [Line2D([], [], color=COLOUR[name], marker=MARKER[name], linewidth=1.1) for name in STEPPERS]
        beside.legend(handles, list(STEPPERS), loc="upper left", frameon=False, fontsize=8)
        told = (
            "gray: another method is faster\nwith no larger error, or the\nresult is wrong\nring: step of 400 µs\n"
            "dashed: claimed by the exact method\ndotted: 400 µs of run time\nbars: quartiles of the time"
        )
        beside.text(0.04, 0.0, told, transform=beside.transAxes, fontsize=8, va="bottom")
    return drawn


def _curve(axes: Axes, rows: Sequence[Measured], beside: Sequence[Measured], name: str) -> None:
    steps = [one for one in rows if one.given["step_s"] != contact.SERVO_S or one.error < NO_ANSWER]
    steps.sort(key=lambda one: -one.given["step_s"])
    line = [one.timed.median_s for one in steps], [max(one.error, 1e-16) for one in steps]
    # Thin, so that a method can be followed where all of it is grey.
    axes.plot(*line, color=COLOUR[name], alpha=0.6, linewidth=0.9, zorder=1)
    for one in rows:
        if one.given["step_s"] == contact.SERVO_S:
            ring: Any = {"marker": "o", "markersize": 9, "markerfacecolor": "none", "markeredgecolor": COLOUR[name]}
            axes.plot([one.timed.median_s], [max(one.error, 1e-16)], linestyle="none", **ring)
    _points(axes, rows, beside, COLOUR[name], MARKER[name], quiet=True)


def _points(
    axes: Axes, rows: Sequence[Measured], beside: Sequence[Measured], own: str, mark: str, *, quiet: bool = False
) -> None:
    """Draw points with the quartiles of their times, grey where another dominates them, and small then if `quiet`."""
    for grey in (True, False):
        some = [one for one in rows if bool(dominated(one, beside)) is grey]
        if some:
            low, middle, high = np.array(
                [(t[0], one.timed.median_s, t[1]) for one in some for t in [one.timed.quartiles_s]]
            ).T
            style: Any = {"marker": mark, "markersize": 4.5, "color": BEATEN if grey else own, "linestyle": "none"}
            spread: list[Any] | None = [np.maximum(middle - low, 0.0), np.maximum(high - middle, 0.0)]
            errors = [max(one.error, 1e-16) for one in some]
            if quiet and grey:
                # Their bars would run together, where many methods meet.
                spread, style = None, style | {"markersize": 2.6}
            axes.errorbar(middle, errors, xerr=spread, elinewidth=1.0, zorder=2 if grey else 3, **style)


def time_text(seconds: float | None) -> str:
    """Return a time to three digits; `-` for None."""
    if seconds is None:
        return "-"
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds * 1e6:.3g} µs"


def numerics(result: Numerics) -> Figure:
    """Return the plot: synthesis and voltages above; resampling, shaping and noise below."""
    with mpl.rc_context(STYLE):
        drawn = Figure(figsize=(9.6, 8.0))
        drawn.suptitle(f"{LABEL}: error against median run time", fontsize=10, fontweight="bold", y=0.985)
        above = drawn.add_gridspec(1, 2, left=0.075, right=0.975, top=0.9, bottom=0.5, wspace=0.18)
        left = drawn.add_subplot(above[0])
        _synthesis(left, result.measured)
        _voltages(drawn.add_subplot(above[1], sharey=left), result.measured)
        below = drawn.add_gridspec(1, 3, left=0.075, right=0.975, top=0.37, bottom=0.1, wspace=0.32)
        for place, panel in enumerate((_resampling, _shaping, _noise)):
            panel(drawn.add_subplot(below[place]), result.measured)
        told = (
            "Each error is the largest over all materials and speeds. Bars: quartiles of the time. Dashed: claimed "
            "error. Gray: another method takes less time with no larger error.\nRed: according to a model, no one "
            "notices smaller errors at the sole (solid) or the fingertip (dotted)."
        )
        drawn.text(0.5, 0.012, told, ha="center", fontsize=8, color=QUIET)
        return drawn


def _synthesis(axes: Axes, rows: Sequence[Measured]) -> None:
    point = {"output_rate_hz": OUTPUT_RATE_HZ, "speed_mm_s": BETWEEN_MM_S}
    shown = [one for one in rows if one.subject == "synthesis" and point.items() <= one.given.items()]
    _curves(axes, shown)
    _unnoticed(axes)
    _logarithmic(axes)
    values = [value for one in rows if one.subject in ("synthesis", "voltages") for value in (one.error, one.claimed)]
    decades = [log10(value) for value in (*values, *UNNOTICED) if value]
    axes.set_ylim(10.0 ** floor(min(decades)), 10.0 ** ceil(max(decades)))
    _times(axes, "from foot speed to waveform")
    axes.set_ylabel("relative error", fontsize=9)
    _sizes(axes, shown)
    axes.legend(loc="upper left", frameon=False, fontsize=8)
    axes.set_title("Synthesis, m/s², 48 kHz; N at the ends", fontsize=9, loc="left", pad=5)


def _voltages(axes: Axes, rows: Sequence[Measured]) -> None:
    shown = [one for one in rows if one.subject == "voltages" and one.given["output_rate_hz"] == OUTPUT_RATE_HZ]
    # Where nothing fits, prepared voltages are those of the step.
    shown = [one for one in shown if one.way != PREPARED or one.others["prepared_share"]]
    _curves(axes, shown)
    _unnoticed(axes)
    _logarithmic(axes)
    _times(axes, "from foot speed to voltages")
    _sizes(axes, shown)
    axes.legend(loc="upper right", frameon=False, fontsize=8)
    axes.set_title("Voltages, 48 kHz; N at the ends", fontsize=9, loc="left", pad=5)


def _sizes(axes: Axes, rows: Sequence[Measured]) -> None:
    """Write the least and the largest N of each way beside its points."""
    for way in dict.fromkeys(one.way for one in rows):
        some = sorted((one for one in rows if one.way == way), key=lambda one: one.given["samples"])
        for one in (some[0], some[-1])[: len(some)]:
            at = one.timed.median_s, one.error
            axes.annotate(f"{one.given['samples']:g}", at, (0, 7), textcoords="offset points", ha="center", fontsize=8)


def _resampling(axes: Axes, measured: Sequence[Measured]) -> None:
    _curves(axes, _plot_below(axes, measured, "resampling", "Resampling, 44.1 to 192 kHz"))
    _unnoticed(axes)
    _times(axes, "median run time", ticks=6)
    axes.set_ylabel("relative error", fontsize=9)
    axes.legend(loc="center left", frameon=False, fontsize=8)


def _shaping(axes: Axes, measured: Sequence[Measured]) -> None:
    rows = _plot_below(axes, measured, "shaping", "")
    _unnoticed(axes)
    for i, way in enumerate(dict.fromkeys(one.way for one in rows)):
        line = [(one.given["frequencies"], one.error) for one in rows if one.way == way]
        axes.plot(*zip(*line, strict=True), color=colour(i), marker=marker(i), markersize=4.5, linewidth=1.1, label=way)
    sizes = np.array(sorted({one.given["frequencies"] for one in rows}))
    finest = [one for one in rows if one.given["frequencies"] == sizes[-1]]
    squares = min(one.error for one in finest) * ((sizes[-1] - 1) / (sizes - 1)) ** 2
    within = squares < NO_ANSWER
    axes.plot(sizes[within], squares[within] / 2, color=QUIET, linestyle=":", linewidth=1.2, label="h²")
    taken = [one.timed.median_s for one in rows]
    axes.set_title(f"Shaping, in {time_text(min(taken))} to {time_text(max(taken))} each", fontsize=9)
    axes.set_xlabel("frequencies in the table", fontsize=9)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.legend(loc="lower left", frameon=False, fontsize=8)


def _noise(axes: Axes, measured: Sequence[Measured]) -> None:
    rows = _plot_below(axes, measured, "noise", "Noise: octave bands")
    _curves(axes, rows, claims=False)
    first = [one for one in rows if one.way == rows[0].way]
    for one in (first[0], first[-1]):
        length, at = f"{one.given['length_s']:g} s", (one.timed.median_s, one.error)
        axes.annotate(length, at, (0, 6), textcoords="offset points", ha="center", fontsize=8)
    axes.margins(x=0.12)
    axes.set_ylim(top=6.0)
    axes.axhline(CLAIMED_DB, color=QUIET, linestyle="--", linewidth=1.0)
    bound, beside = f"claimed from {CLAIMED_FROM_S:g} s on", axes.get_yaxis_transform()
    axes.text(0.98, CLAIMED_DB, bound, transform=beside, ha="right", va="bottom", fontsize=8, color=QUIET)
    _times(axes, "median run time", ticks=6)
    axes.set_ylabel("error (dB)", fontsize=9, labelpad=1)
    axes.legend(loc="upper right", frameon=False, fontsize=8)


def _plot_below(axes: Axes, measured: Sequence[Measured], subject: str, title: str) -> list[Measured]:
    axes.set_xscale("log")
    _logarithmic(axes)
    axes.set_title(title, fontsize=9)
    return [one for one in measured if one.subject == subject]


def _unnoticed(axes: Axes) -> None:
    """Mark the error below which accuracy no longer matters to a person, by the model of `synthesis/noticing.py`."""
    for error, site in zip(UNNOTICED, (SOLE, FINGERTIP), strict=True):
        axes.axhline(error, color="#a40e26", linestyle="-" if site is SOLE else ":", linewidth=1.0, zorder=0)


def _logarithmic(axes: Axes) -> None:
    axes.set_yscale("log")
    axes.grid(visible=True, **RULE)
    axes.tick_params(labelsize=8)
    axes.yaxis.set_major_formatter(FuncFormatter(lambda error, _: f"{error:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def _curves(axes: Axes, rows: Sequence[Measured], *, claims: bool = True) -> None:
    """Draw the error of each way over its time; grey where another dominates it, with its claim as a dashed line."""
    for i, way in enumerate(dict.fromkeys(one.way for one in rows)):
        points = [one for one in rows if one.way == way]
        beaten = [bool(dominated(one, rows)) for one in points]
        shade = BEATEN if all(beaten) else colour(i)
        times = [one.timed.median_s for one in points]
        axes.plot(times, [one.error for one in points], color=shade, linewidth=1.1, zorder=1)
        _points(axes, points, rows, colour(i), marker(i))
        axes.plot([], [], color=shade, marker=marker(i), markersize=4.5, linewidth=1.1, label=way)
        if claims and points[0].claimed is not None:
            claims_at = [(t, one.claimed) for t, one in zip(times, points, strict=True)]
            if max(times) < 1.3 * min(times):
                claims_at = [(min(times) / 1.3, points[0].claimed), (max(times) * 1.3, points[0].claimed)]
            axes.plot(*np.array(claims_at, dtype=np.float64).T, color=shade, linestyle="--", linewidth=1.0)


def _times(axes: Axes, label: str, *, ticks: int = 12) -> None:
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(numticks=ticks))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda seconds, _: time_text(seconds)))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel(label, fontsize=9)


CAUSES = {
    "rate": "output rate",
    "below": "below the response table",
    "above": "above the response table",
    "held_back": "gain limit, highest level",
    "taken_down": "limits of panel and amplifier",
    "table": "steps of the response table",
    "rounding": "rounding",
}
"""The shares of a budget (`synthesis.budget`) that a rig without a scene may have, and what each is called."""


def budget(played: Sequence[Played]) -> Figure:
    """Return the shares of every budget over the speed of the foot: a row for each unit, a panel for each material."""
    units, names = (list(dict.fromkeys(getattr(one, of) for one in played)) for of in ("unit", "material"))
    with mpl.rc_context(STYLE):
        drawn = Figure(figsize=(9.6, 6.2), layout="constrained")
        title = f"{LABEL} on SIMULATED rigs: difference between played and requested signals"
        drawn.suptitle(title, fontsize=10, fontweight="bold")
        all_axes = drawn.subplots(len(units), len(names), sharex=True, sharey="row", squeeze=False)
        for row, unit in zip(all_axes, units, strict=True):
            for axes, name in zip(row, names, strict=True):
                _budget(axes, [one for one in played if (one.unit, one.material) == (unit, name)])
                axes.set_title(f"{name}, rig in {unit}", fontsize=9)
            row[0].set_ylabel("percent of the requested rms", fontsize=9)
        for axes in all_axes[-1]:
            axes.set_xlabel("foot speed (mm/s)", fontsize=9)
        keys = [key for axes in np.ravel(all_axes) for key in zip(*axes.get_legend_handles_labels(), strict=True)]
        found = {label: handle for handle, label in keys}
        labels = [label for label in (*CAUSES.values(), "all of it", "truth") if label in found]
        handles = [found[label] for label in labels]
        drawn.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    return drawn


def _budget(axes: Axes, stimuli: Sequence[Played]) -> None:
    speeds = [one.speed_mm_s for one in stimuli]
    for i, (cause, label) in enumerate(CAUSES.items()):
        shares = np.array([getattr(one.budget, cause) for one in stimuli]) * 100
        if shares.any():
            shown = np.where(shares > 0, shares, np.nan)
            axes.plot(speeds, shown, color=colour(i), marker=marker(i), markersize=3.5, linewidth=1.0, label=label)
    total, truth = (np.array(of) * 100 for of in zip(*((one.budget.total, one.truth) for one in stimuli), strict=True))
    axes.plot(speeds, total, color="black", linewidth=1.4, label="all of it", zorder=1)
    ring: Any = {"marker": "o", "markersize": 7, "markerfacecolor": "none", "markeredgecolor": QUIET}
    axes.plot(speeds, truth, linestyle="none", label="truth", **ring)
    axes.set_xscale("log")
    _logarithmic(axes)
    axes.set_xticks([20, 50, 100, 200, 500], labels=["20", "50", "100", "200", "500"])
    axes.xaxis.set_minor_formatter(NullFormatter())
