"""What `palpate power` prints and writes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from analysis import documents
from analysis.output import publish
from analysis.power import LABEL, Power
from analysis.power_sections import sections
from analysis.tables import WIDTH
from analysis.tables import text as in_terminal
from analysis.workers import software


def text(result: Power, width: int = WIDTH) -> str:
    """Everything for a terminal; what is needed stands last."""
    parts = sorted(sections(result), key=lambda section: section.slug == "needed")
    shown = [in_terminal(section, width) for section in parts if section.slug != "control"]
    return "\n\n\n".join([LABEL, *shown, LABEL])


def as_dict(result: Power) -> dict[str, Any]:
    """Every number, for JSON: None where something is not defined."""
    return {
        "label": LABEL,
        "study": result.study,
        "model": result.model.source,
        "notes": list(result.notes),
        "participants": list(result.participants),
        "studies": result.studies,
        "seed": result.seed,
        "target": result.target,
        "software": software(),
        **{f"{section.slug}_rows": [dict(record) for record in section.records] for section in sections(result)},
    }


def write(result: Power, out: Path) -> tuple[Path, ...]:
    """Write tables (CSV, Markdown, LaTeX) and the plot (PNG, SVG) into a folder.

    Returns:
        The files.

    Raises:
        DatasetError: a folder within a dataset, a file in the way, or the file system refuses.
    """
    from analysis import power_figures

    files = documents.tables(sections(result), LABEL) | documents.drawings([power_figures.plot(result)])
    return publish(out, files, LABEL, "power")
