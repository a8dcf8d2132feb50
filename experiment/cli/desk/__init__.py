"""The commands that show: the desk's first page, and the participant's screen with how a session starts it."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from palpate.experiment.cli import options
from palpate.experiment.cli.options import AtConsole, Participant, ProtocolFile, StudyFolder
from palpate.experiment.errors import LinkError, Remedy

commands = options.room()


@commands.command(epilog="Example: palpate desk study.toml --rig our-rig.toml")
def desk(
    study: Annotated[
        Path | None,
        typer.Argument(
            metavar="[STUDY]", help="Protocol file, or folder of a study's dataset [default: the study in this folder]."
        ),
    ] = None,
    rig: Annotated[
        Path | None, typer.Option("--rig", help="Rig file of this laboratory [default: the one in this folder].")
    ] = None,
    dataset: StudyFolder = None,
    by: AtConsole = "console",
    lines: Annotated[bool, typer.Option("--lines", help="Run sessions in a plain-text console.")] = False,
) -> None:
    """Carry out a study's usual steps from one screen.

    The desk lists the available steps: write, check and seal a protocol; choose, calibrate and check a rig; pilot,
    enroll, ask for facts, consent; practice, begin, resume, record incidents, withdraw; amend, suspend; analyze,
    verify and share. Unavailable steps are gray, with the reason and what to do about it. Enter runs the chosen
    command, and the desk returns after it. Concealed orders remain concealed. `palpate` alone opens the desk in an
    empty folder, or one with a protocol.
    """
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        status = ("palpate", "status", str(dataset or study or "STUDY"))
        raise LinkError("the desk needs a terminal", remedy=Remedy("{} prints a study's progress as text", status))
    options.check_terminal("remove the redirection")
    options.at_once("Opening the desk ...")
    from palpate.experiment.cli.desk import home
    from palpate.experiment.cli.desk.place import Place

    if study is not None and study.is_dir():
        home.show_status(study, refuses="To start sessions here, open the desk with the study's protocol file.")
        return
    here = Place.here()
    session = ("--by", by, *(("--lines",) if lines else ()))
    home.stay(replace(here, protocol=study or here.protocol, rig=rig or here.rig, dataset=dataset, session=session))


@commands.command(epilog="Example: palpate screen study.toml --participant 01 --rig our-rig.toml")
def screen(
    protocol_file: ProtocolFile,
    participant: Participant = "01",
    rig: Annotated[
        Path | None, typer.Option("--rig", help="Rig file with a [screen] table [default: a full screen].")
    ] = None,
    dataset: StudyFolder = None,
    practice: Annotated[
        bool, typer.Option("--practice", help="For a practice session (`palpate run --practice`).")
    ] = False,
    session_at: Annotated[Path | None, typer.Option("--session-at", hidden=True, help="Socket of the session.")] = None,
) -> None:
    """Open the participant's screen for a session.

    `palpate run` opens it if the rig file has a [screen] table; this command opens it again, or before the session
    begins. It shows instructions, when to step and when to answer, breaks, and the choice of the masker's level. It
    never receives what is presented. The session continues without it.

    Close it with Ctrl-C or its window; otherwise it closes one minute after the session has ended. It needs
    PsychoPy, which palpate[lab] installs.
    """
    options.at_once("Opening the participant's screen; this takes a few seconds.")
    from palpate.experiment.apparatus import rig as rigs
    from palpate.experiment.apparatus.display import ScreenRig
    from palpate.experiment.desk import screen as screens
    from palpate.experiment.desk.console import transport
    from palpate.experiment.protocol import files

    settings = (rigs.load(rig).screen if rig else None) or ScreenRig()
    protocol = files.load(protocol_file)
    folder = dataset or options.default_folder(protocol_file, practice=practice)
    path = session_at or transport.place(folder, participant)
    screens.show(
        path,
        settings,
        rig.parent if rig else Path(),
        tell=lambda line: typer.echo(line, err=True),
        stays=session_at is None,
        pictures=files.pictures(protocol),
    )


@contextmanager
def screen_beside(path: Path, protocol_file: Path, rig: Path | None) -> Iterator[bool]:
    """Open the participant's screen of the session at `path` in a process of its own, if the rig has one; yield that.

    It ends by itself after a session that ended well; after a fault it is ended, so that it covers no screen. What it
    says stands beside the socket. Raises `RigError`.
    """
    from palpate.experiment.apparatus import rig as rigs

    if rig is None or rigs.load(rig).screen is None:
        yield False
        return
    command = options.palpate_command("screen", str(protocol_file), "--rig", str(rig), "--session-at", str(path))
    with path.with_suffix(".screen.log").open("wb") as log:
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)  # noqa: S603
    try:
        yield True
    except BaseException:
        process.kill()
        process.wait()
        raise
    process.poll()
