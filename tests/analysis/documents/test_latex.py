"""LaTeX tables: every character stands for itself, environments close, and rows have as many cells as columns."""

from __future__ import annotations

import re

from hypothesis import given
from hypothesis import strategies as st

from palpate.analysis.documents.tables import SPECIAL, Section, Table, escaped, latex

TABLE = Table("a_b & 50 %", ("what", "η²"), (("x -> y", "0.5 ± 0.1"), ("{z}", "<1")), notes=("Note #1.",))


def test_a_table_is_an_environment_that_closes() -> None:
    text = latex(Section("slug", "Title", tables=(TABLE, TABLE)), "REHEARSAL")
    for name in ("table", "tabular"):
        assert text.count(rf"\begin{{{name}}}") == text.count(rf"\end{{{name}}}") == 2
    assert text.count(r"\caption{REHEARSAL. a\_b \& 50 \%}") == 2
    assert r"x $\to$ y & 0.5 $\pm$ 0.1 \\" in text
    assert r"\par\small Note \#1." in text
    assert text.startswith("% Title\n% REHEARSAL\n")


def test_rows_have_as_many_cells_as_the_tabular_has_columns() -> None:
    text = latex(Section("slug", "Title", tables=(TABLE,)), "")
    for row in re.findall(r"(.*) \\\\\n", text):
        assert len(re.split(r"(?<!\\)&", row)) == 2


@given(st.text(alphabet=st.characters(codec="ascii", exclude_categories=["Cc"])))
def test_no_special_character_is_left_bare(text: str) -> None:
    bare = escaped(text)
    for replacement in sorted(SPECIAL.values(), key=len, reverse=True):
        bare = bare.replace(replacement, "")
    assert not set(bare) & set("\\&%$#_{}~^")
