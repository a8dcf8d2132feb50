"""The figures of contact: one impact by every method, and error against run time for each stiffness."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray

from analysis.documents.drawing import COLOURS, STYLE, pdf, png, svg
from analysis.numerics import contact
from analysis.numerics.numerics import Measured
from experiment.errors import SynthesisError
from experiment.synthesis.stepping.impact import Collision, Course, closed_form, in_steps
from experiment.synthesis.stepping.steppers import EXACT, STEPPERS

KINDS: dict[str, Callable[[Figure], bytes]] = {".svg": svg, ".png": png, ".pdf": pdf}
"""What a figure can be written as."""

COLOUR = {**dict(zip([name for name in STEPPERS if name != EXACT], COLOURS, strict=True)), EXACT: "#000000"}
MARKER = dict(zip(STEPPERS, ("o", "^", "s", "D", "v", "P", "*"), strict=True))
"""Of each method."""

FINE = 400
"""Points by which the exact motion is drawn."""


def course(of: Collision, *, rate_hz: float) -> Figure:
    """Return the plot of an impact: r, dr/dt and force over time, by every method in steps of a rate, Hz.

    The exact motion is a line, with dots at its samples. Methods that leave the picture are cut off, and a method that
    needs too many steps is named as left out.
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
        drawn = Figure(figsize=(8.4, 7.2), layout="constrained")
        axes: list[Axes] = list(drawn.subplots(3, 1, sharex=True))
        for place, (label, unit, of_course) in zip(axes, panels, strict=True):
            values = of_course(fine) * unit
            place.plot(fine.times_s * 1e3, values, color=COLOUR[EXACT], linewidth=1.6, label="exact", zorder=1)
            low, high = float(values.min()), float(values.max())
            room = 0.3 * max(high - low, 1e-12)
            place.set_ylim(low - room, high + room)
            place.set_ylabel(label, fontsize=9)
            place.axhline(0.0, color="#d5d9de", linewidth=0.8, zorder=0)
        left_out = []
        for name in STEPPERS:
            try:
                made = in_steps(of, method=name, rate_hz=rate_hz)
            except SynthesisError:
                left_out.append(name)
                continue
            _steps(axes, made, name, [(unit, of_course) for _, unit, of_course in panels])
        axes[0].set_xlim(-0.05 * lasts * 1e3, 1e3 * max(1.1 * lasts, 1.5 / rate_hz))
        axes[-1].set_xlabel("time since the touch (ms)", fontsize=9)
        drawn.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
        title = (
            f"{of.mass_kg:g} kg at {of.speed_m_s:g} m/s on {of.stiffness_n_m:g} N/m and {of.damping_n_s_m:g} N s/m"
            + (f" under {of.force_n:g} N" if of.force_n else "")
            + f", law '{of.law}', steps of {1e6 / rate_hz:.4g} µs"
        )
        if left_out:
            title += f"\nleft out, for they need too many steps: {', '.join(left_out)}"
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


def orders(rows: Sequence[Measured]) -> str:
    """Return the orders of convergence, fitted over the steps of every diagram, in whole sentences."""
    told = []
    for name in STEPPERS:
        found = []
        for stiffness in dict.fromkeys(one.given["stiffness_n_m"] for one in rows):
            points = [one for one in rows if one.way == name and one.given["stiffness_n_m"] == stiffness]
            points = [one for one in points if one.given["step_s"] != contact.SERVO_S]
            fitted = contact.order([one.given["step_s"] for one in points], [one.error for one in points])
            if fitted is not None:
                found.append(fitted)
        told.append(f"{name} {min(found):.1f} to {max(found):.1f}" if found else f"{name} none, all is rounding")
    return (
        f"Orders of convergence, fitted, least and largest of the diagrams: {'; '.join(told)}. Through touch and "
        "release every method that does not find them falls to about the first order, whatever it has elsewhere."
    )


def diagrams(rows: Sequence[Measured]) -> Figure:
    """Return error against run time, a panel for each stiffness and a curve for each method.

    A ring marks the step of the servo; where its error is above the panel, the ring lies at the edge.
    """
    stiffnesses = list(dict.fromkeys((one.given["stiffness_n_m"], one.given["mass_kg"]) for one in rows))
    down = -(-(len(stiffnesses) + 1) // 3)
    with mpl.rc_context(STYLE):
        drawn = Figure(figsize=(8.4, 0.6 + 3.0 * down), layout="constrained")
        drawn.suptitle("SIMULATED impacts: error of the rebound against run time", fontsize=10, fontweight="bold")
        axes: list[Axes] = list(np.ravel(drawn.subplots(down, 3, squeeze=False, sharey=True)))
        for place, (stiffness, mass) in zip(axes, stiffnesses, strict=False):
            here = [one for one in rows if one.given["stiffness_n_m"] == stiffness]
            for name in STEPPERS:
                _curve(place, [one for one in here if one.way == name], name)
            place.axvline(contact.SERVO_S, color="#57606a", linestyle=":", linewidth=1.2)
            place.set_xscale("log")
            place.set_yscale("log")
            place.set_ylim(1e-17, 3.0)
            place.set_title(f"{stiffness:g} N/m, {mass:g} kg", fontsize=9)
            place.tick_params(labelsize=8)
            place.grid(visible=True, color="#d5d9de", linewidth=0.6)
            place.set_xlabel("median run time", fontsize=8)
            place.xaxis.set_major_locator(LogLocator(numticks=4))
            place.xaxis.set_major_formatter(FuncFormatter(lambda s, _: f"{s * 1e3:g} ms"))
            place.yaxis.set_major_formatter(FuncFormatter(lambda error, _: f"{error:g}"))
            for axis in (place.xaxis, place.yaxis):
                axis.set_minor_formatter(NullFormatter())
        axes[0].set_ylabel("relative error", fontsize=9)
        handles, labels = axes[0].get_legend_handles_labels()
        for place in axes[len(stiffnesses) :]:
            place.axis("off")
        axes[len(stiffnesses)].legend(handles, labels, loc="center left", frameon=False, fontsize=8)
        told = "ring: step of 400 µs\ndotted: 400 µs of run time"
        axes[len(stiffnesses)].text(0.0, -0.02, told, transform=axes[len(stiffnesses)].transAxes, fontsize=8)
    return drawn


def _curve(axes: Axes, rows: Sequence[Measured], name: str) -> None:
    style: Any = {"color": COLOUR[name], "marker": MARKER[name], "markersize": 4.5, "linewidth": 1.1}
    steps = [one for one in rows if one.given["step_s"] != contact.SERVO_S]
    axes.plot([one.timed.median_s for one in steps], [max(one.error, 1e-16) for one in steps], label=name, **style)
    for one in rows:
        if one.given["step_s"] == contact.SERVO_S:
            ring: Any = {"marker": "o", "markersize": 9, "markerfacecolor": "none", "markeredgecolor": COLOUR[name]}
            axes.plot([one.timed.median_s], [max(one.error, 1e-16)], linestyle="none", **ring)
