"""The command of the guides that come with palpate, each in the version of the program beside it."""

import re
from pathlib import Path
from typing import Annotated

import typer

from palpate.experiment.cli import options
from palpate.experiment.errors import PalpateError

commands = options.room()

GUIDES = {
    "footsteps": ("palpate/guide/footstep.md", "tutorial: a footstep study in ten minutes"),
    "taps": ("palpate/guide/tapping.md", "tutorial: a tapping study in ten minutes"),
    "stimuli": ("palpate/guide/presented.md", "tutorial: a study of presented stimuli in ten minutes"),
    "questions": ("palpate/guide/questions.md", "24 questions, answered"),
    "limits": ("palpate/guide/limits.md", "what palpate does not do"),
    "coming": ("palpate/guide/coming.md", "coming from PsychoPy, jsPsych or OpenSesame"),
    "devices": ("palpate/guide/devices.md", "your own drivers, and the needs of twelve kinds of devices"),
    "studies": ("protocols/README.md", "protocols, boards, visits, practice: a study step by step"),
    "examples": ("protocols/studies.md", "the questions that the shipped studies answer"),
    "keys": ("protocols/keys.md", "every key of a protocol or rig file"),
    "rigs": ("experiment/apparatus/README.md", "devices: building, wiring, calibrating, your own drivers"),
    "firmware": ("experiment/apparatus/firmware/README.md", "an Arduino as a tracker"),
    "datasets": ("participants/README.md", "datasets, imports, withdrawal, sharing"),
    "analysis": ("analysis/README.md", "tables, power, notebooks"),
    "papers": ("analysis/published/README.md", "auditing printed numbers"),
}
"""For each guide, in the order of a study: its file in the repository, and what it is about."""

ROOT = Path(__file__).parents[2]
"""The checkout, or the package that a wheel installs: with the same folders, but for `protocols` and `palpate`."""


def guide(name: str) -> Path:
    """Return the file of a guide, in a checkout or a wheel. Raises `PalpateError` for an unknown or missing one."""
    if name not in GUIDES:
        raise PalpateError(
            "palpate docs", f"got '{name}'", "run `palpate docs` for the list", allowed=", ".join(GUIDES)
        )
    told, _ = GUIDES[name]
    shipped = told.removeprefix("palpate/").replace("protocols/", "experiment/shipped/")
    for file in (ROOT / told, ROOT / shipped):
        if file.is_file():
            return file
    raise PalpateError(ROOT / told, "the guide was not found", "install palpate again")


@commands.command(epilog="Example: palpate docs rigs")
def docs(
    name: Annotated[str | None, typer.Argument(metavar="[GUIDE]", help="Name of a guide [default: list them].")] = None,
    path: Annotated[
        bool, typer.Option("--path", help="Print the path of the guide's file, for an editor or a browser.")
    ] = False,
) -> None:
    """Show a guide, or list the guides that come with palpate.

    In a terminal, a guide opens in the pager; press q to close it. In a file or a pipe, it is Markdown.
    """
    import sys

    if name is None:
        told = [f"  {one:10}{guide(one) if path else about}" for one, (_, about) in GUIDES.items()]
        options.put("\n".join(told if path else ["Guides (`palpate docs NAME` shows one):", *told]))
        return
    file = guide(name)
    if path:
        options.put(str(file))
        return
    # What the site's links go to is no text of the guide.
    text = re.sub(r"^\{#\w+\}\n", "", file.read_text("utf-8"), flags=re.MULTILINE)
    if not sys.stdout.isatty():
        options.put(text.rstrip())
        return
    from rich.console import Console
    from rich.markdown import Markdown

    console = Console(width=min(Console().width, 100))
    with console.pager():
        console.print(Markdown(text))
