"""The tables of questionnaires, `phenotype/ID.tsv` (BIDS 1.11): a row for each participant with an answer to one.

`build` looks this up for a protocol that asks something. An answer is in a table once its session has ended or paused.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.dataset import bids
from palpate.experiment.dataset.checks import Dataset
from palpate.experiment.protocol.asked import TOUCH, Asked, Questionnaire
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Footer, Questioned
from palpate.experiment.records.journal import Contents


def files(root: Path, dataset: Dataset, origin: bids.Origin) -> bids.Files:
    """Return table and sidecar of each questionnaire with an answer, or with a table whose answers were erased."""
    answers = _answers(dataset)
    written: bids.Files = {}
    for one in _questionnaires(dataset).values():
        rows = answers.get(one.id, {})
        if rows or (root / "phenotype" / f"{one.id}.tsv").exists():
            written |= _table(root, one, rows, origin)
    return written


def shared(part: Path, dataset: Dataset, labels: Mapping[str, str], origin: bids.Origin) -> bids.Files:
    """Return the tables of the questionnaires that the protocol shares, under new `labels` and without texts.

    They have the items of the latest version, and no answer that is none to its item today.
    """
    sharing, asked = dataset.protocol.sharing, dataset.protocol.find(Asked)
    known = {one.id: one for one in asked.questionnaires} if asked is not None else {}
    answers = _answers(dataset)
    written: bids.Files = {}
    for one in (known[name] for name in (sharing.questionnaires if sharing is not None else ()) if name in known):
        kept = one.model_copy(update={"items": tuple(item for item in one.items if item.answer != "text")})
        rows = {
            labels[who]: {item.id: row[item.id] for item in kept.items if item.has(str(row.get(item.id)))}
            for who, row in answers.get(one.id, {}).items()
            if who in labels
        }
        written |= _table(part, kept, rows, origin) if rows and kept.items else {}
    return written


def touched(protocol: Protocol, contents: Contents, *, shared: bool = False) -> dict[str, object]:
    """Return the key of a session's sidecar with what the skin touched: each item, and what was answered, if anything.

    A `shared` copy has no texts, and nothing where the protocol does not share it.
    """
    asked, sharing = protocol.table(Asked), protocol.sharing
    if not asked.touch or (shared and (sharing is None or TOUCH not in sharing.questionnaires)):
        return {}
    given = {
        one.item: one.answer for one in contents.entries if isinstance(one, Questioned) if one.questionnaire == TOUCH
    }
    items = [item for item in asked.touch if not (shared and item.answer == "text")]
    return {"Touch": {one.id: {**one.column(), "Value": given.get(one.id)} for one in items}}


def _questionnaires(dataset: Dataset) -> dict[str, Questionnaire]:
    """Return the questionnaires of every version, each with the items of all; words are those of the latest."""
    known: dict[str, Questionnaire] = {}
    for version in (*dataset.versions.values(), dataset.protocol):
        asked = version.find(Asked)
        for one in asked.questionnaires if asked is not None else ():
            before = known[one.id].items if one.id in known else ()
            items = {item.id: item for item in (*before, *one.items)}
            known[one.id] = one.model_copy(update={"items": tuple(items.values())})
    return known


Rows = dict[str, dict[str, str | int | float | None]]
"""Participant -> item -> answer."""


def _answers(dataset: Dataset) -> dict[str, Rows]:
    """Return the answers to each questionnaire."""
    found: dict[str, Rows] = {}
    for path, header in dataset.sessions:
        for entry in _until_footer(path):
            found.setdefault(entry.questionnaire, {}).setdefault(header.participant, {})[entry.item] = entry.answer
    return found


def _until_footer(path: Path) -> Iterator[Questioned]:
    since: list[Questioned] = []
    for entry in journal.read(path).entries:
        if isinstance(entry, Questioned):
            since.append(entry)
        elif isinstance(entry, Footer):
            yield from since
            since = []


def _table(root: Path, questionnaire: Questionnaire, rows: Rows, origin: bids.Origin) -> bids.Files:
    path = root / "phenotype" / f"{questionnaire.id}.tsv"
    items = {item.id: item.column() for item in questionnaire.items}
    named = [
        {"participant_id": f"sub-{who}", **{name: row.get(name) for name in items}} for who, row in sorted(rows.items())
    ]
    when = f"{questionnaire.title}, asked {questionnaire.when} task {questionnaire.task}."
    described = {"Description": bids.labelled(when, origin)}
    sidecar = {
        **described,
        "MeasurementToolMetadata": described,
        "participant_id": {"Description": "Label of the participant, as in participants.tsv."},
        **items,
    }
    content = bids.table(("participant_id", *items), named)
    return {path: content, path.with_suffix(".json"): storage.json_bytes(sidecar)}
