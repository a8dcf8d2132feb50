"""The desk from its first page to its last: shows what can be done, does it, and comes back."""

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import typer

from palpate.experiment import storage
from palpate.experiment.cli import options
from palpate.experiment.cli.analysis import status_of
from palpate.experiment.cli.desk.place import Place
from palpate.experiment.cli.protocol import a_rig, free_for_a_rig
from palpate.experiment.desk.console.home import Chosen, HomePage, Scene
from palpate.experiment.desk.console.study import StudyPage
from palpate.experiment.desk.terminal import typed_ahead
from palpate.experiment.errors import PalpateError
from palpate.experiment.findings import shown

PRACTICE = "This is PRACTICE, not a study. To continue it, choose 'practice' at the desk."

PAGED = ("check", "analyse", "verify")
"""What may print more than a screen."""

PAGER = {"LESS": "-RPsSpace = next page, b = previous page, q = back to the desk"}


def stay(place: Place) -> None:
    """Show what can be done at a place, and do what is chosen, until the desk is left."""
    said = ""
    while (chosen := HomePage(partial(_scene, place), said).run()) is not None:
        place, said = carry_out(place, chosen)
        # Whoever leans on Enter chooses nothing.
        typed_ahead(sys.stdin)


def _scene(place: Place) -> Scene:
    # Loaded while the page is shown.
    from palpate.experiment.cli.desk.deeds import scene

    return scene(place)


def carry_out(place: Place, chosen: Chosen) -> tuple[Place, str]:
    """Do what was chosen; return where the desk then stands, and what it says."""
    match chosen.name:
        case "rig":
            _, rig, *recordings = chosen.arguments
            return _take_rig(place, Path(rig), Path(recordings[0]) if recordings else None)
        case "open":
            return replace(place, protocol=Path(chosen.arguments[1]), dataset=None), ""
        case "pilot":
            dataset = next(map(Path, chosen.arguments[1:]), None)
            return replace(place, dataset=dataset), ""
        case "status":
            _show_participants(place, Path(chosen.arguments[2]))
            return place, ""
    ended = _run_paged(chosen.arguments) if chosen.name in PAGED else _run(chosen.arguments)
    if chosen.name == "new" and ended == 0:
        here = Place.here()
        place = replace(place, protocol=here.protocol, rig=place.rig or here.rig, dataset=None)
    return place, ""


def _run(command: tuple[str, ...]) -> int:
    """Run a command in a process of its own, which has the terminal until it ends; return its exit code."""
    typer.echo(f"$ {shown(command)}")
    program, *arguments = command
    started = options.palpate_command(*arguments) if program == "palpate" else command
    with _interrupted_alone():
        ended = subprocess.run(started, check=False).returncode  # noqa: S603
    _wait()
    return ended


@contextmanager
def _interrupted_alone() -> Iterator[None]:
    """Leave Ctrl-C to the process that is run meanwhile: a session pauses, and the desk comes back after it."""
    # Unlike SIG_IGN, a handler is not inherited.
    before = signal.signal(signal.SIGINT, lambda *_: None)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _run_paged(command: tuple[str, ...]) -> int:
    """Run a command, and show what it prints page by page where that is more than the terminal shows."""
    typer.echo(f"$ {shown(command)}")
    pager = shutil.which("less")
    with _interrupted_alone():
        ended = subprocess.run(options.palpate_command(*command[1:]), stdout=subprocess.PIPE, check=False)  # noqa: S603
        paged = pager and ended.stdout.count(b"\n") > shutil.get_terminal_size().lines - 3
        if pager and paged:
            subprocess.run([pager], input=ended.stdout, env=os.environ | PAGER, check=False)  # noqa: S603
    if not paged:
        typer.echo(ended.stdout)
        _wait()
    return ended.returncode


def _wait() -> None:
    # Ctrl-C there goes back as well.
    with suppress(typer.Abort):
        typer.prompt("Press Enter to return to the desk", default="", show_default=False, prompt_suffix=". ")


def _take_rig(place: Place, rig: Path, recordings: Path | None) -> tuple[Place, str]:
    """Take a rig file, or write one to begin from where none is."""
    said = f"Rig: {rig}."
    if not rig.exists():
        try:
            storage.write(free_for_a_rig(rig), a_rig(rig).encode())
        except PalpateError as error:
            return place, error.sentence()
        said = f"Written: {rig}. Next, calibrate it (see `palpate docs rigs`)."
    return replace(place, rig=rig, recordings=recordings), said


def _show_participants(place: Place, root: Path) -> None:
    """Show a study's participants, and run the visit of each who is chosen, where nothing prevents that."""
    from palpate.experiment.cli.desk.study import Study

    study = Study(place, place.protocol or root)
    refused = study.unsealed + study.unusable
    why = refused[0].sentence() if refused else "" if study.status else PRACTICE
    while (label := show_status(root, refuses=why)) is not None:
        _run(("palpate", *study.run, "--participant", label))


def show_status(root: Path, *, refuses: str) -> str | None:
    """Show who is done, under way and due, until somebody is chosen for a session, or nobody; return their label."""
    return StudyPage(lambda: status_of(root), refuses=refuses).run()
