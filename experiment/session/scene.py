"""What one task needs, decided from the task alone, and the opening of just that."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from experiment.protocol.models import Protocol

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from experiment.synthesis.crinkle import CrinkleSpectra
    from experiment.synthesis.waveforms import Basis


@dataclass(frozen=True)
class Scene:
    """What a task needs.

    Attributes:
        task: id of the task.
        synthesis: whether stimuli are synthesised; a task with real objects opens no spectra.
        actuator: whether the panel is driven.
        place: whether the experimenter lays out a real object before each step.
        materials: the materials whose spectra are held.
    """

    task: str
    synthesis: bool
    actuator: bool
    place: bool
    materials: tuple[str, ...]


def plan(*, protocol: Protocol, task_id: str) -> Scene:
    """Decide what task `task_id` needs."""
    virtual = protocol.task(task_id).stimulus == "virtual"
    materials = tuple(m.id for m in protocol.materials) if virtual else ()
    return Scene(task_id, synthesis=virtual, actuator=virtual, place=not virtual, materials=materials)


def load_spectra(*, scene: Scene, protocol: Protocol, recordings: Path) -> dict[str, CrinkleSpectra]:
    """The spectra of the materials that `scene` holds, and of no others.

    Args:
        scene: a scene that needs synthesis.
        protocol: its protocol.
        recordings: folder with the recordings' manifest.

    Raises:
        RecordingError: a recording is missing or unusable.
    """
    from experiment.recordings import manifest
    from experiment.synthesis import crinkle

    loaded = manifest.load(recordings, synthesis=protocol.footstep.synthesis, material_ids=scene.materials)
    return {
        material: crinkle.subtract(
            speeds_mm_s=protocol.footstep.synthesis.speeds_mm_s,
            rate_hz=protocol.footstep.synthesis.rate_hz,
            panel_object_takes=loaded.objects[material],
            panel_takes=loaded.panel,
            average=protocol.footstep.synthesis.average,
        )
        for material in scene.materials
    }


def fastest_mm_s(protocol: Protocol) -> float:
    """The fastest foot whose trial a protocol counts, mm/s; infinity where it names none."""
    limits = [rule.limit for rule in protocol.exclusion if rule.when == "speed-above" and rule.limit is not None]
    return min(limits, default=float("inf"))


def felt_outside(spectra: Mapping[str, CrinkleSpectra], protocol: Protocol) -> tuple[str, float]:
    """The material of which most lies outside the tactile band at a speed that the protocol counts.

    Args:
        spectra: of each material of a task.
        protocol: its tactile band, and its fastest foot.

    Returns:
        The material, and the largest rms of what lies outside, m/s^2; infinity where any speed counts.

    Raises:
        SynthesisError: a speed that counts and has no spectrum.
    """
    from experiment.synthesis.crinkle import rms_outside

    fastest, band_hz = fastest_mm_s(protocol), protocol.footstep.tactile.band_hz
    if fastest == float("inf"):
        return next(iter(spectra)), fastest
    levels = {m: rms_outside(of, band_hz=band_hz, fastest_mm_s=fastest) for m, of in spectra.items()}
    loudest = max(levels, key=levels.__getitem__)
    return loudest, levels[loudest]


def open_stimuli(*, scene: Scene, protocol: Protocol, recordings: Path, output_rate_hz: int) -> dict[str, Basis]:
    """Return the materials that `scene` holds, by their ids, prepared from their recordings.

    Args:
        scene: a scene that needs synthesis.
        protocol: its protocol.
        recordings: folder with the recordings' manifest.
        output_rate_hz: samples a second that the actuator expects, Hz.

    Raises:
        RecordingError: a recording is missing or unusable.
        SynthesisError: no waveform can be made of the recordings at this rate.
    """
    spectra = load_spectra(scene=scene, protocol=protocol, recordings=recordings)
    return prepare_stimuli(spectra, protocol=protocol, output_rate_hz=output_rate_hz)


def prepare_stimuli(
    spectra: Mapping[str, CrinkleSpectra], *, protocol: Protocol, output_rate_hz: int
) -> dict[str, Basis]:
    """Return the materials of a task, prepared: with all their bins, or with those of the tactile band.

    Bins outside the band are left out where of no material what lies outside reaches the floor (`felt_outside`). That
    is decided for all materials together: were some filtered and others not, participants could tell them apart by
    that. Arguments and errors are otherwise as in `open_stimuli`.

    Args:
        spectra: of each material.
        protocol: its tactile band and floor, and its fastest foot.
        output_rate_hz: as in `open_stimuli`.
    """
    from experiment.synthesis import crinkle, waveforms

    tactile = protocol.footstep.tactile
    if felt_outside(spectra, protocol)[1] < tactile.floor_m_s2:
        spectra = {material: crinkle.leave_out(of, band_hz=tactile.band_hz) for material, of in spectra.items()}
    return {
        material: waveforms.prepare(of, material=material, output_rate_hz=output_rate_hz)
        for material, of in spectra.items()
    }


def masker_samples(*, protocol: Protocol, rate_hz: int, seconds: float) -> NDArray[np.float64]:
    """One round of the masker's noise: the same in every session, for a masker is no random draw of a study.

    Args:
        protocol: says which noise.
        rate_hz: of the audio device, Hz.
        seconds: length of a round, s.

    Returns:
        Rms 1, shape (n,).

    Raises:
        SynthesisError: no noise can be made at this rate.
    """
    import numpy as np

    from experiment.synthesis.noise import noise

    drawn = np.random.default_rng(0)
    return noise(colour=protocol.masker.noise, samples=round(seconds * rate_hz), rate_hz=rate_hz, rng=drawn)
