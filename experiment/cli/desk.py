"""The commands that show: the desk's first page, and the participant's screen with how a session starts it."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from palpate.experiment.cli import options
from palpate.experiment.cli.options import AtConsole, Participant, ProtocolFile, StudyFolder
from palpate.experiment.errors import LinkError, Remedy

commands = options.room()


@commands.command(epilog="Example: palpate desk study.toml --rig our-rig.toml")
def desk(
    study: options.StudyPlace,
    rig: Annotated[
        Path | None, typer.Option("--rig", help="Rig file of this laboratory, for the sessions that are begun here.")
    ] = None,
    dataset: StudyFolder = None,
    by: AtConsole = "console",
) -> None:
    """Open the desk of a study, from which sessions are begun.

    It shows who is done, under way and due, what comes next, and what is to be done. With the study's protocol file
    and --rig, Enter begins or resumes the session of the participant who is chosen, and the desk comes back after it.
    Without them the page only shows. What is concealed stays so.
    """
    from palpate.experiment.cli.analysis import status_of
    from palpate.experiment.desk.console.study import StudyPage

    place = dataset or study
    status = ("palpate", "status", str(place))
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise LinkError("the desk needs a terminal", remedy=Remedy("{} prints the same as lines of text", status))
    options.check_terminal(Remedy("leave the redirection out, or print the same as lines of text", status))
    refuses = (
        "To begin sessions here, open the desk with the study's protocol file and --rig."
        if rig is None or not study.is_file()
        else ""
    )
    if status_of(place).purpose == "PRACTICE":
        refuses = "This is PRACTICE, and no study yet. palpate run PROTOCOL --practice goes on with it."
    while (label := StudyPage(lambda: status_of(place), refuses=refuses).run()) is not None:
        run = ["run", str(study), "--participant", label, "--rig", str(rig), "--by", by]
        run += ["--dataset", str(dataset)] if dataset else []
        ended = subprocess.run(options.palpate_command(*run), check=False)  # noqa: S603
        if ended.returncode:
            typer.prompt("Enter goes back to the study", default="", show_default=False, prompt_suffix=". ")


@commands.command(epilog="Example: palpate screen study.toml --participant 01 --rig our-rig.toml")
def screen(
    protocol_file: ProtocolFile,
    participant: Participant = "01",
    rig: Annotated[
        Path | None, typer.Option("--rig", help="Rig file, whose table [screen] is used [default: a full screen].")
    ] = None,
    dataset: StudyFolder = None,
    practice: Annotated[bool, typer.Option("--practice", help="Of a session of `palpate run --practice`.")] = False,
    session_at: Annotated[Path | None, typer.Option("--session-at", hidden=True, help="Socket of the session.")] = None,
) -> None:
    """Open the participant's screen of a session.

    `palpate run` opens it where the rig file has a table [screen]; this command opens it again, or before the session
    begins. It shows instructions, when to step and when to answer, breaks, and the choice of the masker's level. What
    is presented never reaches it. The session goes on without it.

    It is closed by Ctrl-C, with its window, or by itself a minute after the session has ended. It needs PsychoPy, which
    palpate[lab] installs.
    """
    options.at_once("The participant's screen opens; that takes some seconds.")
    from palpate.experiment.apparatus import rig as rigs
    from palpate.experiment.apparatus.display import ScreenRig
    from palpate.experiment.desk import screen as screens
    from palpate.experiment.desk.console import transport
    from palpate.experiment.protocol import files

    settings = (rigs.load(rig).screen if rig else None) or ScreenRig()
    folder = dataset or options.default_folder(files.load(protocol_file), practice=practice)
    path = session_at or transport.place(folder, participant)
    screens.show(
        path,
        settings,
        rig.parent if rig else Path(),
        tell=lambda line: typer.echo(line, err=True),
        stays=session_at is None,
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
