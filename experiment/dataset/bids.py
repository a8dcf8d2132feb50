"""Writing the files of a BIDS `beh` dataset: plain tables and sidecars, the same bytes for the same content.

The layout is BIDS 1.11 for behavioral experiments; `Palpate`, `Materials`, `Answers`, `Rows` and `SessionId` are own
keys.
"""

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from palpate.experiment import storage
from palpate.experiment.errors import DatasetError
from palpate.experiment.protocol.designs import design_of
from palpate.experiment.records.events import NO_ANSWER, PLACES, Columns, columns_of
from palpate.experiment.records.software import Software

BIDS_VERSION = "1.11.0"
MISSING = "n/a"
FURTHER = ("further", "force", "sites", "heard_of", "heard", "answers")
"""Groups of columns that a table has where a row has them."""

Origin = Literal["PARTICIPANT", "PILOT", "PRACTICE", "REHEARSAL", "RECONSTRUCTION", "IMPORTED"]

LABELS: dict[Origin, str] = {
    "PARTICIPANT": "",
    "PILOT": "PILOT - real participants, but not study data",
    "PRACTICE": "PRACTICE - simulated participants, experimenter in training",
    "REHEARSAL": "REHEARSAL - simulated participants",
    "RECONSTRUCTION": "RECONSTRUCTION - consistent with the printed tables, not original data",
    "IMPORTED": "IMPORTED - answers that a laboratory measured elsewhere",
}
"""What stands at the head of every file of such a dataset; a study's own data carries no label."""

Files = dict[Path, bytes]
"""What is to be written where."""


@dataclass(frozen=True)
class DatasetText:
    """What a dataset says about itself.

    `study` is an id, `tasks` are in the order of the tables, `origin` produced the rows, and `readme` follows title and
    label. `ordered`: whether trial numbers are the order of the trials; None says nothing. `versions` are those
    of an amended protocol, oldest first, each with its file and its sessions. `approvals` are a board's, in words.
    `incidents` are adverse events and deviations, in words. `took_part` has the person of a session under another's
    label, and whether that one withdrew: `sub-03_task-a` -> `Person`, `Withdrew`.
    """

    study: str
    name: str
    origin: Origin
    license: str
    authors: tuple[str, ...]
    tasks: tuple[str, ...]
    readme: str
    software: Software
    references: tuple[str, ...] = ()
    ordered: bool | None = None
    versions: tuple[Mapping[str, object], ...] = ()
    approvals: tuple[str, ...] = ()
    incidents: tuple[str, ...] = ()
    took_part: Mapping[str, Mapping[str, object]] = field(default_factory=dict)


@dataclass(frozen=True)
class TaskText:
    """What the sidecar of a task's events says.

    `materials` maps ids to descriptions, `presented` are the task's, None for all; `session_id` is None without a
    journal. `kind` and `design` are those of its trials, which present so many materials at `intervals`, if the design
    leaves that open; `answers` are those that are no materials, each with what it names.
    """

    id: str
    title: str
    description: str
    instructions: str
    materials: Mapping[str, str]
    stimulus_presentation: Mapping[str, str]
    origin: Origin
    notes: Mapping[str, object] = field(default_factory=dict)
    session_id: str | None = None
    kind: str = "footstep"
    design: str = "identification"
    answers: Mapping[str, str] = field(default_factory=dict)
    presented: tuple[str, ...] | None = None
    intervals: int | None = None


def write_files(files: Files) -> None:
    """Write every file whole, tables last. Raises `DatasetError` if the file system refuses."""
    for path, content in sorted(files.items(), key=lambda file: file[0].suffix == ".tsv"):
        storage.write_bytes(path, content)


def table(columns: Sequence[str], rows: Iterable[Mapping[str, object]]) -> bytes:
    """Return a tab-separated table: `n/a` for None, NaN and missing values, 1 and 0 for true and false.

    Raises `ValueError` for an unknown column, and `DatasetError` for a text that is empty or has tabs or line ends.
    """
    lines = ["\t".join(columns)]
    for row in rows:
        if unknown := set(row) - set(columns):
            raise ValueError(f"no such columns: {sorted(unknown)}; allowed: {list(columns)}")
        lines.append("\t".join(_cell(row.get(column)) for column in columns))
    return ("\n".join(lines) + "\n").encode()


WRITTEN = ("Name", "BIDSVersion", "DatasetType", "GeneratedBy", "Palpate")
"""The keys of `dataset_description.json` that palpate writes; all others are the laboratory's once they are there."""


def description(root: Path, text: DatasetText) -> Files:
    """Return `dataset_description.json` and `README`; the label of what is no data of a study leads both.

    What a laboratory wrote there stays: every key but those `WRITTEN` here, and the README, which begins with the label
    if there is one. Raises `DatasetError` for a description that is no JSON, and for `Authors` or others that are no
    texts, as BIDS wants them.
    """
    label = LABELS[text.origin]
    name = labelled(text.name, text.origin)
    facts = {
        "Format": storage.DATASET_FORMAT,
        "Study": text.study,
        "Origin": text.origin,
        "Label": label,
        "Tasks": list(text.tasks),
        **({} if text.ordered is None else {"Ordered": text.ordered}),
        **({"Versions": list(text.versions)} if text.versions else {}),
        **({"Incidents": list(text.incidents)} if text.incidents else {}),
        **({"TookPart": dict(text.took_part)} if text.took_part else {}),
    }
    content: dict[str, object] = {
        "Name": name,
        "BIDSVersion": BIDS_VERSION,
        "DatasetType": "raw",
        "License": text.license,
        "Authors": list(text.authors),
        "GeneratedBy": [
            {
                "Name": "palpate",
                "Version": text.software.version,
                "SourceSha256": text.software.source_sha256,
                "Description": label or "measured",
            }
        ],
        "Palpate": facts,
    }
    if text.references:
        content["ReferencesAndLinks"] = list(text.references)
    kept = _laboratorys(root / "dataset_description.json")
    if text.approvals:
        kept["EthicsApprovals"] = list(dict.fromkeys((*kept.get("EthicsApprovals", ()), *text.approvals)))
    readme = root / "README"
    made = f"{name}\n\n{text.readme.strip()}\n".encode()
    own = readme.is_file() and (not label or storage.read_bytes(readme).startswith(name.encode()))
    return {
        root / "dataset_description.json": storage.json_bytes(content | kept),
        readme: storage.read_bytes(readme) if own else made,
    }


def _laboratorys(path: Path) -> dict[str, Any]:
    """Return the keys of a description that are the laboratory's. Raises `DatasetError` where they cannot be read."""
    remedy = "correct it (palpate preserves your own entries), or delete it and palpate will write a new one"
    try:
        found = storage.json_of(storage.read_bytes(path))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        line = error.lineno if isinstance(error, json.JSONDecodeError) else None
        raise DatasetError(path, f"cannot be read ({storage.why(error)})", remedy, line=line) from error
    if not isinstance(found, dict):
        raise DatasetError(path, "cannot be read (not a JSON object)", remedy)
    kept = {key: value for key, value in found.items() if key not in WRITTEN}
    for key in LISTS:
        value = kept.get(key, [])
        if not (isinstance(value, list) and all(isinstance(one, str) for one in value)):
            raise DatasetError(path, f"got {value!r:.60}", "correct it", field=key, allowed="a list of texts")
    for orcid in re.findall(r"\b\d{4}-\d{4}-\d{4}-\d{3}[\dX]\b", " ".join(map(str, kept.get("Authors", ())))):
        if not _is_orcid(orcid):
            raise DatasetError(path, f"got the ORCID {orcid}", "correct it", field="Authors", allowed="a valid one")
    return kept


LISTS = ("Authors", "Funding", "EthicsApprovals", "Keywords", "ReferencesAndLinks")
"""Keys that hold lists of texts (BIDS 1.11, dataset_description.json)."""


def _is_orcid(orcid: str) -> bool:
    """Return whether the last character is the check digit of the others (ISO 7064, MOD 11-2)."""
    digits, total = orcid.replace("-", ""), 0
    for digit in digits[:-1]:
        total = (total + int(digit)) * 2
    return "0123456789X"[(12 - total % 11) % 11] == digits[-1]


def participants(
    root: Path, rows: Iterable[Mapping[str, object]], *, origin: Origin, asked: Columns | None = None
) -> Files:
    """Return `participants.tsv` and its sidecar; columns as in events.json, `origin` the same in all rows.

    `asked` are columns of what participants were asked about themselves.
    """
    rows = ({**row, "origin": origin} for row in rows)
    described = _described({**columns_of("participants"), **(asked or {})}, origin)
    label = described["participant_id"]
    label["Description"] = labelled(str(label["Description"]), origin)
    return {
        root / "participants.tsv": table(tuple(described), rows),
        root / "participants.json": storage.json_bytes(described),
    }


def beh_path(root: Path, participant: str, task: str, suffix: str) -> Path:
    """Return `sub-P/beh/sub-P_task-T_SUFFIX`. Raises `DatasetError` for a label that is not letters and digits."""
    for what, label in (("participant", participant), ("task", task)):
        if not re.fullmatch(r"[0-9A-Za-z]+", label):
            raise DatasetError(what, f"got {label!r}", "rename it", allowed="letters and digits, as BIDS requires")
    return root / f"sub-{participant}" / "beh" / f"sub-{participant}_task-{task}_{suffix}"


def events(root: Path, participant: str, task: TaskText, rows: Iterable[Mapping[str, object]]) -> Files:
    """Return the events of one session, a row an attempt, and the sidecar that describes every column.

    `participant` is a label without `sub-`. Further columns are in the table where some row has them.
    """
    path = beh_path(root, participant, task.id, "events.tsv")
    attempts = list(rows)
    known = {name for row in attempts for name in row}
    own = columns_of(task.kind, design_of(task.design).shown_together({"intervals": task.intervals}))
    further = {name: text for group in FURTHER for name, text in columns_of(group).items()}
    texts = {**own, **{name: text for name, text in further.items() if name in known}}
    described = _described(texts, task.origin)
    for name in ("presented", *PLACES):
        if name in described:
            described[name]["Levels"] = {one: task.materials[one] for one in task.presented or task.materials}
    described["answered"]["Levels"] = {**(task.answers or task.materials), NO_ANSWER: "no material was named"}
    sidecar: dict[str, object] = {
        "TaskName": task.id,
        "TaskTitle": task.title,
        "TaskDescription": labelled(task.description, task.origin),
        "Instructions": task.instructions,
        "StimulusPresentation": dict(task.stimulus_presentation),
        "Kind": task.kind,
        "Design": task.design,
        "Materials": list(task.materials),
        **({"Presented": list(task.presented)} if task.presented else {}),
        **({"Answers": list(task.answers)} if task.answers else {}),
        "Rows": len(attempts),
        **({"SessionId": task.session_id} if task.session_id else {}),
        **task.notes,
        **described,
    }
    return {path: table(tuple(texts), attempts), path.with_suffix(".json"): storage.json_bytes(sidecar)}


def _described(texts: Columns, origin: Origin) -> dict[str, dict[str, object]]:
    own = columns_of("imported") if origin == "IMPORTED" else {}
    return {name: {**text, **own.get(name, {})} for name, text in texts.items()}


def labelled(text: str, origin: Origin) -> str:
    """Return a text, led by the label of what is no data of a study."""
    return f"{LABELS[origin]}: {text}" if LABELS[origin] else text


def _cell(value: object) -> str:
    if value is None:
        return MISSING
    if isinstance(value, bool):
        return "1" if value else "0"
    if isinstance(value, float):
        return repr(value) if np.isfinite(value) else MISSING
    text = str(value)
    if not text or re.search(r"[\t\r\n]", text):
        raise DatasetError(
            "a table", f"got the text {text[:60]!r}", "correct its source", allowed="one line without tabs"
        )
    return text
