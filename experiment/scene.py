"""What one task needs, decided from the task alone, and the opening of just that."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from experiment.protocol.models import Protocol

if TYPE_CHECKING:
    from experiment.synthesis.crinkle import Synthesised

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
    from experiment.recordings import manifest
    from experiment.synthesis import crinkle, engine, methods

    loaded = manifest.load(recordings, synthesis=protocol.synthesis, material_ids=scene.materials)
    spectra = {
        material: crinkle.subtract(
            speeds_mm_s=protocol.synthesis.speeds_mm_s,
            rate_hz=protocol.synthesis.rate_hz,
            panel_object_takes=loaded.objects[material],
            panel_takes=loaded.panel,
            average=protocol.synthesis.average,
        )
        for material in scene.materials
    }

    @cache
    def renderer(material: str, output_rate_hz: int) -> methods.Renderer:
        choice = engine.choose(spectra[material], output_rate_hz=output_rate_hz)
        return choice.prepare(spectra[material], output_rate_hz=output_rate_hz)

    for output_rate_hz in output_rates_hz:
        for material in scene.materials:
            renderer(material, output_rate_hz)

    def render(material: str, speed_mm_s: float, output_rate_hz: int) -> crinkle.Synthesised:
        return renderer(material, output_rate_hz)(speed_mm_s)

    return render
