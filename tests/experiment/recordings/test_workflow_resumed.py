"""Recording that was interrupted: what goes on with it, what is refused, and that no take is lost."""

from __future__ import annotations

import contextlib
import io
import os
import tomllib
from dataclasses import replace
from pathlib import Path

import pytest

from palpate.experiment import storage
from palpate.experiment.apparatus.tracker.zeroing import ZeroedTracker
from palpate.experiment.desk.terminal import TerminalTakes
from palpate.experiment.errors import RecordingError, TrackerStopped
from palpate.experiment.recordings import manifest, store
from tests.approved import Refuses
from tests.experiment.recordings.bench import PLAN, World, Worn, good, interrupted, names, record
from tests.experiment.session.scripted import rest_samples


@pytest.mark.parametrize("after", range(8))
@pytest.mark.parametrize("error", [KeyboardInterrupt, TrackerStopped])
def test_an_interrupted_recording_has_no_manifest_and_goes_on(
    tmp_path: Path, after: int, error: type[BaseException]
) -> None:
    interrupted(tmp_path / "set", after, error)
    assert not (tmp_path / "set").exists()
    world = World(iter(list(good())[after:]))
    record(world, tmp_path / "set")
    assert len(world.kept) == 8 - after
    assert names(tmp_path) == ["set"]
    record(World(good()), tmp_path / "other")
    assert names(tmp_path / "set") == names(tmp_path / "other")
    for path in (tmp_path / "set").iterdir():
        assert path.read_bytes() == (tmp_path / "other" / path.name).read_bytes()


def test_a_stop_while_the_whole_is_written_leaves_every_take(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(directory: Path, **_: object) -> Path:
        directory.mkdir(exist_ok=True)
        (directory / "000_panel_100_1.wav").write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(store, "write", fails)
    with pytest.raises(OSError, match="No space"):
        record(World(good()), tmp_path / "set")
    assert not (tmp_path / "set").exists()
    monkeypatch.undo()
    world = World(iter(()))
    record(world, tmp_path / "set")
    assert world.log == []
    assert names(tmp_path) == ["set"]
    assert manifest.load_all(tmp_path / "set").panel.shape == (2, 2, 8)


def test_another_plan_never_goes_on_with_an_interrupted_one(tmp_path: Path, refuses: Refuses) -> None:
    interrupted(tmp_path / "set", 3)
    other = replace(PLAN, takes=3)
    with refuses(RecordingError):
        record(World(good()), tmp_path / "set", other)


@pytest.mark.parametrize("key", ["protocol_sha256", "rig_sha256"])
def test_another_protocol_or_rig_never_goes_on_with_it(tmp_path: Path, key: str, refuses: Refuses) -> None:
    interrupted(tmp_path / "set", 3)
    with refuses(RecordingError):
        record(World(good()), tmp_path / "set", replace(PLAN, **{key: "c" * 64}))  # type: ignore[arg-type]


def test_takes_without_their_plan_are_refused_and_left_alone(tmp_path: Path, refuses: Refuses) -> None:
    interrupted(tmp_path / "set", 3)
    (tmp_path / ".set.partial" / "plan.json").unlink()
    before = names(tmp_path / ".set.partial")
    with refuses(RecordingError):
        record(World(good()), tmp_path / "set")
    assert names(tmp_path / ".set.partial") == before


def test_two_at_once_are_refused_and_the_first_goes_on(tmp_path: Path, refuses: Refuses) -> None:
    with (
        store.begun(PLAN, tmp_path / "set"),
        refuses(RecordingError),
    ):
        record(World(good()), tmp_path / "set")
    record(World(good()), tmp_path / "set")
    assert names(tmp_path) == ["set"]


def test_takes_are_removed_only_when_the_recordings_are_on_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every file of the whole, and the folder that it is moved into, is synced while every take is still there."""
    synced: set[str] = set()
    fsync = os.fsync

    def spy(descriptor: int) -> None:
        path = Path(f"/proc/self/fd/{descriptor}").readlink()
        takes = list((tmp_path / ".set.partial").glob("*.npz"))
        if len(takes) == len(PLAN.conditions()):
            synced.add(str(path.relative_to(tmp_path)) if path.is_relative_to(tmp_path) else "")
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", spy)
    record(World(good()), tmp_path / "set")
    wavs = {name.split(".wav")[0] for name in map(os.path.basename, synced) if ".wav" in name}
    assert len(wavs) == len(PLAN.conditions())
    assert any("manifest.toml" in name for name in synced)
    assert "." in synced
    assert any(storage.TEMPORARY.fullmatch(name) for name in synced)


def test_a_kill_after_the_recordings_took_their_place_leaves_no_take_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Takes of anything else than what stands there are kept."""
    with monkeypatch.context() as killed:
        killed.setattr(storage, "remove_folder", lambda _: None)
        record(World(good()), tmp_path / "set")
    assert names(tmp_path) == [".set.partial", "set"]
    whole = (tmp_path / "set" / "manifest.toml").read_bytes()
    for content, left in (whole + b"# of another day", [".set.partial", "set"]), (whole, ["set"]):
        (tmp_path / "set" / "manifest.toml").write_bytes(content)
        with pytest.raises(RecordingError, match="set: already contains recordings; allowed: a new or empty folder"):
            record(World(good()), tmp_path / "set")
        assert names(tmp_path) == left


def test_takes_are_never_looked_for_behind_a_link(tmp_path: Path, refuses: Refuses) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "plan.json").write_text("precious")
    (tmp_path / ".set.partial").symlink_to(tmp_path / "mine")
    with refuses(RecordingError):
        record(World(good()), tmp_path / "set")
    assert (tmp_path / "mine" / "plan.json").read_text() == "precious"


def test_a_damaged_take_is_named_before_the_next_is_recorded(tmp_path: Path, refuses: Refuses) -> None:
    interrupted(tmp_path / "set", 3)
    damaged = tmp_path / ".set.partial" / "0001.npz"
    damaged.write_bytes(damaged.read_bytes()[:50])
    with refuses(RecordingError):
        record(World(iter(list(good())[3:])), tmp_path / "set")
    assert not (tmp_path / "set").exists()
    assert names(tmp_path / ".set.partial") == ["0000.npz", "0001.npz", "0002.npz", "lock", "plan.json"]


def test_a_file_is_no_folder(tmp_path: Path, refuses: Refuses) -> None:
    (tmp_path / "set").write_text("x")
    with refuses(RecordingError):
        record(World(good()), tmp_path / "set")


def test_a_folder_in_use_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "mine.txt").write_text("x")
    world = World(good())
    with pytest.raises(RecordingError, match="already contains files"):
        record(world, tmp_path / "set")
    assert (world.log, names(tmp_path)) == ([], ["set"])


def test_each_take_says_from_where_its_heights_count_also_those_from_before_an_interruption(tmp_path: Path) -> None:
    """Recorded in two goes, each zeroed by itself: the foot rests at 0.5 mm, then at -0.75 mm."""
    for takes, rested_mm in ((3, 0.5), (5, -0.75)):
        kept = 3 if takes == 5 else 0
        world = World(iter([c.speed_mm_s for c in PLAN.conditions()][kept : kept + takes]))
        reads = iter([rest_samples(0, rested_mm)])
        worn = Worn(world, reads, rested_mm)
        tracker = ZeroedTracker(worn, contact_mm=0.0, farthest_mm=1.0, samples=200)
        tracker.settle(TerminalTakes(write=io.StringIO(), ask=lambda _: "").rest)
        with contextlib.suppress(StopIteration):
            record(world, tmp_path / "set", tracker=tracker)
    text = tomllib.loads((tmp_path / "set" / "manifest.toml").read_text("utf-8"))
    told = [take["zero"] for take in text["takes"]]
    assert [zero["offset_mm"] for zero in told] == [0.5] * 3 + [-0.75] * 5
    assert {(zero["spread_mm"], zero["samples"]) for zero in told} == {(0.0, 200)}
    assert manifest.load_all(tmp_path / "set").panel.shape == (2, 2, 8)


@pytest.mark.parametrize("text", ["{", "[]"])
def test_a_damaged_plan_is_named(tmp_path: Path, text: str, refuses: Refuses) -> None:
    interrupted(tmp_path / "set", 3)
    (tmp_path / ".set.partial" / "plan.json").write_text(text)
    with refuses(RecordingError):
        record(World(good()), tmp_path / "set")


def test_the_folder_may_be_the_present_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    interrupted(Path(), 3)
    assert names(tmp_path) == [".here.partial", "here"]
