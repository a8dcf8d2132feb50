"""Takes that were kept, until all are there: then the recordings are written and moved into place in one piece.

They lie, each whole, in a folder `.NAME.partial` beside the one asked for. A folder of recordings is therefore complete
or absent, and an interrupted recording goes on where it stopped; one with another plan is refused.
"""

from __future__ import annotations

import io
import json
import os
import shutil
import zipfile
from dataclasses import asdict
from pathlib import Path

import numpy as np

from experiment.apparatus.ports import Window
from experiment.errors import RecordingError
from experiment.recordings.manifest import Take, write
from experiment.recordings.plan import Condition, Plan

PLAN = "plan.json"


def check(out: Path, planned: Plan) -> Path:
    """Refuse a folder that is in use, or in which something else was begun.

    Returns:
        The folder of the takes that are kept until all are there; it may not exist yet.

    Raises:
        RecordingError: saying which.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise RecordingError(f"{out}: holds files already; allowed: a new or empty folder; choose another with --out")
    partial = _beside(out, "partial")
    if not (partial / PLAN).exists():
        return partial
    try:
        begun = json.loads((partial / PLAN).read_text("utf-8"))
    except ValueError as error:
        raise RecordingError(f"{partial / PLAN}: got no JSON ({error}); remove {partial} to start clean") from error
    wanted = json.loads(json.dumps(asdict(planned)))
    if not isinstance(begun, dict):
        raise RecordingError(f"{partial / PLAN}: got no plan; remove {partial} to start clean")
    if begun != wanted:
        differing = [
            f"{key} {begun.get(key)!r} there, {wanted[key]!r} asked for"
            for key in wanted
            if begun.get(key) != wanted[key]
        ]
        raise RecordingError(
            f"{partial}: holds an interrupted recording of another plan ({'; '.join(differing)}); "
            "go on with that plan, choose another --out, or remove the folder to start clean"
        )
    return partial


def begin(planned: Plan, out: Path) -> Path:
    """Make the folder of kept takes, or find it.

    Raises:
        RecordingError: as `check`.
    """
    partial = check(out, planned)
    partial.mkdir(parents=True, exist_ok=True)
    _put(partial / PLAN, json.dumps(asdict(planned), indent=1).encode())
    return partial


def publish(planned: Plan, out: Path) -> Path:
    """Write the recordings from the takes that were kept, and remove those.

    Returns:
        Path of the manifest.

    Raises:
        RecordingError: a take is missing or damaged.
    """
    partial = check(out, planned)
    takes = [_kept(take_path(partial, place), condition) for place, condition in enumerate(planned.conditions())]
    whole = _beside(out, "whole")
    shutil.rmtree(whole, ignore_errors=True)
    manifest = write(
        whole,
        takes=takes,
        rate_hz=planned.rate_hz,
        simulated=planned.simulated,
        label="SIMULATED crackling noise, no recording of a real object" if planned.simulated else planned.source,
        note=f"recorded with palpate record, {planned.source}",
    )
    if out.exists():
        out.rmdir()
    whole.replace(out)
    shutil.rmtree(partial)
    return out / manifest.name


def take_path(partial: Path, place: int) -> Path:
    """Where the take at this place of the plan lies once it is kept."""
    return partial / f"{place:04d}.npz"


def keep(path: Path, window: Window, achieved_mm_s: float) -> None:
    """Put a take on disk: whole, or not at all."""
    content = io.BytesIO()
    np.savez(content, samples_m_s2=window.samples_m_s2, achieved_mm_s=np.float64(achieved_mm_s))
    _put(path, content.getvalue())


def _beside(out: Path, kind: str) -> Path:
    # Resolved, so that "." has a name too.
    place = out.resolve()
    return place.with_name(f".{place.name}.{kind}")


def _kept(path: Path, condition: Condition) -> Take:
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as content:
            samples_m_s2, achieved_mm_s = content["samples_m_s2"], float(content["achieved_mm_s"])
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise RecordingError(f"{path}: got a damaged take ({error}); remove it, then record it again") from error
    return Take(condition.material, condition.speed_mm_s, condition.number, samples_m_s2, achieved_mm_s)


def _put(path: Path, content: bytes) -> None:
    """Whole on disk, or not there."""
    partial = path.with_name(f"{path.name}.writing")
    with partial.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)
