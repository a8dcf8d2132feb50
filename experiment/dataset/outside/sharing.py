"""`palpate share`: a copy of a dataset for others, with what its protocol and its participants allow.

Tables are made of the journals, and hold numbers and words of the protocol alone: no voice, day, note or reason that
somebody typed. Labels are drawn anew. The order of trials follows from seed and label (`study/schedule.py`): whoever
has the seed, or tries all 2^31 seeds that palpate draws, can tell from it which label a participant had.
"""

import json
import secrets
import shutil
import textwrap
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from math import floor
from pathlib import Path
from typing import Any

import tomlkit

from palpate.experiment import storage
from palpate.experiment.clock import day, wall_ns
from palpate.experiment.dataset import bids, build, checks, tables
from palpate.experiment.dataset.checks import Dataset
from palpate.experiment.dataset.imports.reconstruction import new_dataset
from palpate.experiment.dataset.outside import accidents, shared
from palpate.experiment.errors import DatasetError, Remedy, RosterError
from palpate.experiment.protocol import approval
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import journal, software
from palpate.experiment.study.lines import sharing_sha256
from palpate.experiment.study.roster import Roster

OWN = ("participant_id", "first_task", "withdrawn", "origin")
"""Columns of participants.tsv that say nothing of who somebody is."""

VOICE = ("voice_onset", "voice_proposed", "voice_agreement", "voice_lead")
"""Columns of trials that come from the sound of a voice."""

NOT_SHARED = "not shared"
"""What stands for a reason that somebody typed."""

GROUP = 10
"""Numbers that say who somebody is are shared in groups of so many, from a multiple of it on; ours."""

FACTS = ("Format", "Study", "Origin", "Label", "Tasks", "Ordered", "Versions")
"""What palpate says of a dataset and shares; adverse events and deviations are free text."""

INHERITED = ("InstitutionName", "InstitutionAddress", "InstitutionalDepartmentName", "CogAtlasID", "CogPOID")
"""Keys of an `events.json` at the top that hold for every session (BIDS 1.11, the inheritance principle)."""

OF_TRACES = ("SamplingFrequency", "StartTime", "Columns", "PhysioType", "TaskName", "Description")


@dataclass(frozen=True)
class Copy:
    """What was shared.

    `participants` are counted, and those who are `absent`, by why. `columns` say who somebody is, and every participant
    has the same cells there as `smallest_group` of them, themselves included. `left_out` are things that were not
    shared, each with the reason. `anchor` is that of the dataset as it was shared.
    """

    root: Path
    participants: int
    absent: Mapping[str, int]
    columns: tuple[str, ...]
    smallest_group: int
    left_out: Mapping[str, str]
    anchor: str

    def facts(self) -> dict[str, object]:
        """Return it as the description of the copy has it."""
        return {
            "Participants": self.participants,
            "Absent": dict(self.absent),
            "PersonalColumns": list(self.columns),
            "SmallestGroup": self.smallest_group,
            "LeftOut": dict(self.left_out),
        }

    def sentences(self) -> Iterator[str]:
        """Yield it in words."""
        absent = ", ".join(f"{why} {count}" for why, count in self.absent.items())
        yield f"Participants: {self.participants}. Absent: {absent or 'nobody'}."
        alike = f"alike in {', '.join(self.columns)}" if self.columns else "of whom no more is shared than their trials"
        yield f"Smallest group of participants {alike}: {self.smallest_group}."
        yield from (f"Left out: {what}, {why}." for what, why in self.left_out.items())


def share(root: Path, out: Path, without: Sequence[str] = ()) -> Copy:
    """Write a copy of a dataset for others into the new folder `out`, with who has agreed, and say what is in it.

    Columns `without` are left out. The roster has a line of who is shared before the copy is there. Raises
    `DatasetError` as `tables.check_tables`, without a roster, licence or permission in the protocol, for too small a
    group, and for an `out` that exists or lies in the dataset; `RosterError` if nobody agreed.
    """
    if out.resolve().is_relative_to(root.resolve()):
        raise DatasetError(out, "lies in the dataset itself", "choose another folder", allowed="one outside of it")
    if not checks.has_journals(root):
        raise DatasetError(
            root, "has no roster, so nobody's consent to sharing is on record", "ask whoever measured it"
        )
    dataset = tables.check_tables(root)
    study = {path.name: content for path, content in build.study_files(root, dataset).items()}
    description = json.loads(study[shared.DESCRIPTION])
    _check_licence(root, description)
    rows, described = _rows(study["participants.tsv"]), json.loads(study["participants.json"])
    chosen, absent = _chosen(dataset, [row["participant_id"].removeprefix("sub-") for row in rows])
    own = [row for row in rows if row["participant_id"].removeprefix("sub-") in chosen]
    kept, left_out = _personal(own, described, without)
    smallest = min(Counter(tuple(row[column] for column in kept) for row in own).values())
    _check_smallest(root, dataset, smallest, kept)
    if (root / "stimuli").exists() and not _has_stimuli(root, dataset):
        left_out["stimuli"] = "because no file stimuli/LICENSE states their licence"
    anchor = checks.keep_anchor(root)[0] if dataset.roster else checks.anchor(root)
    labels = _drawn(chosen)
    copy = Copy(out, len(labels), absent, kept, smallest, left_out, anchor.line.rpartition(" ")[2])
    with new_dataset(out) as part:
        bids.write_files(
            {
                **_people(part, own, described, labels, kept),
                **_description(part, description, labels, copy),
                **_inherited(root, part),
                **_protocols(part, dataset),
            }
        )
        for path, header in dataset.sessions:
            if header.participant in labels:
                bids.write_files(_session(part, dataset, path, labels[header.participant]))
        if "stimuli" not in left_out and (root / "stimuli").exists():
            shutil.copytree(root / "stimuli", part / "stimuli")
        accidents.keep_attributes(part, build.LABELS[dataset.purpose])
        listed = {"format": storage.DATASET_FORMAT, "files": shared.file_hashes(part)}
        storage.write_json(storage.shared_path(part), listed)
        if dataset.roster is not None:
            _record(root, dataset.protocol, labels, copy.anchor)
    return copy


def _people(
    part: Path,
    rows: Sequence[Mapping[str, str]],
    described: Mapping[str, Any],
    labels: Mapping[str, str],
    kept: Sequence[str],
) -> bids.Files:
    """Return participants.tsv under the new labels, in their order, and its sidecar."""
    columns = (*OWN, *kept)
    renamed = [{**row, "participant_id": f"sub-{labels[row['participant_id'].removeprefix('sub-')]}"} for row in rows]
    renamed.sort(key=lambda row: row["participant_id"])
    said = {"Description": "Participants who agreed to sharing.", **{name: described[name] for name in columns}}
    return {
        part / "participants.tsv": bids.table(columns, [{name: row[name] for name in columns} for row in renamed]),
        part / "participants.json": storage.json_bytes(said),
    }


def _check_licence(root: Path, description: Mapping[str, Any]) -> None:
    """Refuse to share what nobody would be allowed to use."""
    if str(description.get("License", "n/a")).startswith("n/a"):
        path, allowed = root / shared.DESCRIPTION, "a licence, such as CC-BY-4.0 or CC0-1.0"
        raise DatasetError(path, "states no licence", "write it there", field="License", allowed=allowed)


def _chosen(dataset: Dataset, listed: Sequence[str]) -> tuple[list[str], dict[str, int]]:
    """Return who is shared, and how many are not, by why. Raises `DatasetError` and `RosterError`."""
    if (roster := dataset.roster) is None:
        return list(listed), {}
    if dataset.protocol.sharing is None:
        words = "if its board allows it, add that table, seal the amended protocol, and record it: {}"
        remedy = Remedy(words, ("palpate", "amend", "PROTOCOL"), suffices=False)
        raise DatasetError(dataset.root, "its protocol has no table [sharing], so nothing may be shared", remedy)
    terms = sharing_sha256(dataset.protocol.sharing)
    reasons = {label: _absent(roster, terms, label, listed) for label in roster.consent_on}
    chosen = [label for label in listed if not reasons[label]]
    if not chosen:
        remedy = Remedy("record who agrees: {}", ("palpate", "consent", "PROTOCOL", "-p", "LABEL", "--sharing"))
        raise RosterError(roster.path, "nobody with a session has agreed to sharing", remedy)
    return chosen, dict(sorted(Counter(why for why in reasons.values() if why).items()))


def _absent(roster: Roster, terms: str, label: str, listed: Sequence[str]) -> str:
    """Return why a participant is not shared; empty if they are."""
    if label in roster.withdrawn:
        return "withdrew"
    if label not in roster.sharing:
        return "not asked"
    if not roster.sharing[label]:
        return "declined"
    if roster.sharing[label] != terms:
        return "agreed to another [sharing]"
    return "" if label in listed else "no session"


def _personal(
    rows: Sequence[Mapping[str, str]], described: dict[str, Any], without: Sequence[str]
) -> tuple[tuple[str, ...], dict[str, str]]:
    """Return the columns that say who somebody is and are shared, and why others are not; numbers become groups.

    Raises `DatasetError` for a column that is not there.
    """
    kept, left_out = list[str](), dict[str, str]()
    columns = [column for column in rows[0] if column not in OWN]
    if unknown := [column for column in without if column not in columns]:
        raise DatasetError("--without", f"got {unknown[0]}", allowed=", ".join(columns) or "nothing, for no column is")
    for column in columns:
        cells = [row[column] for row in rows]
        if column in without:
            left_out[column] = "as was asked for"
        elif "Levels" in described[column]:
            kept.append(column)
        elif all(cell == bids.MISSING or _is_number(cell) for cell in cells):
            kept.append(column)
            for row in rows:
                row[column] = _grouped(row[column])  # type: ignore[index]
            described[column]["Description"] += f" In groups of {GROUP}."
        else:
            left_out[column] = "because it is free text"
    return tuple(kept), left_out


def _is_number(cell: str) -> bool:
    return cell.removeprefix("-").replace(".", "", 1).isdecimal()


def _grouped(cell: str) -> str:
    """Return the group of a number, such as `20 to 29`."""
    if cell == bids.MISSING:
        return cell
    lowest = floor(float(cell) / GROUP) * GROUP
    return f"{lowest} to {lowest + GROUP - 1}"


def _check_smallest(root: Path, dataset: Dataset, smallest: int, kept: Sequence[str]) -> None:
    """Refuse to share somebody whom too few others are like."""
    rule = dataset.protocol.sharing
    least = rule.smallest_group if rule else 1
    if smallest < least:
        leave = (
            Remedy("leave out a column: {}", ("palpate", "share", str(root), "OUT", "--without", kept[0]))
            if kept
            else ""
        )
        allowed = f"{least} (sharing.smallest_group of the protocol)"
        of = f"alike in {', '.join(kept)}" if kept else "in all"
        what = f"got a smallest group of {smallest} {of}"
        raise DatasetError(root / "participants.tsv", what, leave or "share when more have agreed", allowed=allowed)


def _has_stimuli(root: Path, dataset: Dataset) -> bool:
    """Return whether stimuli may go with a copy: they are simulated, or a file beside them is their licence."""
    return dataset.plan is not None or (root / "stimuli" / "LICENSE").is_file()


def _drawn(labels: Sequence[str]) -> dict[str, str]:
    """Return a new label for each, drawn from the system's randomness, of which nothing is kept."""
    places = list(range(1, len(labels) + 1))
    secrets.SystemRandom().shuffle(places)
    width = max(2, len(str(len(labels))))
    return {label: f"{place:0{width}d}" for label, place in zip(labels, places, strict=True)}


def _session(part: Path, dataset: Dataset, path: Path, label: str) -> bids.Files:
    """Return table, sidecar and traces of one session under a new label."""
    contents = journal.read(path)
    if path in dataset.under_way and not (contents := tables.until_footer(contents)).lines:
        return {}
    header, protocol = contents.header, dataset.version(contents.header)
    task, origin = protocol.task(header.task), build.ORIGINS[dataset.purpose]
    allowed = {None, build.UNANSWERED, *(f"{rule.id}: {rule.reason}" for rule in protocol.exclusion)}
    rows = build.event_rows(build.kind_of(task), path, contents, origin)
    for row in rows:
        if row["redo_reason"] not in allowed:
            row["redo_reason"] = NOT_SHARED
        for column in VOICE:
            row.pop(column, None)
    files = bids.events(part, label, build.task_text(protocol, task, origin), rows)
    for sidecar in (file for file in files if file.suffix == ".json"):
        described = {"Description": "Trials of one session.", **json.loads(files[sidecar])}
        files[sidecar] = storage.json_bytes(described)
    before = bids.beh_path(dataset.root, header.participant, header.task, "")
    for trace in sorted(before.parent.glob(f"{before.name}recording-*_physio.*")):
        content = storage.read_bytes(trace)
        if trace.suffix == ".json":
            said = storage.json_of(content)
            keys = (*OF_TRACES, *said["Columns"])
            content = storage.json_bytes({key: value for key, value in said.items() if key in keys})
        files[bids.beh_path(part, label, header.task, trace.name.removeprefix(before.name))] = content
    return files


def _inherited(root: Path, part: Path) -> bids.Files:
    """Return what a laboratory wrote at the top for the tables of all sessions, but for other keys than `INHERITED`."""
    if not (file := root / "events.json").is_file():
        return {}
    try:
        stated = storage.json_of(storage.read_bytes(file))
        known = {key: str(stated[key]) for key in INHERITED if key in stated}
    except (OSError, ValueError, TypeError) as error:
        raise DatasetError(file, f"cannot be read ({error})", "correct it, or delete it") from error
    return {part / file.name: storage.json_bytes(known)}


def _protocols(part: Path, dataset: Dataset) -> bids.Files:
    """Return each version of the protocol, without its comments, and its seal."""
    files: bids.Files = {}
    versions = list(dataset.versions.values()) or [dataset.protocol]
    known = dataset.approvals.approved if dataset.approvals else ()
    numbers = {one.number: one.protocol_sha256 for one in known} or {1: approval.sha256(versions[0])}
    for number, sha256 in numbers.items():
        path = storage.protocol_path(part, number)
        version = next(one for one in versions if approval.sha256(one) == sha256)
        files[path] = tomlkit.dumps(_stated(json.loads(approval.canonical(version)))).encode()
        seal = approval.seal_path(storage.protocol_path(dataset.root, number))
        if seal.exists():
            files[approval.seal_path(path)] = storage.read_bytes(seal)
    return files


def _stated(value: Any) -> Any:
    """Return a document without keys that are null, which TOML has not."""
    if isinstance(value, dict):
        return {key: _stated(inner) for key, inner in value.items() if inner is not None}
    return [_stated(inner) for inner in value] if isinstance(value, list) else value


def _description(part: Path, source: Mapping[str, Any], labels: Mapping[str, str], copy: Copy) -> bids.Files:
    """Return the description of a copy, as the derivative that it is, and its README."""
    facts = {key: value for key, value in source["Palpate"].items() if key in FACTS} | {"Shared": copy.facts()}
    if "Versions" in facts:
        facts["Versions"] = [{**one, "Sessions": _renamed(one["Sessions"], labels)} for one in facts["Versions"]]
    ours = software.this()
    made = {"Name": "palpate", "Version": ours.version, "SourceSha256": ours.source_sha256}
    content = {
        **{key: source[key] for key in ("Name", "BIDSVersion")},
        "DatasetType": "derivative",
        **{key: value for key, value in source.items() if key not in bids.WRITTEN},
        "GeneratedBy": [{**made, "Description": "palpate share"}],
        "SourceDatasets": [{"Version": f"anchor {copy.anchor}"}],
        "Palpate": facts,
    }
    paragraphs = (
        "This is a copy for others of a dataset that its laboratory keeps, with the participants who agreed to that. "
        "Labels were drawn anew, and times count from the beginning of each session. Journals, voices, days, notes "
        f"and free text stayed behind: where a reason was typed, it reads '{NOT_SHARED}'.",
        *copy.sentences(),
        "palpate verify shows whether a file was changed since, and palpate analyse makes the tables and the report.",
    )
    body = "\n\n".join(textwrap.fill(one, 100) for one in paragraphs)
    return {
        part / shared.DESCRIPTION: storage.json_bytes(content),
        part / "README": f"{source['Name']}\n\n{body}\n".encode(),
    }


def _renamed(sessions: Sequence[str], labels: Mapping[str, str]) -> list[str]:
    parted = [one.removeprefix("sub-").partition("_") for one in sessions]
    return sorted(f"sub-{labels[who]}_{task}" for who, _, task in parted if who in labels)


def _rows(table: bytes) -> list[dict[str, str]]:
    columns, *rows = (line.split("\t") for line in table.decode().splitlines())
    return [dict(zip(columns, row, strict=True)) for row in rows]


def _record(root: Path, protocol: Protocol, labels: Mapping[str, str], anchor: str) -> None:
    """Put on record who is shared, and with the board's leave which label each got, where an erasure deletes it."""
    if protocol.sharing is not None and protocol.sharing.keep_labels:
        for before, label in labels.items():
            path = storage.shared_label_path(root, before)
            known = storage.json_of(storage.read_bytes(path)) if path.exists() else {}
            storage.write_json(path, {**known, anchor: label})
    today: date = day(wall_ns())
    Roster.continued(storage.roster_path(root)).share(tuple(labels), today)
