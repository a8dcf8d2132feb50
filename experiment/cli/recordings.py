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
    rig: Annotated[Path | None, typer.Option("--rig", help="Rig file with an [accelerometer] table.")] = None,
    simulated: Annotated[
        bool, typer.Option("--simulated", help="Record unattended, with a simulated foot and simulated objects.")
    ] = False,
    speeds: Annotated[
        str | None,
        typer.Option("--speeds", help="Target speeds in mm/s, such as 150,250,400 [default: the protocol's]."),
    ] = None,
    takes: Annotated[
        int | None, typer.Option("--takes", help="Number of takes of each condition [default: as in the protocol].")
    ] = None,
    seed: Annotated[
        int, typer.Option("--seed", min=0, max=options.LARGEST_SEED, help="Seed for all random draws of --simulated.")
    ] = 1,
) -> None:
    """Record a protocol's materials and the bare panel.

    The command goes through materials, speeds and takes. It shows the speed of each step next to the target; press
    a key to keep or repeat the take. A knock before the foot's contact is left out. Ctrl-C stops, and the same
    command continues. The rig's actuator is not used, so its response table is not read.
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
                    "--rig",
                    "the rig file is missing",
                    "name it, or use --simulated",
                    allowed="the rig file of this laboratory",
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
        typer.Option("--protocol", help="Protocol that states how takes are averaged [default: by magnitude]."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for the results [default: RECORDINGS/validation].")
    ] = None,
    seed: Annotated[
        int, typer.Option("--seed", min=0, max=options.LARGEST_SEED, help="Seed for the simulated fresh takes.")
    ] = 1,
    figures: Annotated[bool, typer.Option("--figures/--no-figures", help="Draw the figures.")] = True,
    as_json: Json = False,
) -> None:
    """Validate the synthesis on recordings, as in the paper.

    Each fresh take is assigned to the speed whose synthesized spectrum is most similar. The command counts takes
    assigned to their own or a neighboring speed, and compares the materials with each other. It averages takes as
    the protocol states, and also reports the result of the other averaging method.
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
        typer.Argument(metavar="FILE", help="WAV file, text file with a time column, or LabVIEW, MATLAB or HDF5 file."),
    ],
    channel: Annotated[str | None, typer.Option("--channel", help="Name or number (from 1) of the channel.")] = None,
    axes: Annotated[
        tuple[str, str, str] | None,
        typer.Option("--axes", metavar="X Y Z", help="Three channels to combine: the axes of one sensor."),
    ] = None,
    reduction: Annotated[
        Literal["dft321", "norm"] | None,
        typer.Option(
            "--reduction",
            help="How to combine axes: total power per frequency (dft321) or vector length (norm) [default: dft321].",
        ),
    ] = None,
    resample: Annotated[
        bool, typer.Option("--resample", help="Resample unevenly timed samples to an even grid.")
    ] = False,
    plot: Annotated[
        Path | None, typer.Option("--plot", help="File for a plot of the spectrum (.png or .svg) [default: no plot].")
    ] = None,
    encoding: options.Encoding = None,
    decimal: options.Decimal = None,
    time_unit: options.TimeUnit = None,
    time_column: options.TimeColumn = None,
    rate: options.Rate = None,
    section: options.Section = None,
    as_json: Json = False,
) -> None:
    """Print the spectrum of a recording; plot it with --plot.

    The command lists the peaks of the amplitude spectrum. For text and LabVIEW columns, it computes the sampling
    rate from the time column, not from a header. --axes combines the three channels of an accelerometer: dft321 has
    the total power of all three at each frequency (Landin et al. 2010); norm is the length of the acceleration
    without its mean. Samples at uneven times are refused. With --resample, a cubic spline brings them to an even
    grid, bridges gaps of at most 8 samples, and reports its error. Apparent clipping is reported.
    """
    from palpate.experiment.recordings import spectrum as spectra
    from palpate.experiment.recordings.readers import Axes
    from palpate.experiment.settings.delimited import Stated

    if plot is not None and plot.exists() and file.exists() and plot.samefile(file):
        raise PalpateError(f"--plot {plot}", "this file is the recording itself", "name another file")
    if axes is not None and channel is not None:
        raise PalpateError("got --channel with --axes", remedy="leave out one of them", allowed="either")
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
        options.file_option("--rig", "Rig file [default: the simulated rig of rehearsals]."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Print the resources that a task needs and what the rig leaves out of its stimuli.

    For each omission, the command prints the time and memory that it saves and the error that it causes. It measures
    these, and the process of each task on a simulated rig, on this computer while you wait. For taps on virtual
    surfaces, it prints the error of the force on a simulated hand, by cause. The exit code is 2 if the
    protocol does not allow an omission of the rig, or so large an error.
    """
    from palpate.experiment.clock import day, wall_ns
    from palpate.experiment.protocol import files
    from palpate.experiment.rehearsal import held, study

    rig_file = rig or study.simulated_rig(files.load(protocol_file))
    with options.progress("plan", quiet=as_json) as bar:
        source, named, plans = held.plans(protocol_file, rig_file, task, recordings, bar, day(wall_ns()))
    document = {"recordings": source, "rig": named, "tasks": [one.as_dict() for one in plans]}
    heading = f"Measured with: {source}\nRig: {named}"
    with options.working("Simulating thresholds with the adaptive rule, if there is one", quiet=as_json):
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
