"""A description of every format that palpate writes, for tests/reference/formats: `python -m tests.formats`.

A file there is named by format and number, such as `journal-6.json`. A format that changes needs another number, and so
another file. Under a number that was not released the file changes, and it is said how; under one that was, a new kind
of trial, way to answer or sensor may add its columns to those of datasets, and all else is refused.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, get_args

from pydantic import TypeAdapter

from palpate.analysis import documents, export
from palpate.analysis.analyse import analyse
from palpate.analysis.documents import page
from palpate.experiment import storage
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.dataset import bids, tables
from palpate.experiment.dataset.checks import Plan
from palpate.experiment.protocol import approval, designs, kinds
from palpate.experiment.protocol.designs import plannable_tests
from palpate.experiment.protocol.files import ProtocolFile
from palpate.experiment.recordings.manifest import Manifest
from palpate.experiment.records import entries, events, journal
from palpate.experiment.settings.load import Confined
from palpate.experiment.settings.schema import DIALECT
from palpate.experiment.study import enrolment, roster
from tests import releases

FOLDER = Path(__file__).parent / "reference" / "formats"

PROSE = ("title", "description")
"""What a JSON schema says for readers alone."""

Description = dict[str, Any]


def descriptions() -> dict[str, Description]:
    """Return what describes each format today, by its name and number."""
    return {
        _named("protocol", ProtocolFile): {**schema(ProtocolFile), "tests": sorted(plannable_tests())},
        _named("rig", Rig): schema(Rig),
        _named("manifest", Manifest): schema(Manifest),
        f"seal-{approval.FORMAT}": schema(approval.Seal),
        f"roster-{roster.FORMAT}": _plain(TypeAdapter(roster.AnyEntry).json_schema()),
        f"journal-{entries.FORMAT}": _plain(journal.reader(*kinds.NAMES).json_schema()),
        f"dataset-{storage.DATASET_FORMAT}": _dataset(),
        f"results-{page.FORMAT}": _results(),
    }


def _named(name: str, model: type[Confined]) -> str:
    """Return a format's name with the newest number that its files may have."""
    return f"{name}-{max(get_args(model.model_fields['format'].annotation))}"


def schema(model: type[Any]) -> Description:
    """Return the JSON schema of a model without its prose."""
    described: Description = _plain(model.model_json_schema())
    return described


def _plain(schema: Any) -> Any:
    """Return a JSON schema without its prose; a property may have the name of a word for prose."""
    if isinstance(schema, dict):
        prose = {key for key in PROSE if isinstance(schema.get(key), str)}
        return {key: _plain(value) for key, value in schema.items() if key not in prose}
    return [_plain(one) for one in schema] if isinstance(schema, list) else schema


def _dataset() -> Description:
    names = (*kinds.NAMES, *bids.FURTHER, "imported", "participants")
    # Pairs are described as they were before their kind was called tapping: their columns are the same.
    tables_of = {"comparison" if name == "tapping" else name: name for name in names}
    with tempfile.TemporaryDirectory() as folder:
        root = sample("comparison", Path(folder))
        files = {path.relative_to(root).as_posix(): path for path in sorted(root.rglob("*.json"))}
        keys = {name: sorted(json.loads(path.read_text("utf-8"))) for name, path in files.items()}
        palpate = sorted(json.loads(files["dataset_description.json"].read_text("utf-8"))["Palpate"])
    return {
        "columns": {name: list(events.columns_of(kind)) for name, kind in tables_of.items()},
        "keys": {**keys, "Palpate": palpate},
        "read": {end: list(read) for end, read in tables.READ.items()},
        "plan.json": schema(Plan),
        "seed.json": schema(enrolment.Settled),
    }


def sample(design: str, folder: Path) -> Path:
    """Return a small dataset of a design, for which this folder may be written into."""
    written: Path = import_module(f"tests.analysis.designs.{design}.sample").sample(folder)
    return written


def _results() -> Description:
    """Describe the results of a study of each design, and the tables for other programs."""
    with tempfile.TemporaryDirectory() as folder:
        found: Description = {}
        for design in designs.NAMES:
            place = Path(folder) / design
            out = place / "out"
            analyse([sample(design, place)], out, figures=False)
            tables = {path.name: path.read_text("utf-8").splitlines() for path in sorted(out.glob("tables/*.csv"))}
            headings = {
                name: next(line for line in lines if not line.startswith("#")) for name, lines in tables.items()
            }
            found[design] = {
                "results.json": _shape(json.loads((out / "results.json").read_text("utf-8"))),
                "tables": headings,
            }
    exported = {
        design: {name: list(table) for name, table in export.columns_of(design).items()} for design in designs.NAMES
    }
    return {**found, "export": exported}


def _shape(value: object) -> object:
    """Return the keys of JSON objects and the types of what they hold; a list has the shapes of all of its elements."""
    if isinstance(value, Mapping):
        return {key: _shape(inner) for key, inner in value.items()}
    if isinstance(value, list):
        shapes = [_shape(inner) for inner in value]
        return [shape for place, shape in enumerate(shapes) if shape not in shapes[:place]]
    return {float: "number", int: "number", str: "text", bool: "flag"}.get(type(value), "nothing")


RESULTS = Path(documents.__file__).with_name("results.schema.json")
"""What `palpate schema results` writes: made of the description of the newest results."""

BY_DATA = {"by_participant", "known", "magnitudes", "materials", "partial_eta_squared", "statements"}
"""Objects of `results.json` whose keys are labels, names and texts of a study."""


def results_schema(described: Description) -> Description:
    """Return the JSON Schema of `results.json`: the form of each design; None is wherever nothing is defined."""
    forms = [
        {**_form(parts["results.json"]), "type": "object", "title": f"results of the design {design}"}
        for design, parts in described.items()
        if design != "export"
    ]
    title = f"results.json of palpate analyse, format {page.FORMAT}"
    return {"$schema": DIALECT, "$comment": "made by palpate", "title": title, "type": "object", "anyOf": forms}


def _form(*shapes: object, key: str = "") -> Description:
    """Return the schema of everything that has one of these shapes."""
    plain = {"number": "number", "text": "string", "flag": "boolean"}
    known = [shape for shape in shapes if shape != "nothing"]
    lists = [one for one in known if isinstance(one, list)]
    parts: list[Description] = [one for one in known if isinstance(one, dict)]
    if lists and len(lists) == len(known):
        return {"type": ["array", "null"], "items": _form(*(inner for one in lists for inner in one))}
    if parts and len(parts) == len(known):
        names = list(dict.fromkeys(name for one in parts for name in one))
        if key in BY_DATA:
            values = _form(*(inner for one in parts for inner in one.values()))
            return {"type": ["object", "null"], "additionalProperties": values}
        properties = {name: _form(*(one[name] for one in parts if name in one), key=name) for name in names}
        required = sorted(name for name in names if all(name in one for one in parts))
        return {"type": ["object", "null"], "required": required, "properties": properties}
    leaves = sorted({plain[one] for one in known if isinstance(one, str)})
    return {} if lists or parts or not leaves else {"type": [*leaves, "null"]}


def text(description: Description) -> str:
    """Return a description as its file has it."""
    return json.dumps(description, indent=1, sort_keys=True, ensure_ascii=False) + "\n"


def changes(before: object, after: object, path: str) -> Iterator[str]:
    """Yield each place at which two descriptions differ, after + where it is new, - where it is gone, else ~."""
    if isinstance(before, dict) and isinstance(after, dict):
        for key in sorted(before.keys() | after.keys()):
            yield from changes(before.get(key), after.get(key), f"{path}.{key}")
    elif before != after:
        yield f"{'+' if before is None else '-' if after is None else '~'} {path}"


def write(today: Mapping[str, Description], folder: Path) -> tuple[list[str], list[str]]:
    """Write the descriptions that changed into a folder; return how they did, and the names of those that may not."""
    told, refused = [], []
    for name, description in today.items():
        file = folder / f"{name}.json"
        before = json.loads(file.read_text("utf-8")) if file.exists() else None
        changed = list(changes(before, json.loads(text(description)), name))
        if name in releases.formats() and not all(one.startswith(f"+ {name}.columns.") for one in changed):
            refused.append(name)
        elif changed:
            file.write_text(text(description), "utf-8")
        told += changed
    return told, refused


if __name__ == "__main__":
    today = descriptions()
    told, refused = write(today, FOLDER)
    written = (FOLDER / f"results-{page.FORMAT}.json").read_text("utf-8")
    RESULTS.write_text(text(results_schema(json.loads(written))), "utf-8")
    print("\n".join(told) or "No format changed.")
    if refused:
        sys.exit(f"Not written, for a release wrote them: {', '.join(refused)}. Give each its next number.")
