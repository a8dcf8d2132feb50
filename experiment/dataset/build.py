"""From journals to the study's BIDS dataset: events, traces, participants. Reads only what is on disk."""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from itertools import zip_longest
from pathlib import Path
from typing import TypeVar

from palpate.experiment import storage
from palpate.experiment.dataset import bids
from palpate.experiment.dataset.checks import OPEN, Dataset, Each, build_again, has_journals, load_sound, origin_of
from palpate.experiment.errors import DatasetError, PalpateError
from palpate.experiment.protocol.models import Protocol, Task
from palpate.experiment.records import entries, journal, software
from palpate.experiment.records.events import NO_ANSWER
from palpate.experiment.records.progress import progress
from palpate.experiment.storage import foot_path

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

Cells = Mapping[str, object]
"""Column -> what stands in a row."""


def _materials(protocol: Protocol, task: Task) -> str:
    count = len(protocol.presented(task))
    return f"{count} material{'s' if count != 1 else ''}"


@dataclass(frozen=True)
class DatasetKind:
    """A kind of trial in a dataset.

    `cells` yields each outcome of a journal, at this path, that has a row, with the cells that are the kind's own.
    `presented` is what a task presents, in words, and `answers` what each answer names that is no material. `write`
    gets dataset, journal, its contents, raw frames of its outcomes and the origin, and writes what is beside the table.
    """

    cells: Callable[[Path, journal.Contents], Iterator[tuple[entries.Outcome, Cells]]]
    presented: Callable[[Protocol, Task], str] = _materials
    answers: Callable[[Protocol], Mapping[str, str]] = lambda _: {}
    write: Callable[[Path, Path, journal.Contents, Sequence[bytes], bids.Origin], None] = lambda *_: None


def kind_of(task: Task) -> DatasetKind:
    """Return the kind of a task's trials."""
    kind: DatasetKind = import_module(f"palpate.experiment.dataset.kinds.{task.kind}").DATASET
    return kind


def build(root: Path, each: Each = map) -> None:
    """Write the BIDS files of every session under `root/sourcedata`, replacing earlier ones.

    `each` is as for `checks.load`. Journals without a header are omitted. Raises as `load_sound`, and `DatasetError`
    without journals (unless erased) or if a foot trace is not the one its journal names.
    """
    dataset = load_sound(root, each)
    if not storage.journals(root) and not (dataset.roster and dataset.roster.erased):
        raise DatasetError(root, "got no journal", "run a session first", allowed="one or more")
    bids.write_files(_study_files(root, dataset))
    for _ in each(partial(_build_session, root, dataset.protocol, dataset.purpose), [of[0] for of in dataset.sessions]):
        pass


UNMADE = "a rehearsal makes its tables at its end, and not all are there yet; the same palpate rehearse goes on with it"


def unmade(root: Path, dataset: Dataset) -> bool:
    """Return whether a rehearsal without `derivatives` was interrupted, so that its tables may be missing or old."""
    if dataset.purpose != "REHEARSAL":
        return False
    complete = sum(progress(journal.read(path).entries).complete for path, _ in dataset.sessions)
    made = (root / "derivatives").exists() or all(_has_table(root, header) for _, header in dataset.sessions)
    return complete < sum(map(len, dataset.tasks.values())) or not made


def _build_session(root: Path, protocol: Protocol, purpose: entries.Purpose, path: Path) -> None:
    contents, origin = journal.read(path), ORIGINS[purpose]
    kind = kind_of(protocol.task(contents.header.task))
    outcomes = [outcome for outcome, _ in kind.cells(path, contents)]
    kind.write(root, path, contents, raw_frames(path, outcomes), origin)
    # The table comes last: where it is, nothing of its session is missing.
    bids.write_files(_events(root, protocol, purpose, path, contents))


def check_tables(root: Path) -> Dataset:
    """Return a dataset if journals, tables and raw frames agree, apart from open sessions.

    Raises as `load_sound`, and `DatasetError` for the first difference, or if no session ended and none has a table.
    """
    dataset = load_sound(root)
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


def edited(root: Path, dataset: Dataset, under_way: Collection[Path] = (), *, whole: bool = True) -> list[PalpateError]:
    """Return an error for each table that the journals do not give, and for frames that they do not name.

    Journals `under_way` may have tables since their last footer. Files of all participants are compared in a `whole`
    dataset.
    """
    doubts: list[PalpateError] = []

    def unlike(files: bids.Files) -> list[PalpateError]:
        found: list[PalpateError] = []
        for path, content in files.items():
            with _collected(found):
                _check_table(root, path, content)
        return found

    found = unlike(_study_files(root, dataset)) if whole else []
    if found and under_way:
        told = [(path, of) for path, of in dataset.sessions if path not in under_way or _has_table(root, of)]
        files = _study_files(root, replace(dataset, sessions=tuple(told)))
        # Before the first session ends nothing is made that could be missed.
        found = unlike({path: content for path, content in files.items() if told or path.exists()})
    doubts += found
    for path, header in dataset.sessions:
        made, contents = partial(_events, root, dataset.protocol, dataset.purpose, path), journal.read(path)
        found = unlike(made(contents))
        if found and path in under_way:
            earlier = (unlike(made(then)) for then in _since_footer(contents))
            unmade = not until_footer(contents).lines and not _has_table(root, header)
            found = [] if unmade else min([found, *earlier], key=len)
        doubts += found
        with _collected(doubts):
            kind = kind_of(dataset.protocol.task(header.task))
            raw_frames(path, [outcome for outcome, _ in kind.cells(path, contents)])
    return doubts


@contextmanager
def _collected(doubts: list[PalpateError]) -> Iterator[None]:
    """Add the error that ends the block to `doubts`, and go on after it."""
    try:
        yield
    except PalpateError as doubt:
        doubts.append(doubt)


def _since_footer(contents: journal.Contents) -> Iterator[journal.Contents]:
    """Yield a journal as it was after each line since its last footer, the latest first, and at that footer."""
    lines, ended = contents.lines, len(until_footer(contents).lines)
    for count in range(len(lines) - 1, max(ended, 1) - 1, -1):
        yield replace(contents, lines=lines[:count])


def until_footer(contents: journal.Contents) -> journal.Contents:
    """Return a journal as it was when its session last ended, which is when its tables were made; empty if never."""
    ends = [number for number, entry in enumerate(contents.entries, start=1) if isinstance(entry, entries.Footer)]
    return replace(contents, lines=contents.lines[: ends[-1]] if ends else ())


def _has_table(root: Path, header: entries.Header) -> bool:
    return bids.beh_path(root, header.participant, header.task, "events.tsv").exists()


def _events(
    root: Path, protocol: Protocol, purpose: entries.Purpose, path: Path, contents: journal.Contents
) -> bids.Files:
    origin, header = ORIGINS[purpose], contents.header
    task = protocol.task(header.task)
    text = _task_text(protocol, task, origin, header.session_id)
    return bids.events(root, header.participant, text, event_rows(kind_of(task), path, contents, origin))


def _study_files(root: Path, dataset: Dataset) -> bids.Files:
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
        readme=(readmes["all"] | readmes.get(protocol.tasks[0].kind, {}))[origin],
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


def event_rows(
    kind: DatasetKind, path: Path, contents: journal.Contents, origin: bids.Origin
) -> list[dict[str, object]]:
    """Return a row for each attempt that has one: the cells that every kind has, with those of its own."""
    recorded = contents.entries
    answers, corrections = _by_attempt(recorded, entries.Answer), _by_attempt(recorded, entries.Correction)
    redone, spoken = _by_attempt(recorded, entries.Redo), _by_attempt(recorded, entries.Spoken)
    maskers = _maskers(recorded)
    rows: list[dict[str, object]] = []
    for outcome, own in kind.cells(path, contents):
        attempt = outcome.trial, outcome.attempt
        answer, correction, redo = answers.get(attempt), corrections.get(attempt), redone.get(attempt)
        last = correction or answer
        unanswered = None if answer else "no answer was confirmed"
        rows.append(
            {
                "trial": outcome.trial,
                "attempt": outcome.attempt,
                "counted": answer is not None and redo is None,
                "answered": None if last is None else last.answered or NO_ANSWER,
                "response_time": round(answer.response_time_s, 6) if answer else None,
                "redo_reason": unanswered if redo is None else redo.reason,
                "origin": origin,
                **({"corrected_from": answer.answered or NO_ANSWER} if answer and correction else {}),
                **maskers[attempt],
                **_answer_cells(answer, spoken.get(attempt)),
                **own,
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
        elif isinstance(entry, entries.Outcome):
            cells[entry.trial, entry.attempt] = cell
    return cells


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


def raw_frames(journal_file: Path, outcomes: Iterable[entries.Outcome]) -> list[bytes]:
    """Return the raw frames of each outcome with any. Raises `DatasetError` if they are not those it names."""
    traced = [(outcome, outcome.frames) for outcome in outcomes if outcome.frames is not None]
    if not traced:
        return []
    path = foot_path(journal_file)
    try:
        raw = storage.read_bytes(path, 2**30)
    except OSError as error:
        raise DatasetError(path, f"cannot read the foot trace ({error.strerror})", "restore it") from error
    parts = []
    for outcome, trace in traced:
        part = raw[trace.offset : trace.offset + trace.length]
        if hashlib.sha256(part).hexdigest() != trace.sha256:
            raise DatasetError(
                path, f"the frames of trial {outcome.trial} are not those that the journal names", "restore the file"
            )
        parts.append(part)
    return parts


def _task_text(protocol: Protocol, task: Task, origin: bids.Origin, session_id: str) -> bids.TaskText:
    kind = kind_of(task)
    return bids.TaskText(
        id=task.id,
        title=task.title,
        description=f"{task.title}. {kind.presented(protocol, task)}, {task.repetitions} trials each.",
        instructions=task.instruction,
        materials={m.id: m.description for m in protocol.materials},
        presented=task.materials,
        stimulus_presentation={"SoftwareName": "palpate", "SoftwareVersion": software.this().version},
        origin=origin,
        session_id=session_id,
        kind=task.kind,
        answers=kind.answers(protocol),
    )
