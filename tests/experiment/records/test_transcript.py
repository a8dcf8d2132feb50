"""What `palpate journal` says of a session, in lines that fit a page."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.errors import JournalError
from palpate.experiment.protocol import kinds
from palpate.experiment.records import chain, journal, transcript
from palpate.experiment.records.entries import (
    Entry,
    Footer,
    LevelChosen,
    MaskerSet,
    Phase,
    Shown,
    TrackEnded,
    Withdrawal,
)
from palpate.experiment.records.kinds.footstep import FootStep, Zeroed
from palpate.experiment.records.stimulus import Computed, Onset, Shaping, Stimulus
from palpate.experiment.records.tracker import TrackerClock
from tests.approved import Refuses
from tests.experiment.records.test_resume import broken_off, step
from tests.experiment.session.bench import COMPUTED, DELIVERED, HEADER

STIMULUS = Stimulus(
    asked_sha256="0" * 64,
    floored_bins=0,
    extrapolated=False,
    computed=COMPUTED.model_copy(update={"relative_error": 0.391, "left_out": 0.3458}),
    handed_sha256="0" * 64,
    handed_unit="V",
    handed_peak=0.5,
    samples=48_000,
    rate_hz=48_000,
    limited=0,
    reached_peak_m_s2=12.345,
)
ONSET = Onset(
    predicted_us=None,
    standard_error_ms=None,
    predicted_from_us=None,
    prediction_error_ms=-0.12,
    contact_ns=0,
    scheduled_ns=0,
    gate_to_scheduled_ms=1.5,
    delivered=DELIVERED,
)


WITHDRAWN = Withdrawal(reason="asked to stop", torn="")


def told(folder: Path, *entries: Entry) -> str:
    path = folder / "sub-01_task-virtual_journal.jsonl"
    writer = chain.Writer(path, chain.START)
    for number, entry in enumerate((HEADER, *entries)):
        writer.append(writer.next_link(number * 1_000_000, entry.model_dump(mode="json")))
    writer.close()
    return transcript.text(journal.read(path))


def test_levels_and_ends_of_tracks_have_their_lines(tmp_path: Path) -> None:
    text = told(
        tmp_path,
        LevelChosen(trial=1, attempt=2, track="foil", level=0.25),
        TrackEnded(track="foil", why="reversals"),
    )
    assert "trial 1.2: level 0.25" in text
    assert "foil ended: reversals" in text


@pytest.mark.parametrize("name", kinds.NAMES)
def test_each_entry_of_a_kind_has_its_line(name: str) -> None:
    module = import_module(f"palpate.experiment.records.kinds.{name}")
    own = {one for one in vars(module).values() if isinstance(one, type) and issubclass(one, Entry)}
    lines = import_module(f"palpate.experiment.records.transcript.{name}").LINES
    assert set(lines) == set(module.ENTRIES) == {one for one in own if one.__module__ == module.__name__}


def test_one_trial_can_be_told_alone(tmp_path: Path, refuses: Refuses, approved: SnapshotAssertion) -> None:
    told(tmp_path, step(1, 1), Phase(state="paused"), step(2, 1))
    contents = journal.read(tmp_path / "sub-01_task-virtual_journal.jsonl")
    alone = transcript.text(contents, 2)
    assert "trial 2.1: foil" in alone
    assert "trial 1.1" not in alone
    assert "paused" not in alone
    with refuses(JournalError):
        transcript.text(contents, 3)
    assert told_alone(tmp_path / "first", 2) == approved


def told_alone(folder: Path, trial: int) -> str:
    folder.mkdir()
    told(folder, step(1, 1))
    return transcript.text(journal.read(folder / "sub-01_task-virtual_journal.jsonl"), trial)


TAKEN_DOWN = Shaping(
    saturated_bins=0,
    saturated_cost_m_s2=0.0,
    outside_bins=0,
    outside_cost_m_s2=0.0,
    bounded_bins=0,
    bounded_cost_m_s2=0.0,
    scale=0.746,
)

OLD = Computed(method="basis waveforms", relative_error=1e-13)
"""Of a journal from before a stimulus had its budget."""


def stepped(stimulus: Stimulus | None, onset: Onset | None) -> FootStep:
    return step(1, 1).model_copy(update={"stimulus": stimulus, "onset": onset})


@pytest.mark.parametrize(
    ("stimulus", "onset", "said"),
    [
        (None, None, "no stimulus; frames"),
        (
            STIMULUS,
            ONSET,
            "12.3 m/s^2 at the panel, driven by 0.5 V, rms error 39.10% (34.58% left out); frames",
        ),
        (
            STIMULUS.model_copy(update={"shaping": TAKEN_DOWN}),
            ONSET,
            "driven by 0.5 V, scaled to 74.6% by the limit on its voltage, rms error 39.10%",
        ),
        (STIMULUS.model_copy(update={"computed": OLD}), None, "driven by 0.5 V; delivery was not measured; frames"),
        (
            STIMULUS.model_copy(update={"computed": OLD, "extrapolated": True}),
            ONSET,
            "driven by 0.5 V, at a speed outside the recorded range; frames",
        ),
        (
            STIMULUS.model_copy(update={"handed_unit": "m/s^2"}),
            ONSET.model_copy(update={"delivered": None}),
            "a peak of at most 12.3 m/s^2, rms error 39.10% (34.58% left out); delivery was not measured; frames",
        ),
    ],
)
def test_it_says_how_strong_a_stimulus_was_and_whether_that_was_measured(
    tmp_path: Path, stimulus: Stimulus | None, onset: Onset | None, said: str
) -> None:
    text = " ".join(told(tmp_path, stepped(stimulus, onset)).split())
    assert said in text
    assert ("delivery was not measured" in text) == ("delivery was not measured" in said)


def test_it_says_how_well_a_contact_is_known_where_the_journal_does(tmp_path: Path) -> None:
    one = step(1, 1)
    for name, written, said in (
        ("now", one.model_copy(update={"contact_standard_error_ms": 0.284}), True),
        ("before", one, False),
    ):
        (folder := tmp_path / name).mkdir()
        assert ("the contact time has a standard error of 0.28 ms" in " ".join(told(folder, written).split())) == said


def test_it_says_what_the_participant_saw(tmp_path: Path, approved: SnapshotAssertion) -> None:
    first = Shown(show="instructions", text="Crinkle all four.", pace=None, since_ns=7)
    second = Shown(show="ready", text="", pace="fast", since_ns=8)
    text = told(tmp_path, first, second)
    assert text == approved


def test_a_session_without_a_footer_can_be_resumed_unless_the_participant_withdrew(tmp_path: Path) -> None:
    none = "The session has no footer: it"
    again = f"{none} is running, or it was interrupted and can be resumed."
    for name, entries, last in (("on", [], again), ("off", [WITHDRAWN], f"{none} was interrupted.")):
        (folder := tmp_path / name).mkdir()
        assert told(folder, Phase(state="ready"), *entries).splitlines()[-1] == last


@pytest.mark.parametrize(
    ("entry", "field", "wrong"),
    [
        (HEADER, "started_utc", "2001-02-30T00:00:00+00:00"),
        (HEADER, "started_utc", "9999-12-31T23:59:59+00:00"),
        (HEADER, "started_utc", "0001-01-01T00:00:00+14:00"),
        (step(1, 1), "gate_top_us", -1e16),
        (step(1, 1), "gate_bottom_us", 1e16),
        (step(1, 1), "contact_us", 1e300),
        (
            step(1, 1),
            "clock",
            TrackerClock(anchor_us=0, anchor_ns=0, drift_ppm=0.0).model_copy(update={"drift_ppm": 1e300}),
        ),
        (step(1, 1), "stimulus", STIMULUS.model_copy(update={"rate_hz": 0})),
        (MaskerSet(level_db_a=50.0, dose=0.0, daily_level_db_a=None), "level_db_a", 1e300),
    ],
)
def test_a_value_that_nothing_can_have_is_no_entry_however_it_was_chained(
    tmp_path: Path, entry: Entry, field: str, wrong: object, refuses: Refuses
) -> None:
    with refuses(JournalError):
        told(tmp_path, entry.model_copy(update={field: wrong}))


def test_no_line_is_wider_than_a_page(tmp_path: Path) -> None:
    text = told(
        tmp_path,
        Zeroed(offset_mm=-0.5, spread_mm=0.01, samples=100),
        stepped(STIMULUS, ONSET).model_copy(update={"dead_time_ms": 5.0, "presented": ("wood " * 20, "foil" * 40)}),
        broken_off(1, 2, felt=True).model_copy(update={"reason": "a reason of many words, " * 8}),
        Phase(state="paused", detail="x" * 300),
        Footer(reason="paused", detail="y " * 150, answered=0),
    )
    widths = [len(line) for line in text.splitlines()]
    assert max(widths) <= transcript.WIDTH
    # An entry's further lines stand behind its time, so that none of them passes for an entry.
    entries = text.split("\n\n")[1].splitlines()
    assert all(line.startswith(transcript.INDENT) or line[10:14] == " s  " for line in entries)
