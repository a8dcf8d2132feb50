"""The one command, `palpate`: its commands, each from the module of its room, and how an error ends one."""

import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import redirect_stderr, redirect_stdout
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, TextIO, cast

import typer
import typer.main

from palpate import __version__
from palpate.experiment.cli import COMMANDS, overview, tell, was_interrupted
from palpate.experiment.errors import DatasetError, Interrupted, LinkError, PalpateError, ProtocolError
from palpate.experiment.settings.characters import plain


class Commands(typer.core.TyperGroup):
    """The commands of `COMMANDS`, each built when it is called."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands = cast("Any", _Built())

    def format_help(self, ctx: Any, formatter: Any) -> None:  # noqa: ARG002
        formatter.write(overview())


class _Built(Mapping[str, Any]):
    """Commands by name, from the modules of their rooms."""

    def __getitem__(self, name: str) -> Any:
        room = next((part[name][0] for part in COMMANDS.values() if name in part), None)
        if room is None:
            raise KeyError(name)
        return typer.main.get_group(import_module(f"palpate.experiment.cli.{room}").commands).commands[name]

    def __iter__(self) -> Iterator[str]:
        return (name for part in COMMANDS.values() for name in part)

    def __len__(self) -> int:
        return sum(map(len, COMMANDS.values()))


app = typer.Typer(
    cls=Commands,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(value: bool) -> None:
    if value:
        typer.echo(f"palpate {__version__}")
        raise typer.Exit


@app.callback()
def palpate(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Run vibrotactile psychophysics: from an ethics-reviewed protocol to published tables."""


class _Door:
    """A stream on which a control or invisible character is written as its code: what files hold may hold any."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        return self._stream.write(plain(text))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def main() -> None:
    """Run the command. An error becomes its message and exit code 2; raises `KeyboardInterrupt` on Ctrl-C."""
    if sys.stderr is None:
        sys.stderr = Path(os.devnull).open("w")  # noqa: SIM115
    if sys.stdout is None:
        tell("palpate: standard output is closed; open it, or redirect it to /dev/null")
        sys.exit(PalpateError.exit_code)
    with redirect_stdout(cast("TextIO", _Door(sys.stdout))), redirect_stderr(cast("TextIO", _Door(sys.stderr))):
        _run()


def _run() -> None:
    try:
        app()
    except SystemExit as end:
        # Typer ends in silence on Ctrl-C; nothing of ours exits with its code from inside the app.
        if end.code == Interrupted.exit_code:
            raise KeyboardInterrupt from None
        raise
    except PalpateError as error:
        for line in (str(error), *getattr(error, "__notes__", ())):
            # The last words of a session's process hold such lines too.
            in_lines = isinstance(error, ProtocolError | LinkError) or isinstance(error.__cause__, ProtocolError)
            in_lines |= isinstance(error, DatasetError) and len(error.findings) > 1
            keep = "\n" if in_lines else ""
            tell(f"palpate: {plain(line, keep)}")
        raise SystemExit(error.exit_code) from None
    except BrokenPipeError:
        sys.stderr.close()
        raise SystemExit(1) from None
    except OSError as error:
        from palpate.experiment import storage

        where = plain(f"{error.filename}: ", keep="") if error.filename else ""
        tell(f"palpate: {where}{error.strerror or error}; {storage.remedy(error)}, then run the command again")
        raise SystemExit(2) from None
    except MemoryError:
        tell("palpate: not enough memory; use smaller files or numbers, or close other programs")
        raise SystemExit(2) from None
    except RecursionError:
        tell("palpate: the input is nested too deeply to read; simplify it, then run the command again")
        raise SystemExit(2) from None
    except Exception as error:
        if was_interrupted(error):
            raise KeyboardInterrupt from None
        if isinstance(error, ModuleNotFoundError) and f"{error.name}.".startswith("palpate."):
            # A part of the source that no other part needs may be left out.
            tell(f"palpate: {error.name} is not installed; install palpate with all of its parts")
            raise SystemExit(PalpateError.exit_code) from None
        if isinstance(error, RuntimeError) and "Symlink loop" in str(error):
            # So Python tells of a link that leads to itself before 3.13.
            tell(f"palpate: {plain(str(error), keep='')}; give a folder or a file")
            raise SystemExit(2) from None
        tell(f"palpate: {_reported(error)}")
        raise SystemExit(70) from None


def _reported(error: Exception) -> str:
    """Write what a developer needs to a file, and return the line for the experimenter."""
    import tempfile
    import traceback

    with tempfile.NamedTemporaryFile("w", prefix="palpate-", suffix=".txt", delete=False, encoding="utf-8") as file:
        traceback.print_exception(error, file=file)
    return f"an error in palpate itself ({type(error).__name__}); nothing on disk was lost; please report {file.name}"
