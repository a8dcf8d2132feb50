"""From journals to the study's BIDS dataset: events, traces, participants. Reads only what is on disk."""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from palpate.experiment import storage
from palpate.experiment.dataset import bids
from palpate.experiment.dataset.checks import Dataset, Each, load_sound
from palpate.experiment.errors import DatasetError
from palpate.experiment.protocol import approval
from palpate.experiment.protocol.designs import design_of
from palpate.experiment.protocol.models import Protocol, Task
from palpate.experiment.records import entries, journal, software
from palpate.experiment.records.events import NO_ANSWER

if TYPE_CHECKING:
    from palpate.experiment.records.stimulus import Stimulus

ORIGINS: dict[entries.Purpose, bids.Origin] = {
    "STUDY": "PARTICIPANT",
    "PILOT": "PILOT",
    "PRACTICE": "PRACTICE",
    "REHEARSAL": "REHEARSAL",
}
"""What produced the rows of a dataset, by what its sessions are for."""

LABELS = {purpose: bids.LABELS[origin] for purpose, origin in ORIGINS.items()}
"""What stands at the head of all that tells of such a dataset."""

UNANSWERED = "no answer was confirmed"
"""Why an attempt without an answer was done again, where no other reason is on record."""

Cells = Mapping[str, object]
"""Column -> what stands in a row."""


@dataclass(frozen=True)
class DatasetKind:
    """A kind of trial in a dataset.

    `cells` yields each outcome of a journal, at this path, that has a row, with the cells that are the kind's own.
    `write` gets dataset, journal and its contents, and writes what is beside the table.
    """

    cells: Callable[[Path, journal.Contents], Iterator[tuple[entries.Outcome, Cells]]]
    write: Callable[[Dataset, Path, journal.Contents], None] = lambda *_: None


def kind_of(task: Task) -> DatasetKind:
    """Return the kind of a task's trials."""
    kind: DatasetKind = import_module(f"palpate.experiment.dataset.kinds.{task.kind}").DATASET
    return kind


def build(root: Path, each: Each = map) -> Dataset:
    """Write the BIDS files of every session under `root/sourcedata`, replacing earlier ones; return the dataset.

    `each` is as for `checks.load`. Journals without a header are omitted. Raises as `load_sound`, and `DatasetError`
    without journals (unless erased) or if a foot trace is not the one its journal names.
    """
    dataset = load_sound(root, each)
    if not storage.journals(root) and not (dataset.roster and dataset.roster.erased):
        raise DatasetError(root, "got no journal", "run a session first", allowed="one or more")
    import_module("palpate.experiment.dataset.outside.accidents").keep_attributes(root, LABELS[dataset.purpose])
    files = study_files(root, dataset)
    if any(path.parent.name == "phenotype" for path in files) and not (root / "phenotype").exists():
        storage.owners_alone(root)
    bids.write_files(files)
    list(each(partial(_build_session, dataset), [of[0] for of in dataset.sessions]))
    return dataset


def _build_session(dataset: Dataset, path: Path) -> None:
    root, contents = dataset.root, journal.read(path)
    protocol = dataset.version(contents.header)
    kind = kind_of(protocol.task(contents.header.task))
    kind.write(dataset, path, contents)
    # The table comes last: where it is, nothing of its session is missing.
    bids.write_files(session_table(root, protocol, dataset.purpose, path, contents))


def session_table(
    root: Path, protocol: Protocol, purpose: entries.Purpose, path: Path, contents: journal.Contents
) -> bids.Files:
    """Return the table of a session, from what its journal, at this path, contains, and what describes it."""
    origin, header = ORIGINS[purpose], contents.header
    task = protocol.task(header.task)
    text = replace(task_text(protocol, task, origin, header.session_id), notes=touched(protocol, path, contents))
    return bids.events(root, header.participant, text, event_rows(kind_of(task), path, contents, origin))


def touched(protocol: Protocol, path: Path, contents: journal.Contents, *, shared: bool = False) -> dict[str, object]:
    """Return what the skin touched in a session, for its sidecar: the rig's contactor, and what was asked of it."""
    rig_file, found = storage.rig_path(path), dict[str, object]()
    if rig_file.exists():
        part = import_module("palpate.experiment.apparatus.rig").load(rig_file).contactor
        found |= {} if part is None else {"Contactor": part.model_dump(exclude_none=True)}
    if sites := getattr(protocol.kind_table(protocol.task(contents.header.task)), "sites", ()):
        found["Sites"] = {one.name: one.place for one in sites}
    if getattr(protocol, "asked", None) is not None:
        phenotype = import_module("palpate.experiment.dataset.phenotype")
        found |= phenotype.touched(protocol, contents, shared=shared)
    return found


def study_files(root: Path, dataset: Dataset) -> bids.Files:
    """Return the files that stand once in a dataset."""
    protocol, origin = dataset.protocol, ORIGINS[dataset.purpose]
    withdrawn = dataset.roster.withdrawn if dataset.roster is not None else {}
    first_tasks: dict[str, str] = {}
    for _, header in dataset.sessions:
        first_tasks.setdefault(header.participant, bids.MISSING)
        if header.task_position == 1:
            first_tasks[header.participant] = header.task
    people: list[dict[str, object]] = [
        {"participant_id": f"sub-{who}", "first_task": first, "withdrawn": who in withdrawn}
        for who, first in first_tasks.items()
    ]
    asked: dict[str, dict[str, object]] = {}
    answered: bids.Files = {}
    if any(getattr(one, "asked", None) for one in (protocol, *dataset.versions.values())):
        answered = import_module("palpate.experiment.dataset.phenotype").files(root, dataset, origin)
        facts = import_module("palpate.experiment.study.people.facts")
        asked = {name: one.column() for name, one in facts.columns((*dataset.versions.values(), protocol)).items()}
        for row in people:
            who = str(row["participant_id"]).removeprefix("sub-")
            own = facts.simulated(protocol, who) if dataset.plan else facts.answers(root, dataset.people, who)
            row |= {name: value for name, value in own.items() if name in asked}
    if any(dataset.groups.values()):
        asked["group"] = import_module("palpate.experiment.protocol.designs.groups").column(protocol)
        people = [row | {"group": dataset.groups[str(row["participant_id"]).removeprefix("sub-")]} for row in people]
    simulated = origin in ("PRACTICE", "REHEARSAL")
    of_kind, folder = f"{protocol.tasks[0].kind}.toml", Path(__file__).with_name("kinds")
    readme: dict[str, str] = {}
    for path in filter(Path.exists, (folder / "readme.toml", folder / of_kind)):
        readme |= tomllib.loads(path.read_text("utf-8"))
    text = bids.DatasetText(
        study=protocol.study.id,
        name=protocol.study.title,
        origin=origin,
        license="n/a: ask the laboratory",
        authors=("palpate, simulated",) if simulated else ("The laboratory named in the protocol",),
        tasks=tuple(task.id for task in protocol.tasks),
        references=(protocol.study.source,),
        readme=readme[origin],
        software=software.this(),
        versions=tuple(_versions(dataset)),
        approvals=tuple(_approvals(dataset)),
        incidents=tuple(one.sentence for one in dataset.people.incidents),
        took_part={
            f"sub-{who}_task-{task}": {"Person": f"sub-{one}", "Withdrew": one in withdrawn}
            for (who, task), one in dataset.people.took_part.items()
        },
    )
    return bids.participants(root, people, origin=origin, asked=asked) | answered | bids.description(root, text)


def _approvals(dataset: Dataset) -> Iterator[str]:
    """Yield each approval of a study as its seal has it."""
    for one in dataset.approvals.approved if dataset.approvals is not None else ():
        if one.seal_sha256 is not None:
            seal = approval.read(storage.protocol_path(dataset.root, one.number))
            yield f"{' '.join(seal.board.split())}: {seal.approval_number}, {seal.approved_on} to {seal.expires_on}"


def _versions(dataset: Dataset) -> Iterator[Mapping[str, object]]:
    """Yield each version of an amended protocol, with its file and the sessions that began under it."""
    known = dataset.approvals
    if known is None or len(dataset.versions) == 1:
        return
    for one in known.approved:
        if known.version(one.number) != one.number:
            continue
        own = [
            f"sub-{header.participant}_task-{header.task}"
            for _, header in dataset.sessions
            if known.version(known.number_of(header.seal_sha256)) == one.number
        ]
        file = storage.protocol_path(dataset.root, one.number).name
        yield {"Protocol": file, "From": one.from_on.isoformat(), "Sessions": own}


def event_rows(
    kind: DatasetKind, path: Path, contents: journal.Contents, origin: bids.Origin
) -> list[dict[str, object]]:
    """Return a row for each attempt that has one: the cells that every kind has, with those of its own."""
    recorded = contents.entries
    answers, corrections = _by_attempt(recorded, entries.Answer), _by_attempt(recorded, entries.Correction)
    redone, spoken = _by_attempt(recorded, entries.Redo), _by_attempt(recorded, entries.Spoken)
    theirs = any(answer.by == "participant" for answer in answers.values())
    maskers, chosen = _maskers(recorded), _by_attempt(recorded, entries.LevelChosen)
    rows: list[dict[str, object]] = []
    for outcome, own in kind.cells(path, contents):
        attempt = outcome.trial, outcome.attempt
        answer, correction, redo = answers.get(attempt), corrections.get(attempt), redone.get(attempt)
        last = correction or answer
        unanswered = None if answer else UNANSWERED
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
                **({"track": level.track, "level": level.level} if (level := chosen.get(attempt)) else {}),
                **maskers[attempt],
                **_answer_cells(answer, spoken.get(attempt)),
                **(_press_cells(answer, own) if theirs and answer is not None else {}),
                **own,
            }
        )
    return rows


_Judged = TypeVar("_Judged", bound=entries.OfAttempt)


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


def _press_cells(answer: entries.Answer, own: Cells) -> dict[str, object]:
    """Return who answered, in a session in which participants do so themselves, and what is known of the press."""
    heard_s = own.get("onset_error")
    pressed = answer.by == "participant"
    from_onset_s = answer.response_time_s - heard_s if pressed and isinstance(heard_s, float) else None
    return {
        "answered_by": answer.by,
        "response_end": "press" if pressed else "choice",
        "response_time_standard_error": None if answer.error_s is None else round(answer.error_s, 6),
        "response_from_onset": None if from_onset_s is None else round(from_onset_s, 6),
        "press_device_time": None if answer.device_us is None else answer.device_us / 1e6,
    }


def heard_cells(stimulus: Stimulus | None, material: str | None = None) -> dict[str, object]:
    """Return what was heard of a stimulus beside what was sent, by column; nothing where it was not heard whole.

    `material` is whose stimulus it was, where the row presents several.
    """
    heard, moved = (stimulus.heard, stimulus.moved) if stimulus is not None else (None, None)
    if heard is None or moved is None or heard.peak_m_s2 is None or not heard.sent_thirds_db or heard.lost_ms:
        return {}
    return {
        **({} if material is None else {"heard_of": material}),
        "sent_peak": round(moved.peak_m_s2, 9),
        "heard_peak": round(heard.peak_m_s2, 9),
        "heard_delay": None if heard.delay_ms is None else round(heard.delay_ms / 1e3, 6),
        "heard_gain": None if heard.gain is None else round(heard.gain, 6),
        "sent_thirds": " | ".join(map(str, heard.sent_thirds_db)),
        "heard_thirds": " | ".join(map(str, heard.thirds_db)),
    }


def raw_frames(journal_file: Path, recorded: Iterable[entries.Entry]) -> Iterator[bytes]:
    """Yield the raw data of each entry with any. Raises `DatasetError` if they are not those it names."""
    for entry, trace in ((entry, trace) for entry in recorded if (trace := entry.frames) is not None):
        path = storage.raw_path(journal_file, trace.file)
        try:
            part = storage.read_bytes(path, 2**32, trace.offset, trace.length)
        except OSError as error:
            what = f"cannot read the {trace.recording} trace ({error.strerror})"
            raise DatasetError(path, what, "restore it") from error
        if hashlib.sha256(part).hexdigest() != trace.sha256:
            of = f" of trial {entry.trial}" if isinstance(entry, entries.OfAttempt) else ""
            what = f"the {trace.of_what[0]}{of} differ from those that the journal records"
            raise DatasetError(path, what, "restore the file")
        yield part


def task_text(protocol: Protocol, task: Task, origin: bids.Origin, session_id: str | None = None) -> bids.TaskText:
    """Return what describes a session's table, with its id if it is given."""
    design = design_of(task.design)
    return bids.TaskText(
        id=task.id,
        title=task.title,
        description=f"{task.title}. {design.presents(protocol, task)}, {task.repetitions} trials each.",
        instructions=task.instruction,
        materials={m.id: m.description for m in protocol.materials},
        presented=task.materials,
        stimulus_presentation={"SoftwareName": "palpate", "SoftwareVersion": software.this().version},
        origin=origin,
        session_id=session_id,
        kind=task.kind,
        design=task.design,
        intervals=protocol.shown_together(task),
        answers=design.named(protocol),
    )
