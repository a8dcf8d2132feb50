"""A session with levels: what goes on record before an attempt, and what the experimenter cannot ask for."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator
from contextlib import closing
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from palpate.experiment import storage
from palpate.experiment.desk.link.standing import standing
from palpate.experiment.desk.link.wire import SERIES
from palpate.experiment.desk.messages import Correct, Repeat
from palpate.experiment.desk.questions import REVEALED, Remark
from palpate.experiment.protocol.files import ProtocolFile
from palpate.experiment.protocol.models import Levels, Protocol
from palpate.experiment.records import journal
from palpate.experiment.records.entries import (
    Answer,
    Armed,
    Correction,
    Entry,
    LevelChosen,
    Note,
    Redo,
    TrackEnded,
    Visited,
)
from palpate.experiment.records.progress import Progress, progress
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.session.kinds.footstep.levels import at_level, scaled
from palpate.experiment.session.kinds.footstep.stimulus import Sounder
from palpate.experiment.session.kinds.footstep.watch import Watch
from palpate.experiment.session.runner import SessionLog
from palpate.experiment.study.levels import Tracks
from palpate.experiment.study.schedule import block_trials, schedule
from palpate.experiment.synthesis import tap
from palpate.experiment.synthesis.crinkle import LeftOut, leave_out
from palpate.experiment.synthesis.waveforms import prepare
from tests.experiment.protocol.tapping import comparing
from tests.experiment.session.kinds.tapping.bench import ASKED, console, contents, run
from tests.experiment.session.scripted import START_NS, ScriptedActuator
from tests.experiment.synthesis.stimuli import basis_of

LEVELS = Levels(method="up-down", grid=(0.1, 0.2, 0.4, 0.8), first=0.4, down=2, reversals=2)
KEYS = "121221112211222111221122"


def study() -> Protocol:
    """Real samples, which need no device: nothing but a file's rules keeps levels from them."""
    read = ProtocolFile.model_validate(comparing(repetitions=6, order="blocked-random"))
    return read.model_copy(update={"tasks": (read.tasks[0].model_copy(update={"levels": LEVELS}),)})


PROTOCOL = study()
TRACKS = Tracks(PROTOCOL, PROTOCOL.tasks[0])
HEADER = ASKED.model_copy(
    update={
        "order": schedule(protocol=PROTOCOL, participant="01", task_id="live", seed=1),
        "block_trials": block_trials(PROTOCOL, "live"),
    }
)


def session(folder: Path, keys: Iterable[str | Remark]) -> tuple[tuple[Entry, ...], list[str]]:
    desk = console(keys)
    run(PROTOCOL, desk, folder, HEADER)
    return contents(folder).entries, desk.shown


def levels(entries: Iterable[Entry]) -> list[LevelChosen]:
    return [entry for entry in entries if isinstance(entry, LevelChosen)]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Entry, ...]:
    return session(tmp_path_factory.mktemp("whole"), KEYS)[0]


def test_each_attempt_has_its_level_on_record_before_it_is_armed(whole: tuple[Entry, ...]) -> None:
    before = [(one, other) for one, other in pairwise(whole) if isinstance(other, Armed)]
    assert all(isinstance(one, LevelChosen) and one.trial == other.trial for one, other in before)
    assert len(before) == len(levels(whole)) == len([one for one in whole if isinstance(one, Answer)])
    assert list(TRACKS.findings(Path("journal"), whole)) == []
    ended = [entry for entry in whole if isinstance(entry, TrackEnded)]
    assert len(ended) == 3
    done = progress(whole)
    assert (done.complete, done.remaining) == (True, ())
    assert done.trials == len(done.answered) < len(HEADER.order)


def test_levels_of_answered_trials_are_told_by_track_once_they_are_revealed(whole: tuple[Entry, ...]) -> None:
    assert standing(progress(whole)).tracks == ()
    told = standing(progress((*whole, Visited(step=REVEALED, text="")))).tracks
    by_trial, answered = {one.trial: one for one in levels(whole)}, progress(whole).answered
    for track in told:
        assert track.levels == tuple(by_trial[n].level for n in answered if by_trial[n].track == track.name)[-SERIES:]
    assert {track.name for track in told} == {one.track for one in levels(whole)}
    assert told[0].name == by_trial[answered[-1]].track


def test_a_session_that_was_paused_anywhere_goes_on_with_the_same_levels(
    whole: tuple[Entry, ...], tmp_path: Path
) -> None:
    for count in (1, 4, 8):
        folder = tmp_path / str(count)
        session(folder, [*KEYS[:count], "="])
        resumed, _ = session(folder, KEYS[count:])
        assert list(TRACKS.findings(Path("journal"), resumed)) == []
        begun = {entry.trial: entry.level for entry in levels(whole)[:count]}
        assert {entry.trial: entry.level for entry in levels(resumed)[:count]} == begun
        # The attempt at which it paused is another one now, and of the same track at the same level.
        paused, again = (entry for entry in levels(resumed) if entry.trial == levels(resumed)[count].trial)
        assert (again.attempt, again.track, again.level) == (paused.attempt + 1, paused.track, paused.level)
        assert progress(resumed).complete


def test_a_trial_with_an_answer_is_corrected_and_not_repeated(tmp_path: Path) -> None:
    correct = Correct(trial=HEADER.order[0].trial, key="2", reason="misheard")
    repeat = Repeat(trial=HEADER.order[0].trial, reason="coughed")
    entries, shown = session(tmp_path, ["1", repeat, correct, "1", Repeat(trial=3, reason="coughed"), "="])
    redone = [(entry.trial, entry.put_off) for entry in entries if isinstance(entry, Redo)]
    # The trial at the question, and the one at which the session paused.
    assert [trial for trial, _ in redone][:1] == [3]
    assert all(trial != repeat.trial for trial, _ in redone)
    assert [entry.trial for entry in entries if isinstance(entry, Correction)] == [correct.trial]
    assert shown.count(next(line for line in shown if "trial 1 determined" in line)) == 1
    assert list(TRACKS.findings(Path("journal"), entries)) == []


def test_nothing_is_written_between_a_level_and_what_it_follows_from(tmp_path: Path) -> None:
    path = storage.journal_path(tmp_path, "01", "live")
    path.parent.mkdir(parents=True)
    clock, empty, note = ManualClock(START_NS), journal.read_if_begun(path), Note(trial=None, text="from elsewhere")
    with closing(SessionLog(path, clock, empty, progress((HEADER,)), None)) as log:
        log.write(HEADER)
        other = threading.Thread(target=log.write, args=(note,))

        def follows(done: Progress) -> Iterator[Entry]:
            for entry in TRACKS.upcoming(done):
                if not other.ident:
                    other.start()
                other.join(0.05)
                yield entry

        log.follow(follows)
        other.join()
    assert [type(entry) for entry in journal.read(path).entries[1:]] == [LevelChosen, Note]


def test_a_material_at_a_level_is_its_spectrum_times_it() -> None:
    rng = np.random.default_rng(1)
    basis = basis_of(rng.normal(size=200), samples=200, rate_hz=1000, material="felt")
    half, same = scaled(basis, 0.5), scaled(basis, 1.0)
    assert (half.material != basis.material, half.on) == (True, basis.on)
    for speed_mm_s in (80.0, 100.0, 130.0, 200.0, 250.0):
        wanted = basis.at(speed_mm_s)
        assert np.array_equal(half.at(speed_mm_s).waveform_m_s2, 0.5 * wanted.waveform_m_s2)
        assert np.array_equal(same.at(speed_mm_s).waveform_m_s2, wanted.waveform_m_s2)
        third = scaled(basis, 0.3).at(speed_mm_s).waveform_m_s2
        assert np.allclose(third, 0.3 * wanted.waveform_m_s2, rtol=0, atol=1e-12)


def test_what_is_left_out_of_a_material_is_less_by_its_level() -> None:
    basis = basis_of(np.ones(200), samples=200, rate_hz=1000)
    spectra = leave_out(basis.spectra, band_hz=(20.0, 100.0))
    narrow = prepare(spectra, material="felt", output_rate_hz=1000)
    left_out = scaled(narrow, 0.25).spectra.left_out
    assert isinstance(left_out, LeftOut)
    assert left_out.at(0, 0.5) == pytest.approx([0.25 * one for one in narrow.at(150.0).omitted_m_s2])


def watching(sounder: Sounder | None) -> Watch:
    unused: Any = SimpleNamespace()
    return Watch(unused, unused, unused, unused, ManualClock(0), unused, sounder)


def test_another_material_and_the_probe_stay_as_they_are() -> None:
    materials = {name: basis_of(np.ones(50), samples=50, rate_hz=1000, material=name) for name in ("felt", "tin")}
    watch = watching(Sounder(materials, ScriptedActuator()))
    at = at_level(watch, "felt", 0.5).sounder
    assert at is not None
    assert [at.materials[name] is one for name, one in materials.items()] == [False, True]
    assert watch.sounder is not None
    assert watch.sounder.materials is materials
    assert at_level(watching(None), "felt", 0.5).sounder is None


def test_a_tap_at_a_level_is_the_tap_times_it() -> None:
    rings = tap.rings(tap.SURFACES[2], rate_hz=5000, aluminum_m_s2=50.0)
    at = rings.scaled(0.25).at(0.11).waveform_m_s2
    assert np.array_equal(at, 0.11 * (0.25 * rings.unit.waveform_m_s2))
    assert np.array_equal(rings.scaled(1.0).at(0.11).waveform_m_s2, rings.at(0.11).waveform_m_s2)
