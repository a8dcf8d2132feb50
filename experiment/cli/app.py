"""The one command, `palpate`; with cli_lab.py the only place that knows every part. Each part is imported on use.

Typer reads the annotations of every command each time, `--help` included: in modules of commands they are objects, as
they would have to be compiled otherwise, and such modules have no `from __future__ import annotations`.
"""

import sys
from pathlib import Path
from typing import Annotated, Literal

import typer

from experiment import __version__
from experiment.cli import options
from experiment.cli.analysis import analyst, tell_analysis
from experiment.cli.laboratory import Participant, ProtocolFile, lab
from experiment.cli.recordings import engine
from experiment.cli.rig import rig_commands
from experiment.errors import Interrupted, PalpateError

app = typer.Typer(
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    no_args_is_help=True,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

Json = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Names every random draw.")]


def _version(value: bool) -> None:
    if value:
        typer.echo(f"palpate {__version__}")
        raise typer.Exit


@app.callback()
def palpate(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Print it.")] = False,
) -> None:
    """Run vibrotactile psychophysics: from an ethics-reviewed protocol to published tables."""


@app.command(epilog="Example: palpate check protocols/okamoto2012.toml")
def check(protocol_file: ProtocolFile, as_json: Json = False) -> None:
    """Show a protocol to an ethics board.

    Prints a page that states the whole study, or every error at once with path, line, what was got and what is
    allowed.
    """
    from experiment.errors import ProtocolError
    from experiment.protocol import approval, files, page

    try:
        protocol = files.load(protocol_file)
    except ProtocolError as error:
        if as_json:
            from dataclasses import asdict

            options.put({"file": error.file, "valid": False, "errors": [asdict(p) for p in error.problems]})
            raise typer.Exit(error.exit_code) from None
        raise
    if as_json:
        import json

        document = json.loads(approval.canonical(protocol))
        options.put(
            {"file": str(protocol_file), "valid": True, "sha256": approval.sha256(protocol), "protocol": document}
        )
    else:
        typer.echo(page.page(protocol))


@app.command(epilog="Example: palpate schedule protocols/okamoto2012.toml --participant 03 --seed 1")
def schedule(protocol_file: ProtocolFile, participant: Participant, seed: Seed = 1, as_json: Json = False) -> None:
    """Print the trials of one participant, in order."""
    from experiment.protocol import files
    from experiment.study import roster
    from experiment.study import schedule as schedules

    protocol = files.load(protocol_file)
    allocation = roster.find(roster.allocate(protocol, seed), participant)
    orders = {
        task: schedules.schedule(protocol=protocol, participant=allocation.participant, task_id=task, seed=seed)
        for task in allocation.tasks
    }
    if as_json:
        tasks = [{"task": task, "order": [t.model_dump() for t in order]} for task, order in orders.items()]
        options.put({"participant": allocation.participant, "seed": seed, "tasks": tasks})
        return
    for position, (task, order) in enumerate(orders.items(), start=1):
        typer.echo(f"Participant {allocation.participant}, task {position}: {task} (seed {seed})")
        for planned in order:
            typer.echo(f"{planned.trial:4d}  {' and '.join(planned.presented)}")


@app.command(epilog="Example: palpate rehearse protocols/okamoto2012.toml --participants 3 --seed 7 --out trial-run")
def rehearse(
    protocol_file: Annotated[
        Path | None, typer.Argument(metavar="[PROTOCOL]", help="Protocol file; the footstep study by default.")
    ] = None,
    participants: Annotated[
        int | None, typer.Option("--participants", min=1, help="How many; all of the study's by default.")
    ] = None,
    seed: Seed = 1,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder of the dataset; participants/rehearsal-... by default.")
    ] = None,
    rig: Annotated[Path | None, typer.Option("--rig", help="Rig file of a simulated rig.")] = None,
    control: Annotated[
        Literal["none", "silence"], typer.Option("--control", help="'silence' replaces every stimulus by zeros.")
    ] = "none",
    jobs: Annotated[int, typer.Option("--jobs", min=0, help="Participants at a time; 0: one a core.")] = 0,
    real_time: Annotated[bool, typer.Option("--real-time", help="Pace it by the wall clock, and show it.")] = False,
    as_json: Json = False,
) -> None:
    """Run a whole study with simulated participants.

    REHEARSAL: a simulated foot speaks through a real serial port, a simulated observer judges what the actuator
    was sent, answers pass the journal, and the tables come from the dataset on disk. The same command goes on with a
    rehearsal that was interrupted.
    """
    from experiment.cli.options import progress
    from experiment.desk.terminal import TerminalConsole
    from experiment.protocol.files import shipped
    from experiment.rehearsal import study

    screen = TerminalConsole(write=sys.stderr, ask=input, heading="REHEARSAL") if real_time and not as_json else None
    with progress("REHEARSAL", quiet=as_json or screen is not None) as (total, tick):
        dataset = study.rehearse(
            protocol_file=protocol_file or shipped("okamoto2012.toml"),
            rig_file=rig or shipped("rigs/rehearsal.toml"),
            out=out,
            participants=participants,
            seed=seed,
            control=control,
            real_time=real_time,
            jobs=jobs,
            total=total,
            tick=tick,
            screen=screen,
        )
    tell_analysis([dataset], None, as_json=as_json, figures=True)


@app.command(epilog="Example: palpate spectrum recording.lvm --plot spectrum.svg")
def spectrum(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="WAV, text columns with time, or LabVIEW .lvm.")],
    channel: Annotated[str | None, typer.Option("--channel", help="Name or number (from 1) of the channel.")] = None,
    plot: Annotated[Path | None, typer.Option("--plot", help="Where to draw it (.png or .svg).")] = None,
    as_json: Json = False,
) -> None:
    """Print and plot the spectrum of a recording.

    Lists the peaks of the amplitude spectrum. The sampling rate of text and LabVIEW columns is that of their time
    column, not that of a header.
    """
    from experiment.recordings import spectrum as spectra

    if plot is not None and plot.exists() and file.exists() and plot.samefile(file):
        raise PalpateError(f"--plot {plot}: is the recording itself; give another file")
    result = spectra.of_file(file, channel=channel)
    drawn = spectra.plot(result, plot or free(Path(f"{file.stem}_spectrum.png")))
    if as_json:
        options.put({**result.as_dict(), "plot": str(drawn)})
    else:
        typer.echo(f"{result.text()}\nPlot: {drawn}")


@app.command(
    "import-counts",
    epilog="Example: palpate import-counts --task virtual=virtual.csv --task real=real.csv --study okamoto2012 "
    "--out again",
)
def import_counts(
    task: Annotated[list[str], typer.Option("--task", help="TASK=CSV: participant,presented,answered,count.")],
    study: Annotated[str, typer.Option("--study", help="Id of the study.")],
    out: Annotated[Path, typer.Option("--out", help="Folder of the new dataset.")],
    source: Annotated[str | None, typer.Option("--source", help="Where the counts come from.")] = None,
) -> None:
    """Make a dataset from printed counts.

    The dataset is labelled a reconstruction: no original data.
    """
    from experiment.dataset import reconstruction
    from experiment.dataset import reconstruction as counts_file

    pairs = dict(map(counts_file.parse_task, task))
    text = reconstruction.study_text(study, pairs, source)
    typer.echo(f"Dataset: {reconstruction.import_counts(pairs, out, study=text)}")


@app.command(epilog="Example: palpate journal participants/study/sourcedata/sub-01/sub-01_task-virtual_journal.jsonl")
def journal(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Journal of a session (.jsonl).")],
    as_json: Json = False,
) -> None:
    """Verify a journal and tell its story."""
    from experiment.records import journal as journals
    from experiment.records import transcript

    contents = journals.read(file)
    if as_json:
        entries = [{"t_ns": line.t_ns, **line.entry.model_dump(mode="json")} for line in contents.lines]
        options.put({"file": str(file), "torn_bytes": len(contents.torn), "entries": entries})
    else:
        typer.echo(transcript.text(contents))


def free(path: Path) -> Path:
    """`path`, or the first of path-2, path-3, ... that is not there yet."""
    names = (path, *(path.with_stem(f"{path.stem}-{n}") for n in range(2, 10_000)))
    return next((name for name in names if not name.exists()), path)


app.add_typer(analyst)
app.add_typer(engine)
app.add_typer(lab)
app.add_typer(rig_commands)


def main() -> None:
    """Run the command: an error is one line (every line of it useful) and exit code 2.

    Raises:
        KeyboardInterrupt: Ctrl-C that no part made an `Interrupted` of.
    """
    try:
        app()
    except SystemExit as end:
        # Typer ends in silence on Ctrl-C; nothing of ours exits with its code from inside the app.
        if end.code == Interrupted.exit_code:
            raise KeyboardInterrupt from None
        raise
    except PalpateError as error:
        for line in (str(error), *getattr(error, "__notes__", ())):
            print(f"palpate: {line}", file=sys.stderr)  # noqa: T201
        raise SystemExit(error.exit_code) from None
    except BrokenPipeError:
        sys.stderr.close()
        raise SystemExit(1) from None
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        print(f"palpate: {where}{error.strerror or error}; mend that, then call again", file=sys.stderr)  # noqa: T201
        raise SystemExit(2) from None
    except Exception as error:
        print(f"palpate: {_reported(error)}", file=sys.stderr)  # noqa: T201
        raise SystemExit(70) from None


def _reported(error: Exception) -> str:
    """Write what a developer needs to a file, and return the line for the experimenter."""
    import tempfile
    import traceback

    with tempfile.NamedTemporaryFile("w", prefix="palpate-", suffix=".txt", delete=False, encoding="utf-8") as file:
        traceback.print_exception(error, file=file)
    return f"a fault in palpate itself ({type(error).__name__}); nothing on disk was lost; please report {file.name}"
