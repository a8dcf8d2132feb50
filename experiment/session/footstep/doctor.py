"""What `palpate doctor` checks of a rig for footsteps, beside its devices: what it omits of the study's recordings."""

from collections.abc import Iterator
from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.doctor.checks import passed, refused, unchecked
from palpate.experiment.errors import Finding, PalpateError, RigError
from palpate.experiment.protocol import files
from palpate.experiment.session import scene
from palpate.experiment.session.footstep.fidelity import judged
from palpate.experiment.study.enrolment import default_root

NAME = "left out"
"""The name of the check."""


def omissions(
    rig_file: Path, protocol_file: Path | None, dataset: Path | None, recordings: Path | None
) -> Iterator[Finding]:
    """Yield what a rig leaves out of a study's recordings, and whether the protocol allows that.

    Nothing is yielded of a study that synthesises no footsteps, nor of a rig file that cannot be used. Without
    `recordings` those of the dataset are taken, and without `dataset` the study's own. Raises `ProtocolError`.
    """
    protocol = files.load(protocol_file) if protocol_file is not None else None
    if protocol is not None and not (protocol.renders and scene.virtual(protocol).synthesis):
        return
    try:
        rig = rigs.load(rig_file)
    except RigError:
        # A check of its own is red for it.
        return
    if protocol is None:
        yield unchecked(NAME, "no protocol was given", "add --protocol, and the folder of its --recordings")
        return
    most = protocol.footsteps.synthesis.left_out_max
    allowed = f"{most * 100:.6g}%" if most else "anything, for the protocol has no footstep.synthesis.left_out_max"
    folder = recordings or (dataset or default_root(protocol)) / storage.RECORDINGS
    if recordings is None and not folder.exists():
        missing = f"there are no recordings in {folder} yet, of which a rig may leave out {allowed}"
        yield unchecked(NAME, missing, "give their folder, with --recordings")
        return
    try:
        share = judged(protocol=protocol, rig=rig, rig_folder=rig_file.parent, recordings=folder)
    except PalpateError as error:
        yield refused(NAME, error)
        return
    yield passed(NAME, share, allowed)
