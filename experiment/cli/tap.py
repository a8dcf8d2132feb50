"""The commands of taps: what recordings of them hold, and what an impact on a virtual block comes to."""

from pathlib import Path
from typing import Annotated

import typer

from palpate.experiment.cli import options
from palpate.experiment.cli.options import Json
from palpate.experiment.errors import PalpateError

commands = options.room()
tap = typer.Typer(
    rich_markup_mode=None,
    help="Fit recorded taps, or compute an impact on a virtual block.",
    epilog="Example: palpate tap fit recording.txt",
)
commands.add_typer(tap, name="tap")


@tap.command("fit", epilog="Example: palpate tap fit tap-1.txt tap-2.txt --taps taps.csv")
def fit(
    context: typer.Context,
    recordings: Annotated[
        list[Path],
        typer.Argument(
            metavar="RECORDING...", help="WAV files, text files with a time column, or LabVIEW, MATLAB or HDF5 files."
        ),
    ],
    channel: Annotated[str | None, typer.Option("--channel", help="Name or number (from 1) of the channel.")] = None,
    taps: Annotated[
        Path | None,
        typer.Option(
            "--taps", help="CSV file with the columns file,surface,stiffness_n_m,speed_m_s, to derive L, D and f."
        ),
    ] = None,
    encoding: options.Encoding = None,
    decimal: options.Decimal = None,
    time_unit: options.TimeUnit = None,
    time_column: options.TimeColumn = None,
    rate: options.Rate = None,
    section: options.Section = None,
    as_json: Json = False,
) -> None:
    """Fit a decaying sinusoid to each recorded tap.

    Frequency f, decay B and peak are fitted from the largest sample on, with standard errors that are valid for
    correlated residuals. Clipped samples are left out and reported. With --taps, L and D of each surface and the
    exponential of f over stiffness are derived as in Wellman and Howe. A recording that does not ring in a single
    mode is reported as a misfit; the exit code is then 1.
    """
    from dataclasses import asdict

    from palpate.experiment.recordings import tap_fit
    from palpate.experiment.settings.delimited import Stated

    stated = Stated(
        encoding, decimal, time_unit, time_column, options.command_line(context), rate_hz=rate, section=section
    )
    table = tap_fit.read_taps(taps, stated) if taps is not None else None
    rings: list[tap_fit.Ring] = []
    with options.progress("recordings", quiet=as_json or not options.is_long(recordings)) as (total, advance):
        total(len(recordings))
        for path in recordings:
            rings.append(tap_fit.of_file(path, channel=channel, stated=stated))
            advance()
    made = tap_fit.of_taps(rings, table) if table is not None else None
    if as_json:
        options.put({"recordings": [one.as_dict() for one in rings], "set": asdict(made) if made else None})
    else:
        typer.echo("\n".join([*(one.text() for one in rings), *([made.text()] if made else [])]))
    if any(one.misfit for one in rings):
        raise typer.Exit(1)


@tap.command(
    "contact", epilog="Example: palpate tap contact --stiffness 2500 --damping 10 --mass 0.1 --speed 0.2 --plot tap.svg"
)
def contact(
    stiffness: Annotated[float, typer.Option("--stiffness", help="Stiffness K of the block, N/m.")],
    damping: Annotated[float, typer.Option("--damping", help="Damping C of the block, N s/m.")],
    mass: Annotated[float, typer.Option("--mass", help="Mass M that hits the block, kg.")],
    speed: Annotated[float, typer.Option("--speed", help="Speed at which the mass hits the block, m/s.")],
    force: Annotated[
        float,
        typer.Option("--force", help="Constant force that presses the mass into the block, N; a negative force pulls."),
    ] = 0.0,
    law: Annotated[
        str,
        typer.Option(
            "--law", help="clamped (the force never pulls) or printed (as in the paper: it pulls until r = 0)."
        ),
    ] = "clamped",
    method: Annotated[
        str,
        typer.Option(
            "--method",
            help="exact or, for comparison, euler, semi-implicit euler, rk4, implicit midpoint, exponential or "
            "rk4 with events.",
        ),
    ] = "exact",
    rate: Annotated[float, typer.Option("--rate", help="Rate of the servo, Hz.")] = 2500.0,
    plot: Annotated[
        Path | None,
        typer.Option("--plot", help="File for a plot of r, dr/dt and force for every method (.svg, .png or .pdf)."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Compute one impact of a mass on a virtual block.

    The mass meets the block at r = 0. The command prints release, rebound, largest penetration and energies (or why
    there are none), whether the method is stable at this rate and detects the contact, and the condition number, which
    states how much input errors grow.
    """
    from palpate.experiment.synthesis.stepping import impact

    if law not in ("clamped", "printed"):
        raise PalpateError("--law", f"got {law!r}", "choose one of them", allowed="clamped, printed")
    of = impact.Collision(stiffness, damping, mass, speed, force, "printed" if law == "printed" else "clamped")
    made = impact.answer(of, method=method, rate_hz=rate)
    if plot is not None:
        # What draws takes a second to import.
        from palpate.analysis.numerics import figures

        drawn, suffix = figures.KINDS, plot.suffix.lower()
        if suffix not in drawn:
            raise PalpateError(
                f"--plot {plot}", f"got the suffix '{plot.suffix}'", "give one", allowed=", ".join(drawn)
            )
        options.put_file(plot, drawn[suffix](figures.course(of, rate_hz=rate)))
    plotted = f"\nPlot: {plot}" if plot else ""
    options.put({**made.as_dict(), "plot": str(plot) if plot else None} if as_json else made.text() + plotted)
