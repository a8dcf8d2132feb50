"""From journals to the study's BIDS dataset: events, foot traces, participants. Reads only what is on disk."""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from palpate.experiment import storage
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.tracker import frames
from palpate.experiment.apparatus.tracker.clock_map import ClockMap
from palpate.experiment.dataset import bids, comparison
from palpate.experiment.dataset.beliefs import (
    OPEN,
    Believed,
    Each,
    believed,
    build_again,
    collected,
    has_journals,
    origin_of,
)
from palpate.experiment.errors import DatasetError, PalpateError
from palpate.experiment.protocol.models import Protocol, Task
from palpate.experiment.records import entries, journal, software
from palpate.experiment.records.events import NO_ANSWER
from palpate.experiment.records.kinds.footstep import BrokenOff, FootStep, Zeroed
from palpate.experiment.records.progress import progress
from palpate.experiment.records.stimulus import Onset, Stimulus
from palpate.experiment.storage import foot_path, rig_path

LONGEST_GAP_S = 600.0
"""After a longer pause, or where time goes back by more than a frame, the foot trace continues in a new recording."""

FOOT_COLUMNS = {
    "foot_height": "Height of the sole above the panel.",
    "foot_along": "Place of the sole along the face, as the planar tracker was calibrated.",
}
"""What a trace of the foot tells; the second stands where the tracker was planar."""

ORIGINS: dict[entries.Purpose, bids.Origin] = {
    "STUDY": "PARTICIPANT",
    "PILOT": "PILOT",
    "PRACTICE": "PRACTICE",
    "REHEARSAL": "REHEARSAL",
}
"""What produced the rows of a dataset, by what its sessions are for."""

LABELS = {purpose: bids.LABELS[origin] for purpose, origin in ORIGINS.items()}
"""What stands at the head of all that tells of such a dataset."""

READ = {
    "dataset_description.json": ("Name", "Palpate"),
    "_events.json": ("TaskTitle", "Instructions", "Materials", "Answers", "Rows", "SessionId"),
}
"""What analysis reads of JSON files, by the end of their names; the rest is told by each version in its own words."""


@dataclass(frozen=True)
class _Session:
    path: Path
    contents: journal.Contents
    steps: tuple[Placed, ...]


@dataclass(frozen=True)
class Placed:
    """A step on the session's clock.

    `at_us` is the device time of its contact or break, `at_s` the same in s from the tracker's first frame; `drift_ppm`
    is the session's clock against the device's. `zero_mm` is how far from contact the foot rested when last zeroed.
    """

    step: FootStep | BrokenOff
    at_us: float
    at_s: float
    drift_ppm: float
    zero_mm: float

    def seconds(self, device_us: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return device times, any shape, on the clock of `at_s`, s."""
        passed_s = (device_us - self.at_us) / 1e6
        return np.asarray(self.at_s + passed_s * (1 + self.drift_ppm * 1e-6), np.float64)


def build(root: Path, each: Each = map) -> None:
    """Write the BIDS files of every session under `root/sourcedata`, replacing earlier ones.

    `each` is as for `believed`. Journals without a header are omitted. Raises as `believed`, and `DatasetError` without
    journals (unless erased) or if a foot trace is not the one its journal names.
    """
    dataset = believed(root, each)
    if not storage.journals(root) and not (dataset.roster and dataset.roster.erased):
        raise DatasetError(root, "got no journal", "run a session first", allowed="one or more")
    bids.write_files(_study_files(root, dataset))
    for _ in each(partial(_build_session, root, dataset.protocol, dataset.purpose), [of[0] for of in dataset.sessions]):
        pass


UNMADE = "a rehearsal makes its tables at its end, and not all are there yet; the same palpate rehearse goes on with it"


def unmade(root: Path, dataset: Believed) -> bool:
    """Return whether a rehearsal without `derivatives` was interrupted, so that its tables may be missing or old."""
    if dataset.purpose != "REHEARSAL":
        return False
    complete = sum(progress(journal.read(path).entries).complete for path, _ in dataset.sessions)
    made = (root / "derivatives").exists() or all(_has_table(root, header) for _, header in dataset.sessions)
    return complete < sum(map(len, dataset.tasks.values())) or not made


def _build_session(root: Path, protocol: Protocol, purpose: entries.Purpose, path: Path) -> None:
    session = _session(path, journal.read(path))
    _write_foot(root, session, ORIGINS[purpose])
    # The table comes last: where it is, nothing of its session is missing.
    bids.write_files(_events(root, protocol, purpose, session))


def check_tables(root: Path) -> Believed:
    """Return `believed` if journals, tables and raw frames agree, apart from open sessions.

    Raises as `believed`, and `DatasetError` for the first difference, or if no session has ended and none has a table.
    """
    dataset = believed(root)
    doubts = edited(root, dataset, dataset.under_way)
    none = dataset.under_way and not any(_has_table(root, header) for _, header in dataset.sessions)
    if (doubts or none) and unmade(root, dataset):
        raise DatasetError(root, UNMADE)
    for doubt in doubts:
        raise doubt
    if none:
        raise DatasetError(
            root,
            "no session has ended yet, and no table has been made",
            build_again(root, "end one, or have tables made of what was answered so far", suffices=False),
        )
    return dataset


def check_analysed(root: Path) -> tuple[str, ...]:
    """Return what has to be said of a dataset before it is analysed: open sessions, or tables without a journal.

    Raises as `check_tables` where there are journals.
    """
    if has_journals(root):
        return tuple(f"{path}: {OPEN}" for path in sorted(check_tables(root).under_way))
    if (root / "dataset_description.json").exists() and origin_of(root) not in ("RECONSTRUCTION", "IMPORTED"):
        return (f"{root}: no journal stands behind these tables, so a changed cell would not show",)
    return ()


def edited(
    root: Path, dataset: Believed, under_way: Collection[Path] = (), *, whole: bool = True
) -> list[PalpateError]:
    """Return an error for each table that the journals do not give, and for frames that they do not name.

    Journals `under_way` may have tables since their last footer. Files of all participants are compared in a `whole`
    dataset.
    """
    doubts: list[PalpateError] = []

    def unlike(files: bids.Files) -> list[PalpateError]:
        found: list[PalpateError] = []
        for path, content in files.items():
            with collected(found):
                _check_table(root, path, content)
        return found

    found = unlike(_study_files(root, dataset)) if whole else []
    if found and under_way:
        told = [(path, of) for path, of in dataset.sessions if path not in under_way or _has_table(root, of)]
        files = _study_files(root, replace(dataset, sessions=tuple(told)))
        # Before the first session ends nothing is made that could be missed.
        found = unlike({path: content for path, content in files.items() if told or path.exists()})
    doubts += found
    for session in _sessions(dataset):
        made = partial(_events, root, dataset.protocol, dataset.purpose)
        found = unlike(made(session))
        if found and session.path in under_way:
            earlier = (
                unlike(_events(root, dataset.protocol, dataset.purpose, then)) for then in _since_footer(session)
            )
            unmade = not until_footer(session.contents).lines and not _has_table(root, session.contents.header)
            found = [] if unmade else min([found, *earlier], key=len)
        doubts += found
        with collected(doubts):
            raw_frames(session.path, [placed.step for placed in session.steps])
    return doubts


def _since_footer(session: _Session) -> Iterator[_Session]:
    """Yield a session as it was after each line since its last footer, the latest first, and at that footer."""
    lines, ended = session.contents.lines, len(until_footer(session.contents).lines)
    for count in range(len(lines) - 1, max(ended, 1) - 1, -1):
        yield _session(session.path, replace(session.contents, lines=lines[:count]))


def until_footer(contents: journal.Contents) -> journal.Contents:
    """Return a journal as it was when its session last ended, which is when its tables were made; empty if never."""
    ends = [number for number, entry in enumerate(contents.entries, start=1) if isinstance(entry, entries.Footer)]
    return replace(contents, lines=contents.lines[: ends[-1]] if ends else ())


def _has_table(root: Path, header: entries.Header) -> bool:
    return bids.beh_path(root, header.participant, header.task, "events.tsv").exists()


def _sessions(dataset: Believed) -> Iterator[_Session]:
    """Read one journal after another, so that a large dataset takes no more memory than its longest session."""
    return (_session(path, journal.read(path)) for path, _ in dataset.sessions)


def _events(root: Path, protocol: Protocol, purpose: entries.Purpose, session: _Session) -> bids.Files:
    origin, header = ORIGINS[purpose], session.contents.header
    task = _task_text(protocol, protocol.task(header.task), origin, header.session_id)
    paired = protocol.comparison is not None
    rows = comparison.rows(session.contents, origin) if paired else _rows(session, origin)
    return bids.events(root, header.participant, task, rows)


def _study_files(root: Path, dataset: Believed) -> bids.Files:
    """Return the files that stand once in a dataset."""
    protocol, origin = dataset.protocol, ORIGINS[dataset.purpose]
    withdrawn = dataset.roster.withdrawn if dataset.roster is not None else {}
    first_tasks: dict[str, str] = {}
    for _, header in dataset.sessions:
        first_tasks.setdefault(header.participant, bids.MISSING)
        if header.task_position == 1:
            first_tasks[header.participant] = header.task
    people = [
        {"participant_id": f"sub-{who}", "first_task": first, "withdrawn": who in withdrawn}
        for who, first in first_tasks.items()
    ]
    simulated = origin in ("PRACTICE", "REHEARSAL")
    readmes = tomllib.loads(Path(__file__).with_name("readme.toml").read_text("utf-8"))
    text = bids.DatasetText(
        study=protocol.study.id,
        name=protocol.study.title,
        origin=origin,
        license="CC0-1.0" if simulated else "n/a: ask the laboratory",
        authors=("palpate, simulated",) if simulated else ("The laboratory named in the protocol",),
        tasks=tuple(task.id for task in protocol.tasks),
        references=(protocol.study.source,),
        readme=(readmes["all"] | readmes["pairs" if protocol.comparison is not None else "all"])[origin],
        software=software.this(),
    )
    return bids.participants(root, people, origin=origin) | bids.description(root, text)


def _check_table(root: Path, path: Path, content: bytes) -> None:
    """Refuse a table that is not the one that the journals give."""
    # A journal that was cut, its head too, leaves nothing else behind that knows of what is gone.
    cause = "it was edited, or the journals are newer, or were changed themselves"
    remedy = build_again(root, f"{cause}; compare both with a backup, then make the tables again", suffices=False)
    if not path.exists():
        raise DatasetError(path, "is missing", build_again(root, "make it again"))
    read = next((keys for end, keys in READ.items() if path.name.endswith(end)), None)
    if read is None and path.suffix != ".tsv":
        return
    try:
        found = storage.read_bytes(path)
        if read is not None:
            on_disk, given = storage.json_of(found), json.loads(content)
            if not isinstance(on_disk, dict):
                raise ValueError("no JSON object")
            if differing := [key for key in read if on_disk.get(key) != given.get(key)]:
                raise DatasetError(path, f"{differing[0]} is not what the journals give: {remedy}")
            return
    except (OSError, ValueError) as error:
        raise DatasetError(path, f"cannot be read ({storage.why(error)}): {remedy}") from error
    lines = zip_longest(found.split(b"\n"), content.split(b"\n"))
    for number, (on_disk, given) in enumerate(lines, start=1):
        if on_disk != given:
            raise DatasetError(path, f"line {number} is not what the journal gives: {remedy}")


def _session(path: Path, contents: journal.Contents) -> _Session:
    zero_ns: int | None = None
    zero_mm = 0.0
    steps: list[Placed] = []
    for entry in contents.entries:
        if isinstance(entry, entries.TrackerOpened):
            zero_ns = entry.t_ns if zero_ns is None else zero_ns
        elif isinstance(entry, Zeroed):
            zero_mm = entry.offset_mm
        elif isinstance(entry, FootStep | BrokenOff):
            at_us, clock = entry.at_us if isinstance(entry, BrokenOff) else entry.contact_us, entry.clock
            if at_us is None or clock is None:
                # No frame came.
                continue
            if zero_ns is None:
                raise DatasetError(
                    path,
                    "got a step before its tracker was opened",
                    "restore the journal from a backup",
                    allowed="the tracker first",
                )
            at_ns = ClockMap(clock.anchor_us, clock.anchor_ns, clock.drift_ppm).session_ns(at_us)
            at_s = (at_ns - zero_ns) / 1e9
            steps.append(Placed(entry, at_us, at_s, clock.drift_ppm, zero_mm))
    return _Session(path, contents, tuple(steps))


def _rows(session: _Session, origin: bids.Origin) -> list[dict[str, object]]:
    recorded = session.contents.entries
    answers, corrections = _by_attempt(recorded, entries.Answer), _by_attempt(recorded, entries.Correction)
    redone, spoken = _by_attempt(recorded, entries.Redo), _by_attempt(recorded, entries.Spoken)
    maskers = _maskers(recorded)
    rows: list[dict[str, object]] = []
    for placed in session.steps:
        step = placed.step
        attempt = step.trial, step.attempt
        answer, correction = answers.get(attempt), corrections.get(attempt)
        last = correction or answer
        stimulus, onset = (step.stimulus, step.onset) if isinstance(step, FootStep) else (None, None)
        heard = onset.delivered if onset else None
        unanswered = None if answer else "no answer was confirmed"
        reason = redone[attempt].reason if attempt in redone else unanswered
        rows.append(
            {
                "onset": round(placed.at_s, 6),
                "duration": stimulus.samples / stimulus.rate_hz if stimulus else None,
                "trial": step.trial,
                "attempt": step.attempt,
                "counted": answer is not None and attempt not in redone,
                "presented": " | ".join(step.presented),
                "answered": None if last is None else last.answered or NO_ANSWER,
                "response_time": round(answer.response_time_s, 6) if answer else None,
                "foot_speed": round(step.speed_mm_s, 3) if step.speed_mm_s is not None else None,
                "frames_lost": step.link.lost + step.link.damaged,
                "floored_bins": stimulus.floored_bins if stimulus else None,
                "delivered": heard.delivered if heard else None,
                "onset_error": _onset_error_s(onset),
                "redo_reason": step.reason if isinstance(step, BrokenOff) else reason,
                "origin": origin,
                **({"corrected_from": answer.answered or NO_ANSWER} if answer and correction else {}),
                **maskers[attempt],
                **_timing_s(step, onset),
                **_answer_cells(answer, spoken.get(attempt)),
                **_played(stimulus),
            }
        )
    return rows


_Judged = TypeVar("_Judged", entries.Answer, entries.Correction, entries.Redo, entries.Spoken)


def _by_attempt(recorded: Sequence[object], kind: type[_Judged]) -> dict[tuple[int, int], _Judged]:
    """Return the last entry of a kind for each trial and attempt."""
    return {(entry.trial, entry.attempt): entry for entry in recorded if isinstance(entry, kind)}


def _maskers(recorded: Sequence[object]) -> dict[tuple[int, int], dict[str, object]]:
    """Return the cell of the masker's level, if one was set before, for each trial and attempt."""
    cell: dict[str, object] = {}
    cells: dict[tuple[int, int], dict[str, object]] = {}
    for entry in recorded:
        if isinstance(entry, entries.MaskerSet):
            cell = {"masker_level": entry.level_db_a}
        elif isinstance(entry, FootStep | BrokenOff):
            cells[entry.trial, entry.attempt] = cell
    return cells


def _onset_error_s(onset: Onset | None) -> float | None:
    """Return by how much the measured onset missed the contact, s; None if it was not measured."""
    if onset is None or onset.delivered is None or onset.delivered.onset_ns is None:
        return None
    return round((onset.delivered.onset_ns - onset.contact_ns) / 1e9, 6)


def _answer_cells(answer: entries.Answer | None, spoken: entries.Spoken | None) -> dict[str, object]:
    """Return what a microphone adds to an answer, by column; the voice ends the response time only if it is its own."""
    if answer is None or spoken is None:
        return {}
    known = spoken.onset_s is not None
    own = known and spoken.proposed is not None and spoken.proposed == answer.answered
    times_s = {
        **({"response_time": spoken.onset_s} if own else {}),
        "voice_onset": spoken.onset_s,
        "choice_time": answer.response_time_s,
        "confirmation_time": answer.confirmed_s,
    }
    return {
        "response_end": "voice" if own else "choice",
        **{column: None if s is None else round(s, 6) for column, s in times_s.items()},
        "voice_proposed": spoken.proposed,
        "voice_agreement": round(spoken.agreement, 3) if known else None,
        "voice_lead": round(spoken.lead, 3) if known else None,
    }


def _timing_s(step: FootStep | BrokenOff, onset: Onset | None) -> dict[str, object]:
    """Return what is known of a step's timing, by column, s."""
    heard = onset.delivered if onset else None
    known_ms = {
        "contact_standard_error": step.contact_standard_error_ms if isinstance(step, FootStep) else None,
        "prediction_error": onset.prediction_error_ms if onset else None,
        "delivery_error": heard.onset_error_ms if heard else None,
        "gate_to_scheduled": onset.gate_to_scheduled_ms if onset else None,
        "dead_time": step.dead_time_ms,
    }
    return {column: round(ms / 1e3, 6) for column, ms in known_ms.items() if ms is not None}


def _played(stimulus: Stimulus | None) -> dict[str, object]:
    """Return what is known of how a stimulus was played, by column; nothing where a journal is from before that."""
    made = stimulus.computed if stimulus is not None else None
    if made is None or made.left_out is None or made.dissimilarity_m_s2 is None:
        return {}
    return {
        "stimulus_method": made.method,
        "stimulus_error": round(made.relative_error, 9),
        "left_out": round(made.left_out, 9),
        "dissimilarity": round(made.dissimilarity_m_s2, 9),
    }


def _write_foot(root: Path, session: _Session, origin: bids.Origin) -> None:
    """Write the foot's height (and place, if planar) on a grid of the rig's rate that begins anew with each step.

    Between steps it is n/a. A device's clock that drifts leaves a place empty now and then, or has two frames in one.
    """
    if not session.steps:
        return
    header = session.contents.header
    rig = rigs.kept(rig_path(session.path), header.rig_sha256)
    rate_hz = rig.tracker.rate_hz
    parts_of_steps = raw_frames(session.path, [placed.step for placed in session.steps])
    places: list[NDArray[np.float64]] = []
    read_mm: list[NDArray[np.float64]] = []
    for placed, part in zip(session.steps, parts_of_steps, strict=True):
        _, decoded = frames.Decoder(near_us=int(placed.at_us), readings=rig.tracker.readings).feed(part)
        seconds = placed.seconds(decoded.device_us)
        places.append(np.rint(seconds[:1] * rate_hz) + np.rint((seconds - seconds[:1]) * rate_hz))
        heights_mm, along_mm = rig.tracker.height_mm(decoded.counts), rig.tracker.along_mm(decoded.along)
        read_mm.append(np.column_stack([heights_mm - placed.zero_mm, *([] if along_mm is None else [along_mm])]))
    onward = np.diff(np.concatenate(places))
    # Time goes back where the session continued after the wall clock was set back: what was there already stays.
    cuts = np.flatnonzero((onward > LONGEST_GAP_S * rate_hz) | (onward < -1)) + 1
    parts = (np.split(np.concatenate(whole), cuts) for whole in (places, read_mm))
    for number, (on_grid, mm) in enumerate(zip(*parts, strict=True), start=1):
        place = (on_grid - on_grid.min()).astype(np.int64)
        grid = np.full((int(place.max()) + 1, rig.tracker.readings), np.nan)
        grid[place] = mm
        recording = f"recording-foot{number if number > 1 else ''}_physio.tsv.gz"
        bids.write_physio(
            bids.beh_path(root, header.participant, header.task, recording),
            {
                name: bids.PhysioColumn(mm, text, "mm", 3)
                for mm, (name, text) in zip(grid.T, FOOT_COLUMNS.items(), strict=False)
            },
            rate_hz=rate_hz,
            start_s=round(float(on_grid.min()) / rate_hz, 6),
            task=header.task,
            description="Foot height from the tracker, from arming to just after contact; n/a between the steps.",
            origin=origin,
        )


def raw_frames(journal_file: Path, steps: Sequence[FootStep | BrokenOff]) -> list[bytes]:
    """Return the raw frames of each step. Raises `DatasetError` if they are not those that the journal names."""
    if not steps:
        return []
    path = foot_path(journal_file)
    try:
        raw = storage.read_bytes(path, 2**30)
    except OSError as error:
        raise DatasetError(path, f"cannot read the foot trace ({error.strerror})", "restore it") from error
    parts = []
    for step in steps:
        part = raw[step.trace.offset : step.trace.offset + step.trace.length]
        if hashlib.sha256(part).hexdigest() != step.trace.sha256:
            raise DatasetError(
                path, f"the frames of trial {step.trial} are not those that the journal names", "restore the file"
            )
        parts.append(part)
    return parts


def _task_text(protocol: Protocol, task: Task, origin: bids.Origin, session_id: str) -> bids.TaskText:
    count = len(protocol.presented(task))
    what, answers = "1 material" if count == 1 else f"{count} materials", None
    if (compared := protocol.comparison) is not None:
        what = f"{len(protocol.presentations(task))} pairs of {what}, compared by their {compared.quality}"
        answers = {answer: comparison.ANSWERS[answer] for answer in compared.answers.values()}
    return bids.TaskText(
        id=task.id,
        title=task.title,
        description=f"{task.title}. {what}, {task.repetitions} trials each.",
        instructions=task.instruction,
        materials={m.id: m.description for m in protocol.materials},
        presented=task.materials,
        stimulus_presentation={"SoftwareName": "palpate", "SoftwareVersion": software.this().version},
        origin=origin,
        session_id=session_id,
        answers=answers,
    )
