"""From declared stimuli to waveforms, recordings among them, and what a rig makes of each."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest
import tomlkit
from scipy.io import wavfile

from palpate.experiment import storage
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.dataset.checks import Sessions
from palpate.experiment.dataset.verify import companions
from palpate.experiment.errors import ProtocolError, RecordingError, SynthesisError
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import ProtocolFile, shipped
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.session.kinds.presented import fidelity
from palpate.experiment.session.kinds.presented.plan import plan
from palpate.experiment.session.kinds.presented.stimuli import rendered
from palpate.experiment.study import privacy
from tests.experiment.protocol.presented import RECORDED, presenting
from tests.experiment.protocol.small import changed

RIG = shipped("rigs/presented.toml")
TONE_HZ = 80.0


def recording(folder: Path, *, dtype: str = "int16", seconds: float = 1.5) -> Path:
    """A study whose first stimulus is a recorded sinusoid of half of full scale, on 4,000 samples a second."""
    t = np.arange(round(seconds * 4000)) / 4000
    wave = 0.5 * np.sin(2 * np.pi * TONE_HZ * t)
    stored = (wave * 32768).round().astype("int16") if dtype == "int16" else (wave * 127 + 128).astype(dtype)
    wavfile.write(folder / "felt.wav", 4000, stored)
    digest = hashlib.sha256((folder / "felt.wav").read_bytes()).hexdigest()
    study = presenting(first=({"recorded": {**RECORDED["recorded"], "sha256": digest}},))
    (folder / "study.toml").write_text(tomlkit.dumps(study), "utf-8")
    return folder / "study.toml"


def load(study: Path) -> Protocol:
    return files.load(study)


def test_a_recording_is_played_as_it_was_at_any_rate(tmp_path: Path) -> None:
    study = load(recording(tmp_path))
    for rate_hz in (4000, 5000, 48_000):
        wave = rendered(study, rate_hz)["felt"].waveform_m_s2
        assert wave.size == round(0.625 * rate_hz)
        inner = slice(rate_hz // 10, -rate_hz // 10)
        wanted = 10 * np.sin(2 * np.pi * TONE_HZ * (0.375 + np.arange(wave.size) / rate_hz))
        # Samples of a sum of bins lie half a sample apart at another rate: 3 degrees of this tone at most.
        assert np.abs(wave - wanted)[inner].max() < 0.6


def test_a_recording_that_is_another_or_gone_is_refused(tmp_path: Path) -> None:
    study = load(recording(tmp_path))
    (tmp_path / "felt.wav").write_bytes((tmp_path / "felt.wav").read_bytes() + b"\0")
    with pytest.raises(ProtocolError):
        rendered(study, 5000)
    (tmp_path / "felt.wav").unlink()
    with pytest.raises(ProtocolError):
        rendered(study, 5000)


@pytest.mark.parametrize(("dtype", "seconds"), [("uint8", 1.5), ("int16", 0.9)])
def test_a_recording_of_8_bits_or_too_short_is_refused(tmp_path: Path, dtype: str, seconds: float) -> None:
    with pytest.raises(RecordingError):
        rendered(load(recording(tmp_path, dtype=dtype, seconds=seconds)), 5000)


def test_a_copy_of_a_protocol_has_its_recordings_beside_it(tmp_path: Path) -> None:
    study, copy = recording(tmp_path), tmp_path / "kept" / "protocol.toml"
    copy.parent.mkdir()
    files.keep(study, copy)
    np.testing.assert_array_equal(
        rendered(load(copy), 5000)["felt"].waveform_m_s2, rendered(load(study), 5000)["felt"].waveform_m_s2
    )


def test_a_kept_recording_gives_way_to_no_other_and_is_verified(tmp_path: Path) -> None:
    study, root = recording(tmp_path), tmp_path / "dataset"
    first, kept = (tmp_path / "felt.wav").read_bytes(), storage.protocol_path(root)
    storage.people_folder(root)
    files.keep(study, kept)
    files.keep(study, storage.protocol_path(root, 2))
    files.keep(recording(tmp_path, seconds=1.6), tmp_path / "elsewhere.toml")
    with pytest.raises(ProtocolError):
        files.keep(study, storage.protocol_path(root, 3))
    assert kept.with_name("felt.wav").read_bytes() == first
    assert not storage.protocol_path(root, 3).exists()
    assert privacy.unknown_files(root) == []
    assert {one.verdict for one in companions(Sessions(root))} == {"passes"}
    kept.with_name("felt.wav").write_bytes(first + b"\0")
    assert {one.verdict for one in companions(Sessions(root))} == {"refuses"}


def test_a_frequency_that_the_rate_does_not_carry_is_refused() -> None:
    with pytest.raises(SynthesisError):
        rendered(ProtocolFile.model_validate(presenting()), 400)


def test_a_stimulus_that_a_limit_changes_refuses_the_rig_and_is_named() -> None:
    rig = rigs.load(RIG)
    within = files.load(shipped("presented.toml"))
    made = fidelity.on_rig(protocol=within, rig=rig, rig_folder=RIG.parent)
    assert [one.asked_m_s2 for one in made[:2]] == pytest.approx([3.0, 3.0], rel=1e-3)
    assert not list(fidelity.refusals(within, rig, made))
    assert plan(protocol=within, rig=rig, task=within.tasks[0]).refused == ""
    low = within.model_copy(update={"exposure": within.exposure.model_copy(update={"vibration_peak_m_s2": 4.0})})
    refused = list(fidelity.refusals(low, rig, fidelity.on_rig(protocol=low, rig=rig, rig_folder=RIG.parent)))
    assert len(refused) == 2
    assert "rustle" in str(refused[0].what)
    assert fidelity.examine(protocol=low, rig=rig, rig_file=RIG)[1] is not None


def test_what_a_rig_leaves_out_is_at_most_what_the_protocol_allows() -> None:
    rig = rigs.load(RIG)
    strict = ProtocolFile.model_validate(changed(presenting(), ("presented", "left_out_max"), 1e-6))
    made = fidelity.on_rig(protocol=strict, rig=rig, rig_folder=RIG.parent)
    assert {one.material for one in made if one.left_out > 1e-6} == {"felt", "cork"}
    assert len([one for one in fidelity.refusals(strict, rig, made) if "left_out_max" in one.allowed]) == 2
