"""Mistakes planted in a printed ANOVA table: each is named, and a right table is not accused."""

from __future__ import annotations

import pytest
from scipy import stats
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.audit.mistakes import Line
from palpate.analysis.audit.print_lines import source_lines
from palpate.analysis.published.numbers import PrintedSources

RIGHT = {"ss": "42.0", "ms": "21.0", "f": "7.00", "p": f"{stats.f.sf(7, 2, 20):.5f}"}
"""By hand: 42 / 2 = 21, 60 / 20 = 3, 21 / 3 = 7."""


def _lines(**changed: str | None) -> list[Line]:
    groups = {"name": "groups", "df": 2, **RIGHT, **changed}
    blocks = {"name": "blocks", "df": 3, "ss": "27.0", "ms": "9.0"}
    error = {"name": "error", "df": 20, "ss": "60.0", "ms": "3.0"}
    return list(source_lines(PrintedSources.model_validate({"where": "T", "lines": (groups, blocks, error)})))


def test_a_right_table_is_not_accused() -> None:
    assert all(line.agrees for line in _lines())


@pytest.mark.parametrize(
    ("quantity", "printed", "reason"),
    [
        ("ms", "14.0", "it was computed with 3 df, but df is 2"),
        ("ms", "42.0", "it is the sum of squares, not divided by df"),
        ("ms", "4.58", "it is the square root of SS / df"),
        ("f", "2.65", "it is the square root of F, that is, t"),
        ("f", "4.667", "it was computed with 3 df, but df is 2"),
        ("f", "7.35", "its residual was divided by 21 df, but df is 20"),
        ("f", "0.70", "it is the ratio of the sums of squares"),
        ("f", "0.412", "the printed F is eta squared"),
        ("f", "2.33", "it was computed with the MS of blocks"),
        ("p", f"{stats.f.sf(7, 2, 20) / 2:.5f}", "it is one-tailed"),
        ("p", f"{stats.f.sf(7, 2, 20) * 2:.5f}", "it is doubled"),
        ("p", f"{stats.f.sf(7, 3, 20):.5f}", "it was computed with 3, 20 df"),
        ("p", f"{stats.f.sf(7, 2, 25):.5f}", "it was computed with 2, 25 df"),
        ("p", f"{stats.f.sf(7, 20, 2):.4f}", "it was computed with 20, 2 df"),
        ("p", "0.9000", ""),
    ],
)
def test_a_mistake_in_an_anova_table_is_named(quantity: str, printed: str, reason: str) -> None:
    """Wrong numbers by hand, P by scipy; each is beside what is right, so that its own line alone is accused."""
    alone: dict[str, str | None] = (
        {"ms": None} if quantity == "f" else {"f": None, "p": None} if quantity == "ms" else {}
    )
    alone |= {"p": None} if quantity == "f" else {}
    (line,) = [one for one in _lines(**alone, **{quantity: printed}) if not one.agrees]
    assert line.quantity == quantity.upper()
    assert reason in line.reason.split("; or ")


def test_an_f_and_a_p_that_follow_what_is_not_printed_beside_them_say_so(approved: SnapshotAssertion) -> None:
    """MS 14.0 is wrong, and F = 21 / 3 right; F 5.00 is wrong, and P that of 7."""
    (f,) = [one for one in _lines(ms="14.0") if one.quantity == "F"]
    (p,) = [one for one in _lines(f="5.00") if one.quantity == "P"]
    assert f.reason == approved
    assert p.reason == approved


def test_a_residual_of_nothing_leaves_an_f_without_end() -> None:
    """0 / 20 = 0, and 21 / 0 has no end; an eta squared of 1 is what it would be printed as."""
    groups = {"name": "groups", "df": 2, "ss": "42.0", "ms": "21.0", "f": "1.00"}
    error = {"name": "error", "df": 20, "ss": "0", "ms": "0"}
    _, f, _ = source_lines(PrintedSources.model_validate({"where": "T", "lines": (groups, error)}))
    assert not f.agrees
    assert "eta squared" in f.reason
