"""The kept tables of methods are what the command makes: their rows, their claims, and errors within them."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from palpate.analysis.numerics import cases, numerics, played, report
from palpate.analysis.numerics.numerics import FULL, Measured, Numerics
from tests import methods

KEPT, SERVO = methods.kept()


def value(cell: str) -> float | None:
    """The number of a cell; None for a dash."""
    return None if cell == "-" else float(cell.removesuffix(" dB"))


@pytest.fixture(scope="module")
def made() -> Numerics:
    """The rows that the table has, measured without repeats; the printed sum, which takes seconds, is left out."""
    once = replace(
        FULL,
        lengths=(2500,),
        output_rates_hz=(numerics.OUTPUT_RATE_HZ,),
        table_sizes=(report.USUAL_FREQUENCIES,),
        noise_s=(0.5,),
        budget_s=0.0,
        least_repeats=1,
        most_terms=0,
        contact_steps=(),
    )
    rows = [measure() for measure in numerics.measurements(once)]
    return Numerics({}, tuple(rows), (), (), (), (), {})


def test_the_table_has_the_rows_of_the_command_with_their_claims(made: Numerics) -> None:
    ours, servo = report.methods(made).tables
    assert KEPT[0] == list(ours.header)
    kept = {tuple(row[:3]): row for row in KEPT[1:]}
    sum_ = ("synthesis", cases.PRINTED_SUM.name, "2500 bins, 48000 Hz, 170 mm/s")
    assert set(kept) == {row[:3] for row in ours.rows} | {sum_}
    assert kept[sum_][5] == f"{cases.PRINTED_SUM.claim(numerics.made_to_order(2500).grid(48_000)):.1e}"
    for row in ours.rows:
        claimed, told = value(row[5]), value(kept[row[:3]][5])
        assert (claimed is None) == (told is None)
        if claimed is not None:
            assert claimed == pytest.approx(told, rel=0.1)
    assert SERVO[0] == list(servo.header)
    assert [row[0] for row in SERVO[1:]] == [row[0] for row in servo.rows]


def test_errors_in_the_table_are_those_of_the_command_and_within_their_claims(made: Numerics) -> None:
    """Roundings differ by chance, all else hardly."""
    ours, servo = report.methods(made).tables
    errors = {row[:3]: value(row[4]) for row in ours.rows}
    for row in KEPT[1:]:
        error, claimed = value(row[4]), value(row[5])
        assert error is not None
        assert claimed is None or error <= claimed
        if (again := errors.get((row[0], row[1], row[2]))) is not None:
            assert again == pytest.approx(error, rel=1.5 if error < 1e-14 else 0.05)
    for ours_, kept in zip(servo.rows, SERVO[1:], strict=True):
        for one, other in zip(ours_[1:], kept[1:], strict=True):
            first, second = (re.match(r"wrong|[0-9.]+e[-+][0-9]+", cell) for cell in (one, other))
            assert first
            assert second
            if first[0] == "wrong" or second[0] == "wrong":
                assert first[0] == second[0]
            else:
                again, error = float(first[0]), float(second[0])
                assert again == pytest.approx(error, rel=0.05) or max(again, error) < 1e-14


def test_the_faster_way_of_each_pair_is_not_dominated() -> None:
    kept = {(row[0], row[1]): row[6] for row in KEPT[1:]}
    assert kept["synthesis", "basis waveforms"] == kept["voltages", played.PREPARED] == "no"
    assert kept["synthesis", "printed sum"] == kept["voltages", played.SHAPED] == "yes"
    assert kept["resampling", "polyphase filter"] == "yes"


def test_dominated_is_what_another_does_in_less_time_with_no_larger_error() -> None:
    def row(way: str, ms: float, error: float, **given: float) -> Measured:
        spread = (0.9 * ms, 1.1 * ms)
        return Measured("contact", way, given, numerics.Timed(ms, spread, 9), error)

    fast, slow, rough = row("a", 1, 1e-6, k=1), row("b", 2, 1e-6, k=1), row("c", 0.5, 1e-2, k=1)
    close, other, none = row("d", 1.1, 1e-6, k=1), row("e", 9, 1e-3, k=2), row("f", 0.1, 1.0, k=1)
    rows = [fast, slow, rough, close, other, none]
    assert [numerics.dominated(one, rows) for one in rows] == [False, True, False, False, False, True]
    assert numerics.dominated(row("g", 2, 1e-6, k=1, step_s=3.0), rows)
    assert numerics.dominated(replace(slow, subject="noise"), rows) is None
