"""Takes that were kept, until all are there: then the recordings are written and moved into place in one piece.

They lie, each whole, in a folder `.NAME.partial` beside the one asked for, with the plan that they belong to. A folder
of recordings is therefore complete or absent, and an interrupted recording goes on where it stopped, one process at a
time; one with another plan is refused.
"""

from __future__ import annotations

import io
import json
import shutil
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

import numpy as np
from filelock import FileLock, Timeout

from experiment import files
from experiment.apparatus.ports import Window
from experiment.apparatus.zeroing import Zero
from experiment.errors import RecordingError
from experiment.recordings.plan import Condition, Plan
from experiment.recordings.writing import Take, write

PLAN = "plan.json"
LOCK = "lock"

SIMULATED = "SIMULATED crackling noise, no recording of a real object"
"""Label of every recording that a simulation made."""

_FILES = {"protocol_sha256": "the protocol", "rig_sha256": "the rig"}
"""What hashes in a plan are of."""


def check(out: Path, planned: Plan) -> Path:
    """Refuse a folder that is in use, or in which something else was begun.

    Returns:
        The folder of the takes that are kept until all are there; it may not exist yet.

    Raises:
        RecordingError: saying which.
    """
    if out.exists() and not out.is_dir():
        raise RecordingError(f"{out}: is a file; allowed: a new or empty folder; choose another with --out")
    if out.exists() and any(out.iterdir()):
        raise RecordingError(f"{out}: holds files already; allowed: a new or empty folder; choose another with --out")
    partial = _beside(out, "partial")
    if not (partial / PLAN).exists():
        takes = len(list(partial.glob("*.npz")))
        if takes:
            raise RecordingError(
                f"{partial}: got {takes} takes without their {PLAN}, so of what they are is not known; allowed: both; "
                "restore it, choose another --out, or remove the folder to start clean"
            )
        return partial
    try:
        begun = json.loads((partial / PLAN).read_text("utf-8"))
    except ValueError as error:
        raise RecordingError(f"{partial / PLAN}: got no JSON ({error}); remove {partial} to start clean") from error
    wanted = json.loads(json.dumps(asdict(planned)))
    if not isinstance(begun, dict):
        raise RecordingError(f"{partial / PLAN}: got no plan; remove {partial} to start clean")
    differing = [_difference(key, begun.get(key), wanted[key]) for key in wanted if begun.get(key) != wanted[key]]
    if differing:
        raise RecordingError(
            f"{partial}: holds an interrupted recording of another plan ({'; '.join(differing)}); "
            "go on with that plan, choose another --out, or remove the folder to start clean"
        )
    return partial


@contextmanager
def begun(planned: Plan, out: Path) -> Iterator[Path]:
    """The folder of kept takes, held for this process; the operating system lets go however that ends.

    Raises:
        RecordingError: as `check`; a kept take is damaged; or another process records there.
    """
    partial = check(out, planned)
    partial.mkdir(parents=True, exist_ok=True)
    lock = FileLock(partial / LOCK)
    try:
        lock.acquire(blocking=False)
    except Timeout as error:
        raise RecordingError(
            f"{partial}: another palpate record is under way for {out}; allowed: one; end it there, or choose another "
            "--out"
        ) from error
    try:
        # Whoever held it until now may have finished, or begun something else.
        check(out, planned)
        if not (partial / PLAN).exists():
            files.write(partial / PLAN, json.dumps(asdict(planned), indent=1).encode())
        for place, condition in enumerate(planned.conditions()):
            path = take_path(partial, place)
            if path.exists():
                _kept(path, condition)
        yield partial
    finally:
        lock.release()
        if not (partial / PLAN).exists() and not any(partial.glob("*.npz")):
            shutil.rmtree(partial, ignore_errors=True)


def publish(planned: Plan, out: Path, *, note: str = "") -> Path:
    """Write the recordings from the takes that were kept, and remove those once the recordings are on disk.

    Args:
        planned: what they are of.
        out: their folder.
        note: what the manifest says besides.

    Returns:
        Path of the manifest.

    Raises:
        RecordingError: a take is missing or damaged.
    """
    partial = check(out, planned)
    takes = [_kept(take_path(partial, place), condition) for place, condition in enumerate(planned.conditions())]
    whole = _beside(out, "whole")
    shutil.rmtree(whole, ignore_errors=True)
    identity = f"protocol {planned.protocol_sha256}, rig {planned.rig_sha256}"
    manifest = write(
        whole,
        takes=takes,
        rate_hz=planned.rate_hz,
        simulated=planned.simulated,
        label=SIMULATED if planned.simulated else planned.source,
        note="; ".join(filter(None, (f"recorded with palpate record, {planned.source}", note, f"SHA-256: {identity}"))),
    )
    if out.exists():
        out.rmdir()
    whole.replace(out)
    files.sync_folder(out.parent)
    for kept in (*partial.glob("*.npz"), partial / PLAN):
        kept.unlink()
    return out / manifest.name


def take_path(partial: Path, place: int) -> Path:
    """Where the take at this place of the plan lies once it is kept."""
    return partial / f"{place:04d}.npz"


def keep(path: Path, window: Window, achieved_mm_s: float, zero: Zero | None = None) -> None:
    """Put a take on disk: whole, or not at all. `zero` is what its heights count from, if anything."""
    content = io.BytesIO()
    zeros = [] if zero is None else [zero.offset_mm, zero.spread_mm, zero.samples]
    np.savez(
        content, samples_m_s2=window.samples_m_s2, achieved_mm_s=np.float64(achieved_mm_s), zero=np.array(zeros, float)
    )
    files.write(path, content.getvalue())


def _difference(key: str, there: object, asked: object) -> str:
    if key in _FILES:
        return f"{_FILES[key]} {str(there)[:12]}... there, {str(asked)[:12]}... asked for (SHA-256)"
    return f"{key} {there!r} there, {asked!r} asked for"


def _beside(out: Path, kind: str) -> Path:
    # Resolved, so that "." has a name too.
    place = out.resolve()
    return place.with_name(f".{place.name}.{kind}")


def _kept(path: Path, condition: Condition) -> Take:
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as content:
            samples_m_s2, achieved_mm_s = content["samples_m_s2"], float(content["achieved_mm_s"])
            zeros = content["zero"].tolist()
            zero = Zero(zeros[0], zeros[1], round(zeros[2])) if zeros else None
    except (OSError, ValueError, KeyError, IndexError, zipfile.BadZipFile) as error:
        raise RecordingError(f"{path}: got a damaged take ({error}); remove it, then record it again") from error
    return Take(condition.material, condition.speed_mm_s, condition.number, samples_m_s2, achieved_mm_s, zero)
