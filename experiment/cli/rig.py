"""The commands of a rig: which devices this machine has, whether they are in order, and what calibrates them."""

from collections.abc import Iterator
from contextlib import ExitStack, closing, suppress
from dataclasses import asdict
from itertools import chain
from pathlib import Path
from typing import Annotated

import typer

from palpate.experiment.cli import options
from palpate.experiment.cli.options import Json, StudyFolder
from palpate.experiment.errors import Finding

commands = options.room()
calibrate = typer.Typer(
    rich_markup_mode=None,
    help="Calibrate a device of the rig.",
    epilog="Example: palpate calibrate tracker --rig our-rig.toml",
)
commands.add_typer(calibrate, name="calibrate")

Site = Annotated[
    str | None, typer.Option("--site", help="Site of the body whose actuator to measure, as in [[sites]] of the rig.")
]
RigFile = Annotated[Path, options.file_option("--rig", "Rig file of this laboratory.")]


@commands.command(epilog="Example: palpate devices --json")
def devices(as_json: Json = False) -> None:
    """List the devices of this machine.

    The command lists serial ports, with the programs that use them, and audio devices, under their names for a rig
    file. Without an audio library, it lists only serial ports, and what to install; in JSON "audio" is then null.
    """
    from palpate.experiment.apparatus.audio import stream
    from palpate.experiment.apparatus.tracker import serial_port
    from palpate.experiment.errors import AudioError

    serial, unheard = serial_port.devices(), ""
    try:
        audio = stream.devices()
    except AudioError as error:
        audio, unheard = (), error.finding.sentence()
    if as_json:
        cards = None if unheard else [asdict(card) for card in audio]
        options.put({"serial": [asdict(port) for port in serial], "audio": cards})
        if unheard:
            typer.echo(unheard, err=True)
        return
    typer.echo("Serial ports (names for tracker.port):")
    for device in serial:
        held = f"  in use by {', '.join(device.held_by)}" if device.held_by else ""
        typer.echo(f"  {device.port}  {device.description}  {device.identity}".rstrip() + held)
    if not serial:
        typer.echo("  none")
    typer.echo("Audio devices (names for audio.host_api and audio.device; a device in use may show fewer channels):")
    for card in audio:
        typer.echo(
            f'  host_api = "{card.host_api}"  device = "{card.name}"  inputs {card.inputs}, outputs {card.outputs}, '
            f"{card.rate_hz:g} Hz"
        )
    if not audio:
        typer.echo(f"  not known: {unheard}" if unheard else "  none")


@commands.command(epilog="Example: palpate doctor --rig our-rig.toml --protocol study.toml")
def doctor(
    rig: RigFile,
    protocol: Annotated[
        Path | None,
        typer.Option("--protocol", parser=options.a_protocol, help="Protocol file of the study that is about to run."),
    ] = None,
    dataset: StudyFolder = None,
    recordings: Annotated[
        Path | None, typer.Option("--recordings", help="Folder of recordings, for --protocol [default: the dataset's].")
    ] = None,
    compare_panel: Annotated[
        bool,
        typer.Option("--compare-panel", help="Also compare the panel with its measurement; this shakes it for 4 s."),
    ] = False,
    press: Annotated[
        int,
        typer.Option("--press", min=0, max=100, help="Number of times to press each of the participant's buttons."),
    ] = 0,
    as_json: Json = False,
) -> None:
    """Check a rig before a session.

    Keep everyone off the panel, because it may move. The command checks files, calibrations, tracker, audio device
    with its loopback, actuator, force device (without force), disk and clocks, through the drivers that sessions
    use. With --protocol, it also shows what the rig leaves out of the recorded vibrations. This is red if it
    exceeds the protocol's limit, or if the rig cannot render a virtual block. With --press, somebody presses the
    participant's buttons: the command measures the delay of presses and shows silent buttons in red. Each check is
    green, or red with its remedy. The exit code is 2 if any check is red.
    """
    from palpate.experiment.apparatus import rig as rigs
    from palpate.experiment.apparatus.doctor import doctor as doctors
    from palpate.experiment.apparatus.doctor.checks import Report, lines
    from palpate.experiment.clock import MonotonicClock
    from palpate.experiment.errors import RigError
    from palpate.experiment.rehearsal.session import simulated_far_ends

    options.at_once("The checks take 5 to 15 s. Each result appears when its check ends.")
    # A check of its own is red for a rig file that cannot be used.
    with suppress(RigError):
        every = [own.audio for own in rigs.load(rig).views.values()]
        if compare_panel or any(audio is not None and audio.channels.loopback is not None for audio in every):
            typer.echo("Keep feet and hands off the panel: these checks move it.", err=True)
    if press:
        typer.echo(f"Press each of the participant's buttons {press} times; the checks wait for this.", err=True)
    examined = doctors.examine(
        rig_path=rig,
        protocol_path=protocol,
        root=dataset,
        clock=MonotonicClock(),
        simulate=simulated_far_ends,
        may_move=compare_panel,
        presses=press,
    )
    report = Report(rig)
    for check in chain(examined, omissions(rig, protocol, dataset, recordings)):
        report.checks.append(check)
        if not as_json:
            for line in lines(check, options.columns(10_000)):
                typer.echo(line)
    options.put(report.as_dict() if as_json else report.verdict)
    if report.red:
        raise typer.Exit(RigError.exit_code)


def omissions(
    rig_file: Path, protocol_file: Path | None, dataset: Path | None, recordings: Path | None
) -> Iterator[Finding]:
    """Yield what a rig leaves out of what a study plays; nothing of a rig file that cannot be used."""
    from palpate.experiment.apparatus import rig as rigs
    from palpate.experiment.apparatus.doctor.checks import unchecked
    from palpate.experiment.errors import RigError
    from palpate.experiment.protocol import files
    from palpate.experiment.session.kind import session_kind

    protocol = files.load(protocol_file) if protocol_file is not None else None
    try:
        rig = rigs.load(rig_file)
    except RigError:
        # A check of its own is red for it.
        return
    if protocol is None:
        yield unchecked("left out", "no protocol was given", "add --protocol, and --recordings with its folder")
        return
    for kind in {session_kind(task): None for task in protocol.tasks if task.stimulus == "virtual"}:
        yield from kind.omissions(protocol, rig, rig_file.parent, dataset, recordings)


@calibrate.command("tracker", epilog="Example: palpate calibrate tracker --rig our-rig.toml --out new-rig.toml")
def calibrate_tracker(
    rig: RigFile,
    points: Annotated[str, typer.Option("--points", help="Heights above the panel, in mm.")] = "-2,0,10,20,50",
    days: Annotated[
        int, typer.Option("--days", min=1, max=3650, help="Number of days for which the calibration is valid.")
    ] = 90,
    protocol: Annotated[
        Path | None, typer.Option("--protocol", help="Protocol file with the gate that the calibration must cover.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="New rig file [default: print the table].")] = None,
) -> None:
    """Calibrate the tracker at known heights.

    The command goes through the heights, reads the sensor at each, and prints points, residuals, noise, and
    anything questionable. It refuses heights that do not cover the gate of --protocol or that contradict the
    readings. It never changes the rig file: write a new one with --out, or replace the lines under [tracker] with
    the printed ones.
    """
    from palpate.experiment import storage
    from palpate.experiment.apparatus import opening
    from palpate.experiment.apparatus import rig as rigs
    from palpate.experiment.apparatus.tracker import calibration as calibrating
    from palpate.experiment.clock import MonotonicClock
    from palpate.experiment.errors import Interrupted, RigError
    from palpate.experiment.protocol import files
    from palpate.experiment.protocol.kinds.footstep import Footstep

    heights_mm = calibrating.heights_asked(points)
    step = files.load(protocol).table(Footstep).step if protocol is not None else None
    if out is not None and out.exists():
        raise RigError(out, "this file already exists", "name another", allowed="a new file")
    before, clock = rigs.load(rig), MonotonicClock()
    try:
        with closing(opening.open_tracker(calibrating.raw(before), clock=clock)) as tracker:
            made = calibrating.walk(tracker, heights_mm, ask=input, clock=clock)
    except (KeyboardInterrupt, EOFError):
        raise Interrupted("the calibration was interrupted", remedy="nothing was written") from None
    after = calibrating.calibrated(before, made, days)
    for line in calibrating.report(made):
        options.say(line)
    if step is not None:
        rigs.check(after, step)
        options.say(
            f"The calibration covers the gate ({step.gate_top_mm:g} mm) and the panel ({step.contact_mm:g} mm)."
        )
    if out is None:
        typer.echo(f"\n{calibrating.table(after)}")
    else:
        storage.write(out, calibrating.rewritten(rig.read_text("utf-8-sig"), after).encode())
        typer.echo(f"Rig file: {out}")


@calibrate.command("audio", epilog="Example: palpate calibrate audio --rig our-rig.toml --out our-new-rig.toml")
def calibrate_audio(
    rig_file: RigFile,
    out: Annotated[
        Path | None, typer.Option("--out", help="New rig file with the result [default: print the table only].")
    ] = None,
    site: Site = None,
    probes: Annotated[int, typer.Option("--probes", min=2, max=1000, help="Number of sweeps to play.")] = 20,
    peak: Annotated[
        float, typer.Option("--peak", min=0.001, max=1.0, help="Peak of a sweep; 1.0 is full scale.")
    ] = 0.1,
) -> None:
    """Measure latency and level of the audio device by loopback.

    Sweeps are played on the actuator's channel and recorded on the loopback. First disconnect the actuator's
    amplifier, or set a low peak. After xruns, or if sweeps come back outside the limits of [audio.delivered], the
    command plays all of them again; after three attempts it refuses. (A simulated rig's card loses nothing in
    xruns.) The result is the table [audio.latency] of the rig file, or with --site that of the site.
    """
    from datetime import UTC, datetime

    from palpate.experiment.apparatus import host, opening
    from palpate.experiment.apparatus import rig as rigs
    from palpate.experiment.apparatus.audio import calibration
    from palpate.experiment.clock import MonotonicClock
    from palpate.experiment.errors import RigError

    loaded = rigs.load(rig_file)
    own = loaded.at(site)
    audio = opening.audio_of(own)
    entry = audio.channels.loopback
    if entry is None:
        raise RigError(
            rig_file, "audio.channels.loopback is missing", "add it", allowed="an input cabled to the actuator"
        )
    if out is not None and out.exists():
        raise RigError(out, "this file already exists", "name another", allowed="a new file")
    device = None
    with ExitStack() as opened:
        opened.enter_context(host.raised())
        card = None
        if loaded.rig.simulated:
            from palpate.experiment.rehearsal.wires.sound_card import DEVICE, SoundCard

            typer.echo("SIMULATED: this sound card is software, not a device", err=True)
            outputs, inputs = opening.open_channels(loaded)
            card = SoundCard(rate_hz=audio.rate_hz, block=audio.block, inputs=inputs, outputs=outputs)
            opened.callback(card.close)
            device = DEVICE
        stream = calibration.open_probing(loaded, [own], peak=peak, clock=MonotonicClock(), device=device)
        opened.callback(stream.close)
        if card is not None:
            card.disconnect(entry)
            card.connect(audio.channels.actuator, entry)
        sweeps = f"{probes} sweeps on output {audio.channels.actuator}, recorded on input {entry}"
        typer.echo(f"Playing {sweeps} ...", err=True)
        found = calibration.steadily(
            lambda: calibration.measure(stream, output=audio.channels.actuator, entry=entry, peak=peak, probes=probes),
            audio,
            exact=loaded.rig.simulated,
        )
    today = datetime.now(tz=UTC).astimezone().date()
    days = audio.latency.calibration_days
    divided = "as the driver reports them" if found.as_reported else "equally, because the driver does not report both"
    typer.echo(
        f"# {found.probes} probes: round trip {found.round_trip_frames:g} frames, range {found.spread_frames}; gain "
        f"{found.gain:.4g}, range {found.spread_db:.2f} dB; residual {found.residual_db:.0f} dB; {found.xruns} "
        f"xruns\n# the round trip is divided between output and input {divided}"
    )
    typer.echo(found.table(today, days, site), nl=False)
    if out is not None:
        from palpate.experiment import storage

        text = calibration.rewritten(rig_file.read_text("utf-8"), found.values(today, days), site)
        storage.write(out, text.encode())
        rigs.load(out)
        typer.echo(f"# written: {out}")


@calibrate.command("actuator", epilog="Example: palpate calibrate actuator --rig our-rig.toml --out new-rig.toml")
def calibrate_actuator(
    rig: RigFile,
    out: Annotated[Path, typer.Option("--out", help="New rig file; the response table is written next to it.")],
    peak: Annotated[float, typer.Option("--peak", min=0.001, max=1.0, help="Highest sample; 1.0 is full scale.")] = 0.2,
    days: Annotated[
        int, typer.Option("--days", min=1, max=3650, help="Number of days for which the calibration is valid.")
    ] = 30,
    load: Annotated[str, typer.Option("--load", help="Load on the panel. It must not be a person.")] = "nobody",
    panel: Annotated[
        Path | None, typer.Option("--panel", help="Modes file of a SIMULATED panel, for a simulated rig.")
    ] = None,
    site: Site = None,
    seed: options.Seed = 1,
) -> None:
    """Measure the panel with the rig's accelerometer.

    Keep everyone off the panel, because it moves. Multisines are played at three levels for 40 s, or 3 min if it is
    noisy. The command prints full scale, usable band, resonances and linearity. It writes a table of the complex
    response with its standard error and coherence, and a new rig file that names the table in [actuator.measured].
    It refuses a sensor that is dead or is not on this panel, and a response that is too uncertain. With --site, it
    measures the actuator of one site.
    """
    from datetime import UTC, datetime

    from palpate.experiment.apparatus import rig as rigs
    from palpate.experiment.apparatus.panel import calibration
    from palpate.experiment.errors import Interrupted, RigError

    before = rigs.load(rig).at(site)
    calibration.check_accelerometer(before)
    for file in (out, calibration.table_beside(out, site)):
        if file.exists():
            raise RigError(file, "this file already exists", "name another", allowed="a new file")
    if panel is not None and not before.rig.simulated:
        raise RigError(rig, "is not a simulated rig", "leave out --panel", allowed="a rig with simulated = true")
    with ExitStack() as opened:
        if before.rig.simulated:
            from palpate.experiment.rehearsal.wires import bench, modes

            typer.echo("SIMULATED: this panel is software, not a device", err=True)
            moving = modes.MovingPanel(modes.read(panel)) if panel is not None else None
            devices = opened.enter_context(bench.bench(before, moving, seed=seed))
        else:
            devices = opened.enter_context(calibration.devices(before, loudest=peak))
        try:
            input(
                f"Load: {load}. Keep everyone off the panel: it moves for 40 s, or 3 min if it is noisy. Press Enter: "
            )
            made = calibration.measure(devices, loudest=peak, seed=seed)
        except (KeyboardInterrupt, EOFError):
            raise Interrupted("the calibration was interrupted", remedy="nothing was written") from None
    for line in calibration.report(made):
        typer.echo(line)
    today = datetime.now(tz=UTC).astimezone().date()
    calibration.write(rig, out, made, load=load, today=today, days=days, site=site)
    typer.echo(f"Rig file: {out}")
