"""Stimuli at several sites of the body, each behind an output of its own: from the protocol to the dataset."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from dataclasses import replace
from datetime import date
from hashlib import sha256
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from palpate.experiment import storage
from palpate.experiment.apparatus import opening
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.audio import calibration
from palpate.experiment.apparatus.audio.stream import AudioStream, StreamSettings
from palpate.experiment.apparatus.doctor.devices import PEAK
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.clock import Clock, MonotonicClock
from palpate.experiment.dataset.verify import rig_files, verify
from palpate.experiment.errors import DatasetError, RecordingError
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Trained
from palpate.experiment.records.kinds.presented import CutShort, Interval, Presentation
from palpate.experiment.rehearsal.study import rehearse, simulated_rig
from palpate.experiment.rehearsal.wires.sound_card import DEVICE, WiredCard
from palpate.experiment.session.kinds.presented.trials import Sounded
from tests.conftest import Palpate
from tests.experiment.synthesis.stimuli import given
from tests.rig import sites, sound

pytestmark = pytest.mark.alone

CLOCK = MonotonicClock()


def rehearsed(folder: Path, rig: Path | None, text: str) -> Path:
    study = folder / "study.toml"
    study.write_text(text, "utf-8")
    rig_file = rig or simulated_rig(files.load(study))
    out = folder / "out"
    rehearse(protocol_file=study, rig_file=rig_file, out=out, participants=1, seed=1, real_time=rig is not None)
    return out


def rows(dataset: Path) -> list[dict[str, str]]:
    with (dataset / "sub-01" / "beh" / "sub-01_task-name_events.tsv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file, delimiter="\t"))


def checks(out: str) -> dict[tuple[str, str], str]:
    """The verdicts of `palpate doctor --json` by site and check, of those of a site."""
    found = [(one["measured"].removeprefix("SIMULATED: "), one) for one in json.loads(out)["checks"]]
    return {(said.split(":")[0], one["name"]): one["verdict"] for said, one in found if said.startswith("site ")}


def presented(dataset: Path) -> list[Presentation]:
    [path] = dataset.glob("sourcedata/sub-01/*_journal.jsonl")
    return [entry for entry in journal.read(path).entries if isinstance(entry, Presentation)]


def test_a_rehearsal_on_the_shipped_rig_has_every_site_that_the_study_names(tmp_path: Path, palpate: Palpate) -> None:
    out = rehearsed(tmp_path, None, sites.sited())
    assert verify(out).refused == 0
    found = rows(out)
    assert len(found) == 12
    assert {(row["presented"], row["site"]) for row in found} == set(sites.AT.items())
    assert {(one.material, one.site) for entry in presented(out) for one in entry.intervals} == set(sites.AT.items())
    # Whoever feels where answers better than by guesses among four: 8 and more of 12 are right once in 300 times.
    assert sum(row["presented"] == row["answered"] for row in found) > 9
    sidecar = json.loads(next(out.glob("sub-01/beh/*_events.json")).read_text("utf-8"))
    assert sidecar["Sites"].keys() == {"palm", "wrist"}
    assert "site" in sidecar
    assert palpate("export", out, "--out", tmp_path / "tables")[0] == 0
    with (tmp_path / "tables" / "trials.csv").open(encoding="utf-8") as file:
        exported = [(row["presented"], row["presented_site"]) for row in csv.DictReader(file)]
    assert exported == [(row["presented"], row["site"]) for row in found]


def test_a_session_behind_a_sound_card_plays_and_hears_each_site_on_its_channels(tmp_path: Path) -> None:
    with sound.sound_card():
        pass
    out = rehearsed(tmp_path, sites.card_rig(tmp_path), sites.at_once(sites.sited(1)))
    assert verify(out).refused == 0
    found = [row for row in rows(out) if row["counted"] == "1"]
    heard = [one.delivered for entry in presented(out) for one in entry.intervals if one.delivered is not None]
    assert len(heard) >= len(found) == 4
    assert all(one.gain == pytest.approx(1.0, abs=1e-6) and (one.residual_db or 0.0) < -100 for one in heard)
    assert sum(row["presented"] == row["answered"] for row in found) >= 3


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    return rigs.load(sites.card_rig(tmp_path))


@pytest.fixture
def card(rig: Rig) -> Iterator[WiredCard]:
    with sound.sound_card():
        pass
    with WiredCard(rig) as opened:
        yield opened


def test_a_site_is_shaken_alone_and_up_to_its_own_limit(rig: Rig, card: WiredCard) -> None:
    limits_m_s2: dict[str | None, float] = {"palm": 6.0, "wrist": 12.0}
    stream = opening.open_audio(
        rig, limits_m_s2=limits_m_s2, listens=False, masker=None, clock=CLOCK, today=date(2026, 11, 22), device=DEVICE
    )
    try:
        card.wire()
        panels = {site: card.panel(site, None) for site in limits_m_s2}
        actuators = {
            site: opening.open_actuator(rig.at(site), limit_m_s2=limit_m_s2, stream=stream)
            for site, limit_m_s2 in limits_m_s2.items()
        }
        wave = np.random.default_rng(1).uniform(-20, 20, 4800)
        wave[[0, -1]] = 1.0
        for site, actuator in actuators.items():
            actuator.prepare(given(wave))
            onset_ns = CLOCK.now_ns() + 100_000_000
            assert actuator.aim(onset_ns)
            delivered = actuator.delivered(onset_ns)
            assert delivered is not None
            assert (delivered.gain, delivered.residual_db) == (1.0, -200.0), delivered.reason
            felt = {other: panel.felt(1.0 if other == site else 0.0) for other, panel in panels.items()}
            own = felt.pop(site)
            assert own is not None
            assert own.size == wave.size
            assert np.abs(own).max() == pytest.approx(limits_m_s2[site])
            assert list(felt.values()) == [None]
    finally:
        stream.close()


TRAINED = sites.sited(1).replace("\n[[tasks]]\n", "\n[[tasks]]\ntraining = { trials = 2, feedback = false }\n", 1)


@pytest.mark.parametrize(
    ("text", "wrong"),
    [(sites.sited(1), range(99)), (TRAINED, range(4, 5)), (shipped("presented.toml").read_text("utf-8"), range(99))],
)
def test_a_journal_with_another_site_than_the_protocol_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, wrong: range
) -> None:
    # A program that takes one site for another in some of the stimuli; four come before the training.
    at, on_record = {"palm": "wrist", "wrist": "palm", None: "palm"}, Sounded.on_record
    numbers = count()
    monkeypatch.setattr(
        Sounded,
        "on_record",
        lambda one: on_record(replace(one, site=at[one.site]) if next(numbers) in wrong else one),
    )
    with pytest.raises(DatasetError):
        rehearsed(tmp_path, None, text)
    assert "sites" in {one.check for one in verify(tmp_path / "out").findings if one.verdict == "refuses"}


def bare(model: Any, **given: object) -> Any:
    return model.model_construct(**given)


def test_a_trial_has_on_record_each_site_of_a_material_that_it_presents_twice() -> None:
    twice = tuple(bare(Interval, material="hum", site=site) for site in ("palm", "wrist"))
    for entry in (bare(kind, intervals=twice) for kind in (Presentation, CutShort)):
        assert entry.felt_at == bare(Trained, entry=entry).felt_at == (("hum", "palm"), ("hum", "wrist"))


def test_a_dataset_with_another_table_of_a_site_is_refused(tmp_path: Path) -> None:
    path = sites.card_rig(tmp_path)
    (shaping,) = rigs.load(path).response_tables
    (tmp_path / "palm.csv").write_bytes((tmp_path / shaping.response).read_bytes())
    own = f'[sites.actuator.shaping]\nresponse = "palm.csv"\nresponse_sha256 = "{shaping.response_sha256}"\n'
    own += "full_scale_v = 12.0\ngain_limit_v_per_m_s2 = 4.0\n"
    text = path.read_text("utf-8")
    path.write_text(text.replace("full_scale_m_s2 = 40.0\nlow_hz = 20\nhigh_hz = 1000\n", own), "utf-8")
    journal_file = tmp_path / "dataset" / "sub-01_journal.jsonl"
    copy = storage.rig_path(journal_file)
    opening.copy_rig(path, copy)
    header: Any = SimpleNamespace(rig_sha256=rigs.sha256(rigs.load(path)))
    sessions: Any = SimpleNamespace(sessions=[(journal_file, header)])
    assert list(rig_files(sessions)) == []
    table = copy.with_name("palm.csv")
    table.write_bytes(table.read_bytes() + b"\n")
    assert [one.where for one in rig_files(sessions)] == [table]
    table.unlink()
    assert [one.where for one in rig_files(sessions)] == [table]
    (tmp_path / "palm.csv").write_bytes(b"no table")
    changed = path.read_text("utf-8").split("[[sites]]", 1)
    changed[1] = changed[1].replace(shaping.response_sha256, sha256(b"no table").hexdigest())
    path.write_text("[[sites]]".join(changed), "utf-8")
    with pytest.raises(RecordingError):
        rehearsed(tmp_path, path, sites.at_once(sites.sited(1)))
    assert not (tmp_path / "out").exists()


LOOPBACKS = {
    (f"site {site}", f"loopback {what}") for site in {*sites.AT.values()} for what in ("latency", "level", "residual")
}


@pytest.mark.parametrize("swapped", [False, True])
def test_the_doctor_finds_two_cables_that_are_swapped(
    tmp_path: Path, palpate: Palpate, monkeypatch: pytest.MonkeyPatch, swapped: bool
) -> None:
    with sound.sound_card():
        pass
    path = sites.card_rig(tmp_path)
    if swapped:
        wire = WiredCard.wire

        def wrongly(card: WiredCard) -> None:
            wire(card)
            for output, entry in ((3, 3), (4, 2)):
                card.card.disconnect(entry)
                card.card.connect(output, entry)

        monkeypatch.setattr(WiredCard, "wire", wrongly)
    _, out, _ = palpate("doctor", "--rig", path, "--json", "--dataset", tmp_path)
    found = {key: verdict for key, verdict in checks(out).items() if key[1].startswith("loopback")}
    if swapped:
        assert set(found.values()) == {"red"}
    else:
        assert found == dict.fromkeys(LOOPBACKS, "green")


@pytest.fixture
def probed(monkeypatch: pytest.MonkeyPatch) -> list[tuple[float, ...]]:
    """The ceilings of each stream that is opened for probes."""
    opened: list[tuple[float, ...]] = []

    def stream(settings: StreamSettings, clock: Clock) -> AudioStream:
        opened.append(settings.ceilings)
        return AudioStream(settings, clock)

    monkeypatch.setattr(calibration, "AudioStream", stream)
    return opened


def test_the_doctor_moves_the_sites_of_a_study_alone(
    tmp_path: Path, palpate: Palpate, probed: list[tuple[float, ...]]
) -> None:
    with sound.sound_card():
        pass
    path, study = sites.card_rig(tmp_path), tmp_path / "study.toml"
    palm, wrist = sites.SITES.strip().split("\n\n")
    text = sites.sited(1).replace(wrist, "").replace('site = "wrist"', 'site = "palm"')
    study.write_text(text, "utf-8")
    _, out, _ = palpate("doctor", "--rig", path, "--protocol", study, "--json", "--dataset", tmp_path)
    assert palm in text
    assert probed == [(0.0, 0.0, 0.0, PEAK)]
    found = {key: verdict for key, verdict in checks(out).items() if key[1].startswith("loopback")}
    assert found == {key: "green" for key in LOOPBACKS if key[0] == "site palm"}


def test_the_latency_of_a_site_is_measured_on_its_channels(
    tmp_path: Path, palpate: Palpate, probed: list[tuple[float, ...]]
) -> None:
    with sound.sound_card():
        pass
    path, new = sites.card_rig(tmp_path), tmp_path / "new.toml"
    code, _, err = palpate(
        "calibrate", "audio", "--rig", path, "--out", new, "--site", "palm", "--probes", 3, "--peak", 0.5
    )
    assert code == 0, err
    assert probed == [(0.0, 0.0, 0.0, 0.5)]
    before, after = rigs.load(path), rigs.load(new)
    assert (before.at("wrist"), before.audio) == (after.at("wrist"), after.audio)
    found = after.at("palm").audio
    assert found is not None
    assert found.latency.output_ms + found.latency.input_ms == pytest.approx(5.333, abs=0.001)
    assert found.latency.calibrated_on > date(2026, 11, 21)
    assert palpate("calibrate", "audio", "--rig", path, "--site", "toe")[0] != 0


def test_a_rig_without_a_site_of_the_study_is_refused(tmp_path: Path, palpate: Palpate) -> None:
    path, study = sites.card_rig(tmp_path), tmp_path / "study.toml"
    text = path.read_text("utf-8")
    path.write_text(text.replace('name = "palm"', 'name = "toe"'), "utf-8")
    study.write_text(sites.sited(1), "utf-8")
    out = tmp_path / "out"
    code, _, err = palpate("rehearse", study, "--rig", path, "--real-time", "--out", out)
    assert code != 0
    assert "'palm'" in err
    assert not out.exists()
    assert "'palm'" in palpate("check", study, "--rig", path)[2]
