"""The command that shows a session on the participant's screen, and how a session starts it."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from experiment.cli import options
from experiment.cli.options import Participant, ProtocolFile, StudyFolder

commands = options.room()


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
    from experiment.apparatus import rig as rigs
    from experiment.apparatus.display import ScreenRig
    from experiment.desk import link
    from experiment.desk import screen as screens
    from experiment.protocol import files

    settings = (rigs.load(rig).screen if rig else None) or ScreenRig()
    folder = dataset or options.default_folder(files.load(protocol_file), practice=practice)
    path = session_at or link.place(folder, participant)
    screens.show(path, settings, rig.parent if rig else Path(), tell=lambda line: typer.echo(line, err=True))


@contextmanager
def beside(path: Path, protocol_file: Path, rig: Path | None) -> Iterator[bool]:
    """Open the participant's screen of the session at `path` in a process of its own, if the rig has one; yield that.

    Nobody waits for it, and it ends by itself. What it says stands beside the socket. Raises `RigError`.
    """
    from experiment.apparatus import rig as rigs

    if rig is None or rigs.load(rig).screen is None:
        yield False
        return
    command = [sys.executable, "-m", "experiment", "screen", str(protocol_file), "--rig", str(rig)]
    with path.with_suffix(".screen.log").open("wb") as log:
        process = subprocess.Popen(  # noqa: S603
            [*command, "--session-at", str(path)], stdin=subprocess.DEVNULL, stdout=log, stderr=log
        )
    yield True
    process.poll()
