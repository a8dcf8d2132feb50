"""A rehearsal in real time on a sound card of its own: participants feel what the actuator's channel carried."""

from __future__ import annotations

import shutil
from itertools import pairwise
from pathlib import Path

import pytest

from palpate.experiment.errors import DatasetError
from palpate.experiment.protocol.files import shipped
from palpate.experiment.records import journal
from palpate.experiment.records.entries import MaskerSet, Redo
from palpate.experiment.records.kinds.footstep import FootStep, Probed, Zeroed
from palpate.experiment.rehearsal import session, study
from palpate.experiment.rehearsal.kinds.footstep import participant
from palpate.experiment.rehearsal.wires.modes import MovingPanel
from palpate.experiment.rehearsal.wires.panel import CardPanel
from palpate.experiment.rehearsal.wires.sound_card import WiredCard
from tests.approved import Refuses
from tests.rig import sound
from tests.rig.headless import answers, short, tried
from tests.rig.laboratory import HURRIED

pytestmark = pytest.mark.clocked


@pytest.fixture
def hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody waits for a participant who only thinks."""
    for name, value in HURRIED.items():
        monkeypatch.setattr(participant, name, value)


def rehearsed(tmp_path: Path) -> Path:
    root = study.rehearse(
        protocol_file=short(tmp_path),
        rig_file=shipped("rigs/headless.toml"),
        out=tmp_path / "made",
        participants=1,
        seed=1,
        real_time=True,
    )
    assert [len(answers(root, task)) for task in ("virtual", "real")] == [4, 4]
    return root


@pytest.mark.usefixtures("hurried")
def test_a_session_runs_in_real_time_on_a_sound_card_of_its_own(tmp_path: Path) -> None:
    with sound.sound_card():
        pass
    root = rehearsed(tmp_path)
    assert all(float(row["duration"]) == 0.5 for row in answers(root, "virtual"))
    assert all(row["delivered"] == "1" for row in answers(root, "virtual"))
    entries = journal.read(next(root.glob("sourcedata/sub-01/*_task-virtual_journal.jsonl"))).entries
    onsets = [entry.onset for entry in entries if isinstance(entry, FootStep) and entry.onset is not None]
    heard = [onset.delivered for onset in onsets if onset.delivered and onset.delivered.delivered]
    assert len(heard) == 4
    assert all(each.gain == pytest.approx(1.0, abs=1e-6) and (each.residual_db or 0.0) < -100 for each in heard)
    # Predicted from 0.1 mm of noise some 10 ms ahead: within five of the standard errors that go with it.
    assert all(abs(o.prediction_error_ms or 0.0) < 5 * (o.standard_error_ms or 0.0) for o in onsets)
    # What was measured of the timing stands in the journal, and in the table.
    assert all(onset.gate_to_scheduled_ms is not None and onset.gate_to_scheduled_ms > 0 for onset in onsets)
    assert all(float(row["gate_to_scheduled"]) > 0 for row in answers(root, "virtual"))
    told_ms = [each.onset_error_ms for each in heard]
    assert [float(row["delivery_error"]) for row in answers(root, "virtual")] == pytest.approx(
        [error_ms / 1e3 for error_ms in told_ms if error_ms is not None], abs=1e-6
    )
    for task in ("virtual", "real"):
        rows = tried(root, task)
        assert rows[0]["dead_time"] == "n/a"
        for before, row in pairwise(rows):
            # After a stimulus that was not delivered nobody answered.
            assert float(row["dead_time"]) > 0 if before["counted"] == "1" else row["dead_time"] == "n/a"
    assert [entry.material for entry in entries if isinstance(entry, Probed)] == ["aluminum foil"]
    levels = [entry.level_db_a for entry in entries if isinstance(entry, MaskerSet)]
    assert levels[0] == 50.0
    assert levels[-1] is None
    assert all(louder == (softer or 0.0) + 2.0 for softer, louder in pairwise(levels[:-1]))


@pytest.mark.usefixtures("hurried")
def test_stimuli_that_the_loopback_does_not_hear_are_done_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with sound.sound_card():
        pass
    pulled: list[str] = []

    class Pulled(WiredCard):
        """The loopback's cable is out for the masker's probe and the first two stimuli of the task with stimuli."""

        def panel(self, site: str | None, moving: MovingPanel | None) -> CardPanel:
            opened = super().panel(site, moving)
            if pulled:
                return opened
            self.card.disconnect(2)
            feel = opened.felt

            def felt(timeout_s: float) -> object:
                stimulus = feel(timeout_s)
                if stimulus is not None:
                    pulled.append("felt")
                if len(pulled) == 3:
                    self.connect_loopback()
                    pulled.append("plugged in")
                return stimulus

            monkeypatch.setattr(opened, "felt", felt)
            return opened

    monkeypatch.setattr(session, "WiredCard", Pulled)
    root = rehearsed(tmp_path)
    entries = journal.read(next(root.glob("sourcedata/sub-01/*_task-virtual_journal.jsonl"))).entries
    first, second = [entry for entry in entries if isinstance(entry, FootStep)][:2]
    for step in (first, second):
        assert step.onset is not None
        assert step.onset.delivered is not None
        assert not step.onset.delivered.delivered
    redone = [entry for entry in entries if isinstance(entry, Redo)]
    assert [entry.trial for entry in redone][:2] == [1, 2]
    assert all("undelivered" in entry.reason for entry in redone)


def test_simulated_time_is_too_fast_for_an_audio_device(tmp_path: Path, refuses: Refuses) -> None:
    with refuses(DatasetError):
        study.rehearse(
            protocol_file=shipped("okamoto2012.toml"),
            rig_file=shipped("rigs/headless.toml"),
            out=tmp_path / "made",
            participants=1,
            seed=1,
        )
    assert not (tmp_path / "made").exists()


def zeroed(tmp_path: Path) -> Path:
    """The rehearsal's rig without sound, its tracker zeroed."""
    rig = tmp_path / "rig.toml"
    shutil.copy(shipped("rigs/rehearsal-response.csv"), tmp_path)
    text = shipped("rigs/rehearsal.toml").read_text("utf-8")
    rig.write_text(text.replace("[tracker]", "[tracker]\nzeroing_mm = 3.0"), "utf-8")
    return rig


@pytest.mark.usefixtures("hurried")
def test_a_zeroed_tracker_is_rehearsed_in_real_time(tmp_path: Path, refuses: Refuses) -> None:
    where = {"protocol_file": short(tmp_path), "rig_file": zeroed(tmp_path), "out": tmp_path / "made"}
    with refuses(DatasetError):
        study.rehearse(**where, participants=1, seed=1)  # type: ignore[arg-type]
    assert not (tmp_path / "made").exists()
    root = study.rehearse(**where, participants=1, seed=1, real_time=True)  # type: ignore[arg-type]
    assert [len(answers(root, task)) for task in ("virtual", "real")] == [4, 4]
    for path in root.glob("sourcedata/sub-01/*_journal.jsonl"):
        [zero] = [entry for entry in journal.read(path).entries if isinstance(entry, Zeroed)]
        assert zero.offset_mm == pytest.approx(0.0, abs=0.06)
