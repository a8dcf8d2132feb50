"""The report, one HTML file that needs no other and can be read on a desk and on a phone, and the folder it is in."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import nullcontext
from functools import partial
from html import escape
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

from palpate.analysis.documents.tables import Asked, Section, Table, comma_separated, latex, markdown
from palpate.analysis.forked import forked
from palpate.experiment.records import software

if TYPE_CHECKING:
    from palpate.analysis.documents.drawing import Sheet

COLUMN_POINTS = 300.0
"""A figure wider than this takes the whole width of the page."""

REPORT, METHODS = "report.html", "methods.html"

ON_METHODS = "Methods and further tables"
"""The part whose sections are on the page of methods, with the formulas."""

FORMAT = 5
"""The format of a folder of results: its `results.json` and the columns of its tables."""

Methods = Sequence[tuple[str, str]]
"""Names and formulas, in the order of the report."""


def folder(
    title: str,
    label: str,
    sections: Sequence[Section],
    sheets: Sequence[Sheet],
    methods: Methods,
    numbers: Mapping[str, Any],
    *,
    further: Sequence[Section] = (),
    pictures: bool = True,
    source: str = "",
) -> dict[str, bytes]:
    """Return a folder of results, path -> content: figures, tables, every number as JSON, and the report.

    `label` and `source`, the paper below the title, may be empty; `pictures` adds PNG. Numbers must be finite.
    `further` sections have tables, but no part in the report.
    """
    files = drawings(sheets, "figures/", pictures=pictures) if sheets else {}
    files |= tables((*sections, *further), label, "tables/")
    ours = software.this()
    made_by = f"palpate {ours.version}, source {ours.source_sha256[:12]}"
    about = {"format": FORMAT, "made_by": {"palpate": ours.version, "source_sha256": ours.source_sha256}}
    numbers = {**about, **numbers}
    # Indented throughout, those of a million trials would take a minute.
    written = partial(json.dumps, allow_nan=False, ensure_ascii=False)
    lines = ",\n".join(f"{json.dumps(key)}: {written(one)}" for key, one in numbers.items())
    files["results.json"] = f"{{\n{lines}\n}}\n".encode()
    band = f'<div class="band" role="note">{escape(label)}</div>' if label else ""
    paper = f'<p class="source">{escape(source)}</p>' if source else ""
    headed = f"{label}: {title}" if label else title
    numbered = _numbered(sections, sheets)
    style = Path(__file__).with_suffix(".css").read_text("utf-8")

    def page(name: str, body: str) -> bytes:
        return (
            '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width, initial-scale=1">'
            f"<title>{escape(f'{headed}: {name}' if name else headed)}</title><style>\n{style}</style></head>\n"
            f"<body>{band}<main><h1>{escape(title)}</h1>{paper}{body}"
            f"<footer><p>{escape(label)}</p><p>{made_by}</p></footer></main>{band}</body></html>\n"
        ).encode()

    shown = [section for section in sections[1:] if section.part != ON_METHODS]
    further_on = [section for section in sections[1:] if section.part == ON_METHODS]
    first = _section(sections[0], label, numbered, files)
    heading = f"<h2>{escape(sections[0].title)}</h2>"
    opening = f'<section id="{sections[0].slug}" class="first">{heading}{first}</section>'
    report = f'{opening}<p><a href="{METHODS}">{ON_METHODS}</a></p>{_parts(shown, label, numbered, files)}'
    formulas = "".join(f"<dt>{escape(name)}</dt><dd>{escape(formula)}</dd>" for name, formula in methods)
    apart = (
        f'<h2>{ON_METHODS}</h2><p><a href="{REPORT}">Report</a></p>'
        f"{''.join(_folded(section, label, numbered, files) for section in further_on)}"
        f'<section id="methods"><h2>Formulas</h2><dl>{formulas}</dl></section>'
    )
    return {**files, REPORT: page("", report), METHODS: page(ON_METHODS, apart)}


def _parts(
    sections: Sequence[Section], label: str, sheets: Sequence[tuple[int, Sheet]], files: Mapping[str, bytes]
) -> str:
    """Return folded sections, those of one part below its name."""
    parts = []
    for part, of in groupby(sections, key=lambda section: section.part):
        parts += [f'<h2 class="part">{escape(part)}</h2>'] if part else []
        parts += [_folded(section, label, sheets, files) for section in of]
    return "".join(parts)


def _folded(section: Section, label: str, sheets: Sequence[tuple[int, Sheet]], files: Mapping[str, bytes]) -> str:
    heading = f"<h3>{escape(section.title)}</h3>"
    shown = _section(section, label, sheets, files)
    return f'<details class="part" id="{section.slug}"><summary>{heading}</summary>{shown}</details>\n'


def _numbered(sections: Sequence[Section], sheets: Sequence[Sheet]) -> list[tuple[int, Sheet]]:
    """Return the figures of the sections, numbered in the order in which the report shows them."""
    shown = [one for section in sections for one in sheets if one.section == section.slug]
    return list(enumerate(shown, start=1))


def _section(section: Section, label: str, sheets: Sequence[tuple[int, Sheet]], files: Mapping[str, bytes]) -> str:
    parts = []
    if section.asked:
        parts.append(f'<dl class="asked">{"".join(map(_answer_html, section.asked))}</dl>')
    if section.paragraphs:
        said = "".join(f"<p>{escape(paragraph)}</p>" for paragraph in section.paragraphs)
        parts.append(f'<div class="said">{said}</div>')
    here = [
        _figure(number, one, label, files[f"figures/{one.name}.svg"])
        for number, one in sheets
        if one.section == section.slug
    ]
    parts += [f'<div class="figures">{"".join(here)}</div>'] if here else []
    shown = [_table(table) for table in section.tables]
    if section.folded:
        parts += [*map(_table, section.brief), f"<details><summary>All rows</summary>{''.join(shown)}</details>"]
    else:
        parts += shown
    parts += [f"<p>{escape(paragraph)}</p>" for paragraph in section.aside]
    return "".join(parts)


def _answer_html(one: Asked) -> str:
    standing = f' <span class="standing">{escape(one.standing)}</span>' if one.standing else ""
    warnings = "".join(f'<dd class="warning">{escape(warning)}</dd>' for warning in one.warnings)
    return f"<dt>{escape(one.question)}{standing}</dt><dd>{escape(one.answer)}</dd>{warnings}"


def _figure(number: int, one: Sheet, label: str, svg: bytes) -> str:
    text = svg.decode("utf-8")
    drawing = text[text.index("<svg") :]
    width = re.search(r'width="([0-9.]+)pt"', drawing)
    points = float(width.group(1)) if width else 480.0
    drawing = re.sub(r"<metadata>.*?</metadata>", "", drawing, count=1, flags=re.DOTALL)
    drawing = re.sub(r'(\bid="|xlink:href="#|url\(#)', rf"\g<1>{one.name}-", drawing)
    style = f"width:100%;max-width:{2 * points:.0f}px;min-width:{1.3 * points:.0f}px"
    described = escape(". ".join(part for part in (f"Figure {number}", label, one.caption) if part))
    drawing = drawing.replace("<svg ", f'<svg role="img" aria-label="{described}" style="{style}" ', 1)
    kind = ' class="wide"' if points > COLUMN_POINTS else ""
    box = f'<div class="scroll" tabindex="0" role="region" aria-label="Figure {one.name}">{drawing}</div>'
    return f"<figure{kind}>{box}<figcaption>{described}</figcaption></figure>"


def _table(table: Table) -> str:
    head = "".join(
        f'<th scope="col"{_class(column, table)}>{escape(name)}</th>' for column, name in enumerate(table.header)
    )
    rows = []
    for index, row in enumerate(table.rows):
        cells = [f'<th scope="row"{_class(0, table, row[0])}>{_text(row[0])}</th>']
        cells += [
            f"<td{_class(column, table, cell, marked=(index, column) in table.marked)}>{_text(cell)}</td>"
            for column, cell in enumerate(row[1:], start=1)
        ]
        rows.append(f"<tr>{''.join(cells)}</tr>")
    standing = f'<span class="standing">{escape(table.standing)}</span>' if table.standing else ""
    title = f'<p class="caption">{escape(table.title)} {standing}</p>' if table.heading else ""
    name = escape(table.title or "table")
    notes = "".join(f'<p class="note">{escape(note)}</p>' for note in table.notes)
    body = (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{name}"><table><thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table></div>"
        if table.rows
        else ""
    )
    return f"{title}{body}{notes}"


def _text(cell: str) -> str:
    return escape(cell.replace("->", "→"))


def _class(column: int, table: Table, cell: str = "", *, marked: bool = False) -> str:
    names = ["left"] * (column in table.left) + ["wrap"] * (len(cell) > 40) + ["marked"] * marked
    return f' class="{" ".join(names)}"' if names else ""


def tables(parts: Iterable[Section], label: str, folder: str = "") -> dict[str, bytes]:
    """Return each section's records as CSV, its text as Markdown and its tables as LaTeX, if it has them, by name."""
    files: dict[str, str] = {}
    for part in parts:
        name = f"{folder}{part.slug}"
        if part.records:
            files[f"{name}.csv"] = comma_separated(part, label)
        if part.tables or part.paragraphs:
            files[f"{name}.md"] = markdown(part, label)
        if part.tables:
            files[f"{name}.tex"] = latex(part, label)
    return {name: content.encode() for name, content in files.items()}


def drawings(sheets: Iterable[Sheet], folder: str = "", *, pictures: bool = True) -> dict[str, bytes]:
    """Return every figure as SVG, and where there are `pictures` as PNG too, by name; a fork draws half of them."""
    from palpate.analysis.documents import drawing

    kinds = {"svg": drawing.svg, **({"png": drawing.png} if pictures else {})}

    def drawn(some: Iterable[Sheet]) -> dict[str, bytes]:
        return {f"{folder}{one.name}.{kind}": draw(one.figure) for one in some for kind, draw in kinds.items()}

    every = list(sheets)
    with forked(partial(drawn, every[1::2])) if every[1:] else nullcontext(dict) as other:
        found = drawn(every[::2])
        found |= other()
    return {f"{folder}{one.name}.{kind}": found[f"{folder}{one.name}.{kind}"] for one in every for kind in kinds}
