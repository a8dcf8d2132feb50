"""What the figures show, asked of their artists."""

from __future__ import annotations

from dataclasses import replace
from math import sin

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from palpate.analysis.documents.drawing import colour
from palpate.analysis.numerics import figures
from palpate.analysis.numerics.numerics import Measured, Timed
from palpate.analysis.numerics.played import IN_VOLTS, Played
from palpate.experiment.synthesis.budget import Budget
from palpate.experiment.synthesis.stepping.impact import Collision


@pytest.mark.parametrize(("stiffness", "mass", "scale"), [(4500.0, 0.1, "linear"), (1e9, 1e-6, "symlog")])
def test_a_contact_between_two_samples_is_drawn_on_a_scale_of_its_own(
    stiffness: float, mass: float, scale: str
) -> None:
    drawn = figures.course(Collision(stiffness, 1.0, mass, 0.2), rate_hz=2500.0)
    axes: list[Axes] = drawn.axes
    assert {one.get_xscale() for one in axes} == {scale}
    assert ("by its logarithm" in axes[-1].get_xlabel()) is (scale == "symlog")
    assert "$" not in "".join(label.get_text() for label in axes[-1].get_xticklabels())


def test_an_impact_s_last_panel_is_how_far_each_method_is_from_the_exact_one() -> None:
    """Euler's first step without a damper goes v h, and the mass v sin(w h) / w."""
    drawn = figures.course(Collision(4000.0, 0.0, 0.1, 0.2), rate_hz=2500.0)
    [euler] = [line for line in drawn.axes[-1].lines if line.get_color() == figures.COLOUR["euler"]]
    wanted = 1e3 * (0.2 / 2500 - 0.2 * sin(200 / 2500) / 200)
    assert np.asarray(euler.get_ydata())[1] == pytest.approx(wanted, rel=1e-9)


def impact_row(step_s: float, ms: float, error: float) -> Measured:
    given = {"stiffness_n_m": 4500.0, "mass_kg": 0.1, "step_s": step_s}
    return Measured("contact", "rk4", given, Timed(ms / 1e3, (0.9 * ms / 1e3, 1.2 * ms / 1e3), 9), error)


def test_the_ring_of_the_servo_s_step_lies_on_its_line_unless_it_is_no_answer() -> None:
    rows = [impact_row(1e-3, 1.0, 0.1), impact_row(1e-4, 4.0, 0.01), impact_row(4e-4, 2.0, 0.05)]
    figures._curve(axes := Figure().add_subplot(), rows, rows, "rk4")
    assert list(np.asarray(axes.lines[0].get_xdata())) == pytest.approx([1e-3, 2e-3, 4e-3])
    rows[2] = impact_row(4e-4, 50.0, 1.0)
    figures._curve(axes := Figure().add_subplot(), rows, rows, "rk4")
    assert list(np.asarray(axes.lines[0].get_xdata())) == pytest.approx([1e-3, 4e-3])


def row(way: str, ms: float, error: float) -> Measured:
    given = {"samples": 2500.0, "output_rate_hz": 48_000.0, "speed_mm_s": 170.0}
    return Measured("synthesis", way, given, Timed(ms / 1e3, (0.9 * ms / 1e3, 1.2 * ms / 1e3), 9), error, claimed=1e-12)


def test_a_dominated_way_is_grey_quartiles_are_bars_and_claims_are_lines() -> None:
    fast, slow = row("fast", 1.0, 1e-15), row("slow", 3.0, 1e-15)
    axes = Figure().add_subplot()
    figures._curves(axes, [fast, slow])
    bars = axes.containers
    assert [to_hex(bar[0].get_color()) for bar in bars] == [colour(0).lower(), figures.BEATEN]
    ends = [bar[2][0].get_segments()[0][:, 0] for bar in bars]
    for (low, high), one in zip(ends, (fast, slow), strict=True):
        assert (low, high) == pytest.approx(one.timed.quartiles_s)
    claims = [line for line in axes.lines if line.get_linestyle() == "--"]
    assert [set(np.asarray(line.get_ydata())) for line in claims] == [{1e-12}, {1e-12}]
    figures._curves(other := Figure().add_subplot(), [fast, replace(slow, error=1e-18)])
    assert figures.BEATEN not in [to_hex(bar[0].get_color()) for bar in other.containers]


def test_an_error_that_nobody_notices_is_marked_for_either_site() -> None:
    figures._synthesis(axes := Figure().add_subplot(), [row("one", 1.0, 1e-15)])
    marked = [np.asarray(line.get_ydata())[0] for line in axes.lines if to_hex(line.get_color()) == "#a40e26"]
    # 18 third octaves off by a share s each: 18^(1/2) 1.159 ln(1 + s) / ln(1 + w) is d' = 0.0177, 1 % without guessing.
    assert marked == pytest.approx([0.0036066 * np.log(1.052), 0.0036066 * np.log(1.2)], rel=1e-3)
    assert axes.get_ylim() == (1e-15, 1e-3)


def test_a_budget_has_a_line_for_each_cause_that_is_there_and_rings_of_the_truth() -> None:
    speeds = (20.0, 200.0)
    played = [
        Played(IN_VOLTS, "paper", v, np.zeros(2, np.float32), Budget(1.0, 0.0, above=0.3, table=0.04), 0.31)
        for v in speeds
    ]
    [axes] = figures.budget(played).axes
    shown = {str(line.get_label()): np.asarray(line.get_ydata()) for line in axes.lines}
    assert set(shown) == {"above the response table", "steps of the response table", "all of it", "truth"}
    np.testing.assert_allclose(shown["all of it"], np.hypot(30, 4))
    np.testing.assert_allclose(shown["truth"], 31)
