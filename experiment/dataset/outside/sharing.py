"""`palpate share`: a copy of a dataset for others, with what its protocol and its participants allow.

Tables are made of the journals, and hold numbers and words of the protocol alone: no voice, day, note or reason that
somebody typed. Labels are drawn anew. The order of trials follows from seed and label (`study/schedule.py`): whoever
has the seed, or tries all 2^31 seeds that palpate draws, can tell from it which label a participant had.
"""

import json
import os
import re
import secrets
import shutil
import textwrap
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from typing import Any

import tomlkit

from palpate.experiment import storage
from palpate.experiment.apparatus.tracker import landing
from palpate.experiment.clock import day, wall_ns
from palpate.experiment.dataset import bids, build, checks, phenotype, tables
from palpate.experiment.dataset.checks import Dataset
from palpate.experiment.dataset.imports.reconstruction import new_dataset
from palpate.experiment.dataset.outside import accidents, shared
from palpate.experiment.errors import DatasetError, Remedy, RosterError
from palpate.experiment.protocol import approval, files
from palpate.experiment.protocol.designs import groups
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import entries, journal, software
from palpate.experiment.study.lines import sharing_sha256
from palpate.experiment.study.people import facts
from palpate.experiment.study.roster import Roster

OWN = ("participant_id", "first_task", "withdrawn", "origin")
"""Columns of participants.tsv that say nothing of who somebody is."""

VOICE = ("voice_onset", "voice_proposed", "voice_agreement", "voice_lead")
"""Columns of trials that come from the sound of a voice."""

REASONS = (build.UNANSWERED, entries.ASKED_FOR, entries.PAUSED, landing.STOPPED, landing.TURNED_BACK)
"""Why a trial was done again, in palpate's own words; those of a protocol's rules are shared, too."""

NOT_SHARED = "not shared"
"""What stands for a reason that somebody may have typed."""

TRACE = re.compile(r"recording-(foot|force)\d*_physio\.(tsv\.gz|json)")
"""What palpate writes of a foot or a force; a laboratory's own recordings beside it are not shared."""

UNLICENSED = "because there is no stimuli/LICENSE file"
OF_PEOPLE = "because it contains labels and measurements of people in another study"

FACTS = ("Format", "Study", "Origin", "Label", "Tasks", "Ordered", "Versions")
"""What palpate says of a dataset and shares; adverse events and deviations are free text."""

INHERITED = ("InstitutionName", "InstitutionAddress", "InstitutionalDepartmentName", "CogAtlasID", "CogPOID")
"""Keys of an `events.json` at the top that hold for every session (BIDS 1.11, the inheritance principle)."""

ALIKE = "who are identical in first task, group, shared facts and protocol version"

OF_TRACES = ("SamplingFrequency", "StartTime", "Columns", "PhysioType", "TaskName", "Description", "Force")


@dataclass(frozen=True)
class Copy:
    """What was shared.

    `participants` are counted, and those who are `absent`, by why. Every participant has the first task, the group and
    the versions of the protocol of `smallest_group` of them, themselves included. `left_out` are things that were not
    shared, each with the reason. `anchor` is that of the dataset as it was shared.
    """

    root: Path
    participants: int
    absent: Mapping[str, int]
    smallest_group: int
    left_out: Mapping[str, str]
    anchor: str

    def facts(self) -> dict[str, object]:
        """Return it as the description of the copy has it."""
        return {
            "Participants": self.participants,
            "Absent": dict(self.absent),
            "SmallestGroup": self.smallest_group,
            "LeftOut": dict(self.left_out),
        }

    def sentences(self) -> Iterator[str]:
        """Yield it in words."""
        absent = ", ".join(f"{why} {count}" for why, count in self.absent.items())
        yield f"Participants: {self.participants}. Absent: {absent or 'nobody'}."
        yield f"Smallest group of participants {ALIKE}: {self.smallest_group}."
        yield from (f"Left out: {what}, {why}." for what, why in self.left_out.items())


def share(root: Path, out: Path) -> Copy:
    """Write a copy of a dataset for others into the new folder `out`, with who has agreed, and say what is in it.

    The roster has a line of who is shared before the copy is there. Raises `DatasetError` as `tables.check_tables`,
    without a roster, licence or permission in the protocol, for too small a group, and for an `out` that exists or lies
    in the dataset; `RosterError` if nobody agreed.
    """
    if out.resolve().is_relative_to(root.resolve()):
        raise DatasetError(out, "is inside the dataset", "choose another folder", allowed="one outside the dataset")
    if not checks.has_journals(root):
        raise DatasetError(
            root, "has no roster, so it has no record of consent to sharing", "ask the lab that measured it"
        )
    dataset = _with_tables(tables.check_tables(root))
    study = {path.name: content for path, content in build.study_files(root, dataset).items()}
    description = json.loads(study[shared.DESCRIPTION])
    _check_licence(root, description)
    rows, described = _rows(study["participants.tsv"]), json.loads(study["participants.json"])
    rows, described = _shared_facts(dataset, rows, described)
    chosen, absent = _chosen(dataset, [row["participant_id"].removeprefix("sub-") for row in rows])
    own = [row for row in rows if row["participant_id"].removeprefix("sub-") in chosen]
    smallest = _smallest(own, description["Palpate"].get("Versions", ()))
    _check_smallest(root, dataset, smallest)
    licensed = dataset.plan is not None or (root / "stimuli" / "LICENSE").is_file()
    left_out = {} if licensed else dict.fromkeys(_stimuli(root, dataset), UNLICENSED)
    left_out |= {name: OF_PEOPLE for version in _versions(dataset) for name in _of_people(version)}
    anchor = checks.keep_anchor(root)[0] if dataset.roster else checks.anchor(root)
    labels = _drawn(chosen)
    copy = Copy(out, len(labels), absent, smallest, left_out, anchor.line.rpartition(" ")[2])
    with new_dataset(out) as part:
        bids.write_files(
            {
                **_people(part, own, described, labels),
                **_description(part, description, labels, copy),
                **_inherited(root, part),
                **phenotype.shared(part, dataset, labels, build.ORIGINS[dataset.purpose]),
                **_protocols(part, dataset, licensed=licensed),
            }
        )
        _check_protocols(part, dataset)
        relabelled = [(labels[of.participant], path) for path, of in dataset.sessions if of.participant in labels]
        for label, path in sorted(relabelled):
            bids.write_files(_session(part, dataset, path, label))
        if licensed and (root / "stimuli").exists():
            shutil.copytree(root / "stimuli", part / "stimuli")
        accidents.keep_attributes(part, build.LABELS[dataset.purpose])
        listed = {"format": storage.DATASET_FORMAT, "files": shared.file_hashes(part)}
        storage.write_json(storage.shared_path(part), listed)
        _level_times(part)
        if dataset.roster is not None:
            _record(root, dataset.protocol, labels, copy.anchor)
    return copy


def _with_tables(dataset: Dataset) -> Dataset:
    """Return a dataset with the sessions alone that have ended once, of which there is something to share."""

    def has_ended(path: Path) -> bool:
        return path not in dataset.under_way or bool(tables.until_footer(journal.read(path)).lines)

    return replace(dataset, sessions=tuple(one for one in dataset.sessions if has_ended(one[0])))


def _level_times(part: Path) -> None:
    """Give all files one time of change: those of single sessions would tell of their order, or their day."""
    now_ns = wall_ns()
    for path in (*part.rglob("*"), part):
        os.utime(path, ns=(now_ns, now_ns))


def _shared_facts(
    dataset: Dataset, rows: Sequence[Mapping[str, str]], described: Mapping[str, Any]
) -> tuple[list[dict[str, str]], dict[str, Any]]:
    """Return rows of participants.tsv, and its sidecar, with no more of who somebody is than the protocol shares."""
    columns = (*OWN, *[groups.COLUMN] * any(dataset.groups.values()))
    kept = [{name: row[name] for name in columns} for row in rows]
    texts = {name: described[name] for name in columns}
    sharing = dataset.protocol.sharing
    if sharing is not None and sharing.facts:
        known = facts.columns((dataset.protocol,))
        for fact in (known[name] for name in sharing.facts):
            column = facts.shared_column(fact)
            texts[column] = facts.shared_text(fact)
            for own, row in zip(kept, rows, strict=True):
                own[column] = facts.shared_cell(fact, row[fact.id])
    return kept, texts


def _people(
    part: Path, rows: Sequence[Mapping[str, str]], described: Mapping[str, Any], labels: Mapping[str, str]
) -> bids.Files:
    """Return participants.tsv under the new labels, in their order, and its sidecar."""
    renamed = [{**row, "participant_id": f"sub-{labels[row['participant_id'].removeprefix('sub-')]}"} for row in rows]
    renamed.sort(key=lambda row: row["participant_id"])
    said = {"Description": "Participants who agreed to sharing.", **described}
    return {
        part / "participants.tsv": bids.table(tuple(described), renamed),
        part / "participants.json": storage.json_bytes(said),
    }


def _check_licence(root: Path, description: Mapping[str, Any]) -> None:
    """Refuse to share what nobody would be allowed to use."""
    if str(description.get("License", "n/a")).startswith("n/a"):
        path, allowed = root / shared.DESCRIPTION, "a license, such as CC-BY-4.0 or CC0-1.0"
        raise DatasetError(path, "has no license", "add one", field="License", allowed=allowed)


def _chosen(dataset: Dataset, listed: Sequence[str]) -> tuple[list[str], dict[str, int]]:
    """Return who is shared, and how many are not, by why. Raises `DatasetError` and `RosterError`."""
    if (roster := dataset.roster) is None:
        return list(listed), {}
    if dataset.protocol.sharing is None:
        words = "if your board allows sharing, add this table, seal the amended protocol, then run: {}"
        remedy = Remedy(words, ("palpate", "amend", "PROTOCOL"), suffices=False)
        raise DatasetError(dataset.root, "its protocol has no [sharing] table, so nothing may be shared", remedy)
    terms = sharing_sha256(dataset.protocol)
    reasons = {label: _absent(roster, terms, label, listed) for label in roster.consent_on}
    mixed = {one for (label, _), person in roster.took_part.items() if label != person for one in (label, person)}
    reasons |= {label: reasons[label] or "session under another label" for label in mixed}
    chosen = [label for label in listed if not reasons[label]]
    absent = dict(sorted(Counter(why for why in reasons.values() if why).items()))
    if not chosen:
        why = ", ".join(f"{reason}: {times}" for reason, times in absent.items())
        remedy = Remedy("ask again, then run {}", ("palpate", "consent", "PROTOCOL", "-p", "LABEL", "--sharing"))
        raise RosterError(roster.path, f"nobody who had a session agreed to these [sharing] terms ({why})", remedy)
    return chosen, absent


def _absent(roster: Roster, terms: str, label: str, listed: Sequence[str]) -> str:
    """Return why a participant is not shared; empty if they are."""
    if label in roster.withdrawn:
        return "withdrew"
    if label not in roster.sharing:
        return "not asked"
    if not roster.sharing[label]:
        return "declined"
    if roster.sharing[label] != terms:
        return "agreed to different [sharing] terms"
    return "" if label in listed else "no session"


def _smallest(rows: Sequence[Mapping[str, str]], versions: Sequence[Mapping[str, Any]]) -> int:
    """Return how many participants at least have the same first task, group, facts and versions."""
    began = Counter[tuple[str, ...]]()
    for row in rows:
        own = f"{row['participant_id']}_"
        under = [of["Protocol"] for of in versions if any(one.startswith(own) for one in of["Sessions"])]
        told = (cell for name, cell in row.items() if name not in OWN)
        began[row["first_task"], *told, *under] += 1
    return min(began.values())


def _check_smallest(root: Path, dataset: Dataset, smallest: int) -> None:
    """Refuse to share somebody whom too few others are like."""
    rule = dataset.protocol.sharing
    least = rule.smallest_group if rule else 1
    if smallest < least:
        allowed = f"{least} or more (sharing.smallest_group in the protocol)"
        what = f"has a smallest group of {smallest} participants {ALIKE}"
        raise DatasetError(root / "participants.tsv", what, "wait until more participants agree", allowed=allowed)


def _versions(dataset: Dataset) -> Sequence[Protocol]:
    return list(dataset.versions.values()) or [dataset.protocol]


def _stimuli(root: Path, dataset: Dataset) -> Iterator[str]:
    """Yield the folder of stimuli, if there is one, and the name of each that stands beside the protocol."""
    if (root / "stimuli").exists():
        yield "stimuli"
    yield from sorted({name for version in _versions(dataset) for name in version.companions})


def _of_people(version: Protocol) -> set[str]:
    """Return the names of what stands beside a protocol and is no recording or picture: tables of people."""
    return {name for name in version.companions if not name.lower().endswith((".wav", ".png"))}


def _drawn(labels: Sequence[str]) -> dict[str, str]:
    """Return a new label for each, drawn from the system's randomness, of which nothing is kept."""
    places = list(range(1, len(labels) + 1))
    secrets.SystemRandom().shuffle(places)
    width = max(2, len(str(len(labels))))
    return {label: f"{place:0{width}d}" for label, place in zip(labels, places, strict=True)}


def _session(part: Path, dataset: Dataset, path: Path, label: str) -> bids.Files:
    """Return table, sidecar and traces of one session under a new label."""
    contents = journal.read(path)
    if path in dataset.under_way:
        contents = tables.until_footer(contents)
    header, protocol = contents.header, dataset.version(contents.header)
    task, origin = protocol.task(header.task), build.ORIGINS[dataset.purpose]
    allowed = {None, *REASONS, *(f"{rule.id}: {rule.reason}" for rule in protocol.exclusion)}
    rows = build.event_rows(build.kind_of(task), path, contents, origin)
    for row in rows:
        reason = row["redo_reason"]
        if reason not in allowed and not allowed.issuperset(str(reason).split("; ")):
            row["redo_reason"] = NOT_SHARED
        for column in VOICE:
            row.pop(column, None)
    notes = build.touched(protocol, path, contents, shared=True)
    files = bids.events(part, label, replace(build.task_text(protocol, task, origin), notes=notes), rows)
    for sidecar in (file for file in files if file.suffix == ".json"):
        described = {"Description": "Trials of one session.", **json.loads(files[sidecar])}
        files[sidecar] = storage.json_bytes(described)
    before = bids.beh_path(dataset.root, header.participant, header.task, "")
    for trace in sorted(before.parent.glob(f"{before.name}recording-fo*")):
        if not TRACE.fullmatch(trace.name.removeprefix(before.name)):
            continue
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


def _protocols(part: Path, dataset: Dataset, *, licensed: bool) -> bids.Files:
    """Return each version of the protocol, without its comments, its seal, and what may be shared beside it."""
    written: bids.Files = {}
    for number, version in _numbered(dataset).items():
        path = storage.protocol_path(part, number)
        stated = _stated(json.loads(approval.canonical(version)))
        ethics = stated["ethics"]
        ethics.update({key: date.fromisoformat(ethics[key]) for key in ("approved_on", "expires_on") if key in ethics})
        written[path] = tomlkit.dumps(stated).encode()
        for name in sorted({*version.companions} - _of_people(version)) if licensed else ():
            written[path.with_name(name)] = files.companion(version, name)
        seal = approval.seal_path(storage.protocol_path(dataset.root, number))
        if seal.exists():
            written[approval.seal_path(path)] = storage.read_bytes(seal)
    return written


def _numbered(dataset: Dataset) -> dict[int, Protocol]:
    """Return the version of the protocol that each approval began."""
    by_hash = {approval.sha256(one): one for one in _versions(dataset)}
    known = dataset.approvals.approved if dataset.approvals else ()
    return {one.number: by_hash[one.protocol_sha256] for one in known} or {1: next(iter(by_hash.values()))}


def _check_protocols(part: Path, dataset: Dataset) -> None:
    """Refuse a copy whose protocols are not read as those of the dataset. Raises `DatasetError`."""
    for number, version in _numbered(dataset).items():
        path = storage.protocol_path(part, number)
        if approval.sha256(files.load(path)) != approval.sha256(version):
            raise DatasetError(path, "is not the protocol of the dataset", "report this as a bug in palpate")


def _stated(value: Any) -> Any:
    """Return a document without keys that are null, which TOML has not."""
    if isinstance(value, dict):
        return {key: _stated(inner) for key, inner in value.items() if inner is not None}
    return [_stated(inner) for inner in value] if isinstance(value, list) else value


def _description(part: Path, source: Mapping[str, Any], labels: Mapping[str, str], copy: Copy) -> bids.Files:
    """Return the description of a copy, as the derivative that it is, and its README."""
    facts = {key: value for key, value in source["Palpate"].items() if key in FACTS} | {"Shared": copy.facts()}
    if "Versions" in facts:
        facts["Versions"] = [
            {"Protocol": one["Protocol"], "Sessions": _renamed(one["Sessions"], labels)} for one in facts["Versions"]
        ]
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
        "This is a copy of a dataset for other researchers, with the participants who agreed to sharing. Labels are "
        "new and random, and times start at zero in each session. The lab did not share journals, voice recordings, "
        f"session dates, notes or free text. Reasons that may have been typed are replaced by '{NOT_SHARED}'.",
        *copy.sentences(),
        "palpate verify detects changed files. palpate analyse produces the tables and the report.",
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
