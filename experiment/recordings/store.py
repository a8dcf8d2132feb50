"""What is to be recorded, the takes that were saved so far, and the finished recordings.

Until all takes are there, each is saved in a folder `.NAME.partial` with its plan (materials, speeds and takes). Then
the recordings are written and moved into place in one piece. An interrupted recording continues, one process at a time;
one with another plan is refused.
"""

import hashlib
import io
import json
import re
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from filelock import FileLock, Timeout
from numpy.typing import NDArray
from scipy.io import wavfile

from palpate.experiment import storage
from palpate.experiment.apparatus.panel.accelerometer import Window
from palpate.experiment.apparatus.tracker.zeroing import Zero
from palpate.experiment.errors import RecordingError
from palpate.experiment.protocol import approval
from palpate.experiment.protocol.kinds.footstep import FASTEST_MM_S, SLOWEST_MM_S, Footstep
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.recordings.manifest import MANIFEST
from palpate.experiment.settings.load import toml

PLAN = "plan.json"
LOCK = "lock"

SIMULATED = "SIMULATED crackling noise, not a recording of a real object"
"""Label of every recording that a simulation made."""


@dataclass(frozen=True)
class Condition:
    """What one take is of: material (None for the bare panel), target speed, and number among those, from 1."""

    material: str | None
    speed_mm_s: float
    number: int


@dataclass(frozen=True)
class Plan:
    """What is recorded, saved while the recording is under way.

    `source` is the rig, or the simulation with its seed. The hashes are those of the protocol's canonical form and of
    the rig, empty without one. The bare panel comes before the `materials`, which are ids. Each condition has `takes`
    takes at rising target speeds; a take has `samples` at `rate_hz`.
    """

    source: str
    protocol_sha256: str
    rig_sha256: str
    simulated: bool
    materials: tuple[str, ...]
    speeds_mm_s: tuple[float, ...]
    takes: int
    rate_hz: int
    samples: int

    def conditions(self) -> tuple[Condition, ...]:
        """Return what every take is of, in order: the bare panel first, then the materials; slow to fast."""
        return tuple(
            Condition(material, speed_mm_s, number)
            for material in (None, *self.materials)
            for speed_mm_s in self.speeds_mm_s
            for number in range(1, self.takes + 1)
        )


def plan(
    protocol: Protocol,
    *,
    source: str,
    simulated: bool,
    rig_sha256: str = "",
    speeds_mm_s: tuple[float, ...] = (),
    takes: int | None = None,
) -> Plan:
    """Return a protocol's plan, with other speeds or takes if given. Raises `RecordingError` for bad ones."""
    synthesis = protocol.table(Footstep).synthesis
    speeds = tuple(float(v) for v in speeds_mm_s) or synthesis.speeds_mm_s
    if not (all(SLOWEST_MM_S <= v <= FASTEST_MM_S for v in speeds) and all(np.diff(speeds) > 0)):
        raise RecordingError(
            "speeds",
            f"got {', '.join(f'{v:g}' for v in speeds)} mm/s",
            "give increasing speeds within this range",
            allowed=f"{SLOWEST_MM_S:g} to {FASTEST_MM_S:g}, each above the previous one",
        )
    count = synthesis.takes if takes is None else takes
    if not 1 <= count <= 100:
        raise RecordingError("takes", f"got {count}", "give another number", allowed="1 to 100")
    return Plan(
        source=source,
        protocol_sha256=approval.sha256(protocol),
        rig_sha256=rig_sha256,
        simulated=simulated,
        materials=tuple(material.id for material in protocol.materials),
        speeds_mm_s=speeds,
        takes=count,
        rate_hz=synthesis.rate_hz,
        samples=synthesis.samples,
    )


@dataclass(frozen=True)
class Take(Condition):
    """One recording of a condition: acceleration, m/s^2, shape (N,).

    `achieved_mm_s` is the foot's speed through the gate, None without a tracker; `zero` None without zeroing.
    """

    samples_m_s2: NDArray[np.float64]
    achieved_mm_s: float | None = None
    zero: Zero | None = None


def write(directory: Path, *, takes: Iterable[Take], rate_hz: int, simulated: bool, label: str, note: str = "") -> Path:
    """Write takes as float32 WAV files, their manifest last, and return its path.

    Raises `RecordingError` if the directory is not empty, takes differ in length, or a sample is not finite.
    """
    takes = list(takes)
    lengths = sorted({take.samples_m_s2.size for take in takes})
    if len(lengths) != 1:
        raise RecordingError(
            directory, f"got takes of {lengths} samples", "trim them to the same length", allowed="one length"
        )
    for take in takes:
        if not np.all(np.isfinite(take.samples_m_s2)):
            raise RecordingError(
                f"take {take.number} of {take.material or 'the panel'}", "NaN or infinite", "record again"
            )
    if directory.exists() and any(directory.iterdir()):
        raise RecordingError(directory, "already contains files", "choose another", allowed="a new or empty directory")
    directory.mkdir(parents=True, exist_ok=True)
    lines = [
        "format = 1",
        f"label = {toml(label)}",
        f"note = {toml(note)}",
        f"simulated = {'true' if simulated else 'false'}",
        f"rate_hz = {rate_hz}",
        f"samples = {lengths[0]}",
        'unit = "m/s^2"',
    ]
    for place, take in enumerate(takes):
        slug = re.sub(r"[^a-z0-9]+", "_", (take.material or "panel").lower())
        file = f"{place:03d}_{slug}_{take.speed_mm_s:g}_{take.number}.wav"
        buffer = io.BytesIO()
        wavfile.write(buffer, rate_hz, take.samples_m_s2.astype(np.float32))
        storage.create(directory / file, buffer.getvalue())
        lines += ["", "[[takes]]", f"file = {toml(file)}"]
        if take.material is not None:
            lines.append(f"material = {toml(take.material)}")
        lines.append(f"speed_mm_s = {float(take.speed_mm_s)!r}")
        if take.achieved_mm_s is not None:
            lines.append(f"achieved_mm_s = {float(take.achieved_mm_s)!r}")
        if (zero := take.zero) is not None:
            offset_mm, spread_mm = float(zero.offset_mm), float(zero.spread_mm)
            lines.append(f"zero = {{ offset_mm = {offset_mm!r}, spread_mm = {spread_mm!r}, samples = {zero.samples} }}")
        lines += [f"number = {take.number}", f'sha256 = "{hashlib.sha256(buffer.getvalue()).hexdigest()}"']
    manifest = directory / MANIFEST
    storage.create(manifest, ("\n".join(lines) + "\n").encode())
    storage.sync_folder(directory)
    return manifest


def check(out: Path, planned: Plan) -> Path:
    """Return the folder of saved takes, which may not exist yet. Raises `RecordingError` if used by another plan."""
    # Resolved, so that "." has a name too.
    partial = out.resolve().with_name(f".{out.resolve().name}.partial")
    if partial.is_symlink():
        raise RecordingError(
            partial, "got a link", "remove it, or choose another --out", allowed="a folder made by palpate record"
        )
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        what = "already contains files" if out.is_dir() else "is a file"
        if (out / MANIFEST).is_file():
            what = "already contains recordings"
            _finish(partial, (out / MANIFEST).read_bytes())
        raise RecordingError(out, what, "choose another with --out", allowed="a new or empty folder")
    if not (partial / PLAN).exists():
        takes = len(list(partial.glob("*.npz")))
        if takes:
            raise RecordingError(
                partial,
                f"got {takes} takes without their {PLAN}, which lists their materials and speeds",
                "restore it, choose another --out, or remove the folder to start over",
                allowed="takes and plan together",
            )
        return partial
    try:
        found = storage.json_of(storage.read_bytes(partial / PLAN))
    except ValueError as error:
        raise RecordingError(partial / PLAN, f"is not JSON ({error})", f"remove {partial} to start over") from error
    wanted = json.loads(json.dumps(asdict(planned)))
    if not isinstance(found, dict):
        raise RecordingError(partial / PLAN, "is not a plan", f"remove {partial} to start over")
    differing = [_difference(key, found.get(key), wanted[key]) for key in wanted if found.get(key) != wanted[key]]
    if differing:
        raise RecordingError(
            partial,
            f"contains an interrupted recording with a different plan ({'; '.join(differing)})",
            "continue that plan, choose another --out, or remove the folder to start over",
        )
    return partial


@contextmanager
def begun(planned: Plan, out: Path) -> Iterator[Path]:
    """Lock the folder of saved takes and yield it. Raises `RecordingError` as `check`, and for a damaged take."""
    partial = check(out, planned)
    partial.mkdir(parents=True, exist_ok=True)
    lock = FileLock(partial / LOCK)
    try:
        lock.acquire(blocking=False)
    except Timeout as error:
        raise RecordingError(
            partial,
            f"another palpate record is running for {out}",
            "stop it, or choose another --out",
            allowed="one",
        ) from error
    try:
        # The process that held it until now may have finished, or begun something else.
        check(out, planned)
        if not (partial / PLAN).exists():
            storage.write(partial / PLAN, json.dumps(asdict(planned), indent=1).encode())
        for place, condition in enumerate(planned.conditions()):
            path = take_path(partial, place)
            if path.exists():
                _saved_take(path, condition)
        yield partial
    finally:
        lock.release()
        if not (partial / PLAN).exists() and not any(partial.glob("*.npz")):
            storage.remove_folder(partial)


def publish(planned: Plan, out: Path, *, note: str = "") -> Path:
    """Write the recordings, remove the takes, return the manifest's path. Raises `RecordingError` for a bad take."""
    partial = check(out, planned)
    takes = [_saved_take(take_path(partial, place), condition) for place, condition in enumerate(planned.conditions())]
    identity = f"protocol {planned.protocol_sha256}, rig {planned.rig_sha256}"
    note = "; ".join(filter(None, (f"recorded with palpate record, {planned.source}", note, f"SHA-256: {identity}")))
    label = SIMULATED if planned.simulated else planned.source
    with storage.new_folder(out.resolve()) as whole:
        manifest = write(
            whole, takes=takes, rate_hz=planned.rate_hz, simulated=planned.simulated, label=label, note=note
        )
        content = manifest.read_bytes()
        storage.write(partial / MANIFEST, content)
    _finish(partial, content)
    return out / manifest.name


def _finish(partial: Path, published: bytes) -> None:
    """Remove the kept takes of published recordings, known by their manifest."""
    if not partial.exists() or ((kept := partial / MANIFEST).is_file() and kept.read_bytes() == published):
        storage.remove_folder(partial)


def take_path(partial: Path, place: int) -> Path:
    """Return where the take at this place of the plan is kept."""
    return partial / f"{place:04d}.npz"


def save_take(path: Path, window: Window, achieved_mm_s: float, zero: Zero | None = None) -> None:
    """Put a take on disk, whole or not at all; its heights are counted from `zero`, where that is given."""
    content = io.BytesIO()
    zeros = [] if zero is None else [zero.offset_mm, zero.spread_mm, zero.samples]
    np.savez(
        content, samples_m_s2=window.samples_m_s2, achieved_mm_s=np.float64(achieved_mm_s), zero=np.array(zeros, float)
    )
    storage.write(path, content.getvalue())


def _difference(key: str, there: object, asked: object) -> str:
    if file := {"protocol_sha256": "the protocol", "rig_sha256": "the rig"}.get(key):
        return f"{file} {str(there)[:12]}... in the folder, {str(asked)[:12]}... requested (SHA-256)"
    return f"{key} {there!r} in the folder, {asked!r} requested"


def _saved_take(path: Path, condition: Condition) -> Take:
    try:
        with np.load(io.BytesIO(storage.read_bytes(path)), allow_pickle=False) as content:
            samples_m_s2, achieved_mm_s = content["samples_m_s2"], float(content["achieved_mm_s"])
            zeros = content["zero"].tolist()
            zero = Zero(zeros[0], zeros[1], round(zeros[2])) if zeros else None
    except (OSError, ValueError, KeyError, IndexError, zipfile.BadZipFile) as error:
        raise RecordingError(path, f"the take is damaged ({error})", "remove it, then record it again") from error
    return Take(condition.material, condition.speed_mm_s, condition.number, samples_m_s2, achieved_mm_s, zero)
