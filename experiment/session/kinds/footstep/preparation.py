"""From a study's recordings to the prepared materials of a scene."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.errors import RecordingError, Remedy
from palpate.experiment.protocol.kinds.footstep import KIND, Footstep
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.recordings import manifest
from palpate.experiment.session.scene import Scene, virtual
from palpate.experiment.synthesis import waveforms
from palpate.experiment.synthesis.crinkle import CrinkleSpectra, leave_out, rms_outside
from palpate.experiment.synthesis.waveforms import Basis

FLOOR, PHASE = "palpate.experiment.protocol.kinds.floor", "palpate.experiment.synthesis.signals.phase"


def real_recordings(root: Path, given: Path | None, protocol: Protocol) -> Path:
    """Return the recordings given or the dataset's. Raises `PalpateError` if they or thresholds are not real."""
    kept = root / storage.RECORDINGS
    folder = given or kept
    if protocol.table(Footstep).tactile.measured is not None:
        import_module(FLOOR).refuse_simulated(protocol)
    if manifest.is_simulated(folder):
        raise RecordingError(
            folder,
            "the recordings are simulated",
            Remedy("record real ones ({}), or use palpate rehearse", manifest.RECORD),
        )
    if not kept.exists():
        needed = virtual(protocol).materials
        manifest.load(folder, synthesis=protocol.table(Footstep).synthesis, material_ids=needed)
    elif manifest.sha256(folder) != manifest.sha256(kept):
        raise RecordingError(folder, "the study was started with different recordings", "leave out --recordings")
    return folder


def load_spectra(*, scene: Scene, protocol: Protocol, recordings: Path) -> dict[str, CrinkleSpectra]:
    """Return the spectra of the materials of `scene` from their recordings. Raises `RecordingError`."""
    synthesis = protocol.table(Footstep).synthesis
    loaded = manifest.load(recordings, synthesis=synthesis, material_ids=scene.materials)
    spectra = {material: loaded.spectra(material, average=synthesis.average) for material in scene.materials}
    return import_module(PHASE).with_phase(spectra, loaded.objects, scene.phase) if scene.phase else spectra


def fastest_mm_s(protocol: Protocol) -> float:
    """Return the speed of the fastest foot whose trial a protocol counts, mm/s; infinity if it names none."""
    limits = [rule.limit for rule in protocol.exclusion if rule.when == "speed-above" and rule.limit is not None]
    return min(limits, default=float("inf"))


def floor_m_s2(protocol: Protocol, participant: str | None = None) -> float:
    """Return the rms outside the tactile band that a participant, or anybody, does not feel, m/s^2."""
    measured = KIND.floor_m_s2(protocol, participant)
    return protocol.table(Footstep).tactile.floor_m_s2 if measured is None else measured


def felt_outside(spectra: Mapping[str, CrinkleSpectra], protocol: Protocol) -> tuple[str, float]:
    """Return the material with the largest rms outside the tactile band at a speed that counts, and that, m/s^2.

    It is infinity if any speed counts. Raises `SynthesisError` if a speed that counts has no spectrum.
    """
    fastest, band_hz = fastest_mm_s(protocol), protocol.table(Footstep).tactile.band_hz
    if fastest == float("inf"):
        return next(iter(spectra)), fastest
    levels = {m: rms_outside(of, band_hz=band_hz, fastest_mm_s=fastest) for m, of in spectra.items()}
    loudest = max(levels, key=levels.__getitem__)
    return loudest, levels[loudest]


def open_stimuli(
    *, scene: Scene, protocol: Protocol, recordings: Path, output_rate_hz: int, participant: str | None = None
) -> dict[str, Basis]:
    """Return the prepared materials of `scene` by id, for an actuator's rate in Hz and a participant's floor.

    Raises `RecordingError` for a bad recording, and `SynthesisError` if no waveform can be made at this rate.
    """
    spectra = load_spectra(scene=scene, protocol=protocol, recordings=recordings)
    return prepare_stimuli(spectra, protocol=protocol, output_rate_hz=output_rate_hz, participant=participant)


def prepare_stimuli(
    spectra: Mapping[str, CrinkleSpectra], *, protocol: Protocol, output_rate_hz: int, participant: str | None = None
) -> dict[str, Basis]:
    """Return the materials of a task, prepared: with all their bins, or with those of the tactile band.

    Bins outside are left out if `felt_outside` is below the participant's floor in every material: filtering only some
    would tell them apart. Raises as `open_stimuli`.
    """
    tactile, kept = protocol.table(Footstep).tactile, spectra
    if felt_outside(spectra, protocol)[1] < floor_m_s2(protocol, participant):
        kept = {material: leave_out(of, band_hz=tactile.band_hz) for material, of in spectra.items()}
    return {
        material: waveforms.prepare(of.in_time(kept[material]), material=material, output_rate_hz=output_rate_hz)
        for material, of in spectra.items()
    }
