"""A rehearsal in real time on a sound card of its own: participants feel what the actuator's channel carried."""

from __future__ import annotations

import csv
import re
import shutil
from itertools import pairwise
from pathlib import Path

import pytest

from experiment.errors import DatasetError
from experiment.protocol.files import shipped
from experiment.records import journal
from experiment.records.entries import MaskerSet, Phase, Redo, Spoken
from experiment.records.footstep import FootStep, Probed, Zeroed
from experiment.rehearsal import session, study
from experiment.rehearsal.footstep import participant
from experiment.rehearsal.footstep.panel import CardPanel
from experiment.rehearsal.wires.sound_card import WiredCard
from tests.rig import sound
from tests.rig.laboratory import HURRIED

pytestmark = pytest.mark.clocked


@pytest.fixture
def hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody waits for a participant who only thinks."""
    for name, value in HURRIED.items():
        monkeypatch.setattr(participant, name, value)


def short(tmp_path: Path) -> Path:
    """The footstep study with four trials a task and hardly a break."""
    text = shipped("okamoto2012.toml").read_text("utf-8")
    for pattern, value in (("repetitions", "1"), ("min_s", "0"), ("max_s", "0.01"), ("break_min_s", "0")):
        text = re.sub(rf"(?m)^{pattern} = \S+", f"{pattern} = {value}", text)
    text = text.replace("limit = 36", "limit = 4")
    text = text.replace("[masker]\n", '[masker]\nprobe = { material = "aluminum foil", speed_mm_s = 200 }\n')
    path = tmp_path / "short.toml"
    path.write_text(text, "utf-8")
    return path


def tried(root: Path, task: str) -> list[dict[str, str]]:
    [path] = root.glob(f"sub-01/beh/*_task-{task}_events.tsv")
    with path.open() as file:
        return list(csv.DictReader(file, delimiter="\t"))


def answers(root: Path, task: str) -> list[dict[str, str]]:
    return [row for row in tried(root, task) if row["counted"] == "1"]


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

        def panel(self) -> CardPanel:
            opened = super().panel()
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


def test_simulated_time_is_too_fast_for_an_audio_device(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"its audio device runs in real time, .*; add --real-time, or give a rig"):
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
def test_a_zeroed_tracker_is_rehearsed_in_real_time(tmp_path: Path) -> None:
    where = {"protocol_file": short(tmp_path), "rig_file": zeroed(tmp_path), "out": tmp_path / "made"}
    with pytest.raises(DatasetError, match=r"a resting foot, and no foot rests in simulated time; add --real-time"):
        study.rehearse(**where, participants=1, seed=1)  # type: ignore[arg-type]
    assert not (tmp_path / "made").exists()
    root = study.rehearse(**where, participants=1, seed=1, real_time=True)  # type: ignore[arg-type]
    assert [len(answers(root, task)) for task in ("virtual", "real")] == [4, 4]
    for path in root.glob("sourcedata/sub-01/*_journal.jsonl"):
        [zero] = [entry for entry in journal.read(path).entries if isinstance(entry, Zeroed)]
        assert zero.offset_mm == pytest.approx(0.0, abs=0.06)


def test_a_simulated_participant_says_the_answers_into_the_microphone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with sound.sound_card():
        pass
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    protocol, rig = short(tmp_path), tmp_path / "rig.toml"
    text = protocol.read_text("utf-8").replace('pause_key = "q"', 'pause_key = "q"\nmicrophone = true')
    # Objects are laid out in both tasks, so that blocks may be long, and a busy machine keeps up with them.
    text = text.replace("voice_recordings = false", "voice_recordings = true")
    text = text.replace('stimulus = "virtual"', 'stimulus = "real"')
    protocol.write_text(text, "utf-8")
    changed = shipped("rigs/headless.toml").read_text("utf-8").replace("block = 128", "block = 1024")
    rig.write_text(changed.replace("put_ms = 2.667", "put_ms = 21.333"), "utf-8")
    shutil.copy(shipped("rigs/rehearsal-response.csv"), tmp_path)
    out = tmp_path / "made"
    root = study.rehearse(protocol_file=protocol, rig_file=rig, out=out, participants=1, seed=1, real_time=True)
    phases = []
    for task in ("virtual", "real"):
        rows = answers(root, task)
        assert len(rows) == 4
        assert [row["voice_proposed"] for row in rows] == [row["answered"] for row in rows]
        assert {row["response_end"] for row in rows} == {"voice"}
        assert all(0 < float(row["voice_onset"]) < float(row["choice_time"]) for row in rows)
        assert all(float(row["voice_agreement"]) > 0.9 for row in rows)
        path = next(root.glob(f"sourcedata/sub-01/*_task-{task}_journal.jsonl"))
        phases += [entry.detail for entry in journal.read(path).entries if isinstance(entry, Phase)]
        for entry in journal.read(path).entries:
            if isinstance(entry, Spoken):
                assert (path.parent / "voices" / str(entry.sound)).stat().st_size > 10_000
    told = [detail.partition(": ")[2] for detail in phases if detail.startswith("the microphone proposes answers")]
    assert sorted(told) == [
        "the participant said each of 4 answers 2 times",
        "what the participant said earlier in this visit is compared with",
    ]
    # The visit is over, and what was computed of it is gone.
    assert not list(tmp_path.glob("palpate-*/*.voice"))
