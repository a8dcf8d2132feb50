"""What a rig for footsteps omits of a study's recordings: `palpate doctor` checks it, and the board reads it."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.apparatus.doctor.checks import passed, refused, unchecked
from palpate.experiment.apparatus.panel.conditioning import Played
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.errors import Finding, PalpateError, RecordingError
from palpate.experiment.protocol.kinds.footstep import Footstep
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.session import scene
from palpate.experiment.session.kinds.footstep import preparation, trials
from palpate.experiment.session.kinds.footstep.felt import felt_on
from palpate.experiment.session.kinds.footstep.fidelity import WEAKER, judged, played, speeds_mm_s
from palpate.experiment.study.enrolment import default_root
from palpate.experiment.synthesis.felt import Felt

NAME = "left out"
"""The name of the check."""


def omissions(
    protocol: Protocol, rig: Rig, rig_folder: Path, dataset: Path | None, recordings: Path | None
) -> Iterator[Finding]:
    """Yield what a rig leaves out of a study's recordings, whether the protocol allows it, and a lacking sensor.

    Without `recordings` those of the dataset are taken, and without `dataset` the study's own.
    """
    if protocol.table(Footstep).force:
        from palpate.experiment.apparatus.doctor import foot_force

        yield from foot_force.missing(rig)
    most = protocol.table(Footstep).synthesis.left_out_max
    allowed = f"{most * 100:.6g}%" if most else ("any share, because it has no footstep.synthesis.left_out_max")
    folder = recordings or (dataset or default_root(protocol)) / storage.RECORDINGS
    if recordings is None and not folder.exists():
        missing = f"{folder} has no recordings yet; a rig may leave out {allowed}"
        yield unchecked(NAME, missing, "give their folder with --recordings")
        return
    try:
        yield passed(NAME, judged(protocol=protocol, rig=rig, rig_folder=rig_folder, recordings=folder), allowed)
    except PalpateError as error:
        yield refused(NAME, error)


def examine(
    *, protocol: Protocol, rig: Rig, rig_file: Path, recordings: Path | None
) -> tuple[str, PalpateError | None]:
    """Return what the board reads of a rig, beside what the protocol allows it to leave out; raises as `judged`.

    `recordings` None stands for those of the study's dataset; where there are none, a protocol that limits what is left
    out has the rig refused.
    """
    trials.check_force(rig, protocol)
    folder, name = recordings or default_root(protocol) / storage.RECORDINGS, f"Rig '{rig.rig.name}'"
    most = protocol.table(Footstep).synthesis.left_out_max
    allowed = "sets no limit" if most is None else f"allows {most * 100:.6g}%"
    if recordings is None and not folder.exists():
        if most is not None:
            limited = f"the protocol {allowed} of a vibration to be left out"
            return "", RecordingError(
                f"{limited}, and {folder} has no recordings", remedy="give their folder (--recordings)"
            )
        limitless = "the protocol does not limit how much of a vibration a rig may leave out"
        return f"{name}: {limitless}. To see what is left out, give the recordings folder (--recordings).", None
    told = judged(protocol=protocol, rig=rig, rig_folder=rig_file.parent, recordings=folder)
    every: dict[str, list[Played]] = {}
    for each in scene.played(protocol):
        spectra = preparation.load_spectra(scene=each, protocol=protocol, recordings=folder)
        every |= played(spectra, protocol=protocol, rig=rig, rig_folder=rig_file.parent)
    scales = {material: tuple(one.scale * one.panel_scale for one in of) for material, of in every.items()}
    bound = binding(scales, protocol) + noticing(felt_on(every, rig=rig, rig_folder=rig_file.parent), protocol)
    mend = "palpate plan shows how to lower this"
    return f"{name}: {told}. The protocol {allowed}; {mend}. {bound} The recordings are in {folder}.", None


def noticing(felt: Mapping[str, Sequence[Felt]], protocol: Protocol) -> str:
    """Return in words how probably a person notices what a measured panel changes at the most; empty without one."""
    every = [(one, v, name) for name, of in felt.items() for one, v in zip(of, speeds_mm_s(protocol), strict=bool(of))]
    if not every:
        return ""
    worst, speed_mm_s, material = max(every, key=lambda one: one[0].noticed_at_least)
    return (
        f" The panel changes {material} at {speed_mm_s:.0f} mm/s the most: by {worst.third_octave_db:.1f} dB in a "
        "third octave. A model from published thresholds, untested on this rig, predicts that a person would notice "
        f"this in {worst.noticed_at_least:.0%} to {worst.noticed_at_most:.0%} of comparisons, excluding guesses."
    )


def binding(scales: Mapping[str, Sequence[float]], protocol: Protocol) -> str:
    """Return in words from which speed on a limit scales each material, and by how much, so that none does unseen."""
    speeds, bound = speeds_mm_s(protocol), []
    for material, of in scales.items():
        if down := [(v, scale) for v, scale in zip(speeds, of, strict=True) if scale <= 1 - WEAKER]:
            least = min(down, key=lambda one: one[1])
            bound.append(f"{material} from {down[0][0]:.0f} mm/s up, to {least[1]:.0%} at {least[0]:.0f} mm/s")
    limits = f"The limits of the panel ({protocol.exposure.vibration_peak_m_s2:g} m/s^2) and the amplifier"
    if not bound:
        return f"{limits} do not scale down any vibration from {speeds[0]:.0f} to {speeds[-1]:.0f} mm/s."
    unequal = len(bound) < len(scales) or len({tuple(of) for of in scales.values()}) > 1
    warned = " Materials are scaled unequally, which participants may notice." if unequal else ""
    return f"{limits} scale vibrations down: {'; '.join(bound)}.{warned}"
