"""A dataset on disk as a `Study` that lists every attempt and participant left out, and why.

Only the BIDS files are read: `dataset_description.json`, `participants.tsv`, `sub-*/beh/*_events.tsv` with their
sidecars, and `sourcedata/protocol.toml`; no journals.
"""

from __future__ import annotations

import hashlib
import json
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from glob import escape
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_args

import pandas as pd

from palpate.analysis.reading.files import (
    MISSING,
    Levels,
    json_of,
    presented_in,
    table_of,
    trials_in,
    wrong,
)
from palpate.analysis.reading.labels import check_once, first_tasks_of_people, sentences, took_part
from palpate.analysis.reading.study import Part, Study, Task, TaskDesign
from palpate.analysis.reading.versions import apply_rules, of_people, read_versions
from palpate.experiment import storage
from palpate.experiment.errors import DatasetError, other_format
from palpate.experiment.protocol import designs, kinds
from palpate.experiment.records.events import PLACES

if TYPE_CHECKING:
    from palpate.experiment.protocol.models import Protocol

T = TypeVar("T")

TOUCHED = ("Contactor", "Touch")
"""Keys of a sidecar that say what the skin touched."""

ORIGINS = ("PARTICIPANT", "PILOT", "PRACTICE", "REHEARSAL", "RECONSTRUCTION", "IMPORTED")


Say = Callable[..., None]
"""What tells of progress: words, and how many of how many sessions are done."""


COMPUTING = "Computing tables and models"


def silent(*_: object) -> None:
    """Tell of no progress."""


EACH = 50
"""Progress is told after so many sessions."""


def read(root: Path, say: Say = silent) -> Study:
    """Read the dataset in the folder `root`; `say` gets progress.

    Raises `DatasetError` for a file that is missing, broken or truncated, `OtherFormat`, and `ProtocolError` for a
    broken protocol.
    """
    description = _description(root)
    facts = _facts(description, root / "dataset_description.json")
    withdrawn, first_tasks, facts_of_people = _participants(root / "participants.tsv")
    _refuse_strangers(root, set(withdrawn), facts["Tasks"])
    columns: dict[str, Any] = {}
    texts: dict[str, str] = {}
    session_ids: dict[tuple[str, str], str] = {}
    owners: dict[str, tuple[str, str]] = {}
    forces: dict[tuple[str, str], tuple[Path, ...]] = {}
    touched: dict[tuple[str, str], dict[str, Any]] = {}
    tasks: dict[str, Task] = {}
    materials: tuple[str, ...] = ()
    asked: dict[str, TaskDesign] = {}
    people = took_part(root, facts, withdrawn)
    for label, task in _counted([*product(withdrawn, facts["Tasks"])], say):
        participant = people.get((label, task), label)
        path = root / f"sub-{label}" / "beh" / f"sub-{label}_task-{task}_events.tsv"
        if not path.exists():
            _check_absent(path)
            continue
        beside = path.with_suffix(".json")
        sidecar = _sidecar(beside)
        if materials and materials != tuple(sidecar["Materials"]):
            raise DatasetError(beside, "Materials differ from those of other files", "correct one of the files")
        materials = tuple(sidecar["Materials"])
        own = _design(sidecar)
        if asked and own not in asked.values():
            raise DatasetError(
                beside, "Kind, Design or Answers differ from those of other files", "correct one of the files"
            )
        asked[task] = own
        shown = tuple(sidecar.get("Presented", materials))
        tasks[task] = _task(task, shown, sidecar, tasks.get(task), beside)
        if (session_id := sidecar.get("SessionId")) is not None:
            _check_new(str(session_id), owners, beside)
            session_ids[participant, task] = str(session_id)
            owners[str(session_id)] = participant, task
        check_once(root, participant, task, touched)
        touched[participant, task] = {key: sidecar[key] for key in TOUCHED if key in sidecar}
        recorded = path.name.removesuffix("events.tsv") + "recording-force"
        near = [one for one in path.parent.iterdir() if one.name.startswith(recorded)]
        forces[participant, task] = tuple(sorted(one for one in near if one.name.endswith("_physio.tsv.gz")))
        levels = Levels(shown, own, facts["Origin"], facts.get("Format") != storage.DATASET_FORMAT)
        _extend(columns, trials_in(path, participant, task, levels, sidecar["Rows"]), texts)
    if not columns:
        raise DatasetError(f"{root} contains no trials", remedy="run a session first, then rebuild the dataset")
    versions = tuple(of_people(read_versions(root, facts), people))
    first_tasks = first_tasks_of_people(first_tasks, people)
    protocol, sealed = _plan(root / "sourcedata" / (versions[-1].file if versions else "protocol.toml"))
    attempts, exclusions, unasked = apply_rules(pd.DataFrame(columns), withdrawn, protocol, versions)
    done = tuple(tasks[task] for task in facts["Tasks"] if task in tasks)
    names = tuple(task.id for task in done)
    return Study(
        id=str(facts["Study"]), name=str(description.get("Name", facts["Study"])), origin=str(facts["Origin"]),
        label=str(facts["Label"]), materials=materials, tasks=done, participants=tuple(withdrawn),
        first_tasks=first_tasks, session_ids=session_ids, attempts=attempts, exclusions=exclusions, unasked=unasked,
        ordered=facts["Origin"] != "RECONSTRUCTION" and facts.get("Ordered", True) is True,
        parts=(Part(root.resolve().name, tuple(withdrawn), names, protocol, sealed, _anchors(root), versions,
                    tuple(facts.get("Incidents", ())) + sentences(people)),),
        designs=asked, forces=forces, facts=facts_of_people, touched=touched,
    )  # fmt: skip


def _counted(sessions: Sequence[T], say: Say) -> Iterator[T]:
    """Yield sessions, and tell how many were read before."""
    for done, one in enumerate(sessions):
        if done % EACH == 0:
            say("Reading the dataset", done, len(sessions))
        yield one


def _extend(columns: dict[str, Any], found: Mapping[str, Sequence[Any]], texts: dict[str, str]) -> None:
    """Add the columns of a session: numbers in a quarter of the memory of a list, texts each once."""
    for name, values in found.items():
        if isinstance(values, array):
            columns.setdefault(name, array("d")).extend(values)
        else:
            own = map(texts.setdefault, values, values) if values and isinstance(values[0], str) else values
            columns.setdefault(name, []).extend(own)


def _task(task: str, shown: tuple[str, ...], sidecar: Mapping[str, Any], known: Task | None, beside: Path) -> Task:
    if known is not None and known.presented != shown:
        raise DatasetError(beside, f"Presented differs from other files of task {task}", "correct one of the files")
    return Task(task, str(sidecar.get("TaskTitle", task)), str(sidecar.get("Instructions", "")), shown)


def _check_absent(events: Path) -> None:
    if left := sorted(events.parent.glob(f"{escape(events.name.removesuffix('events.tsv'))}*")):
        raise DatasetError(
            f"{events} is missing, but {left[0].name} exists", remedy="restore it or rebuild the dataset"
        )


def _check_new(session_id: str, owners: Mapping[str, tuple[str, str]], sidecar: Path) -> None:
    if session_id in owners:
        who, task = owners[session_id]
        what = f"participant {who}, task {task} has the same SessionId {session_id}"
        raise DatasetError(sidecar, what, "keep one of the two sessions")


def _plan(path: Path) -> tuple[Protocol | None, str]:
    """Return the protocol of a dataset, and what its seal says; None where no copy of it is there."""
    if not path.exists():
        return None, ""
    from palpate.experiment.protocol import files

    protocol = files.load(path)
    return protocol, _sealed(path, protocol)


def _anchors(root: Path) -> tuple[str, ...]:
    """Return the day and the number of each anchor in a dataset's log; `verify` says what is wrong with others."""
    import rfc8785

    log, found = root / "sourcedata" / "anchors.log", []
    for line in log.read_bytes().splitlines() if log.exists() else ():
        try:
            anchor = json.loads(line)["anchor"]
            number = hashlib.sha256(rfc8785.dumps(anchor)).hexdigest()
            found.append(f"{anchor['anchored_utc'][:10]} {'-'.join(number[at : at + 4] for at in range(0, 16, 4))}")
        except (ValueError, KeyError, TypeError):
            continue
    return tuple(found)


def _sealed(plan: Path, protocol: Protocol) -> str:
    """Return what the seal beside the copy of a protocol says of it, and which approvals renewed that."""
    from palpate.experiment.protocol import approval

    if not approval.seal_path(plan).exists():
        return "no seal is stored with it"
    seal = approval.read(plan)
    if seal.protocol_sha256 != approval.sha256(protocol):
        return "the seal stored with it is for another version"
    later = [
        approval.read(one) for one in storage.protocol_paths(plan.parent.parent) if approval.seal_path(one).exists()
    ]
    own = [one.approval_number for one in later if one.protocol_sha256 == seal.protocol_sha256]
    renewed = f", renewed by {', '.join(own[1:])}" if own[1:] else ""
    return f"sealed, approval {seal.approval_number} by {seal.board}, valid from {seal.approved_on}{renewed}"


def _design(sidecar: dict[str, Any]) -> TaskDesign:
    # A sidecar names its answers where these are not the materials.
    name, answers = sidecar["Design"], tuple(sidecar.get("Answers", sidecar["Materials"]))
    shown = {"intervals": 1 + (PLACES[1] in sidecar)}
    return TaskDesign(name, sidecar["Kind"], answers, designs.design_of(name).shown_together(shown))


def _facts(description: dict[str, Any], path: Path) -> dict[str, Any]:
    facts = description.get("Palpate")
    if isinstance(facts, dict) and (
        other := other_format(path, "dataset", facts.get("Format"), get_args(storage.DatasetFormat))
    ):
        raise other
    if not isinstance(facts, dict) or not {"Study", "Origin", "Label", "Tasks"} <= set(facts):
        raise DatasetError(
            path, "the key Palpate needs Study, Origin, Label and Tasks", "use a dataset made by palpate"
        )
    if facts["Origin"] not in ORIGINS:
        raise DatasetError(path, f"Origin is {facts['Origin']!r}", "correct it", allowed=", ".join(ORIGINS))
    tasks = facts["Tasks"]
    if not (isinstance(tasks, list) and all(isinstance(task, str) for task in tasks)):
        raise DatasetError(path, f"Tasks is {tasks!r}", "correct it", allowed="a list of task ids")
    incidents = facts.get("Incidents", [])
    if not (isinstance(incidents, list) and all(isinstance(one, str) for one in incidents)):
        raise DatasetError(path, f"Incidents is {incidents!r:.60}", "rebuild the tables", allowed="a list of texts")
    return facts


def _description(root: Path) -> dict[str, Any]:
    if not root.is_dir():
        raise DatasetError(root, "is not a folder", "give the folder of a dataset, such as participants/okamoto2012")
    return json_of(root / "dataset_description.json", "give the folder of a dataset made by palpate")


def _sidecar(path: Path) -> dict[str, Any]:
    sidecar = json_of(path, "rebuild the dataset, because every events file needs its sidecar")
    materials, rows = sidecar.get("Materials"), sidecar.get("Rows")
    if not (isinstance(materials, list) and len(materials) > 1 and all(isinstance(m, str) for m in materials)):
        raise wrong(path, "Materials", materials, "a list of two or more names")
    shown = sidecar.get("Presented", materials)
    if not (isinstance(shown, list) and shown and shown == [one for one in materials if one in shown]):
        raise wrong(path, "Presented", shown, f"a list of some of {', '.join(materials)}, in this order")
    answers = sidecar.get("Answers", [])
    if not (isinstance(answers, list) and all(isinstance(answer, str) for answer in answers)):
        raise wrong(path, "Answers", answers, "a list of texts")
    touched = [sidecar.get(key, {}) for key in TOUCHED]
    if not all(isinstance(one, dict) for one in (*touched, *touched[1].values())):
        raise wrong(path, " and ".join(TOUCHED), touched, "objects")
    for key, known in (("Kind", kinds.NAMES), ("Design", designs.NAMES)):
        if sidecar.get(key) not in known:
            raise wrong(path, key, sidecar.get(key), ", ".join(known))
    if len(presented_in(asked := _design(sidecar))) != asked.intervals:
        raise wrong(path, "Design", sidecar["Design"], f"a design for {sidecar['Kind']}")
    if not isinstance(rows, int):
        raise wrong(path, "Rows", rows, "the number of rows")
    return sidecar


def _participants(path: Path) -> tuple[dict[str, bool], dict[str, str], dict[tuple[str, str], str]]:
    """Return whether each participant withdrew, the first task of those who have one, and the cell of each column."""
    columns, rows = table_of(path)
    if "participant_id" not in columns:
        raise DatasetError(path, f"the column participant_id is missing; got {columns}", "rebuild the dataset")
    found: dict[str, bool] = {}
    first: dict[str, str] = {}
    told: dict[tuple[str, str], str] = {}
    for number, row in enumerate(rows, start=2):
        cells = dict(zip(columns, row, strict=True))
        label = cells["participant_id"].removeprefix("sub-")
        if label in found:
            raise DatasetError(path, f"participant {label} is listed twice", "keep one of the lines", line=number)
        found[label] = cells.get("withdrawn", MISSING) == "1"
        if (task := cells.get("first_task", MISSING)) != MISSING:
            first[label] = task
        told |= {(label, column): cell for column, cell in cells.items()}
    return found, first, told


def _refuse_strangers(root: Path, participants: set[str], tasks: Sequence[str]) -> None:
    for path in sorted(root.glob("sub-*/beh/[!.]*_events.tsv")):
        label = path.parent.parent.name.removeprefix("sub-")
        if label not in participants:
            raise DatasetError(
                path, f"participant {label} is not in participants.tsv", "add the line, or remove the file"
            )
        if path.name not in {f"sub-{label}_task-{task}_events.tsv" for task in tasks}:
            raise DatasetError(
                path, f"its task is not in dataset_description.json, which has {list(tasks)}", "add it there"
            )
