"""Dataset on disk -> tidy frame; lists every attempt and participant that the analysis leaves out, and why.

Reads only the BIDS files: `dataset_description.json`, `participants.tsv`, `sub-*/beh/*_events.tsv` with their
sidecars, and `sourcedata/protocol.toml` where there is one. Nothing here knows of journals.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from glob import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from analysis.documents.tables import plural
from analysis.reading.study import Part, Study, Task, exclude
from experiment.errors import DatasetError
from experiment.records.events import EVENT_COLUMNS, NO_ANSWER

if TYPE_CHECKING:
    from experiment.protocol.models import Protocol

MISSING = "n/a"
FURTHER = {
    "masker_db_a": "masker_level",
    **{f"{column}_s": column for column in ("prediction_error", "delivery_error", "gate_to_scheduled", "dead_time")},
}
"""Name of each further column here, and in the table."""

ORIGINS = ("PARTICIPANT", "REHEARSAL", "RECONSTRUCTION")


def read(root: Path) -> Study:
    """Read the dataset in the folder `root`.

    Raises:
        DatasetError: for a file that is missing, broken or truncated; it names the file and what to do.
        ProtocolError: for a broken copy of the protocol.
    """
    description = _json(root / "dataset_description.json", "give the folder of a dataset made by palpate")
    facts = _facts(description, root / "dataset_description.json")
    withdrawn, first_tasks = _participants(root / "participants.tsv")
    _no_strangers(root, set(withdrawn), tuple(facts["Tasks"]))
    rows: list[dict[str, object]] = []
    session_ids: dict[tuple[str, str], str] = {}
    tasks: dict[str, Task] = {}
    materials: tuple[str, ...] = ()
    for participant in withdrawn:
        for task in facts["Tasks"]:
            path = root / f"sub-{participant}" / "beh" / f"sub-{participant}_task-{task}_events.tsv"
            if not path.exists():
                _never_begun(path, f"sub-{participant}_task-{task}_")
                continue
            sidecar = _sidecar(path.with_suffix(".json"))
            if materials and materials != tuple(sidecar["Materials"]):
                raise DatasetError(
                    f"{path.with_suffix('.json')}: Materials differ from those of other files; mend one of them"
                )
            materials = tuple(sidecar["Materials"])
            tasks[task] = Task(task, str(sidecar.get("TaskTitle", task)), str(sidecar.get("Instructions", "")))
            if (session_id := sidecar.get("SessionId")) is not None:
                for (who, other), known in session_ids.items():
                    if known == session_id:
                        raise DatasetError(
                            f"{path.with_suffix('.json')}: SessionId {known} is that of participant {who}, task "
                            f"{other}, too; keep one of them"
                        )
                session_ids[participant, task] = str(session_id)
            rows += _events(path, participant, task, materials, facts["Origin"], sidecar["Rows"])
    if not rows:
        raise DatasetError(f"{root} holds no trial; run a session first, then make the dataset again")
    protocol = _protocol(root / "sourcedata" / "protocol.toml")
    attempts = pd.DataFrame(rows)
    rules = protocol.exclusion if protocol else ()
    with_objects = [task.id for task in protocol.tasks if task.stimulus == "real"] if protocol else []
    exclusions, unasked = exclude(attempts, withdrawn, rules, with_objects=with_objects)
    done = tuple(tasks[task] for task in facts["Tasks"] if task in tasks)
    return Study(
        id=str(facts["Study"]),
        name=str(description.get("Name", facts["Study"])),
        origin=str(facts["Origin"]),
        label=str(facts["Label"]),
        materials=materials,
        tasks=done,
        participants=tuple(withdrawn),
        first_tasks=first_tasks,
        session_ids=session_ids,
        attempts=attempts,
        exclusions=exclusions,
        unasked=unasked,
        parts=(Part(root.resolve().name, tuple(withdrawn), tuple(task.id for task in done), protocol),),
    )


def _facts(description: dict[str, Any], path: Path) -> dict[str, Any]:
    facts = description.get("Palpate")
    if not isinstance(facts, dict) or not {"Study", "Origin", "Label", "Tasks"} <= set(facts):
        raise DatasetError(f"{path}: key Palpate lacks Study, Origin, Label or Tasks; give a dataset made by palpate")
    if facts["Origin"] not in ORIGINS:
        raise DatasetError(f"{path}: Origin is {facts['Origin']!r}; allowed: {', '.join(ORIGINS)}; mend it")
    tasks = facts["Tasks"]
    if not (isinstance(tasks, list) and all(isinstance(task, str) for task in tasks)):
        raise DatasetError(f"{path}: Tasks is {tasks!r}; allowed: a list of task ids; mend it")
    return facts


def _text(path: Path, remedy: str) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise DatasetError(f"{path} is missing; {remedy}") from error
    except (OSError, UnicodeDecodeError) as error:
        raise DatasetError(f"{path} cannot be read ({error}); {remedy}") from error


def _json(path: Path, remedy: str) -> dict[str, Any]:
    try:
        content = json.loads(_text(path, remedy))
    except json.JSONDecodeError as error:
        raise DatasetError(f"{path}: line {error.lineno}: no JSON ({error.msg}); make the dataset again") from error
    if not isinstance(content, dict):
        raise DatasetError(f"{path}: got {type(content).__name__}; allowed: a JSON object; make the dataset again")
    return content


def _sidecar(path: Path) -> dict[str, Any]:
    sidecar = _json(path, "make the dataset again, every events file has its sidecar")
    materials, rows = sidecar.get("Materials"), sidecar.get("Rows")
    if not (isinstance(materials, list) and len(materials) > 1 and all(isinstance(m, str) for m in materials)):
        raise DatasetError(
            f"{path}: Materials is {materials!r}; allowed: a list of two names or more; make the dataset again"
        )
    if not isinstance(rows, int):
        raise DatasetError(f"{path}: Rows is {rows!r}; allowed: the number of rows; make the dataset again")
    return sidecar


def _table(path: Path) -> tuple[list[str], list[list[str]]]:
    text = _text(path, "make the dataset again")
    if not text.endswith("\n"):
        raise DatasetError(f"{path} ends in the middle of a line; it is truncated: make the dataset again")
    lines = [line.split("\t") for line in text.removesuffix("\n").split("\n")]
    for number, line in enumerate(lines, start=1):
        if len(line) != len(lines[0]):
            raise DatasetError(f"{path}: line {number}: {len(line)} cells under {len(lines[0])} columns; mend the line")
    return lines[0], lines[1:]


def _participants(path: Path) -> tuple[dict[str, bool], dict[str, str]]:
    """Whether each participant withdrew, and the task done first of those of whom it is known."""
    columns, rows = _table(path)
    if "participant_id" not in columns:
        raise DatasetError(f"{path}: no column participant_id; got {columns}; make the dataset again")
    found: dict[str, bool] = {}
    first: dict[str, str] = {}
    for number, row in enumerate(rows, start=2):
        cells = dict(zip(columns, row, strict=True))
        label = cells["participant_id"].removeprefix("sub-")
        if label in found:
            raise DatasetError(f"{path}: line {number}: participant {label} stands twice; keep one line")
        found[label] = cells.get("withdrawn", MISSING) == "1"
        if (task := cells.get("first_task", MISSING)) != MISSING:
            first[label] = task
    return found, first


def _protocol(path: Path) -> Protocol | None:
    if not path.exists():
        return None
    from experiment.protocol import files

    return files.load(path)


def _no_strangers(root: Path, participants: set[str], tasks: tuple[str, ...]) -> None:
    for path in sorted(root.glob("sub-*/beh/*_events.tsv")):
        label = path.parent.parent.name.removeprefix("sub-")
        if label not in participants:
            raise DatasetError(f"{path}: participant {label} is not in participants.tsv; add the line or remove it")
        if path.name not in {f"sub-{label}_task-{task}_events.tsv" for task in tasks}:
            raise DatasetError(f"{path}: task not in dataset_description.json, which has {list(tasks)}; add it there")


def _never_begun(events: Path, prefix: str) -> None:
    """Refuse a session of which there are other files, but no events."""
    if left := next(iter(sorted(events.parent.glob(f"{escape(prefix)}*"))), None):
        raise DatasetError(
            f"{events} is missing, though {left.name} stands there; restore it or make the dataset again"
        )


def _events(
    path: Path, participant: str, task: str, materials: tuple[str, ...], origin: str, count: int
) -> list[dict[str, object]]:
    columns, lines = _table(path)
    if missing := [column for column in EVENT_COLUMNS if column not in columns]:
        raise DatasetError(f"{path}: no column {', '.join(missing)}; make the dataset again")
    if len(lines) != count:
        raise DatasetError(f"{path}: {plural(len(lines), 'row')}, its sidecar says {count}; make the dataset again")
    rows: list[dict[str, object]] = []
    counted: set[object] = set()
    for number, line in enumerate(lines, start=2):
        row = _event(dict(zip(columns, line, strict=True)), f"{path}: line {number}", materials, origin)
        if row["counted"]:
            if row["trial"] in counted:
                raise DatasetError(f"{path}: line {number}: trial {row['trial']} counts twice; one attempt may count")
            counted.add(row["trial"])
        rows.append({"participant": participant, "task": task, **row})
    return rows


def _event(cells: Mapping[str, str], where: str, materials: tuple[str, ...], origin: str) -> dict[str, object]:
    counted = cells["counted"]
    answers = (*materials, NO_ANSWER) if counted == "1" else (*materials, NO_ANSWER, MISSING)
    for column, allowed in (
        ("counted", ("0", "1")),
        ("presented", materials),
        ("answered", answers),
        ("origin", (origin,)),
    ):
        if cells[column] not in allowed:
            raise DatasetError(f"{where}: {column}: got {cells[column]!r}; allowed: {', '.join(allowed)}; mend the row")
    return {
        "trial": _whole(cells["trial"], f"{where}: trial"),
        "attempt": _whole(cells["attempt"], f"{where}: attempt"),
        "counted": counted == "1",
        "presented": cells["presented"],
        "answered": cells["answered"],
        "response_time_s": _number(cells["response_time"], f"{where}: response_time", "a number from 0"),
        "foot_speed_mm_s": _number(cells["foot_speed"], f"{where}: foot_speed", "a number from 0"),
        "frames_lost": _number(cells["frames_lost"], f"{where}: frames_lost", "a whole number from 0"),
        "delivered": _number(cells["delivered"], f"{where}: delivered", "0, 1"),
        "onset_error_s": _number(cells["onset_error"], f"{where}: onset_error"),
        **{name: _number(cells.get(column, MISSING), f"{where}: {column}") for name, column in FURTHER.items()},
        "redo_reason": cells["redo_reason"],
        "included": counted == "1",
    }


def _whole(cell: str, where: str) -> int:
    if not (cell.isascii() and cell.isdigit() and len(cell) < 8 and int(cell) > 0):
        raise DatasetError(f"{where}: got {cell!r}; allowed: a whole number from 1; mend the row")
    return int(cell)


ALLOWED: Mapping[str, Callable[[float], bool]] = {
    "a number": math.isfinite,
    "a number from 0": lambda value: 0 <= value < math.inf,
    "a whole number from 0": lambda value: 0 <= value < math.inf and value.is_integer(),
    "0, 1": lambda value: value in (0, 1),
}
"""In words -> whether a value is so."""


def _number(cell: str, where: str, allowed: str = "a number") -> float:
    if cell == MISSING:
        return math.nan
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not ALLOWED[allowed](value):
        raise DatasetError(f"{where}: got {cell!r}; allowed: {allowed}, or {MISSING}; mend the row")
    return value
