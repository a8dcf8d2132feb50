"""What a rig in volts plays: the oracle of its voltages, claims, condition numbers, and the budget beside the truth."""

from __future__ import annotations

import runpy
from collections.abc import Callable
from dataclasses import replace
from math import asinh, pi, sqrt
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from palpate.analysis.numerics import figures, numerics, oracle, played
from palpate.analysis.numerics.cases import Case, settle
from palpate.analysis.numerics.played import IN_M_S2, IN_VOLTS, PREPARED, RIG, SHAPED, Rig
from palpate.experiment.synthesis.crinkle import CrinkleSpectra
from palpate.experiment.synthesis.shaping import Response
from palpate.experiment.synthesis.voltages import Drive, Driven

CASES = played.cases()


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.given)
def test_it_holds(case: Case) -> None:
    settled = settle(case)
    assert settled.holds, settled.seen
    assert settled.seen


def test_the_traps_of_a_numerical_analyst_are_among_the_cases() -> None:
    given = {case.given for case in CASES}
    assert {"silence", "1e300 m/s^2", "a null at 300 Hz, and bins next to it", "one recorded speed"} <= given


def two_bins(first: float, second: float) -> CrinkleSpectra:
    """Bins at 100 and 150 Hz, of 50 samples at 1 kHz: 10 Hz a bin."""
    amplitudes = np.zeros((2, 50))
    amplitudes[:, [10, 15]] = first, second
    signs = np.ones((2, 50))
    signs[:, 15] = -1
    return CrinkleSpectra(np.array([100.0, 200.0]), 1000, amplitudes, signs)


def test_the_oracle_s_voltages_are_those_by_hand() -> None:
    """By hand: at 100 Hz 2 and 6 m/s^2 at 1 and 2 V; at 150 Hz 3 and 8, halfway between the frequencies measured."""
    response = Response(np.array([100.0, 200.0]), np.array([1.0, 2.0]), np.array([[2.0, 6.0], [4.0, 10.0]]))
    for asked, scale, gain, volts in (
        ((4.0, 3.0), 1.0, 1e9, (1.5, 1.0)),
        ((8.0, 6.0), 0.5, 1e9, (1.5, 1.0)),
        ((1.0, 100.0), 1.0, 1e9, (0.5, 2.0)),
        ((4.0, 3.0), 1.0, 0.25, (1.0, 0.75)),
    ):
        found = oracle.voltages(
            two_bins(*asked),
            speed_mm_s=130.0,
            output_rate_hz=1000,
            response=response,
            gain_limit_v_per_m_s2=gain,
            scale=scale,
        )
        t = (np.arange(50) + 0.5) / 1000
        wanted = volts[0] * np.cos(2 * pi * 100 * t) - volts[1] * np.cos(2 * pi * 150 * t)
        np.testing.assert_allclose(found.samples.astype(np.float64), wanted, rtol=0, atol=1e-13)
        assert float(found.scale) == pytest.approx(sqrt((volts[0] ** 2 + volts[1] ** 2) / 2), rel=1e-15)


def test_a_null_takes_the_highest_level_or_what_the_gain_limit_leaves() -> None:
    null = Response(np.array([10.0, 400.0]), np.array([1.0, 2.0]), np.zeros((2, 2)))
    for gain, volts in ((1e9, 2.0), (0.1, 0.3)):
        found = oracle.voltages(
            two_bins(3.0, 0.0),
            speed_mm_s=130.0,
            output_rate_hz=1000,
            response=null,
            gain_limit_v_per_m_s2=gain,
            scale=1.0,
        )
        assert float(found.scale) == pytest.approx(volts / sqrt(2))


def broken(by: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> Callable[[Drive, object], Driven]:
    right = Drive.__call__

    def wrong(self: Drive, stimulus: object) -> Driven:
        made = right(self, stimulus)  # type: ignore[arg-type]
        return made._replace(voltages_v=by(made.voltages_v))

    return wrong


@pytest.mark.parametrize(
    ("by", "told"),
    [(lambda v: v * (1 + 1e-10), "of the error claimed"), (lambda v: v * 1e3, " V")],
    ids=["a wrong digit", "above the limit"],
)
def test_voltages_that_err_are_noticed(
    monkeypatch: pytest.MonkeyPatch, by: Callable[[NDArray[np.float64]], NDArray[np.float64]], told: str
) -> None:
    monkeypatch.setattr(Drive, "__call__", broken(by))
    [case] = [case for case in CASES if case.given == "levels exceeded by most bins"]
    settled = settle(case)
    assert not settled.holds
    assert settled.seen.endswith(told)


def test_a_row_of_voltages_breaks_its_claim_where_any_place_does(monkeypatch: pytest.MonkeyPatch) -> None:
    extent = replace(numerics.QUICK, lengths=(50,), budget_s=0.0, least_repeats=1)
    rows = [measure() for measure in numerics.voltages(extent)]
    assert {one.way for one in rows} == {PREPARED, SHAPED}
    assert all(one.holds and one.worst_at for one in rows)
    assert [one.others["prepared_share"] > 0.5 for one in rows if one.way == PREPARED] == [True, True]
    monkeypatch.setattr(Drive, "__call__", broken(lambda v: v * (1 + 1e-10)))
    assert not any(measure().holds for measure in numerics.voltages(extent))


def test_the_condition_number_of_a_panel_that_saturates_is_that_of_its_closed_form() -> None:
    """W(a) = E sinh(a / (G E)): a W' / W = x / tanh x, with x = a / (G E) = asinh(e / E)."""
    levels = np.linspace(0.01, 8.0, 800)
    rig = Rig(played.panel((50, 100, 150, 200), levels.tolist()), rate_hz=1000, gain_limit_v_per_m_s2=1e9)
    amplitude_m_s2 = float(oracle.answered_m_s2(np.array([100.0]), np.array([6.0]))[0])
    x = asinh(6.0 / oracle.SOFT_V)
    found = played.sensitivity(two_bins(amplitude_m_s2, 0.0), rig, speed_mm_s=130.0)
    assert found.worst_by_amplitude == pytest.approx(x / np.tanh(x), rel=2e-3)
    assert found.rms_by_amplitude == pytest.approx(found.worst_by_amplitude)


def test_bins_that_a_limit_decides_hang_on_nothing() -> None:
    rig = replace(RIG, gain_limit_v_per_m_s2=1e-3, rate_hz=1000)
    assert played.sensitivity(two_bins(1.0, 1.0), rig, speed_mm_s=130.0).worst_by_amplitude == 0.0


def test_condition_numbers_of_lines_by_hand() -> None:
    """From 1 to 3 m/s^2 between 100 and 200 mm/s: v C' / C = v 0.02 / (0.02 v - 1), 3 at 75 beyond the middle."""
    amplitudes = np.zeros((2, 50))
    amplitudes[:, 10] = 1.0, 3.0
    spectra = CrinkleSpectra(np.array([100.0, 200.0]), 1000, amplitudes, np.ones((2, 50)))
    [of_speed] = [
        one
        for one in played.conditions({"line": spectra}, (120.0,))
        if (one.of, one.on) == ("stimulus", "speed of the foot")
    ]
    assert of_speed.number == pytest.approx(120 * 0.02 / 1.4, rel=1e-5)
    assert of_speed.where == "line, 120 mm/s"
    assert played.jump(spectra) < 1e-12
    turned = replace(spectra, signs=np.where(np.arange(2)[:, None] == 0, 1.0, -1.0) * np.ones((2, 50)))
    assert played.jump(turned) == pytest.approx(2.0)


@pytest.fixture(scope="module")
def stimuli() -> list[played.Played]:
    bright = numerics.made_to_order(2500, "bright")
    return [*played.play("bright", bright, unit=IN_VOLTS), *played.play("bright", bright, unit=IN_M_S2)]


def test_a_budget_is_the_truth_and_its_shares_add_up(stimuli: list[played.Played]) -> None:
    for one in stimuli:
        assert one.holds
        shares = [getattr(one.budget, cause) for cause in figures.CAUSES]
        assert sqrt(sum(share**2 for share in shares)) == pytest.approx(one.budget.total, rel=1e-12)
    in_volts = [one for one in stimuli if one.unit == IN_VOLTS]
    assert all(one.budget.left_out > 0.1 for one in in_volts)
    assert all(one.budget.total < 1e-7 for one in stimuli if one.unit == IN_M_S2)


def test_a_budget_that_misses_a_cause_does_not_hold(stimuli: list[played.Played]) -> None:
    assert not replace(stimuli[0], budget=replace(stimuli[0].budget, below=0.0, above=0.0)).holds


def test_the_truth_can_be_found_by_other_means(
    stimuli: list[played.Played],
    repository_root: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """By a program that imports no line of palpate."""
    file = repository_root / "tests" / "analysis" / "numerics" / "by_hand.py"
    assert "import palpate" not in file.read_text("utf-8")
    (tmp_path / "numerics").mkdir()
    materials = {"bright": numerics.made_to_order(2500, "bright")}
    (tmp_path / "numerics" / "played.npz").write_bytes(played.arrays(stimuli, materials))
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(file))
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert len(lines) == len(stimuli)
    for material, v, unit, *numbers in lines:
        [one] = [one for one in stimuli if (one.unit, round(one.speed_mm_s)) == (unit, int(v))]
        truth, told, total = map(float, numbers)
        assert (material, told, total) == ("bright", one.truth, one.budget.total)
        assert truth == pytest.approx(told, rel=1e-3)
