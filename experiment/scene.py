"""What one task needs, decided from the task alone, and the opening of just that."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from experiment.protocol.models import Protocol

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from experiment.synthesis.crinkle import CrinkleSpectra, Synthesised
    from experiment.synthesis.engine import Choice

Render = Callable[[str, float, int], "Synthesised"]
"""(material, foot speed in mm/s, output rate in Hz) -> the stimulus."""


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

    loaded = manifest.load(recordings, synthesis=protocol.synthesis, material_ids=scene.materials)
    return {
        material: crinkle.subtract(
            speeds_mm_s=protocol.synthesis.speeds_mm_s,
            rate_hz=protocol.synthesis.rate_hz,
            panel_object_takes=loaded.objects[material],
            panel_takes=loaded.panel,
            average=protocol.synthesis.average,
        )
        for material in scene.materials
    }


def fastest_mm_s(protocol: Protocol) -> float:
    """The fastest foot whose trial a protocol counts, mm/s; infinity where it names none."""
    limits = [rule.limit for rule in protocol.exclusion if rule.when == "speed-above" and rule.limit is not None]
    return min(limits, default=float("inf"))


def choose(spectra: CrinkleSpectra, protocol: Protocol, output_rate_hz: int) -> Choice:
    """How the stimuli of one material are computed: exactly, or on the tactile band where the rest is not felt.

    It is not felt where no bin outside the band reaches the floor at any speed that the protocol counts.

    Args:
        spectra: of the material.
        protocol: its tactile band and floor, and its fastest foot.
        output_rate_hz: samples a second that the actuator expects, Hz.

    Raises:
        SynthesisError: no waveform can be made at this rate.
    """
    from experiment.synthesis import engine, pruning

    tactile, fastest = protocol.tactile, fastest_mm_s(protocol)
    if fastest == float("inf") or (
        pruning.loudest_outside(spectra, band_hz=tactile.band_hz, fastest_mm_s=fastest) >= tactile.floor_m_s2
    ):
        return engine.choose(spectra, output_rate_hz=output_rate_hz)
    return engine.choose(spectra, output_rate_hz=output_rate_hz, band_hz=tactile.band_hz, allowed_relative_error=1.0)


def open_stimuli(*, scene: Scene, protocol: Protocol, recordings: Path, output_rates_hz: Sequence[int] = ()) -> Render:
    """Load the spectra that `scene` holds and return what renders a stimulus from them.

    Args:
        scene: a scene that needs synthesis.
        protocol: its protocol.
        recordings: folder with the recordings' manifest.
        output_rates_hz: rates that will be asked for, Hz. What a rate needs is prepared here; any other rate costs some
            milliseconds when it is first asked for.

    Raises:
        RecordingError: a recording is missing or unusable.
        SynthesisError: no waveform can be made of the recordings at one of the rates.
    """
    spectra = load_spectra(scene=scene, protocol=protocol, recordings=recordings)
    return prepare_stimuli(spectra, protocol=protocol, output_rates_hz=output_rates_hz)


def prepare_stimuli(
    spectra: Mapping[str, CrinkleSpectra], *, protocol: Protocol, output_rates_hz: Sequence[int] = ()
) -> Render:
    """What renders a stimulus from spectra; arguments and errors as in `open_stimuli`."""
    from experiment.synthesis import crinkle, methods

    @cache
    def renderer(material: str, output_rate_hz: int) -> methods.Renderer:
        choice = choose(spectra[material], protocol, output_rate_hz)
        return choice.prepare(spectra[material], output_rate_hz=output_rate_hz)

    for output_rate_hz in output_rates_hz:
        for material in spectra:
            renderer(material, output_rate_hz)

    def render(material: str, speed_mm_s: float, output_rate_hz: int) -> crinkle.Synthesised:
        return renderer(material, output_rate_hz)(speed_mm_s)

    return render


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
