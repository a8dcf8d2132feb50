"""Levels on record: cut anywhere they go on with the same one, and what does not follow is found on its line."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palpate.experiment.findings import Finding
from palpate.experiment.protocol.designs.comparison import FIRST, SECOND
from palpate.experiment.protocol.files import ProtocolFile
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records.entries import (
    Answer,
    Armed,
    Correction,
    Entry,
    Footer,
    LevelChosen,
    Note,
    Redo,
    TrackEnded,
)
from palpate.experiment.records.kinds.tapping import PairLaidOut
from palpate.experiment.records.progress import Progress, progress
from palpate.experiment.study.levels import Tracks
from palpate.experiment.study.schedule import block_trials, schedule
from tests.experiment.protocol import leveled
from tests.experiment.protocol.tapping import rendering
from tests.experiment.session.bench import HEADER
from tests.experiment.study.levels.test_up_down import naive_levels, naive_reversals

SEEDS = range(5)
PATH = Path("sub-01_task-virtual_journal.jsonl")


def study() -> Protocol:
    """Three materials, and so three tracks of two of them each."""
    tables = rendering()
    task = tables["tasks"][0] | {"order": {"kind": "blocked-random"}, "repetitions": 24}
    levels = leveled.LEVELS | {"grid": (0.1, 0.2, 0.4, 0.8), "first": 0.8, "reversals": 5}
    return ProtocolFile.model_validate(tables | {"format": 5, "tasks": (task | {"levels": levels},)})


PROTOCOL = study()
TRACKS = Tracks(PROTOCOL, PROTOCOL.tasks[0])


def answer(entry: Armed, answered: str | None) -> Answer:
    return Answer(
        trial=entry.trial,
        attempt=entry.attempt,
        presented=entry.presented,
        answered=answered,
        key="1",
        response_time_s=1.0,
        confirmed_s=1.5,
    )


def simulated(seed: int, *, remarks: bool = True) -> list[Entry]:
    """A whole session: `remarks` are trials that come again, answers that are none, and corrections at any moment."""
    order = schedule(protocol=PROTOCOL, participant="01", task_id="virtual", seed=seed)
    size = block_trials(PROTOCOL, "virtual")
    header = HEADER.model_copy(update={"order": order, "block_trials": size, "task_kind": "tapping"})
    recorded: list[Entry] = [header]
    rng, done = np.random.default_rng(seed), Progress(header)

    def write(entry: Entry) -> None:
        nonlocal done
        recorded.append(entry)
        done = done.after(entry)

    def correct() -> None:
        trial, said = done.said[int(rng.integers(len(done.said)))]
        other = {FIRST: SECOND, SECOND: None, None: FIRST}[said]
        write(Correction(trial=trial, attempt=done.attempts[trial], answered=other, key="1", reason="misheard"))

    while True:
        for entry in list(TRACKS.upcoming(done)):
            write(entry)
        if not done.remaining:
            write(Footer(reason="complete", answered=len(done.answered)))
            return recorded
        planned = done.remaining[0]
        if remarks and done.said and rng.random() < 0.1:
            correct()
        armed = Armed(
            trial=planned.trial,
            attempt=done.attempts.get(planned.trial, 0) + 1,
            presented=planned.presented,
        )
        write(armed)
        write(PairLaidOut(trial=armed.trial, attempt=armed.attempt, presented=armed.presented, laid_ns=0))
        if remarks and rng.random() < 0.1:
            put_off = bool(rng.random() < 0.5)
            write(Redo(trial=armed.trial, attempt=armed.attempt, reason="a door slammed", put_off=put_off))
            continue
        harder = FIRST if planned.presented == tuple(sorted(planned.presented, key=RANKS.index))[::-1] else SECOND
        right = rng.random() < 0.5 + 0.5 * done.levels[planned.trial]
        write(answer(armed, harder if right else SECOND if harder == FIRST else FIRST))
        if remarks and rng.random() < 0.05:
            correct()


RANKS = [material.id for material in PROTOCOL.materials]


def findings(recorded: Sequence[Entry]) -> list[Finding]:
    return list(TRACKS.findings(PATH, recorded))


def of_levels(recorded: Sequence[Entry]) -> list[int]:
    return [place for place, entry in enumerate(recorded) if isinstance(entry, LevelChosen | TrackEnded)]


def test_pairs_of_one_material_are_not_presented() -> None:
    assert PROTOCOL.presentations(PROTOCOL.tasks[0]) == (("felt", "cork"), ("felt", "tin"), ("cork", "tin"))
    assert PROTOCOL.trials(PROTOCOL.tasks[0]) == 72


@pytest.mark.parametrize("seed", SEEDS)
def test_levels_of_each_track_are_those_of_the_printed_rule(seed: int) -> None:
    recorded, rule = simulated(seed, remarks=False), PROTOCOL.tasks[0].levels
    assert rule is not None
    done = progress(recorded)
    ends = {entry.track: entry.why for entry in recorded if isinstance(entry, TrackEnded)}
    assert ends.keys() == {planned.track for planned in done.header.order}
    said, presented = dict(done.said), {one.trial: one for one in done.header.order}
    for track, why in ends.items():
        trials = [trial for trial in said if presented[trial].track == track]
        answers = "".join(
            "+" if (RANKS.index(first) > RANKS.index(second)) == (said[trial] == FIRST) else "-"
            for trial in trials
            for first, second in [presented[trial].presented]
        )
        assert [done.levels[trial] for trial in trials] == naive_levels(answers, rule)[:-1]
        assert (why == "reversals") == (naive_reversals(answers, rule.down or 0) == rule.reversals)
        assert why == "reversals" or len(trials) == 24


@pytest.mark.parametrize("seed", SEEDS)
def test_cut_anywhere_a_session_goes_on_with_what_is_on_record(seed: int) -> None:
    recorded = simulated(seed)
    assert findings(recorded) == []
    for place in of_levels(recorded):
        assert next(TRACKS.upcoming(progress(recorded[:place]))) == recorded[place]
        # Cut once more before it began, the same attempt has its level twice.
        twice = [*recorded[: place + 1], *TRACKS.upcoming(progress(recorded[: place + 1]))]
        assert findings(twice) == []
    assert list(TRACKS.upcoming(progress(recorded))) == []


def test_a_correction_changes_levels_to_come_and_no_level_on_record() -> None:
    changed = 0
    for seed in SEEDS:
        recorded = simulated(seed)
        for place, entry in enumerate(recorded):
            if isinstance(entry, Correction):
                before, after = progress(recorded[:place]), progress(recorded[: place + 1])
                assert (before.levels, before.ended, before.remaining) == (after.levels, after.ended, after.remaining)
                changed += list(TRACKS.upcoming(before))[-1:] != list(TRACKS.upcoming(after))[-1:]
    assert changed > 1


def test_no_answer_moves_no_track() -> None:
    recorded = simulated(1, remarks=False)
    place = next(place for place, entry in enumerate(recorded) if isinstance(entry, Answer))
    said = recorded[place]
    assert isinstance(said, Answer)
    before, none = progress(recorded[:place]), said.model_copy(update={"answered": None})
    after = before.after(none)
    assert after.answered == (said.trial,)
    assert TRACKS._states(after) == TRACKS._states(before)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_forged_entry_is_found_on_its_line(seed: int) -> None:
    recorded, rng = simulated(seed), np.random.default_rng(seed)
    places = of_levels(recorded)
    for place in rng.choice(places, size=min(10, len(places)), replace=False).tolist():
        entry: Any = recorded[place]
        lies: list[dict[str, object]] = [{"track": "felt"}]
        if isinstance(entry, LevelChosen):
            lies += [{"level": level} for level in (0.1, 0.2, 0.4, 0.8, 0.5) if level != entry.level]
            lies += [{"trial": entry.trial + 1}, {"attempt": entry.attempt + 1}]
        else:
            lies.append({"why": "trials" if entry.why == "reversals" else "reversals"})
        for lie in lies:
            forged = [*recorded[:place], entry.model_copy(update=lie), *recorded[place + 1 :]]
            (finding,) = findings(forged)
            assert (finding.where, finding.line) == (PATH, place + 1), lie


def test_an_attempt_without_a_level_and_an_end_that_is_left_out_are_found() -> None:
    recorded = simulated(3)
    for place in of_levels(recorded):
        (finding,) = findings([*recorded[:place], *recorded[place + 1 :]])
        assert finding.line is not None
        assert finding.line > place


def test_a_track_that_ended_stays_ended() -> None:
    recorded = simulated(2, remarks=False)
    place = next(place for place, entry in enumerate(recorded) if isinstance(entry, TrackEnded))
    ended = recorded[place]
    assert isinstance(ended, TrackEnded)
    done = progress(recorded[: place + 1])
    assert all(planned.track != ended.track for planned in done.remaining)
    assert done.trials == len(done.answered) + len(done.remaining) < len(done.header.order)
    (trial, said) = next(one for one in done.said[::-1] if _track(done, one[0]) == ended.track)
    other = SECOND if said == FIRST else FIRST
    corrected = done.after(Correction(trial=trial, attempt=1, answered=other, key="1", reason="misheard"))
    assert all(not isinstance(entry, TrackEnded) for entry in TRACKS.upcoming(corrected))
    assert corrected.remaining == done.remaining
    assert done.after(Note(trial=None, text="a break")).remaining == done.remaining


def _track(done: Progress, trial: int) -> str:
    return next(one.track for one in done.header.order if one.trial == trial)
