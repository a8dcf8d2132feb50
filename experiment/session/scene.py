"""What one task needs, decided from the task alone, and the opening of just that."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from experiment.protocol.models import Protocol
from experiment.records.stimulus import Computed

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from experiment.synthesis.crinkle import CrinkleSpectra
    from experiment.synthesis.engine import Choice
    from experiment.synthesis.waveforms import Renderer, Synthesised


@dataclass(frozen=True)
class Rendered:
    """A stimulus, and how it was computed."""

    stimulus: Synthesised
    computed: Computed


Render = Callable[[str, float, int], Rendered]
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
    from experiment.synthesis.pruning import loudest_outside

    fastest, band_hz = fastest_mm_s(protocol), protocol.footstep.tactile.band_hz
    if fastest == float("inf"):
        return next(iter(spectra)), fastest
    levels = {m: loudest_outside(of, band_hz=band_hz, fastest_mm_s=fastest) for m, of in spectra.items()}
    loudest = max(levels, key=levels.__getitem__)
    return loudest, levels[loudest]


def choose(spectra: Mapping[str, CrinkleSpectra], protocol: Protocol, output_rate_hz: int) -> dict[str, Choice]:
    """How the stimuli of a task's materials are computed: exactly, or on the tactile band where the rest is not felt.

    It is not felt where of no material what lies outside reaches the floor (`felt_outside`). That is decided for all
    materials together: were some filtered and others not, participants could tell them apart by that.

    Args:
        spectra: of each material of a task.
        protocol: its tactile band and floor, and its fastest foot.
        output_rate_hz: samples a second that the actuator expects, Hz.

    Raises:
        SynthesisError: no waveform can be made at this rate.
    """
    from experiment.synthesis import engine, pruning

    if felt_outside(spectra, protocol)[1] >= protocol.footstep.tactile.floor_m_s2:
        return {material: engine.choose(of, output_rate_hz=output_rate_hz) for material, of in spectra.items()}
    band_hz = protocol.footstep.tactile.band_hz

    def on_the_band(of: CrinkleSpectra) -> Choice:
        left_out = pruning.left_out_error(of, band_hz=band_hz, on=of.grid(output_rate_hz))
        allowed = left_out + engine.EXACT
        return engine.choose(of, output_rate_hz=output_rate_hz, band_hz=band_hz, allowed_relative_error=allowed)

    return {material: on_the_band(of) for material, of in spectra.items()}


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

    @cache
    def chosen(output_rate_hz: int) -> dict[str, tuple[Renderer, Computed]]:
        return {
            material: (
                choice.prepare(spectra[material], output_rate_hz=output_rate_hz),
                Computed(method=choice.method.name, relative_error=choice.estimate.relative_error),
            )
            for material, choice in choose(spectra, protocol, output_rate_hz).items()
        }

    for output_rate_hz in output_rates_hz:
        chosen(output_rate_hz)

    def render(material: str, speed_mm_s: float, output_rate_hz: int) -> Rendered:
        renderer, computed = chosen(output_rate_hz)[material]
        return Rendered(renderer(speed_mm_s), computed)

    return render


def examples(render: Render, scene: Scene, protocol: Protocol, output_rate_hz: int) -> list[Synthesised]:
    """A stimulus of each material that a scene holds, for what is to be prepared for their like."""
    speed_mm_s = protocol.footstep.synthesis.speeds_mm_s[0]
    return [render(material, speed_mm_s, output_rate_hz).stimulus for material in scene.materials]


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
