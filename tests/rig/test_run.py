"""`palpate run` as a laboratory uses it: a tracker that streams in real time, a networked actuator, typed keys."""

from __future__ import annotations

import csv
import gzip
import json
import re
import shlex
import shutil
import signal
from collections.abc import Callable, Iterator, Sequence
from datetime import date, timedelta
from pathlib import Path

import numpy as np
import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.panel.movement import DRIFT_DB
from palpate.experiment.apparatus.tracker.serial_tracker import SerialTracker
from palpate.experiment.desk.terminal import TerminalConsole
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Answer, Entry, Footer, Note, TrackerOpened
from palpate.experiment.records.kinds.footstep import BrokenOff, FootStep, Zeroed
from palpate.experiment.rehearsal.kinds.footstep import recorded_takes
from palpate.experiment.rehearsal.wires.panel import Panel
from tests.approved import on_any_machine
from tests.conftest import Palpate
from tests.plugged import PluggedLine
from tests.rig.faults import Faults
from tests.rig.laboratory import NOISE_MM, SPEED_MM_S, Laboratory, write_rig

pytestmark = pytest.mark.clocked


def keys(prompt: str) -> bool:
    """Return whether an answer's key is asked for, or asked for again."""
    return "did the participant say" in prompt or "confirm" in prompt


def counted(dataset: Path, task: str) -> list[dict[str, str]]:
    """Return the rows of the trials that count: of a step that broke off on a busy machine there is one more."""
    with (dataset / "sub-01" / "beh" / f"sub-01_task-{task}_events.tsv").open(encoding="utf-8") as events:
        return [row for row in csv.DictReader(events, delimiter="\t") if row["counted"] == "1"]


def counted_steps(entries: Sequence[Entry]) -> list[FootStep]:
    """Return the steps that were answered."""
    answered = {(entry.trial, entry.attempt) for entry in entries if isinstance(entry, Answer)}
    return [entry for entry in entries if isinstance(entry, FootStep) and (entry.trial, entry.attempt) in answered]


@pytest.fixture
def laboratory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, palpate: Palpate, task: str, seed_for: Callable[[Path, str], int]
) -> Iterator[Laboratory]:
    """A sealed study of one trial a material, a rig file, an enrolled participant; the foot steps when armed."""
    simulated_rig = rigs.load(shipped("rigs/rehearsal.toml"))
    panel = Panel(simulated_rig.actuator)
    with PluggedLine(link=tmp_path / "tracker") as line:
        write_rig(tmp_path, "rehearsal", port=f'"{line.url}"', address=f'"{panel.address}"')
        study = (
            shipped("okamoto2012.toml")
            .read_text("utf-8")
            .replace("min_s = 180", "min_s = 0")
            .replace("limit = 36", "limit = 4")
        )
        (tmp_path / "study.toml").write_text(study.replace("repetitions = 10", "repetitions = 1"), "utf-8")
        there = Laboratory(panel, line)
        drain = SerialTracker.drain

        def step_when_armed(self: SerialTracker) -> None:
            drain(self)
            there.drained()

        monkeypatch.setattr(SerialTracker, "drain", step_when_armed)
        monkeypatch.chdir(tmp_path)
        today = date.today()
        approval = ["--approved-on", today, "--expires-on", today + timedelta(9)]
        assert palpate("seal", "study.toml", "--approval-number", "17", *approval)[0] == 0
        consent = ["--consent-on", today, "--dataset", "dataset"]
        consent += ["--seed", seed_for(tmp_path / "study.toml", task)]
        assert palpate("enrol", "study.toml", "-p", "01", *consent)[0] == 0
        yield there
        there.foot.close()
    panel.close()


@pytest.mark.parametrize("task", ["real", "virtual"])
def test_a_session_from_the_experimenters_chair(
    laboratory: Laboratory,
    task: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    palpate: Palpate,
    approved: SnapshotAssertion,
) -> None:
    protocol = files.load(tmp_path / "study.toml")
    recordings = tmp_path / "recordings"
    manifest = recorded_takes.make_recordings(recordings, protocol=protocol, seed=1)
    where = ["--rig", "rig.toml", "--dataset", "dataset", "--recordings", recordings]
    if task == "virtual":
        code, _, err = palpate("run", "study.toml", "-p", "01", "--task", task, *where)
        assert code == 2
        assert on_any_machine(err, tmp_path) == approved
        assert not (tmp_path / "dataset" / "stimuli").exists()
    # From here on they stand in for a laboratory's own.
    manifest.write_text(manifest.read_text("utf-8").replace("simulated = true", "simulated = false"), "utf-8")
    typed = iter("ccaanntt")
    prompts: list[str] = []
    told: list[str] = []
    show = TerminalConsole.show

    def ask(prompt: str) -> str:
        prompts.append("Lay out" if "Lay out" in prompt else prompt)
        return next(typed) if keys(prompt) else "y" * ("[y]" in prompt)

    def shown(self: TerminalConsole, text: str) -> None:
        told.extend([text] * (not prompts))
        show(self, text)

    monkeypatch.setattr("builtins.input", ask)
    monkeypatch.setattr(TerminalConsole, "show", shown)
    code, out, _ = palpate("run", "study.toml", "-p", "01", "--task", task, *where)
    assert code == 0
    assert "complete: 4 answers" in out
    assert prompts.count("Lay out") == (4 if task == "real" else 0)
    left_out = r"Rig 'rehearsal': at most 34\.\d\d% \(rms\) of copy paper at 200 mm/s \(.*\) is left out; the limits "
    # Before anything was asked.
    assert len(re.findall(left_out, "\n".join(told))) == (task == "virtual")
    folder = tmp_path / "dataset" / "sourcedata" / "sub-01"
    entries = journal.read(folder / f"sub-01_task-{task}_journal.jsonl").entries
    # No accelerometer of this rig hears the panel.
    assert sum("accelerometer" in e.text for e in entries if isinstance(e, Note)) == (task == "virtual")
    assert "accelerometer" in "".join(told) or task == "real"
    answers = [e for e in entries if isinstance(e, Answer)]
    assert [a.answered for a in answers] == ["copy paper", "aluminum foil", None, "typing paper"]
    steps = counted_steps(entries)
    assert [s.speed_mm_s for s in steps] == pytest.approx([SPEED_MM_S] * 4, rel=0.03)
    assert [s.link.lost + s.link.damaged for s in steps] == [0, 0, 0, 0]
    assert all(0 < a.response_time_s < 5 for a in answers)
    delivered = [laboratory.panel.felt(0) for _ in steps]
    if task == "virtual":
        assert [s.stimulus.samples for s in steps if s.stimulus] == [d.size for d in delivered if d is not None]
        assert len({s.stimulus.handed_sha256 for s in steps if s.stimulus}) == 4
        assert [s.stimulus.moved.drift_db for s in steps if s.stimulus and s.stimulus.moved] == [DRIFT_DB] * 4
    else:
        assert delivered == [None] * 4
    description = json.loads((tmp_path / "dataset" / "dataset_description.json").read_text())
    assert description["Palpate"]["Origin"] == "PARTICIPANT"
    assert [row["origin"] for row in counted(tmp_path / "dataset", task)] == ["PARTICIPANT"] * 4


def plugged_in_when_waited_for(laboratory: Laboratory, monkeypatch: pytest.MonkeyPatch, sole_mm: float = 0.0) -> None:
    reconnect = SerialTracker.reconnect

    def plugged_in_again(self: SerialTracker, timeout_s: float) -> None:
        laboratory.line.replug()
        laboratory.power(sole_mm)
        reconnect(self, timeout_s)

    monkeypatch.setattr(SerialTracker, "reconnect", plugged_in_again)


@pytest.mark.parametrize("task", ["real"])
def test_a_tracker_that_is_unplugged_in_mid_step_is_waited_for_and_nothing_is_lost(
    laboratory: Laboratory, task: str, monkeypatch: pytest.MonkeyPatch, palpate: Palpate
) -> None:
    laboratory.faults[3] = Faults(unplug_at=250)
    plugged_in_when_waited_for(laboratory, monkeypatch)
    typed = iter("ccaanntt")
    monkeypatch.setattr(
        "builtins.input",
        lambda prompt: (
            next(typed) if "did the participant say" in prompt or "confirm" in prompt else "y" * ("[y]" in prompt)
        ),
    )
    code, out, err = palpate(
        "run", "study.toml", "-p", "01", "--task", task, "--rig", "rig.toml", "--dataset", "dataset"
    )
    assert (code, err) == (0, "")
    assert "within 300 s" in out
    assert "device is back" in out
    assert "complete: 4 answers" in out
    folder = Path("dataset") / "sourcedata" / "sub-01"
    entries = journal.read(folder / f"sub-01_task-{task}_journal.jsonl").entries
    attempts = [(e.trial, e.attempt) for e in entries if isinstance(e, FootStep | BrokenOff)]
    assert attempts == [(1, 1), (2, 1), (3, 1), (3, 2), (4, 1)]
    assert [e.trial for e in entries if isinstance(e, Answer)] == [1, 2, 3, 4]
    assert sum(isinstance(e, TrackerOpened) for e in entries) == 2
    (broken,) = [e for e in entries if isinstance(e, BrokenOff)]
    assert (broken.trial, broken.felt) == (3, False)
    assert broken.link.received > 0
    events = (Path("dataset") / "sub-01" / "beh" / f"sub-01_task-{task}_events.tsv").read_text()
    assert events.count("port has disappeared") == 1


@pytest.mark.parametrize("task", ["real"])
def test_a_tracker_that_is_unplugged_between_two_steps_is_waited_for(
    laboratory: Laboratory, task: str, monkeypatch: pytest.MonkeyPatch, palpate: Palpate
) -> None:
    plugged_in_when_waited_for(laboratory, monkeypatch)
    typed = iter("ccaanntt")
    asked = 0

    def ask(prompt: str) -> str:
        nonlocal asked
        if "did the participant say" not in prompt and "confirm" not in prompt:
            return "y" * ("[y]" in prompt)
        asked += "did the participant say" in prompt
        if asked == 2 and "did the participant say" in prompt:
            laboratory.foot.close()
            laboratory.line.unplug()
        return next(typed)

    monkeypatch.setattr("builtins.input", ask)
    code, out, err = palpate(
        "run", "study.toml", "-p", "01", "--task", task, "--rig", "rig.toml", "--dataset", "dataset"
    )
    assert (code, err) == (0, "")
    assert "device is back" in out
    assert "complete: 4 answers" in out
    folder = Path("dataset") / "sourcedata" / "sub-01"
    entries = journal.read(folder / f"sub-01_task-{task}_journal.jsonl").entries
    attempts = [(e.trial, e.attempt) for e in entries if isinstance(e, FootStep | BrokenOff)]
    assert attempts == [(1, 1), (2, 1), (3, 1), (4, 1)]
    assert sum(isinstance(e, TrackerOpened) for e in entries) == 2


@pytest.mark.parametrize("task", ["real"])
def test_a_tracker_is_zeroed_by_the_resting_foot_and_anew_once_it_was_plugged_in_again(
    laboratory: Laboratory, task: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, palpate: Palpate
) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(rig.read_text("utf-8").replace("[tracker]", "[tracker]\nzeroing_mm = 3.0"), "utf-8")
    # The sensor sees the foot 1.5 mm above its sole, and after it was plugged in again 0.8 mm below.
    laboratory.foot.close()
    laboratory.power(1.5)
    laboratory.faults[4] = Faults(unplug_at=250)
    plugged_in_when_waited_for(laboratory, monkeypatch, -0.8)
    typed = iter("ccaanntt")
    zeroings: list[str] = []

    def ask(prompt: str) -> str:
        if "Zeroing" in prompt:
            zeroings.append(prompt)
            # The first time the foot steps instead.
            laboratory.resting = len(zeroings) > 1
            if laboratory.resting:
                laboratory.foot.finish()
                laboratory.foot.put_down()
        return next(typed) if keys(prompt) else "y" * ("[y]" in prompt)

    monkeypatch.setattr("builtins.input", ask)
    where = ["--rig", "rig.toml", "--dataset", "dataset"]
    code, out, err = palpate("run", "study.toml", "-p", "01", "--task", task, *where)
    assert (code, err) == (0, "")
    assert re.search(r"Zeroing: .*; allowed: .* 0\.5 mm", zeroings[1])
    assert "complete: 4 answers" in out
    path = Path("dataset") / "sourcedata" / "sub-01" / f"sub-01_task-{task}_journal.jsonl"
    entries = journal.read(path).entries
    zeros = [e for e in entries if isinstance(e, Zeroed)]
    # Medians of 500 readings of 0.1 mm noise, in counts of 0.026 mm.
    assert [zero.offset_mm for zero in zeros] == pytest.approx([1.5, -0.8], abs=0.06)
    assert [zero.spread_mm for zero in zeros] == pytest.approx([NOISE_MM] * 2, rel=0.25)
    assert len(zeros) == 2
    steps = counted_steps(entries)
    assert [s.speed_mm_s for s in steps] == pytest.approx([SPEED_MM_S] * 4, rel=0.03)
    # Where a foot has landed, heights are those of its sole again.
    [trace] = Path("dataset").glob("sub-01/beh/*_physio.tsv.gz")
    [sidecar] = Path("dataset").glob("sub-01/beh/*_physio.json")
    begins_s = json.loads(sidecar.read_text("utf-8"))["StartTime"]
    heights_mm = np.genfromtxt(gzip.decompress(trace.read_bytes()).decode().splitlines())
    landings_s = [float(row["onset"]) for row in counted(Path("dataset"), task)]
    landed = [heights_mm[round((s - begins_s) * 1000) + 30 :][:60] for s in landings_s]
    assert [float(np.median(after)) for after in landed] == pytest.approx([0.0] * 4, abs=0.1)
    code, told, _ = palpate("journal", path)
    assert len(re.findall(r"zeroed: .* [+-]\d\.\d\d mm .* 0\.\d\d mm", told)) == 2


@pytest.mark.parametrize("task", ["real"])
@pytest.mark.usefixtures("laboratory")
def test_ctrl_c_while_the_last_line_is_written_leaves_the_tables_of_a_complete_session(
    task: str, monkeypatch: pytest.MonkeyPatch, palpate: Palpate, approved: SnapshotAssertion
) -> None:
    typed, append = iter("ccaanntt"), journal.Journal.append

    def appending(self: journal.Journal, entry: Entry) -> int:
        if isinstance(entry, Footer):
            signal.raise_signal(signal.SIGINT)
        return append(self, entry)

    def ask(prompt: str) -> str:
        return next(typed) if keys(prompt) else "y" * ("[y]" in prompt)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    monkeypatch.setattr(journal.Journal, "append", appending)
    monkeypatch.setattr("builtins.input", ask)
    where = ["--rig", "rig.toml", "--dataset", "dataset"]
    code, _, err = palpate("run", "study.toml", "-p", "01", "--task", task, *where)
    signal.signal(signal.SIGINT, before)
    assert code == 130
    assert err == approved
    path = Path("dataset") / "sourcedata" / "sub-01" / f"sub-01_task-{task}_journal.jsonl"
    assert journal.read(path).entries[-1] == Footer(reason="complete", answered=4)
    assert [row["origin"] for row in counted(Path("dataset"), task)] == ["PARTICIPANT"] * 4


@pytest.mark.parametrize("task", ["real"])
def test_each_sessions_end_is_anchored_and_a_register_that_is_away_costs_nothing(
    laboratory: Laboratory,
    task: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    palpate: Palpate,
    approved: SnapshotAssertion,
) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(rig.read_text("utf-8") + '\n[anchors]\nfile = "~/lab share/register"\n', "utf-8")
    monkeypatch.setenv("HOME", str(tmp_path))
    typed = iter("ccqqaanntt")
    monkeypatch.setattr(
        "builtins.input",
        lambda prompt: (
            next(typed) if "did the participant say" in prompt or "confirm" in prompt else "y" * ("[y]" in prompt)
        ),
    )
    session = ["run", "study.toml", "-p", "01", "--task", task, "--rig", "rig.toml", "--dataset", "dataset"]
    code, out, _ = palpate(*session)
    assert (code, "1 answer on disk" in out) == (0, True)
    assert "the lab book" in out
    assert f"NOT ANCHORED: {tmp_path}/lab share/register: " in out
    remedy = shlex.join(["palpate", "anchor", "dataset", "--to", f"{tmp_path}/lab share/register"])
    assert f"run: {remedy}" in out
    (tmp_path / "lab share").mkdir()
    shutil.copytree("dataset", "backup")
    code, out, _ = palpate(*session)
    assert (code, "complete: 4 answers" in out) == (0, True)
    assert f"Anchored in {tmp_path}/lab share/register." in out
    assert "a new file" in out
    number = re.findall(r"For the lab book: .* (\S+)\n", out)[0]
    assert re.search(r": 1 of 4 trials .*; trial 2 ", out)
    code, out, _ = palpate(*session)
    assert (code, "the lab book" in out) == (0, False)
    assert out.endswith(": 4 answers.\n")
    assert "nothing was added" in out
    code, out, _ = palpate("verify", "dataset", "--register", "lab share/register", "--number", number)
    assert (code, out.count("PROVEN by"), "NOT PROVEN" in out) == (0, 2, False)
    # A backup that was restored does not put to anybody again what the newer state has answered.
    code, _, err = palpate(*session[:-1], "backup")
    assert (code, err.count("\n")) == (2, 1)
    assert on_any_machine(re.sub(r"line \d+", "line N", err), tmp_path) == approved
