r"""A section as LaTeX: one `table` environment a table, for `\input` into a paper; needs the package booktabs."""

from __future__ import annotations

from analysis.tables import Section, Table

SPECIAL = {
    "\\": r"\textbackslash{}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "±": r"$\pm$",
    "²": r"$^2$",
    "η": r"$\eta$",
    "√": r"$\surd$",
    "→": r"$\to$",
    "<": r"$<$",
    ">": r"$>$",
    "|": r"$|$",
}


def latex(section: Section, label: str) -> str:
    """The section's tables, each with the dataset's label in its caption; `label` is empty for a study's own data."""
    parts = [f"% {section.title}", *([f"% {label}"] if label else [])]
    return "\n".join([*parts, *(_table(table, section.title, label) for table in section.tables)]) + "\n"


def escaped(text: str) -> str:
    """Text in which every character stands for itself."""
    return "".join(SPECIAL.get(character, character) for character in text.replace("->", "→"))


def _table(table: Table, title: str, label: str) -> str:
    columns = "".join("l" if column in table.left else "r" for column in range(len(table.header)))
    caption = ". ".join(part for part in (label, table.title or title) if part)
    lines = [
        "",
        r"\begin{table}",
        rf"\caption{{{escaped(caption)}}}",
        rf"\begin{{tabular}}{{{columns}}}",
        r"\toprule",
        _row(table.header),
        r"\midrule",
        *map(_row, table.rows),
        r"\bottomrule",
        r"\end{tabular}",
    ]
    notes = [rf"\par\small {escaped(note)}" for note in table.notes]
    return "\n".join([*lines, *notes, r"\end{table}"])


def _row(cells: tuple[str, ...]) -> str:
    return " & ".join(map(escaped, cells)) + r" \\"
