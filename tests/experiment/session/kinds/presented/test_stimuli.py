"""From declared stimuli to waveforms, recordings among them, and what a rig makes of each."""

from __future__ import annotations

import hashlib
import json
from datetime import date
from pathlib import Path

import numpy as np
import pytest
import tomlkit
from numpy.typing import NDArray
from scipy.io import wavfile

from palpate.experiment import storage
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.dataset.checks import Sessions
from palpate.experiment.dataset.verify import companions
from palpate.experiment.errors import ProtocolError, RecordingError, SynthesisError
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import ProtocolFile, shipped
from palpate.experiment.protocol.kinds.presented import Presented, Site
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.session.kinds.presented import fidelity
from palpate.experiment.session.kinds.presented.plan import plan
from palpate.experiment.session.kinds.presented.stimuli import rendered, scaled
from palpate.experiment.study import privacy
from palpate.experiment.study.people import enrolling
from tests.conftest import Palpate
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


def written(folder: Path, samples: NDArray[np.int16], rate_hz: int = 4000, **own: object) -> Protocol:
    """Return the study of a recording of these samples."""
    wavfile.write(folder / "felt.wav", rate_hz, samples)
    digest = hashlib.sha256((folder / "felt.wav").read_bytes()).hexdigest()
    part = {**RECORDED["recorded"], "sha256": digest, "begins_s": 0.0, "lasts_s": 1.0, **own}
    study = presenting(first=({"recorded": part},))
    (folder / "study.toml").write_text(tomlkit.dumps(study), "utf-8")
    return load(folder / "study.toml")


HALF = (16384 * np.sin(2 * np.pi * TONE_HZ * np.arange(4000) / 4000)).astype(np.int16)
# No two of its cycles have the same samples.
CLIPPED = np.clip(32_000 * np.sin(np.arange(4000) * 0.1317), -20_000, 20_000).astype(np.int16)


@pytest.mark.parametrize(
    ("samples", "rate_hz", "own", "found"),
    [
        (HALF, 4000, {}, []),
        (np.stack([HALF, HALF], axis=1), 4000, {}, [("recorded", "refuses")]),
        (HALF[:3600], 4000, {}, [("recorded", "refuses")]),
        (HALF, 4000, {"full_scale_m_s2": 9000.0}, [("full_scale_m_s2", "refuses")]),
        (HALF, 4000, {"lasts_s": 0.9}, [("lasts_s", "warns")]),
        (HALF[::4], 1000, {}, [("file", "warns")]),
        (
            CLIPPED,
            4000,
            {"full_scale_m_s2": 5.0},
            [("file", "warns")],
        ),
    ],
    ids=["good", "stereo", "short", "strong", "long", "slow", "clipped"],
)
def test_a_check_opens_each_recording(
    tmp_path: Path, samples: NDArray[np.int16], rate_hz: int, own: dict[str, object], found: list[tuple[str, str]]
) -> None:
    every = list(fidelity.companions(written(tmp_path, samples, rate_hz, **own)))
    assert [(one.field.rpartition(".")[2], one.verdict) for one in every] == found
    assert all(one.remedy or one.allowed for one in every)


@pytest.mark.parametrize(("peak_m_s2", "verdicts"), [(9.9, ["refuses"]), (10.1, [])])
def test_a_recording_is_compared_with_the_limit_of_its_site(
    tmp_path: Path, peak_m_s2: float, verdicts: list[str]
) -> None:
    # It reaches 10 m/s^2; the study allows more.
    study = written(tmp_path, HALF)
    assert study.exposure.vibration_peak_m_s2 > 10.1
    table = study.table(Presented)
    sited = tuple(one.model_copy(update={"site": "palm"}) for one in table.stimuli)
    palm = Site(name="palm", place="The left palm.", peak_m_s2=peak_m_s2)
    table = table.model_copy(update={"sites": (palm,), "stimuli": sited})
    found = list(fidelity.companions(study.model_copy(update={"presented": table})))
    assert [one.verdict for one in found] == verdicts
    assert all("palm" in one.allowed for one in found)


def test_a_click_that_a_ramp_makes_weak_is_played(tmp_path: Path) -> None:
    """A fifth of the way up a raised cosine a sample has 9.5 % of itself: (1 - cos(pi / 5)) / 2."""
    click = np.zeros(4000, dtype=np.int16)
    click[400], click[3600] = 32767, -32767
    study = written(tmp_path, click, full_scale_m_s2=50.0)
    (first, *others) = study.table(Presented).stimuli
    (part,) = first.parts
    ramped = first.model_copy(update={"parts": (part.model_copy(update={"ramp_s": 0.5}),)})
    table = study.table(Presented).model_copy(update={"stimuli": (ramped, *others)})
    assert [one.verdict for one in fidelity.companions(study)] == ["refuses"]
    assert list(fidelity.companions(study.model_copy(update={"presented": table}))) == []


def test_the_command_refuses_a_recording_that_cannot_be_played_and_tells_of_one_that_is_odd(
    tmp_path: Path, palpate: Palpate
) -> None:
    written(tmp_path, np.stack([HALF, HALF], axis=1))
    code, out, _ = palpate("check", tmp_path / "study.toml", "--json")
    (error,) = json.loads(out)["errors"]
    assert code != 0
    assert error["path"].endswith("recorded")
    written(tmp_path, HALF, lasts_s=0.9)
    told = json.loads(palpate("check", tmp_path / "study.toml", "--json")[1])["advice"]
    assert [one["path"].rpartition(".")[2] for one in told] == ["lasts_s"]


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
    # By the response without phase, which may be 1.3 % too high, as `Stimulus.reached_peak_m_s2` says.
    assert all(f"at most {one.reached_m_s2:.3g} m/s^2" in one.words for one in made)
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


@pytest.mark.parametrize("ramp_s", [0.0, 0.1])
def test_what_a_rate_does_not_carry_of_a_recording_is_left_out_on_record(tmp_path: Path, ramp_s: float) -> None:
    """1 m/s^2 at 100 Hz and 10 at 4000: by Parseval 10 / sqrt(101) of the rms is beyond 2500 Hz."""
    t = np.arange(44_100) / 44_100
    wave = np.sin(2 * np.pi * 100 * t) + 10 * np.sin(2 * np.pi * 4000 * t)
    wavfile.write(tmp_path / "felt.wav", 44_100, (wave / 20).astype(np.float32))
    digest = hashlib.sha256((tmp_path / "felt.wav").read_bytes()).hexdigest()
    part = {"recorded": {**RECORDED["recorded"], "sha256": digest}, "ramp_s": ramp_s}
    (tmp_path / "study.toml").write_text(
        tomlkit.dumps(presenting(first=(part, {"silence": {"lasts_s": 0.5}}))), "utf-8"
    )
    study, rig = load(tmp_path / "study.toml"), rigs.load(RIG)
    assert rig.actuator.rate_hz == 5000
    made = fidelity.on_rig(protocol=study, rig=rig, rig_folder=RIG.parent)[0]
    assert made.left_out == pytest.approx(10 / np.sqrt(101), abs=1e-3)
    assert [one for one in fidelity.refusals(study, rig, (made,)) if "left_out_max" in one.allowed]
    of_it = rendered(study, 5000)["felt"]
    assert scaled(of_it, 0.5).omitted_m_s2[0] == pytest.approx(of_it.omitted_m_s2[0] / 2)
    assert rendered(study, 44_100)["felt"].omitted_m_s2 == (0.0, 0.0)


def test_what_a_rig_that_nobody_measured_leaves_out_is_not_known() -> None:
    study, rig = files.load(shipped("presented.toml")), rigs.load(RIG)
    plain = {"shaping": None, "full_scale_m_s2": 50.0}
    nobody = rig.model_copy(update={"actuator": rig.actuator.model_copy(update=plain)})
    band = {**plain, "low_hz": 1.0, "high_hz": 2000.0}
    measured = rig.model_copy(update={"actuator": rig.actuator.model_copy(update=band)})
    assert study.table(Presented).left_out_max is None
    for one, known in ((rig, True), (measured, True), (nobody, False)):
        told, refused = fidelity.examine(protocol=study, rig=one, rig_file=RIG)
        assert (fidelity.UNKNOWN in told, refused) == (not known, None)
        said = fidelity.judge(protocol=study, rig=one, rig_file=RIG, today=date(2026, 1, 1))
        assert said.startswith(fidelity.UNKNOWN) == (not known)
        planned = plan(protocol=study, rig=one, task=study.tasks[0])
        assert (planned.unknown != "", planned.as_dict()["unknown"] != "", fidelity.UNKNOWN in planned.text()) == (
            not known,
        ) * 3


@pytest.mark.parametrize("missing", [True, False])
def test_a_dataset_begins_once_every_recording_is_right(tmp_path: Path, palpate: Palpate, missing: bool) -> None:
    study, names = recording(tmp_path), ("felt.wav", "cork.wav")
    right = (tmp_path / "felt.wav").read_bytes()
    parts = [
        {"recorded": {**RECORDED["recorded"], "file": one, "sha256": hashlib.sha256(right).hexdigest()}}
        for one in names
    ]
    study.write_text(tomlkit.dumps(presenting(first=tuple(parts))), "utf-8")
    if not missing:
        (tmp_path / "cork.wav").write_bytes(right + b"\0")
    root = tmp_path / "dataset"
    with pytest.raises(ProtocolError):
        enrolling.enrol(study, "01", None, root=root, seed=1)
    assert not (root / "sourcedata" / "felt.wav").exists()
    code, _, err = palpate("check", study)
    assert (code, "cork.wav" in err) == (2, True)
    approval = ("--approval-number", "1", "--approved-on", "2020-02-01", "--expires-on", "2021-02-01")
    assert palpate("seal", study, *approval)[0] == 2
    (tmp_path / "cork.wav").write_bytes(right)
    # As after a command that was killed between two files.
    (root / "sourcedata" / "felt.wav").write_bytes(right)
    enrolling.enrol(study, "01", None, root=root, seed=1)
    assert all((root / "sourcedata" / one).read_bytes() == right for one in names)
    assert palpate("check", study)[0] == palpate("seal", study, *approval)[0] == 0


def test_what_is_heard_is_held_for_as_long_as_a_trial_presents(tmp_path: Path) -> None:
    study = ProtocolFile.model_validate(presenting())
    table = study.table(Presented)
    longest_s = max(one.lasts_s for one in table.stimuli)
    assert table.pause_s is not None
    assert table.trial_s == 2 * longest_s + table.pause_s
    assert table.model_copy(update={"pause_s": None}).trial_s == longest_s
