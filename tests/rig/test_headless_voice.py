"""A rehearsal in real time whose simulated participant speaks into the microphone of a sound card of its own."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.protocol.files import shipped
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Phase, Spoken
from palpate.experiment.rehearsal import study
from tests.rig import sound
from tests.rig.headless import answers, short

pytestmark = pytest.mark.alone


def test_a_simulated_participant_says_the_answers_into_the_microphone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, approved: SnapshotAssertion
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
    assert sorted(told) == approved
    # The visit is over, and what was computed of it is gone.
    assert not list(tmp_path.glob("palpate-*/*.voice"))
