"""A dataset on disk, or several pooled, as a `Study` that lists every attempt and participant left out, and why.

Only the BIDS files are read: `dataset_description.json`, `participants.tsv`, `sub-*/beh/*_events.tsv` with their
sidecars, and `sourcedata/protocol.toml`; no journals. Nobody may be in two pooled datasets: sessions are compared by
their ids, and without an id by trials, answers and times of the same participant.
"""

from __future__ import annotations

import hashlib
import json
import math
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from glob import escape
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_args

import pandas as pd

from palpate.analysis.documents.tables import plural
from palpate.analysis.reading.labels import check_once, first_tasks_of_people, sentences, took_part
from palpate.analysis.reading.study import Part, Study, Task, TaskDesign, check_chances
from palpate.analysis.reading.versions import apply_rules, of_people, read_versions
from palpate.experiment import storage
from palpate.experiment.errors import DatasetError, other_format
from palpate.experiment.protocol import designs, kinds
from palpate.experiment.records.events import NO_ANSWER, PLACES, Columns, columns_of
from palpate.experiment.settings.characters import JOINERS, hidden, quoted

if TYPE_CHECKING:
    from palpate.experiment.protocol.models import Protocol

T = TypeVar("T")

MISSING = "n/a"
FURTHER = {
    "masker_db_a": "masker_level",
    "level": "level",
    **{f"{column}_s": column for column in ("prediction_error", "delivery_error", "gate_to_scheduled", "dead_time")},
    "foot_force_n": "foot_force",
    "foot_force_peak_n": "foot_force_peak",
    "stimulus_error": "stimulus_error",
    "left_out": "left_out",
    "dissimilarity_m_s2": "dissimilarity",
    "sent_peak_m_s2": "sent_peak",
    "heard_peak_m_s2": "heard_peak",
    "heard_delay_s": "heard_delay",
    "heard_gain": "heard_gain",
}
"""The name of each further column of numbers in the frame, and in the events file."""

OF_STEPS = {
    "foot_speed_mm_s": ("foot_speed", "a number from 0"),
    "frames_lost": ("frames_lost", "a whole number from 0"),
    "delivered": ("delivered", "0, 1"),
    "onset_error_s": ("onset_error", "a number"),
}
"""What only footsteps have: its name in the frame, its column, and what that may hold; NaN of other trials."""

THIRDS = 18
"""So many third octaves are from 10 to 500 Hz."""

TOUCHED = ("Contactor", "Touch")
"""Keys of a sidecar that say what the skin touched."""

PRESENTED = ("presented", *PLACES)
"""Columns that say what a trial presented; a kind has the first, or the others."""

NEEDED = ("trial", "attempt", "counted", "answered", "response_time", "redo_reason", "origin")
"""Columns without which no trial is read; a dataset of an older format may lack others that came later."""

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
        levels = _Levels(shown, own, facts["Origin"], facts.get("Format") != storage.DATASET_FORMAT)
        _extend(columns, _events(path, participant, task, levels, sidecar["Rows"]), texts)
    if not columns:
        raise DatasetError(f"{root} contains no trials", remedy="run a session first, then make the dataset again")
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
        raise DatasetError(
            beside, f"Presented differs from that of other files of task {task}", "correct one of the files"
        )
    return Task(task, str(sidecar.get("TaskTitle", task)), str(sidecar.get("Instructions", "")), shown)


def _check_absent(events: Path) -> None:
    if left := sorted(events.parent.glob(f"{escape(events.name.removesuffix('events.tsv'))}*")):
        raise DatasetError(
            f"{events} is missing, but {left[0].name} is there", remedy="restore it or make the dataset again"
        )


def _check_new(session_id: str, owners: Mapping[str, tuple[str, str]], sidecar: Path) -> None:
    if session_id in owners:
        who, task = owners[session_id]
        what = f"SessionId {session_id} is also that of participant {who}, task {task}"
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
        return "no seal stands beside it"
    seal = approval.read(plan)
    if seal.protocol_sha256 != approval.sha256(protocol):
        return "the seal beside it is of another version"
    later = [
        approval.read(one) for one in storage.protocol_paths(plan.parent.parent) if approval.seal_path(one).exists()
    ]
    own = [one.approval_number for one in later if one.protocol_sha256 == seal.protocol_sha256]
    renewed = f", renewed by {', '.join(own[1:])}" if own[1:] else ""
    return f"sealed, approval {seal.approval_number} of {seal.board}, from {seal.approved_on} on{renewed}"


@dataclass(frozen=True)
class _Levels:
    """What the cells of an events file may hold."""

    presented: tuple[str, ...]
    design: TaskDesign
    origin: str
    older: bool


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
            path, "the key Palpate lacks Study, Origin, Label or Tasks", "give a dataset made by palpate"
        )
    if facts["Origin"] not in ORIGINS:
        raise DatasetError(path, f"Origin is {facts['Origin']!r}", "correct it", allowed=", ".join(ORIGINS))
    tasks = facts["Tasks"]
    if not (isinstance(tasks, list) and all(isinstance(task, str) for task in tasks)):
        raise DatasetError(path, f"Tasks is {tasks!r}", "correct it", allowed="a list of task ids")
    incidents = facts.get("Incidents", [])
    if not (isinstance(incidents, list) and all(isinstance(one, str) for one in incidents)):
        raise DatasetError(path, f"Incidents is {incidents!r:.60}", "make the tables again", allowed="a list of texts")
    return facts


def _text(path: Path, remedy: str) -> str:
    try:
        return storage.read_text(path)
    except FileNotFoundError as error:
        raise DatasetError(f"{path} is missing", remedy=remedy) from error
    except (OSError, UnicodeDecodeError) as error:
        raise DatasetError(f"{path} cannot be read ({storage.why(error)})", remedy=remedy) from error


def _description(root: Path) -> dict[str, Any]:
    if not root.is_dir():
        raise DatasetError(root, "is no folder", "give that of a dataset, such as participants/okamoto2012")
    return _json(root / "dataset_description.json", "give the folder of a dataset made by palpate")


def _json(path: Path, remedy: str) -> dict[str, Any]:
    text = _text(path, remedy)
    try:
        content = storage.json_of(text)
    except json.JSONDecodeError as error:
        raise DatasetError(path, f"line {error.lineno} is not JSON ({error.msg})", "make the dataset again") from error
    except ValueError as error:
        raise DatasetError(path, f"is not JSON ({error})", "make the dataset again") from error
    if not isinstance(content, dict):
        raise DatasetError(path, f"got {type(content).__name__}", "make the dataset again", allowed="a JSON object")
    # Without escapes and without such a character in the text, none can stand in what it holds.
    if "\\" in text or hidden(text, "\n" + JOINERS):
        _refuse_hidden(path, content)
    return content


def _refuse_hidden(path: Path, held: object) -> None:
    """Refuse a text, wherever it stands in a document, with a character that a page or a table must not show."""
    if isinstance(held, Mapping):
        held = [*held, *held.values()]
    if isinstance(held, list):
        for one in held:
            _refuse_hidden(path, one)
    elif isinstance(held, str) and hidden(held, "\n" + JOINERS):
        raise DatasetError(
            path,
            f"got {quoted(held)}",
            "make the dataset again",
            allowed="text without control or invisible characters",
        )


def _sidecar(path: Path) -> dict[str, Any]:
    sidecar = _json(path, "make the dataset again, because every events file has its sidecar")
    materials, rows = sidecar.get("Materials"), sidecar.get("Rows")
    if not (isinstance(materials, list) and len(materials) > 1 and all(isinstance(m, str) for m in materials)):
        raise _wrong(path, "Materials", materials, "a list of two names or more")
    shown = sidecar.get("Presented", materials)
    if not (isinstance(shown, list) and shown and shown == [one for one in materials if one in shown]):
        raise _wrong(path, "Presented", shown, f"a list of some of {', '.join(materials)}, in this order")
    answers = sidecar.get("Answers", [])
    if not (isinstance(answers, list) and all(isinstance(answer, str) for answer in answers)):
        raise _wrong(path, "Answers", answers, "a list of texts")
    touched = [sidecar.get(key, {}) for key in TOUCHED]
    if not all(isinstance(one, dict) for one in (*touched, *touched[1].values())):
        raise _wrong(path, " and ".join(TOUCHED), touched, "objects")
    for key, known in (("Kind", kinds.NAMES), ("Design", designs.NAMES)):
        if sidecar.get(key) not in known:
            raise _wrong(path, key, sidecar.get(key), ", ".join(known))
    if len(_presented(asked := _design(sidecar))) != asked.intervals:
        raise _wrong(path, "Design", sidecar["Design"], f"a design that asks of what {sidecar['Kind']} presents")
    if not isinstance(rows, int):
        raise _wrong(path, "Rows", rows, "the number of rows")
    return sidecar


def _columns(asked: TaskDesign) -> Columns:
    """Return the columns of a table of trials of a kind and a design."""
    return columns_of(asked.kind, asked.intervals)


def _presented(asked: TaskDesign) -> list[str]:
    """Return those that say what a trial presented."""
    return [column for column in PRESENTED if column in _columns(asked)]


def _wrong(path: Path, key: str, got: object, allowed: str) -> DatasetError:
    return DatasetError(path, f"{key} is {got!r}", "make the dataset again", allowed=allowed)


def _table(path: Path) -> tuple[list[str], list[list[str]]]:
    text = _text(path, "make the dataset again")
    if not text.endswith("\n"):
        raise DatasetError(f"{path} ends in the middle of a line", remedy="it is truncated: make the dataset again")
    _refuse_hidden(path, text.replace("\t", " "))
    lines = [line.split("\t") for line in text.removesuffix("\n").split("\n")]
    for number, line in enumerate(lines, start=1):
        if len(line) != len(lines[0]):
            raise DatasetError(
                path, f"{len(line)} cells under {len(lines[0])} columns", "correct the line", line=number
            )
    return lines[0], lines[1:]


def _participants(path: Path) -> tuple[dict[str, bool], dict[str, str], dict[tuple[str, str], str]]:
    """Return whether each participant withdrew, the first task of those who have one, and the cell of each column."""
    columns, rows = _table(path)
    if "participant_id" not in columns:
        raise DatasetError(path, f"the column participant_id is missing; got {columns}", "make the dataset again")
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


def _events(path: Path, participant: str, task: str, levels: _Levels, count: int) -> dict[str, Sequence[object]]:
    """Return the columns of a table of trials, by their names in the frame."""
    header, lines = _table(path)
    own = list(_columns(levels.design))
    if levels.older:
        own = [column for column in own if column in (*NEEDED, *PRESENTED)]
    if missing := [column for column in own if column not in header]:
        raise DatasetError(path, f"missing columns: {', '.join(missing)}", "make the dataset again")
    if len(lines) != count:
        raise DatasetError(path, f"{plural(len(lines), 'row')}, its sidecar says {count}", "make the dataset again")
    cells = {name: [line[place] for line in lines] for place, name in enumerate(header)}
    _check_choices(path, cells, levels)
    found = _parsed(path, cells, _presented(levels.design))
    known: set[object] = set()
    for number, (trial, counts) in enumerate(zip(found["trial"], found["counted"], strict=True), start=2):
        if counts and trial in known:
            raise DatasetError(path, f"trial {trial} counts twice", "let one attempt count", line=number)
        known |= {trial} if counts else set()
    return {"participant": [participant] * count, "task": [task] * count, **found}


def _check_choices(path: Path, cells: Mapping[str, Sequence[str]], levels: _Levels) -> None:
    """Raise `DatasetError` for the first cell of a column that is none of those that it may have."""
    answers = (*levels.design.answers, NO_ANSWER)
    choices: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
        "counted": (("0", "1"),) * 2,
        **dict.fromkeys(_presented(levels.design), (levels.presented,) * 2),
        "answered": ((*answers, MISSING), answers),
        "origin": ((levels.origin,),) * 2,
    }
    for column, allowed in choices.items():
        for number, (cell, counted) in enumerate(zip(cells[column], cells["counted"], strict=True), start=2):
            if cell not in (may := allowed[counted == "1"]):
                where, got = f"{path}: line {number}", f"{column}: got {cell!r}"
                raise DatasetError(where, got, "correct the row", allowed=", ".join(may))


def _parsed(path: Path, cells: Mapping[str, list[str]], presented: Sequence[str]) -> dict[str, Sequence[Any]]:
    """Return the columns of the frame from the cells of each column."""
    none = [MISSING] * len(cells["trial"])

    def numbers(column: str, allowed: str = "a number") -> Sequence[float]:
        if column not in cells:
            return array("d", [math.nan]) * len(none)
        return array("d", _each(path, column, cells[column], partial(_number, allowed=allowed)))

    together = [" | ".join(of) for of in zip(*(cells[column] for column in presented), strict=True)]
    counted = [cell == "1" for cell in cells["counted"]]
    return {
        **{column: _each(path, column, cells[column], _whole) for column in ("trial", "attempt")},
        "counted": counted,
        "presented": together,
        **{column: cells[column] for column in presented},
        "answered": cells["answered"],
        "response_time_s": numbers("response_time", "a number from 0"),
        **{name: numbers(column, allowed) for name, (column, allowed) in OF_STEPS.items()},
        **{name: numbers(column) for name, column in FURTHER.items()},
        **{name: _each(path, name, cells.get(name, none), _levels_db) for name in ("sent_thirds", "heard_thirds")},
        "stimulus_method": cells.get("stimulus_method", none),
        "heard_of": cells.get("heard_of", together),
        "redo_reason": cells["redo_reason"],
        "included": counted,
    }


def _each(path: Path, column: str, cells: Sequence[str], parse: Callable[[str], T]) -> list[T]:
    """Return what each cell of a column holds. Raises `DatasetError` for the first that `parse` refuses."""
    known: dict[str, T] = {}
    for number, cell in enumerate(cells, start=2):
        if cell not in known:
            try:
                known[cell] = parse(cell)
            except ValueError as error:
                got, allowed = error.args
                where = f"{path}: line {number}: {column}"
                raise DatasetError(where, got, "correct the row", allowed=allowed) from None
    return [known[cell] for cell in cells]


def _levels_db(cell: str) -> tuple[float, ...] | None:
    """Return the levels of third octaves, dB, shape (18,); None for none."""
    parts = [] if cell == MISSING else cell.split(" | ")
    if parts and len(parts) != THIRDS:
        raise ValueError(f"got {plural(len(parts), 'level')}", f"{THIRDS} levels, or {MISSING}")
    return tuple(map(_number, parts)) or None


def _whole(cell: str) -> int:
    if not (cell.isascii() and cell.isdigit() and len(cell) < 8 and int(cell) > 0):
        raise ValueError(f"got {cell!r}", "a whole number from 1")
    return int(cell)


ALLOWED: Mapping[str, Callable[[float], bool]] = {
    "a number": math.isfinite,
    "a number from 0": lambda value: 0 <= value < math.inf,
    "a whole number from 0": lambda value: 0 <= value < 2**53 and value.is_integer(),
    "0, 1": lambda value: value in (0, 1),
}
"""The words of an error -> the check of a value."""


def _number(cell: str, allowed: str = "a number") -> float:
    if cell == MISSING:
        return math.nan
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not ALLOWED[allowed](value):
        raise ValueError(f"got {cell!r}", f"{allowed}, or {MISSING}")
    return value


LEAST = 2
"""Sessions of answers alone, without ids or times, that must agree before they count as copies."""

NAMED = 5
"""The most participants who are named where several are in two datasets."""


def read_pooled(roots: Sequence[Path], say: Say = silent) -> Study:
    """Read the datasets in these folders, and pool them where there are several; `say` gets progress.

    Participant 03 of dataset `lab` becomes `lab-03`. Exclusions, plans and trials of each are those of its own
    protocol. Raises `DatasetError` as `read`, and for a folder named twice, different origins, materials, titles or
    chances, or the same people's trials; and `ProtocolError`.
    """
    if len({root.resolve() for root in roots}) < len(roots):
        raise DatasetError(
            f"got the same dataset twice in {', '.join(map(str, roots))}", remedy="name each dataset once"
        )
    studies = [read(root, say) for root in roots]
    return studies[0] if len(studies) == 1 else _pool(studies, _names(roots))


def _pool(studies: Sequence[Study], names: Sequence[str]) -> Study:
    first = studies[0]
    _check_alike(studies, names)
    for index, study in enumerate(studies):
        for other in range(index):
            _check_apart(studies[other], study, (names[other], names[index]))
    ids = list(dict.fromkeys(study.id for study in studies))
    renamed = [_renamed(study, name) for study, name in zip(studies, names, strict=True)]
    parts = tuple(part for study in renamed for part in study.parts)
    check_chances(parts, len(first.materials))
    by_person: Any = {each: _union(getattr(study, each) for study in renamed) for each in BY_PERSON}
    return replace(
        first,
        id="+".join(ids),
        name=f"Pooled: {'; '.join(f'{s.name} ({name})' for s, name in zip(studies, names, strict=True))}",
        tasks=_tasks(studies),
        designs=_union(study.designs for study in studies),
        participants=tuple(label for study in renamed for label in study.participants),
        **by_person,
        attempts=pd.concat([study.attempts for study in renamed], ignore_index=True),
        exclusions=tuple(exclusion for study in renamed for exclusion in study.exclusions),
        unasked=tuple(one for study in renamed for one in study.unasked),
        parts=parts,
        ordered=all(study.ordered for study in studies),
    )


BY_PERSON = ("first_tasks", "session_ids", "forces", "facts", "touched")
"""What a study has by participant."""


def _union(mappings: Iterable[Mapping[Any, Any]]) -> dict[Any, Any]:
    return {key: value for mapping in mappings for key, value in mapping.items()}


def _check_alike(studies: Sequence[Study], names: Sequence[str]) -> None:
    first = studies[0]
    origins = {study.origin for study in studies}
    if len(origins) > 1:
        raise DatasetError(
            f"got datasets of {', '.join(sorted(origins))}",
            remedy="pool the datasets of each origin separately",
            allowed="those of one origin",
        )
    for study, name in zip(studies, names, strict=True):
        if study.materials != first.materials:
            raise DatasetError(
                name,
                f"got the materials {', '.join(study.materials)}",
                "analyse it separately",
                allowed=f"{', '.join(first.materials)}, as in {names[0]}",
            )
        if {*study.designs.values()} != {*first.designs.values()}:
            raise DatasetError(
                name, f"got other answers than in {names[0]}", "analyse it separately", allowed="the same"
            )


def _check_apart(first: Study, second: Study, names: tuple[str, str]) -> None:
    there = {session_id: who for (who, _), session_id in second.session_ids.items()}
    copies = {who: there[one] for (who, _), one in first.session_ids.items() if one in there}
    people = [who if who == name else f"{who} (there {name})" for who, name in copies.items()]
    told = "by the ids of their sessions"
    if not people:
        old, new = _trials(first), _trials(second)
        both = [key for key in old if key in new and not (key in first.session_ids and key in second.session_ids)]
        alike = [key for key in both if old[key] == new[key]]
        # Times hardly coincide, whatever the labels are. Answers alone may, but hardly those of several sessions and of
        # every one in both.
        people = _same_trials(first, second)
        if len(alike) >= LEAST and len(alike) == len(both):
            people += [who for who, _ in alike]
        people = list(dict.fromkeys(people))
        told = "all trials of a session are the same, and no id distinguishes the sessions"
    if people:
        more = f" and {len(people) - NAMED} more" if len(people) > NAMED else ""
        raise DatasetError(
            f"{names[0]} and {names[1]} contain the same trials of {', '.join(people[:NAMED])}{more} ({told})",
            remedy="give each participant once",
        )


def _same_trials(first: Study, second: Study) -> list[str]:
    """Return who of the first has a session, with times, of the same trials in the second, where one has no id."""
    timed = first.attempts.dropna(subset="response_time_s").groupby(["participant", "task"]).groups
    old = {(key[1], trials): key for key, trials in _trials(first).items() if key in timed}
    both = ((old.get((key[1], trials)), key) for key, trials in _trials(second).items())
    return [one[0] for one, other in both if one and not (one in first.session_ids and other in second.session_ids)]


def _trials(study: Study) -> dict[tuple[str, str], str]:
    """Return participant and task -> the attempts of the session as text, of sessions with a mistake."""
    columns = ["trial", "attempt", "presented", "answered", "response_time_s", "foot_speed_mm_s"]
    return {
        (str(who), str(task)): held[columns].to_csv(index=False)
        for (who, task), held in study.attempts.groupby(["participant", "task"], sort=False)
        if (held["presented"] != held["answered"]).any()
    }


def _names(roots: Sequence[Path]) -> list[str]:
    plain = [root.resolve().name for root in roots]
    return [name if plain.count(name) == 1 else f"{name}{index}" for index, name in enumerate(plain, start=1)]


def _renamed(study: Study, name: str) -> Study:
    return replace(
        study,
        participants=tuple(f"{name}-{label}" for label in study.participants),
        first_tasks={f"{name}-{label}": task for label, task in study.first_tasks.items()},
        facts={(f"{name}-{who}", column): cell for (who, column), cell in study.facts.items()},
        session_ids={(f"{name}-{who}", task): one for (who, task), one in study.session_ids.items()},
        forces={(f"{name}-{who}", task): one for (who, task), one in study.forces.items()},
        touched={(f"{name}-{who}", task): one for (who, task), one in study.touched.items()},
        attempts=study.attempts.assign(participant=[f"{name}-{who}" for who in study.attempts["participant"]]),
        exclusions=tuple(replace(one, participant=f"{name}-{one.participant}") for one in study.exclusions),
        unasked=tuple(replace(one, participant=f"{name}-{one.participant}") for one in study.unasked),
        parts=tuple(
            replace(
                part,
                name=name,
                participants=tuple(f"{name}-{label}" for label in part.participants),
                versions=tuple(
                    replace(one, sessions=frozenset((f"{name}-{who}", task) for who, task in one.sessions))
                    for one in part.versions
                ),
            )
            for part in study.parts
        ),
    )


def _tasks(studies: Sequence[Study]) -> tuple[Task, ...]:
    found: dict[str, Task] = {}
    for study in studies:
        for task in study.tasks:
            known = found.setdefault(task.id, task)
            if (known.title, known.presented) != (task.title, task.presented):
                one, other = (f"'{each.title}' with {', '.join(each.presented)}" for each in (known, task))
                raise DatasetError(
                    f"task {task.id}", f"got {one}, and {other}", "analyse the datasets separately", allowed="one"
                )
    return tuple(found.values())
