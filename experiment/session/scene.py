"""What one task needs, decided from the task alone, and the opening of just that."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from palpate.experiment.protocol.kinds.footstep import Footstep
from palpate.experiment.protocol.models import Protocol, Task
from palpate.experiment.session.kind import session_kind

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from palpate.experiment.apparatus.rig import Rig
    from palpate.experiment.synthesis.crinkle import CrinkleSpectra
    from palpate.experiment.synthesis.noise import Colour
    from palpate.experiment.synthesis.waveforms import Basis


@dataclass(frozen=True)
class Scene:
    """What a task needs.

    Stimuli are made from the spectra of `materials`, those of the task and of the masker's probe, for what shakes
    (`actuator`). `masker` is the noise's color, None for none, and a microphone may listen to answers (`listens`).
    """

    actuator: bool
    materials: tuple[str, ...]
    masker: Colour | None
    listens: bool

    @property
    def synthesis(self) -> bool:
        """Whether stimuli are made from recordings."""
        return bool(self.materials)

    def sounds(self, rig: Rig) -> bool:
        """Return whether anything of an audio device is needed: headphones, a microphone, or an output that shakes."""
        return self.masker is not None or self.listens or (self.actuator and rig.actuator.driver == "audio")


def plan(*, protocol: Protocol, task_id: str) -> Scene:
    """Decide what task `task_id` needs."""
    task, whole = protocol.task(task_id), virtual(protocol)
    if task.masker is not None:
        whole = replace(whole, masker=None if task.masker == "none" else task.masker)
    if task.stimulus == "virtual":
        return replace(whole, materials=_played(protocol, [task]))
    return replace(whole, actuator=False, materials=())


def virtual(protocol: Protocol) -> Scene:
    """Return what all tasks with virtual stimuli need together, or one that presented every material."""
    every = [task.model_copy(update={"materials": None}) for task in protocol.tasks]
    return Scene(
        actuator=True,
        materials=_played(protocol, [task for task in protocol.tasks if task.stimulus == "virtual"] or every),
        masker=protocol.masker.noise,
        listens=protocol.answers.microphone,
    )


def played(protocol: Protocol, task_ids: Collection[str] | None = None) -> list[Scene]:
    """Return the scene of a task with virtual stimuli (of `task_ids`, if given) for each choice of materials."""
    virtual_ids = [t.id for t in protocol.tasks if t.stimulus == "virtual" and (task_ids is None or t.id in task_ids)]
    each = [plan(protocol=protocol, task_id=one) for one in virtual_ids] or [virtual(protocol)]
    return list({scene.materials: scene for scene in each}.values())


def _played(protocol: Protocol, tasks: Sequence[Task]) -> tuple[str, ...]:
    """Return the materials of which these tasks play recordings."""
    wanted = {material for task in tasks for material in session_kind(task).recorded(protocol, [task])}
    return tuple(material.id for material in protocol.materials if material.id in wanted)


def besides(*, scene: Scene, protocol: Protocol, recordings: Path) -> Scene:
    """Return a scene with the materials instead that are recorded and not its own; errors as `load_spectra`."""
    from palpate.experiment.recordings import manifest

    recorded = manifest.materials_of(recordings).difference(scene.materials)
    return replace(scene, materials=tuple(one.id for one in protocol.materials if one.id in recorded))


def load_spectra(*, scene: Scene, protocol: Protocol, recordings: Path) -> dict[str, CrinkleSpectra]:
    """Return the spectra of the materials of `scene` from their recordings. Raises `RecordingError`."""
    from palpate.experiment.recordings import manifest

    synthesis = protocol.table(Footstep).synthesis
    loaded = manifest.load(recordings, synthesis=synthesis, material_ids=scene.materials)
    return {material: loaded.spectra(material, average=synthesis.average) for material in scene.materials}


def fastest_mm_s(protocol: Protocol) -> float:
    """Return the speed of the fastest foot whose trial a protocol counts, mm/s; infinity if it names none."""
    limits = [rule.limit for rule in protocol.exclusion if rule.when == "speed-above" and rule.limit is not None]
    return min(limits, default=float("inf"))


def felt_outside(spectra: Mapping[str, CrinkleSpectra], protocol: Protocol) -> tuple[str, float]:
    """Return the material with the largest rms outside the tactile band at a speed that counts, and that, m/s^2.

    It is infinity if any speed counts. Raises `SynthesisError` if a speed that counts has no spectrum.
    """
    from palpate.experiment.synthesis.crinkle import rms_outside

    fastest, band_hz = fastest_mm_s(protocol), protocol.table(Footstep).tactile.band_hz
    if fastest == float("inf"):
        return next(iter(spectra)), fastest
    levels = {m: rms_outside(of, band_hz=band_hz, fastest_mm_s=fastest) for m, of in spectra.items()}
    loudest = max(levels, key=levels.__getitem__)
    return loudest, levels[loudest]


def open_stimuli(*, scene: Scene, protocol: Protocol, recordings: Path, output_rate_hz: int) -> dict[str, Basis]:
    """Return the prepared materials of `scene` by id, for an actuator's rate in Hz.

    Raises `RecordingError` for a bad recording, and `SynthesisError` if no waveform can be made at this rate.
    """
    spectra = load_spectra(scene=scene, protocol=protocol, recordings=recordings)
    return prepare_stimuli(spectra, protocol=protocol, output_rate_hz=output_rate_hz)


def prepare_stimuli(
    spectra: Mapping[str, CrinkleSpectra], *, protocol: Protocol, output_rate_hz: int
) -> dict[str, Basis]:
    """Return the materials of a task, prepared: with all their bins, or with those of the tactile band.

    Bins outside are left out if `felt_outside` is below the floor in every material: filtering only some would tell
    them apart. Raises as `open_stimuli`.
    """
    from palpate.experiment.synthesis import crinkle, waveforms

    tactile = protocol.table(Footstep).tactile
    if felt_outside(spectra, protocol)[1] < tactile.floor_m_s2:
        spectra = {material: crinkle.leave_out(of, band_hz=tactile.band_hz) for material, of in spectra.items()}
    return {
        material: waveforms.prepare(of, material=material, output_rate_hz=output_rate_hz)
        for material, of in spectra.items()
    }


def masker_samples(*, colour: Colour, rate_hz: int, seconds: float) -> NDArray[np.float64]:
    """Return a round of the masker's noise, rms 1, shape (n,), the same in all sessions. Raises `SynthesisError`."""
    import numpy as np

    from palpate.experiment.synthesis.noise import noise

    drawn = np.random.default_rng(0)
    return noise(colour=colour, samples=round(seconds * rate_hz), rate_hz=rate_hz, rng=drawn)
