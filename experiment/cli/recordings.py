"""The commands of recordings: record, validate, spectrum, plan."""

import sys
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from palpate.experiment.cli import options
from palpate.experiment.cli.options import Json, ProtocolFile
from palpate.experiment.errors import Finding, Interrupted, PalpateError, RecordingError, RigError

if TYPE_CHECKING:
    from palpate.experiment.protocol.models import Protocol

commands = options.room()


@commands.command(epilog="Example: palpate record study.toml --rig our-rig.toml --out recordings")
def record(
    protocol_file: ProtocolFile,
    out: Annotated[Path, typer.Option("--out", help="Folder for the recordings; it must be new or empty.")],
    rig: Annotated[Path | None, typer.Option("--rig", help="Rig file with a table [accelerometer].")] = None,
    simulated: Annotated[
        bool, typer.Option("--simulated", help="Record unattended, with a simulated foot and simulated objects.")
    ] = False,
    speeds: Annotated[
        str | None,
        typer.Option("--speeds", help="Target speeds in mm/s, such as 150,250,400 [default: the protocol's]."),
    ] = None,
    takes: Annotated[
        int | None, typer.Option("--takes", help="How many takes of each condition [default: as the protocol says].")
    ] = None,
    seed: Annotated[
        int, typer.Option("--seed", min=0, max=options.LARGEST_SEED, help="Seed of every random draw of --simulated.")
    ] = 1,
) -> None:
    """Record a protocol's materials and the bare panel.

    The command goes through materials, speeds and takes and shows the achieved speed of each step beside its target; a
    key keeps or repeats the take. A knock before the foot's contact is left out. Ctrl-C stops, and the same command
    continues. The rig's actuator is not used, so its response table is not read.
    """
    from palpate.experiment.recordings import workflow

    wanted = _speeds(speeds)
    try:
        if simulated:
            from palpate.experiment.protocol.files import shipped
            from palpate.experiment.rehearsal.kinds.footstep import recorder

            manifest = recorder.record_simulated(
                protocol_file=protocol_file,
                rig_file=rig or shipped("rigs/rehearsal.toml"),
                out=out,
                seed=seed,
                speeds_mm_s=wanted,
                takes=takes,
            )
        else:
            from palpate.experiment.desk.terminal import TerminalTakes, typed_ahead

            if rig is None:
                raise RecordingError(
                    "--rig", "got none", "name it, or use --simulated", allowed="the rig file of this laboratory"
                )
            manifest = workflow.record_on_rig(
                protocol_file=protocol_file,
                rig_file=rig,
                out=out,
                console=TerminalTakes(write=sys.stdout, ask=input, early=lambda: typed_ahead(sys.stdin)),
                speeds_mm_s=wanted,
                takes=takes,
            )
    except KeyboardInterrupt:
        raise Interrupted("the recording was interrupted", remedy="run the same command to continue it") from None
    typer.echo(f"{'SIMULATED recordings' if simulated else 'Recordings'}: {manifest.parent}")


@commands.command(epilog="Example: palpate validate recordings --fresh fresh-takes --out validation")
def validate(
    folder: Annotated[Path, typer.Argument(metavar="RECORDINGS", help="Folder of recordings.")],
    fresh: Annotated[
        Path | None, typer.Option("--fresh", help="Folder of fresh takes [default: simulated takes].")
    ] = None,
    protocol_file: Annotated[
        Path | None,
        typer.Option("--protocol", help="Protocol that says how takes are averaged [default: by magnitude]."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for the results [default: RECORDINGS/validation].")
    ] = None,
    seed: Annotated[
        int, typer.Option("--seed", min=0, max=options.LARGEST_SEED, help="Seed of the simulated fresh takes.")
    ] = 1,
    figures: Annotated[bool, typer.Option("--figures/--no-figures", help="Draw the figures.")] = True,
    as_json: Json = False,
) -> None:
    """Validate the synthesis on recordings, as published.

    Each fresh take is assigned to the speed whose synthesised spectrum is most like it; takes assigned to their own or
    a neighbouring speed are counted, and the materials are compared with one another. Takes are averaged as the
    protocol says, and the result of the other way to average is given beside it.
    """
    from palpate.analysis.validation import report
    from palpate.experiment.protocol import files
    from palpate.experiment.protocol.kinds.footstep import Footstep
    from palpate.experiment.recordings import manifest

    average = files.load(protocol_file).table(Footstep).synthesis.average if protocol_file is not None else "magnitude"
    recorded = manifest.load_all(folder)
    if fresh is not None:
        if fresh.resolve() == folder.resolve():
            raise RecordingError(
                f"--fresh {fresh}", "got the recordings themselves", "record them", allowed="other takes"
            )
        others = manifest.load_all(fresh)
    else:
        from palpate.experiment.rehearsal.kinds.footstep import recorder

        others = recorder.fresh_takes(recorded, seed=seed)
    folder_out = out or folder / "validation"
    result = report.validate(recorded, others, folder_out, average=average, figures=figures)
    options.put(result.as_dict() if as_json else result.text())


@commands.command(epilog="Example: palpate spectrum recording.lvm --plot spectrum.svg")
def spectrum(
    context: typer.Context,
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="WAV, text with a column of times, LabVIEW, MATLAB or HDF5 file."),
    ],
    channel: Annotated[str | None, typer.Option("--channel", help="Name or number (from 1) of the channel.")] = None,
    axes: Annotated[
        tuple[str, str, str] | None,
        typer.Option("--axes", metavar="X Y Z", help="Three channels that are the axes of one sensor, made one."),
    ] = None,
    reduction: Annotated[
        Literal["dft321", "norm"] | None,
        typer.Option(
            "--reduction",
            help="How axes become one: all their power at each frequency, or their length [default: dft321].",
        ),
    ] = None,
    resample: Annotated[
        bool, typer.Option("--resample", help="Bring samples at uneven times onto an even grid.")
    ] = False,
    plot: Annotated[
        Path | None, typer.Option("--plot", help="Draw the spectrum into this file (.png or .svg) [default: nothing].")
    ] = None,
    encoding: options.Encoding = None,
    decimal: options.Decimal = None,
    time_unit: options.TimeUnit = None,
    time_column: options.TimeColumn = None,
    rate: options.Rate = None,
    section: options.Section = None,
    as_json: Json = False,
) -> None:
    """Print the spectrum of a recording, and plot it with --plot.

    The peaks of the amplitude spectrum are listed. The sampling rate of text and LabVIEW columns is taken from their
    time column and not from a header. With --axes the three channels of an accelerometer become one: dft321 has at each
    frequency the power of all three (Landin et al. 2010), norm the length of the acceleration without its mean. Samples
    at uneven times are refused; with --resample a cubic spline takes them to an even grid, and its error is stated.
    Gaps of at most 8 samples are bridged so. What looks clipped is said to.
    """
    from palpate.experiment.recordings import spectrum as spectra
    from palpate.experiment.recordings.readers import Axes
    from palpate.experiment.settings.delimited import Stated

    if plot is not None and plot.exists() and file.exists() and plot.samefile(file):
        raise PalpateError(f"--plot {plot}", "this is the recording itself", "name another file")
    if axes is not None and channel is not None:
        raise PalpateError("got --channel with --axes", remedy="leave one of them out", allowed="either")
    if axes is None and reduction is not None:
        raise PalpateError("got --reduction without --axes", remedy="name the axes with --axes X Y Z", allowed="both")
    stated = Stated(encoding, decimal, time_unit, time_column, options.command_line(context), resample, rate, section)
    made_of = None if axes is None else Axes(axes, reduction or "dft321")
    with options.working(f"Reading {file}", quiet=as_json or not options.is_long([file])):
        result = spectra.of_file(file, channel=channel, axes=made_of, stated=stated)
    drawn = None if plot is None else spectra.plot(result, plot)
    plotted = f"\nPlot: {drawn}" if drawn else ""
    options.put({**result.as_dict(), "plot": str(drawn) if drawn else None} if as_json else result.text() + plotted)


@commands.command(epilog="Example: palpate plan okamoto2012 --task real")
def plan(
    protocol_file: ProtocolFile,
    task: Annotated[
        str | None, typer.Option("--task", help="Id of one task [default: every task of the protocol].")
    ] = None,
    recordings: Annotated[
        Path | None, typer.Option("--recordings", help="Folder of recordings [default: simulated recordings].")
    ] = None,
    rig: Annotated[
        Path | None,
        options.file_option("--rig", "Rig file [default: the rehearsal's]."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Print what a task needs and what it leaves out.

    Each omission is printed with the time and memory that it saves and the error that it causes, measured on this
    machine while you wait, and so is a process of each task, on a simulated rig. Of taps on virtual surfaces it prints
    how far the force on a simulated hand is off, cause by cause. The exit code is 2 where the protocol does not allow
    what the rig leaves out, or so large an error.
    """
    from palpate.experiment.clock import day, wall_ns
    from palpate.experiment.protocol import files
    from palpate.experiment.rehearsal import held, study

    rig_file = rig or study.simulated_rig(files.load(protocol_file))
    with options.progress("plan", quiet=as_json) as bar:
        source, named, plans = held.plans(protocol_file, rig_file, task, recordings, bar, day(wall_ns()))
    document = {"recordings": source, "rig": named, "tasks": [one.as_dict() for one in plans]}
    heading = f"Measured with: {source}\nRig: {named}"
    with options.working("Simulating thresholds by the rule of the levels, if there is one", quiet=as_json):
        doubts = _threshold_doubts(files.load(protocol_file))
    document["doubts"] = [one.sentence() for one in doubts]
    if as_json:
        options.put(document)
    else:
        options.say("\n\n\n".join([heading, *(one.text() for one in plans)]))
        options.say("".join(f"\n{one.sentence()}.\n" for one in doubts).removesuffix("\n"))
    if any(one.refused for one in plans):
        raise typer.Exit(RigError.exit_code)


def _threshold_doubts(protocol: "Protocol") -> list[Finding]:
    """Return what is doubtful about the rules of levels of a study of thresholds."""
    if all(task.levels is None for task in protocol.tasks):
        return []
    from palpate.analysis.designs import planned_design
    from palpate.experiment.study.levels import methods

    own = planned_design(protocol).thresholds
    return list(import_module(own).doubts(protocol, methods(protocol))) if own else []


def _speeds(text: str | None) -> tuple[float, ...]:
    if text is None:
        return ()
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise RecordingError("--speeds", f"got {text!r}", allowed="numbers and commas, such as 150,250,400") from None
