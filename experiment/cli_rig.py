"""The commands of a rig: devices, calibrate."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

rig_commands = typer.Typer()
calibrate = typer.Typer(
    help="Calibrate a device of the rig.", epilog="Example: palpate calibrate tracker --rig our-rig.toml"
)
rig_commands.add_typer(calibrate, name="calibrate")

RigFile = Annotated[Path, typer.Option("--rig", help="Rig file of this laboratory.")]


@calibrate.command("tracker", epilog="Example: palpate calibrate tracker --rig our-rig.toml --out new-rig.toml")
def calibrate_tracker(
    rig: RigFile,
    points: Annotated[str, typer.Option("--points", help="Heights above the panel, mm.")] = "-2,0,10,20,50",
    days: Annotated[int, typer.Option("--days", min=1, max=3650, help="For how many days it will hold.")] = 90,
    protocol: Annotated[
        Path | None, typer.Option("--protocol", help="Protocol file whose gate the calibration must reach past.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="New rig file; by default the table is printed.")] = None,
) -> None:
    """Calibrate the tracker at known heights.

    Walks through the heights, reads the sensor at each, and prints points, residuals and noise. The rig file itself is
    never changed: --out writes a new one, or the printed lines replace the old ones under [tracker].
    """
    from experiment import files
    from experiment.apparatus import calibrating
    from experiment.apparatus import rig as rigs
    from experiment.clock import MonotonicClock
    from experiment.errors import Interrupted, RigError
    from experiment.protocol import load

    heights_mm = calibrating.heights(points)
    step = load.load(protocol).step if protocol is not None else None
    if out is not None and out.exists():
        raise RigError(f"{out}: exists; allowed: a new file; name another")
    before = rigs.load(rig)
    try:
        made = calibrating.walk(before, heights_mm, ask=input, clock=MonotonicClock())
    except (KeyboardInterrupt, EOFError):
        raise Interrupted("the calibration was interrupted; nothing was written") from None
    after = calibrating.calibrated(before, made, days)
    for line in calibrating.report(made, after, step):
        typer.echo(line)
    if out is None:
        typer.echo(f"\n{calibrating.table(after)}")
    else:
        files.write(out, calibrating.rewritten(rig.read_text("utf-8-sig"), after).encode())
        typer.echo(f"Rig file: {out}")


@rig_commands.command(epilog="Example: palpate devices --json")
def devices(
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")] = False,
) -> None:
    """List the devices of this machine: serial ports, what is behind them, and who holds them."""
    from experiment.apparatus import serial_devices

    serial = serial_devices.devices()
    if as_json:
        typer.echo(json.dumps({"serial": [asdict(device) for device in serial]}, indent=2, ensure_ascii=False))
        return
    typer.echo("Serial ports, as tracker.port names them:")
    for device in serial:
        held = f"  held by {', '.join(device.held_by)}" if device.held_by else ""
        typer.echo(f"  {device.port}  {device.description}  {device.identity}".rstrip() + held)
    if not serial:
        typer.echo("  none")
