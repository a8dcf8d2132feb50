"""Sessions of presented stimuli with a scripted actuator and experimenter: what is played when, and what is kept."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palpate.experiment import storage
from palpate.experiment.dataset.kinds.presented import _played
from palpate.experiment.desk.messages import ENTER, Repeat
from palpate.experiment.desk.questions import Event, Play, Playing, Reply
from palpate.experiment.errors import ActuatorError, PalpateError
from palpate.experiment.protocol.files import ProtocolFile, shipped
from palpate.experiment.protocol.kinds.presented import Presented
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Answer, Armed, Entry, Footer, Header, PlannedTrial, Redo
from palpate.experiment.records.kinds.presented import CutShort, Interval, Presentation, Sample
from palpate.experiment.records.progress import progress
from palpate.experiment.records.stimulus import Delivered
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.session import attempt, runner
from palpate.experiment.session.kind import Lent
from palpate.experiment.session.kinds.presented.stimuli import rendered
from palpate.experiment.session.kinds.presented.trials import Presentations, PresentedDevices
from tests.experiment.protocol.presented import presenting
from tests.experiment.session.bench import HEADER
from tests.experiment.session.kinds.presented.test_stimuli import recording
from tests.experiment.session.scripted import START_NS, ScriptedActuator, ScriptedConsole

PRESENTED = (("felt",), ("cork",), ("cork", "felt"), ("felt", "cork", "felt"))


def protocol(**changed: Any) -> Protocol:
    study = ProtocolFile.model_validate(presenting())
    return study.model_copy(update={"presented": study.table(Presented).model_copy(update=changed)})


def header(presented: Iterable[tuple[str, ...]]) -> Header:
    order = tuple(PlannedTrial(trial=n, presented=one) for n, one in enumerate(presented, start=1))
    own = {"task": "one", "task_kind": "presented", "order": order, "block_trials": len(order)}
    return HEADER.model_copy(update=own)


class Familiar(Presentations):
    """Of participants who are familiar with every stimulus."""

    @property
    def samples(self) -> Mapping[str, str]:
        return {}


class Devices(PresentedDevices):
    def begin(self, lent: Lent) -> Presentations:
        return Familiar(self, lent)


class Bench:
    """A session that is run, and run again, on the same disk."""

    opens: type[PresentedDevices] = Devices

    def __init__(self, folder: Path, study: Protocol, presented: Iterable[tuple[str, ...]], keys: str) -> None:
        self.folder, self.study, self.header = folder, study, header(presented)
        self.clock = ManualClock(START_NS)
        self.actuator, self.console = ScriptedActuator(), ScriptedConsole(self.clock, keys)
        self.pressed_ns: list[int] = []
        self.console.instead[Play] = self.press

    def press(self) -> Reply | None:
        self.clock.sleep_ns(700_000_000)
        self.pressed_ns.append(self.clock.now_ns())
        return Reply(ENTER)

    def run(self) -> Footer:
        stimuli = rendered(self.study, self.actuator.rate_hz)
        devices = attempt.Devices(
            kind=self.opens({None: self.actuator}, stimuli),
            console=self.console,
            clock=self.clock,
            masker=None,
            reconnect_s=300.0,
        )
        rig_file = shipped("rigs/presented.toml")
        return runner.run(
            protocol=self.study, header=self.header, devices=devices, rig_file=rig_file, dataset=self.folder
        )

    @property
    def entries(self) -> tuple[Entry, ...]:
        return journal.read(storage.journal_path(self.folder, "01", "one")).entries

    def of(self, kind: type[Any]) -> list[Any]:
        return [entry for entry in self.entries if isinstance(entry, kind)]


def test_each_trial_plays_what_it_presents_one_after_the_other(tmp_path: Path) -> None:
    bench = Bench(tmp_path, protocol(), PRESENTED, "fkfk")
    assert bench.run().reason == "complete"
    table = bench.study.table(Presented)
    waves = rendered(bench.study, bench.actuator.rate_hz)
    flat = [material for trial in PRESENTED for material in trial]
    assert len(bench.actuator.played) == len(flat)
    for played, material in zip(bench.actuator.played, flat, strict=True):
        np.testing.assert_array_equal(played, waves[material].waveform_m_s2)
    kept = bench.of(Presentation)
    assert [tuple(one.material for one in entry.intervals) for entry in kept] == [*PRESENTED]
    assert table.pause_s is not None
    for entry in kept:
        for one, other in pairwise(entry.intervals):
            ends_s = one.onset_ns / 1e9 + one.stimulus.lasts_s
            assert other.onset_ns / 1e9 - ends_s == pytest.approx(table.pause_s, abs=1e-6)
    # The answer is timed from the onset of the last one.
    (first, *_), times = kept, [entry.response_time_s for entry in bench.of(Answer)]
    assert times[0] >= first.intervals[-1].stimulus.lasts_s


@pytest.mark.parametrize(("set_off", "asks"), [("experimenter", True), ("participant", True), ("clock", False)])
def test_nothing_is_felt_before_the_gap_is_over_and_somebody_or_the_clock_sets_it_off(
    tmp_path: Path, set_off: str, asks: bool
) -> None:
    bench = Bench(tmp_path, protocol(set_off=set_off, gap_s=5.0), PRESENTED[:2] * 2, "fkfk")
    bench.run()
    assert len(bench.pressed_ns) == 4 * asks
    kept, answers = bench.of(Presentation), bench.of(Answer)
    assert {entry.set_off for entry in kept} == {set_off}
    for number, entry in enumerate(kept):
        onset_ns = entry.intervals[0].onset_ns
        if asks:
            assert onset_ns == bench.pressed_ns[number]
        if number:
            before = kept[number - 1].intervals[-1].onset_ns / 1e9 + answers[number - 1].confirmed_s
            assert onset_ns / 1e9 - before >= 5.0 - 1e-6
            assert asks or onset_ns / 1e9 - before == pytest.approx(5.0, abs=1e-3)


def test_a_stimulus_that_was_not_delivered_is_repeated_where_a_rule_says_so(tmp_path: Path) -> None:
    rule = {"id": "not played", "when": "undelivered", "action": "repeat-trial", "reason": "it was not played"}
    study = ProtocolFile.model_validate({**presenting(), "exclusion": (rule,)})
    bench = Bench(tmp_path, study, PRESENTED[:2], "fk")
    bench.actuator.heard.append(Delivered(requested_ns=0, xruns=1, delivered=False, reason="an xrun"))
    assert bench.run().reason == "complete"
    assert [entry.attempt for entry in bench.of(Presentation)] == [1, 1, 2]
    assert [entry.put_off for entry in bench.of(Redo)] == [True]


def test_several_stimuli_are_marked_before_each_begins_and_one_is_not(tmp_path: Path) -> None:
    bench = Bench(tmp_path, protocol(), PRESENTED, "fkfk")
    marked: list[tuple[int, int]] = []
    tell = bench.console.tell

    def noted(event: Event) -> None:
        if isinstance(event, Playing):
            marked.append((event.place, bench.clock.now_ns()))
        tell(event)

    bench.console.tell = noted  # type: ignore[method-assign]
    bench.run()
    kept = [entry for entry in bench.of(Presentation) if len(entry.intervals) > 1]
    assert [place for place, _ in marked] == [1, 2, 1, 2, 3]
    onsets_ns = [one.onset_ns for entry in kept for one in entry.intervals]
    ahead_ns = [onset_ns - at_ns for onset_ns, (_, at_ns) in zip(onsets_ns, marked, strict=True)]
    assert ahead_ns == [pytest.approx(250_000_000, abs=10_000_000)] * 5


def test_a_device_that_fails_leaves_what_was_felt_on_record_and_the_trial_comes_again(tmp_path: Path) -> None:
    bench = Bench(tmp_path, protocol(), PRESENTED[2:3], "fk")
    bench.actuator.heard.extend([None, ActuatorError("actuator", "it is gone")])
    with pytest.raises(PalpateError):
        bench.run()
    (cut,) = bench.of(CutShort)
    assert [one.material for one in cut.intervals] == ["cork", "felt"]
    assert cut.put_off
    assert bench.run().reason == "complete"
    assert [(entry.trial, entry.attempt) for entry in bench.of(Presentation)] == [(1, 2)]


def test_a_trial_that_is_asked_for_again_before_it_is_set_off_is_not_felt(tmp_path: Path) -> None:
    bench = Bench(tmp_path, protocol(), PRESENTED[:2], "fkfk")

    def repeats() -> Reply | None:
        session = next(one for one in reversed(bench.console.attended) if one is not None)
        bench.console.instead[Play] = bench.press
        session.remark(Repeat(trial=1, reason="they sneezed"))
        return Reply(ENTER)

    bench.console.instead[Play] = repeats
    assert bench.run().reason == "complete"
    (cut,) = bench.of(CutShort)
    assert (cut.trial, cut.intervals, cut.put_off) == (1, (), False)
    assert [entry.trial for entry in bench.of(Presentation)] == [2, 1]


def test_a_session_that_is_interrupted_while_it_waits_goes_on_with_the_same_trial(tmp_path: Path) -> None:
    bench = Bench(tmp_path, protocol(), PRESENTED[:2], "fk")

    def interrupts() -> Reply | None:
        bench.console.instead[Play] = bench.press
        raise KeyboardInterrupt

    bench.console.instead[Play] = interrupts
    assert bench.run().reason == "paused"
    assert not bench.actuator.played
    assert bench.run().reason == "complete"
    assert [(one.trial, one.attempt) for one in bench.of(Armed)] == [(1, 1), (1, 2), (2, 1)]


def test_a_level_multiplies_every_stimulus_of_its_trial(tmp_path: Path) -> None:
    levels = {"method": "up-down", "grid": (0.25, 0.5, 1.0), "first": 0.5, "down": 1, "reversals": 2}
    study = presenting(repetitions=4)
    study["tasks"] = ({**study["tasks"][0], "levels": levels},)
    read = ProtocolFile.model_validate(study)
    bench = Bench(tmp_path, read, [("felt",), ("cork",)] * 4, "ffffffff")
    bench.run()
    waves = rendered(read, bench.actuator.rate_hz)
    first = bench.actuator.played[0]
    np.testing.assert_array_equal(first, 0.5 * waves["felt"].waveform_m_s2)


LEVELS = {"method": "up-down", "grid": (0.25, 0.5, 1.0), "first": 0.5, "down": 1, "reversals": 2}


@pytest.mark.parametrize("leveled", [False, True])
def test_what_a_participant_gets_familiar_with_is_played_and_on_record(tmp_path: Path, leveled: bool) -> None:
    study = presenting()
    study["tasks"] = ({**study["tasks"][0], "levels": LEVELS if leveled else None},)
    read = ProtocolFile.model_validate(study)
    bench = Bench(tmp_path, read, PRESENTED[:2], "fk")
    bench.opens = PresentedDevices
    bench.console.handles.extend(["2" if leveled else "k", ENTER])
    assert bench.run().reason == "complete"
    felt = [(entry.interval.material, entry.level) for entry in bench.of(Sample)]
    extremes = [("felt", 0.25), ("felt", 1.0), ("cork", 1.0), ("cork", 0.25)]
    assert felt == (extremes if leveled else [("cork", 1.0), ("felt", 1.0)])
    waves = rendered(read, bench.actuator.rate_hz)
    for played, (material, level) in zip(bench.actuator.played, felt, strict=False):
        np.testing.assert_array_equal(played, level * waves[material].waveform_m_s2)
    done = progress(bench.entries)
    assert done.stimuli == len(felt) + 2
    (*_, last) = bench.of(Sample)
    (first, *_) = bench.of(Presentation)
    assert first.intervals[0].onset_ns > last.interval.onset_ns


def familiar(folder: Path, *keys: str, **wanted: float) -> Bench:
    """One in which a participant gets familiar with felt and cork first."""
    study = presenting()
    task = study["tasks"][0]
    study["tasks"] = ({**task, "familiarisation": {**task["familiarisation"], **wanted}},)
    bench = Bench(folder, ProtocolFile.model_validate(study), PRESENTED[:2], "fk")
    bench.opens = PresentedDevices
    bench.console.handles.extend(keys)
    return bench


def test_what_was_not_delivered_was_not_felt_and_plays_again(tmp_path: Path) -> None:
    bench = familiar(tmp_path, ENTER, ENTER)
    bench.actuator.heard.append(Delivered(requested_ns=0, xruns=1, delivered=False, reason="an xrun"))
    assert bench.run().reason == "complete"
    assert [entry.interval.material for entry in bench.of(Sample)] == ["felt", "cork", "felt"]
    assert [" ".join(sorted(counts.values())) for counts in bench.console.counts] == [
        "cork (0) felt (0)",
        "cork (1) felt (0)",
    ]
    assert sum("an xrun" in text for text in bench.console.shown) == 1


def test_what_sounded_is_on_record_whatever_comes_after(tmp_path: Path) -> None:
    bench = familiar(tmp_path, ENTER)
    bench.actuator.heard.append(ActuatorError("actuator", "went away"))
    with pytest.raises(ActuatorError):
        bench.run()
    (sample,) = bench.of(Sample)
    assert progress(bench.entries).vibration_s == sample.interval.stimulus.lasts_s


def test_after_its_longest_time_a_familiarisation_plays_nothing(tmp_path: Path) -> None:
    bench = familiar(tmp_path, *"ffffffff", min_s=0, max_s=4)
    assert bench.run().reason == "complete"
    assert 3 <= len(bench.of(Sample)) <= 4
    assert bench.console.counts[-1] == {}


def test_each_share_of_a_row_is_of_the_stimulus_that_is_worst_by_it() -> None:
    bare = {"asked_sha256": "", "floored_bins": 0, "extrapolated": False, "handed_sha256": "", "handed_unit": "V"}
    rest = {**bare, "handed_peak": 1.0, "samples": 5, "rate_hz": 5000, "limited": 0, "reached_peak_m_s2": 1.0}
    shares = ((0.3, 0.1, None), (0.2, 0.2, 0.5))
    intervals = tuple(
        Interval.model_validate(
            {
                "material": "felt",
                "onset_ns": 0,
                "stimulus": {
                    **rest,
                    "computed": {"method": "", "relative_error": off, "left_out": out, "dissimilarity_m_s2": unlike},
                },
                "delivered": None,
            }
        )
        for off, out, unlike in shares
    )
    cells = _played(intervals, 0)
    assert (cells["stimulus_error"], cells["left_out"], cells["dissimilarity"]) == (0.3, 0.2, 0.5)
    assert _played(intervals[:1], 0)["dissimilarity"] is None


ROOMS = ("session.kinds.footstep", "rehearsal", "recordings")
UNNEEDED = tuple(f"palpate.experiment.{room}" for room in ROOMS)
WAV = {"palpate.experiment.recordings", "palpate.experiment.recordings.wav"}
"""What a recorded part is read with."""
TRACKER = "palpate.experiment.apparatus.tracker"
LEFT = {TRACKER, f"{TRACKER}.settings"}
"""What a rig file is read with."""

LOADS = """
import socket, sys, threading
from contextlib import ExitStack
from datetime import date
from pathlib import Path
from types import SimpleNamespace
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.protocol import files
from palpate.experiment.session import run
from palpate.experiment.session.kind import Sitting, session_kind
protocol, rig_file = files.load(Path(sys.argv[1])), Path(sys.argv[2])
(task, *_), rig = protocol.tasks, rigs.load(rig_file)
kind = session_kind(task)
kind.judge(protocol=protocol, rig=rig, rig_file=rig_file, today=date(2026, 1, 1))
sitting = Sitting(protocol, rig, rig_file, "01", task.id, Path(), None, run.MonotonicClock())
with socket.create_server(("127.0.0.1", 0)) as server, ExitStack() as opened:
    threading.Thread(target=lambda: server.accept()[0].close()).start()
    panel = f"127.0.0.1:{server.getsockname()[1]}"
    kind.opens(sitting, None, SimpleNamespace(panel=lambda *_: panel, playing=lambda actuator, *_: actuator), opened)
print(*sorted(sys.modules), sep="\\n")
"""


@pytest.mark.parametrize("recorded", [False, True])
def test_a_session_of_presented_stimuli_loads_no_tracker_and_no_footstep(tmp_path: Path, recorded: bool) -> None:
    study = recording(tmp_path) if recorded else shipped("presented.toml").resolve()
    words = [sys.executable, "-c", LOADS, str(study), str(shipped("rigs/presented.toml").resolve())]
    loaded = subprocess.run(words, capture_output=True, text=True, check=True).stdout.split()
    assert {name for name in loaded if name.startswith(UNNEEDED)} == (WAV if recorded else set())
    assert {name for name in loaded if name.startswith(TRACKER)} <= LEFT
