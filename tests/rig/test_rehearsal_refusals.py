"""Rehearsals that are refused, interrupted or spoilt: nothing is overwritten, and nothing is lost."""

from __future__ import annotations

import hashlib
import json
import shutil
from contextlib import suppress
from datetime import date
from itertools import count
from pathlib import Path
from typing import Any

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment import storage
from palpate.experiment.apparatus import opening
from palpate.experiment.dataset import build, checks, tables
from palpate.experiment.dataset.status import status
from palpate.experiment.dataset.verify import verify
from palpate.experiment.errors import DatasetError, Interrupted, JournalError, ProtocolError, RigError, TrackerError
from palpate.experiment.protocol.files import shipped
from palpate.experiment.records import journal
from palpate.experiment.rehearsal import session, study
from palpate.experiment.rehearsal.kinds.footstep import participant, recorded_takes
from palpate.experiment.rehearsal.wires.foot import Foot, Trajectory
from tests.approved import Refuses
from tests.rig.faults import Faults
from tests.rig.rehearsed import counted, rehearse


def test_another_table_of_the_same_name_is_never_put_over_the_one_that_was_used(
    tmp_path: Path, one: Path, refuses: Refuses
) -> None:
    root = tmp_path / "rehearsal"
    shutil.copytree(one, root)
    kept = root / "sourcedata" / "sub-01" / "rehearsal-response.csv"
    kept.write_text("# simulated, of another day\n")
    before = kept.read_bytes()
    with refuses(RigError):
        opening.copy_rig(root / "sourcedata" / "rig.toml", kept.with_name("another_rig.toml"))
    assert kept.read_bytes() == before


def test_it_goes_on_after_the_port_vanished_and_loses_nothing(
    tmp_path: Path, one: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps = 0
    step = Foot.step

    def unplugged_at_the_thirtieth(self: Foot, trajectory: Trajectory, start_us: int) -> None:
        nonlocal steps
        steps += 1
        step(self, trajectory, start_us, Faults(unplug_at=150) if steps == 30 else None)

    monkeypatch.setattr(Foot, "step", unplugged_at_the_thirtieth)
    monkeypatch.setattr(session.SimulatedEnds, "reconnect_s", 0.2)
    # Another test may have got the number of the port meanwhile, with a tracker that counts from another start.
    with pytest.raises((Interrupted, TrackerError), match=r"tracker at "):
        rehearse(tmp_path / "rehearsal")
    told: list[tuple[int, int]] = []
    root = rehearse(tmp_path / "rehearsal", total=lambda answers, done: told.append((answers, done)))
    assert told == [(80, 29)]
    for task in ("virtual", "real"):
        answers = [(row["trial"], row["presented"]) for row in counted(root, task)]
        assert answers == [(row["trial"], row["presented"]) for row in counted(one, task)]


def test_another_rehearsal_or_anything_else_in_the_folder_is_refused(
    tmp_path: Path, one: Path, refuses: Refuses
) -> None:
    with refuses(DatasetError):
        rehearse(one, seed=2)
    (tmp_path / "study").mkdir()
    (tmp_path / "study" / "data.tsv").write_text("precious")
    with refuses(DatasetError):
        rehearse(tmp_path / "study")
    assert (tmp_path / "study" / "data.tsv").read_text() == "precious"


def rig_with(folder: Path, old: str, new: str) -> Path:
    """The rehearsal's rig with one line changed, and the response table beside it."""
    for name in ("rehearsal.toml", "rehearsal-response.csv"):
        shutil.copyfile(shipped(f"rigs/{name}"), folder / name)
    path = folder / "rehearsal.toml"
    text = path.read_text("utf-8")
    assert text.count(old) == 1
    path.write_text(text.replace(old, new), "utf-8")
    return path


@pytest.mark.parametrize("jobs", [1, 2])
@pytest.mark.parametrize("exists", [False, True])
def test_a_rehearsal_that_is_refused_before_the_first_session_leaves_nothing(
    tmp_path: Path, jobs: int, exists: bool
) -> None:
    (tmp_path / "rig").mkdir()
    unfit = rig_with(tmp_path / "rig", "[tracker]\n", '[tracker]\ndriver = "nobody_wrote_this:Tracker"\n')
    out = tmp_path / "new" / "rehearsal"
    if exists:
        out.mkdir(parents=True)
    with pytest.raises(RigError, match="nobody_wrote_this"):
        study.rehearse(
            protocol_file=shipped("okamoto2012.toml"), rig_file=unfit, out=out, participants=2, seed=1, jobs=jobs
        )
    assert sorted(tmp_path.rglob("*")) == sorted(
        [*tmp_path.glob("rig"), *tmp_path.glob("rig/*"), *([out.parent, out] * exists)]
    )
    # Another rig may be rehearsed there.
    assert len(counted(rehearse(out), "virtual")) == 40


def test_of_two_rehearsals_that_begin_at_once_in_one_folder_one_is_refused_and_takes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second begins just when the first has made the folder."""
    out, refused = tmp_path / "made", 0
    participant, is_begun = session.rehearse_participant, study.is_begun

    def second() -> None:
        nonlocal refused
        with monkeypatch.context() as within:
            # It looked before the first had made anything.
            within.setattr(study, "is_begun", lambda *_: False)
            with pytest.raises(DatasetError, match="another palpate program is creating it now"):
                rehearse(out)
        refused += 1

    def beginning(*of: Any) -> None:
        plan = checks.Plan(**json.loads(storage.plan_path(out).read_text("utf-8")))
        second()
        assert is_begun(out, plan)
        monkeypatch.setattr(study, "rehearse_participant", participant)
        participant(*of)

    monkeypatch.setattr(study, "rehearse_participant", beginning)
    assert rehearse(out) == out
    assert refused == 1
    assert [path.name for path in tmp_path.iterdir()] == ["made"]
    assert len(counted(out, "virtual")) == 40


def test_of_two_that_make_one_folder_at_once_the_later_is_refused_and_takes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refuses: Refuses
) -> None:
    out, make = tmp_path / "made", recorded_takes.make_recordings

    def making(*at: Path, **what: Any) -> object:
        with monkeypatch.context() as within:
            within.setattr(participant, "make_recordings", make)
            rehearse(out)
        return make(*at, **what)

    monkeypatch.setattr(participant, "make_recordings", making)
    with refuses(DatasetError):
        rehearse(out)
    assert [path.name for path in tmp_path.iterdir()] == ["made"]
    assert len(counted(out, "virtual")) == 40


def test_a_rehearsal_that_fails_after_its_first_session_began_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Foot, "step", interrupted)
    with pytest.raises(Interrupted):
        rehearse(tmp_path / "rehearsal")
    assert journal.read(storage.journal_path(tmp_path / "rehearsal", "01", "virtual")).lines


def cut_off(root: Path, task: str = "virtual") -> None:
    """Leave of a session what was there when it was killed in an early trial."""
    path = storage.journal_path(root, "01", task)
    lines = path.read_bytes().splitlines(keepends=True)[:20]
    path.write_bytes(b"".join(lines))
    path.with_suffix(".head").write_text(f"{len(lines):012d} {hashlib.sha256(lines[-1].rstrip()).hexdigest()}\n")


def test_the_status_of_one_that_was_killed_names_the_command_that_goes_on(
    tmp_path: Path, one: Path, approved: SnapshotAssertion
) -> None:
    root = tmp_path / "rehearsal"
    shutil.copytree(one, root)
    cut_off(root)
    [told] = status(root, date(2026, 11, 26)).reminders
    assert told.sentence() == approved


def test_one_that_was_interrupted_before_its_tables_were_made_is_accused_of_nothing(
    tmp_path: Path, one: Path, refuses: Refuses
) -> None:
    root = tmp_path / "rehearsal"

    def found() -> tuple[set[str], str]:
        told = verify(root).findings
        [tables] = [finding.verdict for finding in told if finding.place() == "tables"]
        return {finding.place() for finding in told if finding.verdict == "refuses"}, tables

    shutil.copytree(one, root)
    assert found() == (set(), "passes")
    (root / "participants.tsv").unlink()
    # Complete, and every session has its table.
    assert found() == ({"participants.tsv"}, "passes")
    shutil.rmtree(root / "sub-01")
    # As of one that was interrupted while tables were made.
    assert found() == (set(), "unknown")
    with refuses(DatasetError):
        tables.check_tables(root)
    (root / "derivatives").mkdir()
    # They were made, for they were analysed.
    assert "participants.tsv" in found()[0]
    (root / "derivatives").rmdir()
    cut_off(root)
    assert found() == (set(), "unknown")
    build.build(root)
    # Made of what there was.
    assert found() == (set(), "passes")


def test_one_that_was_interrupted_at_any_file_of_its_tables_is_accused_of_nothing(
    tmp_path: Path, one: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root, write = tmp_path / "rehearsal", storage.write

    def interrupt_after(files: int) -> None:
        left = iter(range(files))
        monkeypatch.setattr(storage, "write", lambda *of: write(*of) if next(left, None) is not None else interrupted())

    for made in count():
        shutil.copytree(one, root)
        for path in (root / "sub-01", *root.glob("participants.*"), root / "README", root / "dataset_description.json"):
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        interrupt_after(made)
        with suppress(KeyboardInterrupt):
            build.build(root)
        monkeypatch.undo()
        report = verify(root)
        assert not report.refused, (made, report)
        if not any("were not compared: a rehearsal" in finding.clause() for finding in report.findings):
            break
        shutil.rmtree(root)
    # Study's files, then of each session trace and table, each with its sidecar.
    assert made == 4 + 2 * 4


def test_tables_that_are_older_than_an_unfinished_rehearsal_are_no_doubt(tmp_path: Path, one: Path) -> None:
    root = tmp_path / "rehearsal"
    shutil.copytree(one, root)
    cut_off(root)
    build.build(root)
    for path in (one / "sourcedata" / "sub-01").glob("*virtual*"):
        shutil.copy(path, root / "sourcedata" / "sub-01")
    cut_off(root, "real")
    for analysed in (False, True):
        if analysed:
            (root / "derivatives").mkdir()
        report = verify(root)
        assert not report.refused, report
        assert "were not compared" in str(report)


def interrupted(*_: object) -> None:
    raise KeyboardInterrupt


def test_a_broken_journal_is_refused_and_nothing_is_overwritten(tmp_path: Path, one: Path, refuses: Refuses) -> None:
    root = tmp_path / "rehearsal"
    shutil.copytree(one, root)
    path = storage.journal_path(root, "01", "virtual")
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(lines[:5] + lines[6:]))
    before = path.read_bytes()
    with refuses(JournalError):
        rehearse(root)
    assert path.read_bytes() == before


def test_a_truncated_journal_is_refused_and_nothing_is_overwritten(tmp_path: Path, one: Path) -> None:
    root = tmp_path / "rehearsal"
    shutil.copytree(one, root)
    path = storage.journal_path(root, "01", "virtual")
    path.write_bytes(path.read_bytes()[:-2000])
    before = path.read_bytes()
    for error, call in ((JournalError, lambda: rehearse(root)), (DatasetError, lambda: build.build(root))):
        with pytest.raises(error, match=r"is truncated: it had .* restore it from a backup"):
            call()
    assert path.read_bytes() == before


def test_a_missing_journal_is_refused(tmp_path: Path, one: Path, refuses: Refuses) -> None:
    root = tmp_path / "rehearsal"
    shutil.copytree(one, root)
    storage.journal_path(root, "01", "real").unlink()
    with refuses(JournalError):
        rehearse(root)


def test_a_rehearsal_never_writes_inside_a_dataset(one: Path, refuses: Refuses) -> None:
    with refuses(DatasetError):
        rehearse(one / "inside" / "deeper")
    assert not (one / "inside").exists()


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_broken_copy_of_the_protocol_is_named(tmp_path: Path, one: Path, jobs: int) -> None:
    root = tmp_path / "rehearsal"
    shutil.copytree(one, root)
    (root / "sourcedata" / "protocol.toml").write_text("x =")
    with pytest.raises(ProtocolError, match=r"protocol\.toml: 1 error"):
        rehearse(root, jobs=jobs)


def test_a_journal_without_a_header_is_left_out_of_the_dataset(tmp_path: Path, one: Path) -> None:
    root = tmp_path / "rehearsal"
    shutil.copytree(one, root)
    unborn = storage.journal_path(root, "02", "virtual")
    unborn.parent.mkdir()
    unborn.write_bytes(b'{"n":0,"t_ns":9')
    build.build(root)
    assert not (root / "sub-02").exists()


def test_a_foot_trace_that_was_changed_is_refused(tmp_path: Path, one: Path, refuses: Refuses) -> None:
    root = tmp_path / "rehearsal"
    shutil.copytree(one, root)
    path = storage.foot_path(storage.journal_path(root, "01", "real"))
    data = bytearray(path.read_bytes())
    data[1000] ^= 1
    path.write_bytes(data)
    with refuses(DatasetError):
        build.build(root)
