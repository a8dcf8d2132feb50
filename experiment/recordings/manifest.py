"""Reading recordings of materials: one float WAV a take, and a `manifest.toml` that says what each take is of.

`store.py` writes them:

```toml
format = 1
label = "SIMULATED crackling noise"
note = "..."
simulated = true
rate_hz = 5000
samples = 2500
unit = "m/s^2"

[[takes]]
file = "000_panel_50_1.wav"     # a take without material is one of the bare panel
speed_mm_s = 50.0               # the target
achieved_mm_s = 51.3            # measured by the tracker; left out where there was none
# where the foot rested before (calibration.py): heights are counted from there; left out without tracker.zeroing_mm
zero = { offset_mm = 1.21, spread_mm = 0.08, samples = 2500 }
number = 1
sha256 = "..."
```
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from palpate.experiment import storage
from palpate.experiment.errors import ProtocolError, RecordingError, Remedy
from palpate.experiment.protocol.kinds.footstep import Synthesis
from palpate.experiment.recordings.wav import wav_samples
from palpate.experiment.settings import load as settings
from palpate.experiment.settings.load import ONE_LINE, Confined, Name, Remark
from palpate.experiment.synthesis.crinkle import Average, CrinkleSpectra, subtract

MANIFEST = "manifest.toml"

LARGEST = 8 * 2**20
"""No manifest is larger, bytes: tens of thousands of takes."""


@dataclass(frozen=True)
class Recordings:
    """The takes of the requested materials, in m/s^2, sampled at `rate_hz`.

    `simulated`: a simulation made some of them. `speeds_mm_s` are target speeds, shape (S,); takes of the bare `panel`
    and of each of the `objects` have shape (S, T, N).
    """

    label: str
    simulated: bool
    rate_hz: int
    speeds_mm_s: NDArray[np.float64]
    panel: NDArray[np.float64]
    objects: Mapping[str, NDArray[np.float64]]

    def spectra(self, material: str, *, average: Average = "magnitude") -> CrinkleSpectra:
        """Return the spectra of one material without the panel: equation (2) of Okamoto et al.

        Raises `RecordingError` for a material without takes, and `SynthesisError` as `subtract`.
        """
        if material not in self.objects:
            known = ", ".join(self.objects)
            raise RecordingError("recordings", f"got material {material!r}", "name one", allowed=known)
        return subtract(
            speeds_mm_s=self.speeds_mm_s,
            rate_hz=self.rate_hz,
            panel_object_takes=self.objects[material],
            panel_takes=self.panel,
            average=average,
        )


class _Zero(Confined):
    offset_mm: Annotated[float, Field(allow_inf_nan=False)]
    spread_mm: Annotated[float, Field(ge=0, allow_inf_nan=False)]
    samples: Annotated[int, Field(ge=2)]


class _Take(Confined):
    file: Annotated[
        str, Field(pattern=r"^[^/\\]+\.wav$", description="the name of a .wav file in this folder"), ONE_LINE
    ]
    material: Name | None = None
    speed_mm_s: Annotated[float, Field(gt=0, allow_inf_nan=False)]
    achieved_mm_s: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    zero: _Zero | None = None
    number: Annotated[int, Field(ge=1, le=1000)]
    sha256: Annotated[
        str, Field(pattern=r"^[0-9a-f]{64}$", description="64 hexadecimal digits, as sha256sum prints them")
    ]


class Manifest(Confined):
    """What `manifest.toml` holds."""

    format: Literal[1]
    label: Remark
    note: Remark = ""
    simulated: bool
    rate_hz: Annotated[int, Field(ge=1)]
    samples: Annotated[int, Field(ge=1)]
    unit: Literal["m/s^2"]
    takes: tuple[_Take, ...]


def sha256(directory: Path) -> str:
    """Return the SHA-256 of the manifest, which holds the hash of every take. Raises `RecordingError`."""
    try:
        return hashlib.sha256(storage.read_bytes(directory / MANIFEST)).hexdigest()
    except OSError as error:
        raise _unreadable(directory / MANIFEST) from error


def is_simulated(directory: Path) -> bool:
    """Return whether a simulation made a set of recordings. Raises `RecordingError` as `load` does of a manifest."""
    return _read(directory / MANIFEST).simulated


def materials_of(directory: Path) -> frozenset[str]:
    """Return the ids of the materials of which there are takes. Raises `RecordingError` as `is_simulated`."""
    return frozenset(take.material for take in _read(directory / MANIFEST).takes if take.material is not None)


def load(directory: Path, *, synthesis: Synthesis, material_ids: Sequence[str]) -> Recordings:
    """Return the checked takes of the bare panel and of the requested materials.

    Raises `RecordingError` for a bad manifest, another rate or length than the protocol's, or a take that is missing,
    listed twice, changed, damaged, not float, not mono or not finite.
    """
    path = directory / MANIFEST
    manifest = _read(path)
    for name in ("rate_hz", "samples"):
        got, allowed = getattr(manifest, name), getattr(synthesis, name)
        if got != allowed:
            raise RecordingError(
                path,
                f"{name}: got {got}",
                "record again, or change one of these files",
                allowed=f"{allowed}, as in the protocol",
            )
    return _loaded(directory, manifest, synthesis.speeds_mm_s, synthesis.takes, material_ids)


RECORD = ("palpate", "record", "PROTOCOL", "--rig", "RIG", "--out", "FOLDER")
"""The command that records; a folder of recordings does not name its protocol and its rig file."""


def load_all(directory: Path) -> Recordings:
    """Return all checked takes, as many at each speed for every material. Raises `RecordingError`, also for none."""
    path = directory / MANIFEST
    manifest = _read(path)
    materials = dict.fromkeys(take.material for take in manifest.takes if take.material is not None)
    if not materials:
        raise RecordingError(
            path,
            f"got {len(manifest.takes)} takes, but none of a material",
            Remedy("record them with {}", RECORD),
            allowed="takes of at least one material and of the bare panel",
        )
    speeds_mm_s = sorted({take.speed_mm_s for take in manifest.takes})
    return _loaded(directory, manifest, speeds_mm_s, max(take.number for take in manifest.takes), tuple(materials))


def _loaded(
    directory: Path, manifest: Manifest, speeds_mm_s: Sequence[float], takes: int, material_ids: Sequence[str]
) -> Recordings:
    path = directory / MANIFEST
    by_condition: dict[tuple[str | None, float, int], _Take] = {}
    for take in manifest.takes:
        condition = (take.material, take.speed_mm_s, take.number)
        if condition in by_condition:
            raise RecordingError(
                path,
                f"got {take.file} and {by_condition[condition].file} for {_condition(*condition)}",
                "remove one of them from the manifest",
                allowed="one file",
            )
        by_condition[condition] = take
    wanted = [
        [(material, speed_mm_s, number) for speed_mm_s in speeds_mm_s for number in range(1, takes + 1)]
        for material in (None, *material_ids)
    ]
    for condition in (condition for of_material in wanted for condition in of_material):
        if condition not in by_condition:
            raise RecordingError(
                path,
                f"got no {_condition(*condition)}",
                "record the missing takes",
                allowed=f"{takes} takes at each of {list(speeds_mm_s)} mm/s",
            )

    def takes_of(conditions: list[tuple[str | None, float, int]]) -> NDArray[np.float64]:
        found = [by_condition[condition] for condition in conditions]
        samples = [_samples(directory / take.file, take=take, manifest=manifest) for take in found]
        return np.reshape(samples, (len(speeds_mm_s), takes, manifest.samples))

    return Recordings(
        label=manifest.label,
        simulated=manifest.simulated,
        rate_hz=manifest.rate_hz,
        speeds_mm_s=np.array(speeds_mm_s, dtype=np.float64),
        panel=takes_of(wanted[0]),
        objects={material: takes_of(of_it) for material, of_it in zip(material_ids, wanted[1:], strict=True)},
    )


def _condition(material: str | None, speed_mm_s: float, number: int) -> str:
    return f"take {number} of {material or 'the bare panel'} at {speed_mm_s:g} mm/s"


def _unreadable(path: Path) -> RecordingError:
    return RecordingError(
        path, "cannot be read", "give another folder", allowed=f"a folder of recordings with a {MANIFEST}"
    )


def _read(path: Path) -> Manifest:
    if not path.is_file():
        raise _unreadable(path)
    try:
        return settings.checked(path, Manifest, *settings.parsed(path, LARGEST))
    except ProtocolError as error:
        first, *others = error.findings
        more = f" ({len(others)} more)" if others else ""
        remedy = f"correct the manifest, or restore it from a backup{more}"
        raise RecordingError.at(replace(first, remedy=remedy)) from error


def _samples(path: Path, *, take: _Take, manifest: Manifest) -> NDArray[np.float64]:
    try:
        content = storage.read_bytes(path)
    except OSError as error:
        raise RecordingError(
            path, f"cannot be read ({error.strerror})", "restore it", allowed="the file named in the manifest"
        ) from error
    rate_hz, samples = wav_samples(content, file=str(path))

    def refuse(got: str, allowed: str, remedy: str) -> RecordingError:
        return RecordingError(path, f"got {got}", remedy, allowed=allowed)

    if rate_hz != manifest.rate_hz:
        raise refuse(f"{rate_hz} Hz", f"{manifest.rate_hz} Hz, as in the manifest", "record or resample it again")
    if samples.dtype.kind != "f":
        raise refuse(f"{samples.dtype} samples", "float samples in m/s^2", "save it as a float WAV")
    if samples.ndim != 1:
        raise refuse(f"{samples.shape[1]} channels", "one channel", "save only the accelerometer channel")
    if samples.size != manifest.samples:
        raise refuse(f"{samples.size} samples", f"{manifest.samples}, as in the manifest", "trim it or record it again")
    if not np.all(np.isfinite(samples)):
        raise refuse("NaN or infinite samples", "finite numbers", "record it again")
    digest = hashlib.sha256(content).hexdigest()
    if digest != take.sha256:
        raise refuse(f"sha256 {digest[:12]}...", f"{take.sha256[:12]}..., as in the manifest", "restore the file")
    return samples.astype(np.float64)
