"""The command that runs a session: on lines of text, or in a process of its own with a console beside it."""

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated

import typer

from palpate.experiment.cli import options
from palpate.experiment.cli.options import AtConsole, ProtocolFile, StudyFolder
from palpate.experiment.errors import LinkError, PalpateError, PauseAsked, SessionError

if TYPE_CHECKING:
    from palpate.experiment.desk.link.wire import View
    from palpate.experiment.desk.linked import LinkedConsole
    from palpate.experiment.desk.questions import Console
    from palpate.experiment.protocol.models import Protocol
    from palpate.experiment.records.entries import Footer

commands = options.room()

BEGINS_S = 30.0
"""A session's process listens, or has ended, within this time, s."""


@commands.command(epilog="Example: palpate run study.toml --participant 01 --rig our-rig.toml")
def run(
    protocol_file: ProtocolFile,
    participant: Annotated[
        str | None, typer.Option("--participant", "-p", help="Participant's label, such as 03.")
    ] = None,
    task: Annotated[
        str | None, typer.Option("--task", help="Id of one of the participant's tasks [default: all remaining tasks].")
    ] = None,
    rig: Annotated[Path | None, typer.Option("--rig", help="Rig file of this laboratory.")] = None,
    recordings: Annotated[
        Path | None,
        typer.Option("--recordings", help="Folder of recordings [default: stimuli/recordings in the dataset]."),
    ] = None,
    dataset: StudyFolder = None,
    practice: Annotated[
        bool,
        typer.Option(
            "--practice",
            help="Practice with a simulated laboratory and participant; only the protocol is needed [default folder: "
            "participants/practice-STUDY].",
        ),
    ] = False,
    repetitions: Annotated[
        int | None,
        typer.Option(
            "--repetitions",
            min=1,
            help="With --practice: number of times to present each stimulus or pair, rounded up to what the design "
            "allows.",
        ),
    ] = None,
    lines: Annotated[
        bool,
        typer.Option("--lines", help="Use a plain-text console [default: a full-screen console in a terminal]."),
    ] = False,
    by: AtConsole = "console",
    serve: Annotated[
        str | None,
        typer.Option(
            "--serve",
            metavar="ADDRESS",
            help="Open the console in a browser instead, at this address of the computer (127.0.0.1 is reachable only "
            "from this computer).",
        ),
    ] = None,
    port: Annotated[int, typer.Option("--port", min=1, max=65535, help="Port of the browser page.")] = 8000,
    served: Annotated[bool, typer.Option("--served", hidden=True, help="Show the console to a browser.")] = False,
    session_at: Annotated[
        Path | None,
        typer.Option("--session-at", hidden=True, help="Run the session alone, for consoles that connect here."),
    ] = None,
) -> None:
    """Run or resume a participant's visit.

    The visit consists of the tasks in their order, one session each, with the break between them. The protocol must
    be sealed and the participant enrolled. Ctrl-C pauses the session, and the same command continues it. If the rig
    file requires zeroing the tracker, the participant first rests their foot on the panel.

    In a terminal, the session is a separate process, and this command is its console. If you leave or lose the
    console, run the same command to return to the session.

    With --practice, a simulated participant steps and says an answer, and you press the keys. Practice needs no seal
    or enrollment, and its files never count in a study.
    """
    at_console = not lines and session_at is None and options.at_terminal(draws=not served and serve is None)
    if session_at is None and not served and serve is None:
        options.at_once(f"Opening the {'PRACTICE session, with a simulated laboratory' if practice else 'session'} ...")
    from palpate.experiment.protocol import files
    from palpate.experiment.session import answering
    from palpate.experiment.session.visit import ending_words

    if practice and recordings is not None:
        raise SessionError(
            "got --recordings with --practice", remedy="practice simulates recordings", allowed="one of them"
        )
    if not practice and (participant is None or rig is None):
        raise SessionError(
            "--participant or --rig is missing",
            remedy="give both, or practice without a laboratory (--practice)",
            allowed="both, for a session with a participant",
        )
    protocol = files.load(protocol_file)
    folder, who = _folder(protocol_file, dataset, repetitions, practice=practice), participant or "01"
    named = {"--rig": rig, "--recordings": recordings, "--task": task, "--by": by, "--serve": serve, "--port": port}
    given = (*_stated(named), *["--lines"] * lines)

    def once(console: "Console") -> "Footer":
        if practice or rig is None:
            from palpate.experiment.rehearsal import study

            return study.practice(
                protocol_file=protocol_file,
                repetitions=repetitions,
                rig_file=rig or study.simulated_rig(protocol),
                participant=who,
                task_id=task,
                out=folder,
                console=console,
            )
        from palpate.experiment.session import run as visits

        return visits.run(
            protocol_file=protocol_file,
            rig_file=rig,
            participant=who,
            task_id=task,
            root=dataset,
            recordings=recordings,
            console=console,
            given=given,
        )

    if session_at is not None:
        from palpate.experiment.cli import desk
        from palpate.experiment.desk import prompts
        from palpate.experiment.desk.linked import LinkedConsole

        view = _first_view(protocol, who, folder, practice=practice)
        with desk.screen_beside(session_at, protocol_file, rig) as opened:
            linked = LinkedConsole(view, answers=prompts.shown_answers(protocol), screen=opened)
            _listen(session_at, linked, once, last=task is None)
    elif served:
        threading.Thread(target=_end_with, args=(os.getppid(),), name="server", daemon=True).start()
        _attend(folder, who, by)
    elif serve is not None:
        from palpate.experiment.desk.console import transport

        transport.place(folder, who)
        _serve(serve, port)
    elif not at_console:
        answering.check_lines(protocol)
        from palpate.experiment.desk.terminal import TerminalConsole, typed_ahead

        heading = "PRACTICE" if practice else f"Participant {participant}."
        console = TerminalConsole(write=sys.stdout, ask=input, heading=heading, early=lambda: typed_ahead(sys.stdin))
        options.say(ending_words(once(console), last=task is None))
    else:
        _attend(folder, who, by)


def _stated(named: Mapping[str, object]) -> Iterator[str]:
    """Yield options with their values, as words of a command, but for those that are as without them."""
    for option, value in named.items():
        if value not in (None, {"--by": "console", "--port": 8000}.get(option)):
            yield from (option, str(value))


def _folder(protocol_file: Path, dataset: Path | None, repetitions: int | None, *, practice: bool) -> Path:
    """Return where a session's dataset stands. Raises `SessionError` for a study with fewer repetitions."""
    if repetitions and not practice:
        raise SessionError("got --repetitions", remedy="leave it out", allowed="--repetitions only with --practice")
    return dataset or options.default_folder(protocol_file, practice=practice, repetitions=repetitions)


def _first_view(protocol: "Protocol", participant: str, folder: Path, *, practice: bool) -> "View":
    from palpate.experiment import storage
    from palpate.experiment.desk.link.wire import View
    from palpate.experiment.protocol.kinds import kind_of
    from palpate.experiment.study import enrolment

    label = "PRACTICE" if practice else ""
    if not practice and storage.seed_path(folder).exists() and enrolment.purpose_of(folder) == "PILOT":
        label = "PILOT"
    at_will = any(kind_of(task.kind).at_will for task in protocol.tasks)
    mode, progress = protocol.answers.mode, protocol.answers.progress
    return View(
        label=label,
        study=protocol.study.id,
        at_will=at_will,
        mode=mode,
        progress=progress,
        reveals=protocol.answers.reveal,
        participant=participant,
    )


def _listen(path: Path, console: "LinkedConsole", once: Callable[["LinkedConsole"], "Footer"], *, last: bool) -> None:
    """Run a session for consoles that connect at `path`, until it is complete or nobody wants it to go on."""
    from palpate.experiment.desk.link import Link
    from palpate.experiment.session.visit import BETWEEN, ending_words

    with closing(Link(path, console)) as link:
        console.wake = link.wake
        try:
            footer = once(console)
        except PauseAsked:
            console.ended(f"{BETWEEN} To continue it, run the same command.", 0)
            return
        except PalpateError as error:
            console.ended(error.sentence(), error.exit_code)
            raise
        console.ended(ending_words(footer, last=last), 0)


def _attend(folder: Path, participant: str, by: str) -> None:
    """Show the console of a session; begin the session if none is under way, and again if its process was lost."""
    from palpate.experiment.desk.console import transport
    from palpate.experiment.desk.link.wire import Hello

    path = transport.place(folder, participant)
    while True:
        # A file without a name: what a session says at its end can be about a person.
        with tempfile.TemporaryFile() as said:
            begun = None if transport.answers(path) else _begin(path, said)
            try:
                # Loaded while the session's process loads.
                from palpate.experiment.desk.console.app import attend

                if begun is not None:
                    _wait_for(begun, path, said)
                left = attend(path, Hello(role="console", by=by))
            except KeyboardInterrupt:
                # Before a console took the key: nobody is left at the session that was begun for it.
                if begun is not None:
                    begun.send_signal(signal.SIGINT if hasattr(signal, "SIGHUP") else signal.SIGTERM)
                raise
            if left.why == "gone" and left.again:
                continue
            if left.why == "left":
                options.say("The session continues without a console. To return to it, run the same command.")
                return
            if left.ended is not None:
                options.say(left.ended.words)
                raise typer.Exit(left.ended.exit_code)
            raise LinkError(
                _last_words(said)
                if begun
                else "the session's process has ended; to resume the session, run the same command"
            )


def _serve(host: str, port: int) -> None:
    """Serve the console of a session to browsers: each visitor's is this same command."""
    if not hasattr(signal, "SIGHUP"):
        # The server starts each by a shell, and a console knows by its parent whether the server is there.
        raise LinkError(
            "the browser console does not run on this system", remedy="run the session in a terminal, without --serve"
        )
    try:
        from palpate.experiment.desk.console import serve
    except ImportError as error:
        raise LinkError(
            f"the browser console needs {error.name}", remedy="install palpate with the 'serve' extra"
        ) from error
    serve.served(options.palpate_command(*sys.argv[1:], "--served"), host=host, port=port).serve()


def _end_with(server: int) -> None:
    """End this process, as a closed terminal would, once the server that started it is gone."""
    while os.getppid() == server:
        time.sleep(1.0)
    os.kill(os.getpid(), signal.SIGHUP)


def _begin(path: Path, said: IO[bytes]) -> "subprocess.Popen[bytes]":
    """Begin the session's process by the command that this one was given; what it prints goes into the file."""
    command = options.palpate_command(*sys.argv[1:], "--session-at", str(path))
    # A session of its own: what ends the terminal does not end it.
    return subprocess.Popen(  # noqa: S603
        command,
        stdin=subprocess.DEVNULL,
        stdout=said,
        stderr=said,
        start_new_session=True,
        creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
    )


def _wait_for(process: "subprocess.Popen[bytes]", path: Path, said: IO[bytes]) -> None:
    """Wait until the session's process listens. Raises `LinkError` with its last words if it does not."""
    from palpate.experiment.desk.console import transport

    begun_s = time.monotonic()
    while not transport.answers(path):
        if process.poll() is not None or time.monotonic() - begun_s > BEGINS_S:
            raise LinkError(_last_words(said))
        time.sleep(0.02)


def _last_words(said: IO[bytes]) -> str:
    # Where the process still writes, it goes on from where it is.
    here = said.tell()
    said.seek(0)
    words = said.read(1 << 16).decode("utf-8", "replace").strip()
    said.seek(here)
    return (
        words.removeprefix("palpate: ")
        or "the session's process ended without a message; to resume the session, run the same command"
    )
