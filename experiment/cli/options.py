"""What commands share: options and arguments, JSON for programs, the progress bar, and what registers commands.

Modules of commands have no `from __future__ import annotations`, so that Typer need not compile the annotations.
"""

import re
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from palpate.experiment.errors import LinkError, PalpateError, Remedy
from palpate.experiment.settings.characters import hidden, quoted

if TYPE_CHECKING:
    from rich.progress import Progress


def a_protocol(name: str) -> Path:
    """Return the protocol file that is named, by its path or its id. Raises `PalpateError` for what is neither."""
    from palpate.experiment.protocol.files import named

    return named(name)


def a_file(name: str) -> Path:
    """Return the file at a path, also where a guide names one that comes with palpate."""
    from palpate.experiment.protocol.files import of_guides

    return of_guides(name)


def file_option(name: str, words: str) -> Any:
    """Return an option that takes such a file."""
    return typer.Option(name, parser=a_file, metavar="FILE", help=words)


ProtocolFile = Annotated[
    Path,
    typer.Argument(
        parser=a_protocol, metavar="PROTOCOL", help="Protocol file (TOML), or okamoto2012, which comes with palpate."
    ),
]
Participant = Annotated[str, typer.Option("--participant", "-p", help="Participant's label, such as 03.")]
StudyFolder = Annotated[
    Path | None, typer.Option("--dataset", help="Folder of the study's dataset [default: participants/STUDY].")
]
StudyPlace = Annotated[
    Path,
    typer.Argument(metavar="STUDY", help="Folder of a study's dataset, or protocol file (for its default folder)."),
]
AtConsole = Annotated[
    str, typer.Option("--by", metavar="LABEL", help="Who is at the console: a label for the record, not a name.")
]
LARGEST_SEED = 2**63 - 1
"""The largest whole number that the files of a study may hold."""

Seed = Annotated[int, typer.Option("--seed", min=0, max=LARGEST_SEED, help="Seed for all random draws.")]
Json = Annotated[bool, typer.Option("--json", help="Print a single JSON document and nothing else.")]
Encoding = Annotated[
    str | None, typer.Option("--encoding", help="Code page of a text file that is not Unicode, such as cp1252.")
]
Decimal = Annotated[str | None, typer.Option("--decimal", help="Decimal separator in a text file [default: detected].")]
TimeUnit = Annotated[
    str | None, typer.Option("--time-unit", help="Unit of the times: s, ms, us, ns, min, h or d [default: the file's].")
]
TimeColumn = Annotated[
    str | None, typer.Option("--time-column", help="Name of the time column, if a text file has several.")
]

Rate = Annotated[
    float | None,
    typer.Option("--rate", metavar="HZ", help="Sampling rate; needed only for a file without times."),
]
Section = Annotated[
    str | None,
    typer.Option("--section", help="Name or number (from 1) of the table to read, if a text file has several."),
]


def command_line(context: typer.Context) -> tuple[str, ...]:
    """Return the command as it was typed, for a remedy to add to: `palpate`, its name, arguments and options."""
    words = ["palpate", *context.command_path.split()[1:]]
    for parameter in context.command.params:
        source = context.get_parameter_source(parameter.name or "")
        if source is None or source.name != "COMMANDLINE":
            continue
        given = context.params[parameter.name or ""]
        for value in given if isinstance(given, (list, tuple)) else (given,):
            flag = () if parameter.param_type_name == "argument" else (max(parameter.opts, key=len),)
            words += flag if value is True else (*flag, str(value))
    return tuple(words)


MADE_BY_PALPATE = (
    b'<meta name="generator" content="palpate">',
    b"<dc:title>palpate</dc:title>",
    b"Software\0palpate",
    b"/Creator (palpate)",
    b'"$comment": "made by palpate',
)
"""What its pages, and its figures as SVG, PNG and PDF, say of who made them."""


def put_file(path: Path, content: bytes) -> None:
    """Write a figure or a page where an option says, over nothing but another that palpate made.

    Raises `PalpateError` for any other file that stands there, and `DatasetError` if the file system refuses.
    """
    from palpate.experiment import storage

    if path.exists() and not (path.is_file() and any(mark in storage.read_bytes(path) for mark in MADE_BY_PALPATE)):
        raise PalpateError(path, "already exists and was not made by palpate", "name another file")
    storage.write_bytes(path, content)


def a_day(text: str) -> date:
    """Return the day that an option gives. Raises `PalpateError` for what is none."""
    with suppress(ValueError):
        if re.fullmatch(r"[0-9]{4}-[0-9]{2}-[0-9]{2}", text):
            return date.fromisoformat(text)
    raise PalpateError(f"got the date {quoted(text)}", allowed="a calendar date as YYYY-MM-DD, such as 2026-04-01")


def default_folder(protocol_file: Path, *, practice: bool, repetitions: int | None = None) -> Path:
    """Return where the dataset of a study stands, or that of its practice. Raises `ProtocolError`."""
    from palpate.experiment.protocol import files
    from palpate.experiment.rehearsal.study import practice_folder
    from palpate.experiment.study import enrolment

    if practice:
        return practice_folder(protocol_file, repetitions)
    return enrolment.default_root(files.load(protocol_file))


def palpate_command(*arguments: str) -> list[str]:
    """Return the command that starts palpate in a process of its own."""
    from palpate.experiment import storage

    return storage.python_command("-m", "palpate.experiment", *arguments)


def at_once(words: str) -> None:
    """Tell whoever sits at a terminal what is being done, before it loads for seconds."""
    if sys.stderr is not None and sys.stderr.isatty():
        say(words, err=True)


def say(words: str, *, err: bool = False) -> None:
    """Print lines that end between words where the terminal does; one with an indent goes on further in."""
    import textwrap

    width = columns(10_000)
    for line in words.split("\n"):
        left = len(line) - len(line.lstrip())
        onward = " " * (left + 2) if left else ""
        broken = textwrap.wrap(line, width, subsequent_indent=onward, break_long_words=False, break_on_hyphens=False)
        typer.echo("\n".join(broken), err=err)


def check_terminal(remedy: Remedy | str) -> None:
    """Raise `LinkError` where the screen could not be seen, for it is drawn on the standard error; name what to do."""
    if sys.stderr is None or not sys.stderr.isatty():
        raise LinkError(
            "standard error, on which the screen is drawn, is not a terminal (e.g., because of 2> FILE)",
            remedy=remedy,
            allowed="a terminal",
        )


def at_terminal(*, draws: bool) -> bool:
    """Return whether a session's command stands at a terminal. Raises `LinkError` where a console `draws` unseen."""
    found = sys.stdin.isatty() and sys.stdout.isatty()
    if found and draws:
        check_terminal("remove the redirection, or use the plain-text console (--lines)")
    return found


def ask(asked: str) -> str:
    """Return the line that is typed after what is `asked`; nothing where nobody can type."""
    try:
        return input(asked).strip()
    except (EOFError, OSError, ValueError):
        return ""


def confirm(asked: str, wanted: str, nothing: str) -> None:
    """Return once `wanted` was typed after what is `asked`. Raises `PalpateError`, with `nothing` in words."""
    typed = ask(f"{asked} Type {wanted} to continue: ")
    if typed != wanted:
        raise PalpateError(nothing, f"got {quoted(typed)}", "type it exactly, or give --yes", allowed=wanted)


def room() -> typer.Typer:
    """Return where a module's commands are registered."""
    return typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False, add_completion=False)


def put(found: object) -> None:
    """Print words as they are, and a document as JSON.

    JSON is in ASCII if it holds characters that do not leave as they are, or if the stream is in a code page.
    """
    import json

    if isinstance(found, str):
        typer.echo(found)
        return
    text = json.dumps(found, indent=2, ensure_ascii=False, allow_nan=False)
    ascii_alone = hidden(text, "\n") or not (sys.stdout.encoding or "").lower().startswith("utf")
    typer.echo(json.dumps(found, indent=2, allow_nan=False) if ascii_alone else text)


NARROWEST = 40
"""Text is not written in fewer columns."""


def columns(most: int) -> int:
    """Return in how many columns to write: those of the terminal, at most so many, and these where there is none."""
    import shutil

    return max(NARROWEST, min(most, shutil.get_terminal_size((most, 24)).columns))


BAR = 30
"""The width of a progress bar beside words."""


@contextmanager
def working(what: str, *, quiet: bool = False) -> Iterator[Callable[..., None]]:
    """Say what is being computed, at a terminal until it is; yield what says something else there then.

    That takes words and, for a bar beside them, how much is done and of how much.
    """
    from rich.console import Console

    console = Console(file=sys.__stderr__)
    if quiet or not console.is_terminal:
        _tell(f"{what} ...", quiet=quiet)
        yield lambda *_: None
        return
    from rich.progress_bar import ProgressBar
    from rich.table import Table

    with console.status(what) as status:

        def say(words: str, done: int = 0, of: int = 0) -> None:
            line = Table.grid(padding=(0, 1))
            if of:
                line.add_row(words, ProgressBar(of, done, width=BAR), f"{done}/{of}")
            else:
                line.add_row(words)
            status.update(line)

        yield say


def _tell(words: str, *, quiet: bool) -> None:
    if not quiet and sys.__stderr__ is not None:
        print(words, file=sys.__stderr__, flush=True)


@contextmanager
def progress(label: str, *, quiet: bool) -> Iterator[tuple[Callable[..., None], Callable[[], None]]]:
    """Show a progress bar on standard error; yield what draws it, with a total and what is done, and what advances it.

    It moves about on the terminal with control characters, so it writes to the stream of the process itself. Elsewhere
    it is a line at the beginning, and one for each tenth.
    """
    from rich.console import Console

    console = Console(file=sys.__stderr__)
    bar: Progress | None = None
    plain = not quiet and not console.is_terminal
    if plain:
        _tell(f"{label} ...", quiet=quiet)

    def begin(total: int, done: int = 0) -> None:
        nonlocal bar
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

        counted = BarColumn(), MofNCompleteColumn(), TextColumn("elapsed"), TimeElapsedColumn()
        bar = Progress(TextColumn("{task.description}"), *counted, console=console, disable=quiet or plain)
        bar.add_task(label, total=total, completed=done)
        bar.start()

    def advance() -> None:
        if bar is not None:
            bar.advance(bar.task_ids[0])
            (task,) = bar.tasks
            done, of = int(task.completed), int(task.total or 0)
            if plain and 10 * done // of > 10 * (done - 1) // of:
                _tell(f"{label} {done}/{of}, elapsed {task.elapsed or 0.0:.0f} s", quiet=quiet)

    try:
        yield begin, advance
    finally:
        if bar is not None:
            bar.stop()


@contextmanager
def shares(*, quiet: bool) -> Iterator[Callable[[float], None]]:
    """Show a progress bar in percent; yield what takes the share that is done."""
    with progress("%", quiet=quiet) as (begin, advance):
        begin(100)
        reached = 0

        def done(share: float) -> None:
            nonlocal reached
            while reached < int(share * 100):
                reached += 1
                advance()

        yield done


MANY_FILES, LARGE_BYTES = 50, 2 * 2**20
"""So many files, or so many bytes of them, may take longer than 2 s to read. Ours."""


def is_long(files: Sequence[Path]) -> bool:
    """Return whether it may take longer than 2 s to read these files, as far as they are there."""
    return len(files) >= MANY_FILES or sum(path.stat().st_size for path in files if path.is_file()) >= LARGE_BYTES
