"""`palpate run` of a study of real samples: sealed, enrolled, with a rig whose tracker and actuator nobody opens."""

from __future__ import annotations

from contextlib import nullcontext
from datetime import date
from pathlib import Path

import pytest

from palpate.experiment.apparatus import host
from palpate.experiment.clock import day, wall_ns
from palpate.experiment.dataset.verify import verify
from palpate.experiment.protocol import files
from palpate.experiment.protocol.approval import sealing
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.session.run import run
from palpate.experiment.study.people import enrolling
from tests.experiment.session.scripted import START_NS, ScriptedConsole

CHANGED = {
    "repetitions = 8 ": "repetitions = 2 ",
    "limit = 108": "limit = 20",
    "min_s = 120": "min_s = 0",
}


def test_a_session_of_real_samples_needs_no_device(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(host, "raised", lambda: nullcontext(""))
    text = shipped("wellman1995.toml").read_text("utf-8")
    for old, new in CHANGED.items():
        assert old in text
        text = text.replace(old, new)
    study, rig = tmp_path / "study.toml", tmp_path / "rig.toml"
    study.write_text(text, "utf-8")
    devices = shipped("rigs/rehearsal.toml")
    # Nobody listens there.
    nowhere = {
        "simulated = true": "simulated = false",
        'port = "rehearsal"': 'port = "socket://127.0.0.1:9"',
        'address = "rehearsal"': 'address = "127.0.0.1:9"',
    }
    named = devices.read_text("utf-8")
    for old, new in nowhere.items():
        assert old in named
        named = named.replace(old, new)
    rig.write_text(named, "utf-8")
    (tmp_path / "rehearsal-response.csv").write_bytes(devices.with_name("rehearsal-response.csv").read_bytes())
    protocol = files.load(study)
    sealing.write(
        study,
        protocol,
        approval_number="17",
        board=protocol.ethics.board,
        approved_on=date(2001, 1, 1),
        expires_on=date(2199, 1, 1),
    )
    root = tmp_path / "dataset"
    enrolling.enrol(study, "01", day(wall_ns()), root=root, seed=1)
    desk = ScriptedConsole(ManualClock(START_NS), "12" * 15)
    footer = run(
        protocol_file=study,
        rig_file=rig,
        participant="01",
        task_id="live",
        root=root,
        recordings=None,
        console=desk,
        given=(),
    )
    assert (footer.reason, footer.answered) == ("complete", 30)
    assert len(desk.placed) == 30
    assert [*root.rglob("*.cobs"), *root.rglob("*.bin")] == []
    journal = next(root.rglob("*_journal.jsonl")).read_text("utf-8")
    assert "The experimenter confirmed: " in journal
    assert any(shown.startswith("For the lab") for shown in desk.shown)
    assert verify(root).refused == 0
    events = (root / "sub-01" / "beh" / "sub-01_task-live_events.tsv").read_text().splitlines()
    assert len(events) == 31
    assert events[1].endswith("PARTICIPANT")
