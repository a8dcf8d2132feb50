"""The site: `python -m tests.site [FOLDER]` builds it from guides, docstrings and pictures, without a network.

Sphinx reads the guides where they are, so a link between two files of the repository is one of the site too. A link or
an anchor that leads nowhere fails the build. Needs the extra `site`.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from palpate import __version__
from palpate.experiment.cli import COMMANDS, docs
from tests.figures import PAGES
from tests.measures.source import FOLDERS, REPOSITORY, tracked_files

if TYPE_CHECKING:
    from sphinx.application import Sphinx

OUT = REPOSITORY / "build" / "site"

OTHERS = (
    "README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "experiment/README.md",
    "experiment/decisions.md",
    "tests/README.md",
    "tests/faults/README.md",
)
"""What only developers read: `palpate docs` has the rest."""

SETTINGS = {
    "project": "palpate",
    "html_title": f"palpate {__version__}",
    "root_doc": f"{PAGES}/index",
    "include_patterns": [f"{PAGES}/*.md", *OTHERS, *(file for file, _ in docs.GUIDES.values())],
    "extensions": ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"],
    "myst_heading_anchors": 4,
    "myst_enable_extensions": ["attrs_inline", "attrs_block"],
    "default_role": "code",
    "autodoc_typehints": "none",
    "html_theme": "furo",
    "html_copy_source": False,
    "html_show_sphinx": False,
    "html_static_path": [],
    "smartquotes": False,
}

INDEX = f'<!doctype html><meta charset="utf-8"><meta http-equiv="refresh" content="0; url={PAGES}/index.html">\n'


def build(out: Path, root: Path = REPOSITORY) -> None:
    """Build the site of a checkout into a folder. Raises `SystemExit` where a link, anchor or picture is missing."""
    from sphinx.application import Sphinx

    app = Sphinx(
        root,
        None,
        out,
        out.with_name(f"{out.name}.doctrees"),
        "html",
        confoverrides=SETTINGS,
        status=None,
        freshenv=True,
        warningiserror=True,
    )
    app.connect("source-read", _fill)
    app.build()
    if app.statuscode:
        raise SystemExit(app.statuscode)
    (out / "index.html").write_text(INDEX, "utf-8")


def _fill(app: Sphinx, page: str, source: list[str]) -> None:
    """Put what is written from the program into the page that asks for it."""
    lists = {"commands": _commands, "modules": _modules}
    source[0] = re.sub(r"^<!-- (commands|modules) -->$", lambda m: "\n".join(lists[m[1]]()), source[0], flags=re.M)


def _commands() -> Iterator[str]:
    """Yield the help of every command, in the order of the overview."""
    from typer.main import get_command

    from palpate.experiment.cli.app import app

    group = get_command(app)
    for part, names in COMMANDS.items():
        yield f"## {part}\n"
        for name in names:
            command = group.commands[name]  # type: ignore[attr-defined]
            yield f"### palpate {name}\n\n```text\n{command.help}\n\n{command.epilog}\n```\n"


def _modules() -> Iterator[str]:
    """Yield every module with the first sentence of its docstring, by room."""
    room = ""
    for file in sorted(tracked_files(*FOLDERS), key=lambda path: (path.parent, path.name)):
        if file.suffix != ".py":
            continue
        if str(file.parent) != room:
            room = str(file.parent)
            yield f"\n## {room}\n"
        text = ast.get_docstring(ast.parse((REPOSITORY / file).read_text("utf-8"))) or ""
        yield f"- `{file.name}`: {' '.join(text.split(chr(10) * 2)[0].split())}"


if __name__ == "__main__":
    build(Path(sys.argv[1]).resolve() if sys.argv[1:] else OUT)
