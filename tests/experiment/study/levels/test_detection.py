"""Detection with levels on record: catch trials are of no track, kills change nothing, tracks lead to 70.7 %."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from math import log10
from pathlib import Path
from statistics import NormalDist

import numpy as np
import pytest

from palpate.experiment.protocol.designs.detection import FIRST, NO, SECOND, YES
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records.entries import Answer, Armed, Correction, Entry, Footer, LevelChosen, TrackEnded
from palpate.experiment.records.kinds.presented import Presentation
from palpate.experiment.records.progress import Progress, progress
from palpate.experiment.study.levels import Tracks
from palpate.experiment.study.schedule import block_trials, schedule
from tests.experiment.protocol.detection import CONSTANT, UP_DOWN, protocol
from tests.experiment.session.bench import HEADER

YES_NO = protocol(1, UP_DOWN, repetitions=20)
FIXED = protocol(1, CONSTANT, repetitions=6)
FINE = UP_DOWN | {"grid": tuple(round(10 ** (place / 20 - 1.5), 6) for place in range(31)), "reversals": 40}
TWO = protocol(2, FINE, repetitions=200)
PATH = Path("sub-01_task-one_journal.jsonl")

Observer = Callable[[np.random.Generator, float, tuple[str, ...]], str]


def simulated(study: Protocol, seed: int, observer: Observer) -> list[Entry]:
    """A whole session, without remarks."""
    (task,) = study.tasks
    tracks = Tracks(study, task)
    order = schedule(protocol=study, participant="01", task_id=task.id, seed=seed)
    facts = {"order": order, "block_trials": block_trials(study, task.id), "task": task.id, "seed": seed}
    header = HEADER.model_copy(update=facts | {"task_kind": "presented", "design": "detection"})
    recorded: list[Entry] = [header]
    rng, done = np.random.default_rng(seed), Progress(header)

    def write(*entries: Entry) -> None:
        nonlocal done
        for entry in entries:
            recorded.append(entry)
            done = done.after(entry)

    while True:
        write(*tracks.upcoming(done))
        if not done.remaining:
            write(Footer(reason="complete", answered=len(done.answered)))
            return recorded
        planned = done.remaining[0]
        of = {"trial": planned.trial, "attempt": 1, "presented": planned.presented}
        said = observer(rng, done.levels.get(planned.trial, 0.0), planned.presented)
        write(
            Armed.model_validate(of),
            Presentation.model_validate(of | {"intervals": (), "set_off": "clock"}),
            Answer.model_validate(of | {"answered": said, "key": "1", "response_time_s": 1.0, "confirmed_s": 1.5}),
        )


BLANK = YES_NO.materials[-1].id


def yes_or_no(rng: np.random.Generator, level: float, presented: tuple[str, ...]) -> str:
    share = 0.2 if presented == (BLANK,) else 0.2 + 0.75 * level
    return YES if rng.random() < share else NO


def chance_above(rng: np.random.Generator, level: float, presented: tuple[str, ...]) -> str:
    """Right with 0.5 + 0.5 Phi((x - t) / s), with t at 0.2 and s = 4 dB."""
    right = rng.random() < 0.5 + 0.5 * NormalDist().cdf(20 * log10(level / 0.2) / 4)
    return FIRST if (presented[0] != BLANK) == right else SECOND


def levels_by_track(recorded: Sequence[Entry]) -> dict[str, list[float]]:
    found: dict[str, list[float]] = {}
    for entry in recorded:
        if isinstance(entry, LevelChosen):
            found.setdefault(entry.track, []).append(entry.level)
    return found


@pytest.mark.parametrize("seed", range(3))
def test_catch_trials_have_no_level_move_no_track_and_end_with_the_others(seed: int) -> None:
    recorded = simulated(YES_NO, seed, yes_or_no)
    done, (task,) = progress(recorded), YES_NO.tasks
    catches = {one.trial for one in done.header.order if one.presented == (BLANK,)}
    assert not catches & done.levels.keys()
    ends = [entry for entry in recorded if isinstance(entry, TrackEnded)]
    assert (ends[-1].track, ends[-1].why) == (BLANK, "tracks")
    assert {one.track for one in ends} == {one.id for one in YES_NO.materials}
    # Another answer to every catch trial: the same levels follow.
    tracks = Tracks(YES_NO, task)
    for entry in [one for one in recorded if isinstance(one, Answer) and one.trial in catches]:
        place = recorded.index(entry)
        before, other = progress(recorded[:place]), NO if entry.answered == YES else YES
        answers = (entry, entry.model_copy(update={"answered": other}))
        assert len({tuple(tracks.upcoming(before.after(one))) for one in answers}) == 1


@pytest.mark.parametrize("study", [YES_NO, FIXED], ids=["up-down", "constant"])
def test_cut_anywhere_a_session_goes_on_at_the_level_on_record(study: Protocol) -> None:
    recorded, tracks = simulated(study, 4, yes_or_no), Tracks(study, study.tasks[0])
    assert list(tracks.findings(PATH, recorded)) == []
    cuts = [place for place, entry in enumerate(recorded) if isinstance(entry, LevelChosen | TrackEnded)]
    for place in cuts:
        assert next(tracks.upcoming(progress(recorded[:place]))) == recorded[place]
    forged = [
        entry.model_copy(update={"level": 0.5}) if isinstance(entry, LevelChosen) else entry for entry in recorded
    ]
    assert [one.line for one in tracks.findings(PATH, forged)] == [cuts[0] + 1]
    (lost,) = tracks.findings(PATH, [*recorded[: cuts[3]], *recorded[cuts[3] + 1 :]])
    assert (lost.line or 0) > cuts[3]


def test_constant_levels_are_balanced_and_no_answer_changes_them() -> None:
    recorded = simulated(FIXED, 5, yes_or_no)
    assert levels_by_track(recorded) == levels_by_track(simulated(FIXED, 5, lambda *_: NO))
    assert levels_by_track(recorded) != levels_by_track(simulated(FIXED, 6, yes_or_no))
    for levels in levels_by_track(recorded).values():
        passes = [levels[at : at + 4] for at in range(0, len(levels), 4)]
        assert {tuple(sorted(one)) for one in passes} == {CONSTANT["grid"]}
        assert Counter(levels) == dict.fromkeys(CONSTANT["grid"], 3)
    place = next(
        i for i, entry in enumerate(recorded) if isinstance(entry, Answer) and entry.trial in done_levels(recorded)
    )
    said = recorded[place]
    assert isinstance(said, Answer)
    corrected = Correction(trial=said.trial, attempt=1, answered=YES, key="1", reason="misheard")
    tracks, before = Tracks(FIXED, FIXED.tasks[0]), progress(recorded[: place + 1])
    assert list(tracks.upcoming(before)) == list(tracks.upcoming(before.after(corrected)))


@pytest.mark.parametrize("seed", range(3))
def test_constant_levels_are_balanced_over_intervals(seed: int) -> None:
    """32 trials of a signal, with it first in half at each of 4 levels, and in every 8 of them."""
    study = protocol(2, CONSTANT, repetitions=16)
    recorded = simulated(study, seed, chance_above)
    levels, done = done_levels(recorded), progress(recorded)
    for signal in [one.id for one in study.materials[:-1]]:
        shown = [(levels[one.trial], one.presented[0]) for one in done.header.order if signal in one.presented]
        wanted = {(level, first): 4 for level in CONSTANT["grid"] for first in (signal, BLANK)}
        assert Counter(shown) == wanted
        assert {len({*shown[at : at + 8]}) for at in range(0, 32, 8)} == {8}


def test_a_staircase_has_its_signal_first_in_half_of_any_four_trials() -> None:
    order = schedule(protocol=TWO, participant="01", task_id=TWO.tasks[0].id, seed=1)
    for signal in [one.id for one in TWO.materials[:-1]]:
        first = [one.presented[0] == signal for one in order if signal in one.presented]
        assert {sum(first[at : at + 4]) for at in range(0, len(first), 4)} == {2}


@pytest.mark.parametrize("seed", range(9, 12))
def test_tracks_that_have_all_their_trials_leave_every_catch_trial(seed: int) -> None:
    recorded = simulated(FIXED, seed, yes_or_no)
    said = [entry for entry in recorded if isinstance(entry, Answer)]
    assert sum(one.trial not in done_levels(recorded) for one in said) == 6
    assert {one.why for one in recorded if isinstance(one, TrackEnded)} == {"trials"}


def done_levels(recorded: Sequence[Entry]) -> dict[int, float]:
    return dict(progress(recorded).levels)


def test_two_down_one_up_leads_to_70_7_percent() -> None:
    """Levitt (1971): p^2 = 1/2, here at x = t + s z((2^-1/2 - 0.5) / 0.5), z(0.41421) = -0.21671."""
    tracks = levels_by_track(simulated(TWO, 7, chance_above))
    assert len(tracks) == len(TWO.materials) - 1
    wanted_db = 20 * log10(0.2) - 0.21671 * 4
    means = [np.mean(20 * np.log10(levels[30:])) for levels in tracks.values()]
    # Of steps of 1 dB; the SD of such a mean over seeds is 0.4 dB.
    assert np.mean(means) == pytest.approx(wanted_db, abs=0.8)
