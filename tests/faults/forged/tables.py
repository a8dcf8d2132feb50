"""Forged tables: what analysis reads of a dataset, and what it does not read."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from palpate.experiment import storage
from tests.faults.forged.case import (
    Act,
    At,
    Case,
    Forgery,
    append_bytes,
    delete,
    description,
    events,
    events_table,
    in_turn,
    inside,
    make_folder,
    people,
    replace_text,
    set_key,
    sidecar,
    write,
)
from tests.faults.forged.studies import read_lines, write_chain

TABLED = ("study", "pairs", "visits", "people", "rehearsed pairs", "practice", "rehearsal")
FOOTSTEPS = ("study", "visits", "people", "rehearsal")
REHEARSED = ("rehearsal", "rehearsed pairs")


def _random_events(case: Case) -> Path:
    """The table of any journal that has one."""
    tables = [events_table(case, journal) for journal in case.journals()]
    return case.choose("table", [table for table in tables if table.exists()])


def _open_events(case: Case) -> Path:
    """The table of a session that goes on after a pause."""
    return events_table(case, case.journals()[4])


def _take_answer(at: At) -> Act:
    """Take the answer from a row of a table."""

    def act(case: Case) -> None:
        path = at(case)
        header, *rows = path.read_text("utf-8").splitlines()
        place = case.choose("row", range(len(rows)))
        cells = rows[place].split("\t")
        cells[header.split("\t").index("answered")] = "(none)"
        rows[place] = "\t".join(cells)
        path.write_text("\n".join([header, *rows, ""]), "utf-8")

    return act


READ: dict[str, object] = {
    "TaskTitle": "Another",
    "Instructions": "Another",
    "Kind": "another",
    "Design": "another",
    "Materials": [],
    "Answers": ["first"],
    "Rows": 1,
    "SessionId": "0" * 32,
}
"""Keys of a sidecar that analysis reads, with a value that none has."""


def _other_key(case: Case) -> None:
    key = case.choose("key", list(READ))
    set_key(sidecar, key, READ[key])(case)


def _change_row(change: Callable[[list[str]], list[str]]) -> Act:
    """Change the cells of the first row of the table of participants."""

    def act(case: Case) -> None:
        header, first, *rows = people(case).read_text("utf-8").splitlines()
        people(case).write_text("\n".join([header, "\t".join(change(first.split("\t"))), *rows, ""]), "utf-8")

    return act


def _add_row(participant: str) -> Act:
    """Add a participant to the table of participants, with the cells of the first one."""

    def act(case: Case) -> None:
        rows = people(case).read_text("utf-8").splitlines()
        people(case).write_text("\n".join([*rows, rows[1].replace("sub-01", participant), ""]), "utf-8")

    return act


def _trace(end: str) -> At:
    """Return what gives the trace of the foot of the first journal."""
    return lambda case: Path(str(events(case)).replace("_events.tsv", f"_recording-foot_physio.{end}"))


def _interrupt(case: Case) -> None:
    """The last session of a rehearsal lacks its end and its tables, as a kill leaves it."""
    path = case.journals()[-1]
    write_chain(path, read_lines(path)[:-4])
    for table in events_table(case, path).parent.glob(path.name.replace("_journal.jsonl", "_*")):
        table.unlink()


def _say_origin(origin: str) -> Act:
    """The description says that the tables are of another origin."""

    def act(case: Case) -> None:
        facts: Any = json.loads(description(case).read_bytes())
        storage.write_json(description(case), {**facts, "Palpate": {**facts["Palpate"], "Origin": origin}})

    return act


FORGERIES = (
    Forgery("another answer in a table", TABLED, _take_answer(_random_events)),
    Forgery("another answer in the table of an open session", ("visits",), _take_answer(_open_events)),
    Forgery("a table from a spreadsheet", TABLED, replace_text(_random_events, "\n", "\r\n", most=-1)),
    Forgery("a folder in the place of a table", TABLED, make_folder(_random_events)),
    Forgery("another key of a sidecar", TABLED, _other_key),
    Forgery("a sidecar without content", TABLED, write(sidecar)),
    Forgery("a sidecar that is no object", TABLED, write(sidecar, "[]")),
    Forgery("a sidecar with a number that is none", TABLED, write(sidecar, '{"Rows": NaN}')),
    Forgery("a sidecar with arrays in arrays", TABLED, write(sidecar, "[" * 40 + "]" * 40)),
    Forgery("a text of a sidecar that nothing reads", TABLED, set_key(sidecar, "TaskDescription", "Another")),
    Forgery("another name of the dataset", TABLED, set_key(description, "Name", "Another")),
    Forgery("no README", TABLED, delete(inside("README"))),
    Forgery("no table of participants", TABLED, delete(people)),
    Forgery("another first task", TABLED, _change_row(lambda cells: [cells[0], "none", *cells[2:]])),
    Forgery("a withdrawn participant's row as before", ("people",), replace_text(people, "\t1\t", "\t0\t")),
    Forgery("an erased participant's row", ("people",), _add_row("sub-05")),
    Forgery("a table of nobody", TABLED, write(inside("sub-77", "beh", "sub-77_task-real_events.tsv"))),
    Forgery("no trace of the foot", FOOTSTEPS, delete(_trace("tsv.gz"))),
    Forgery("another trace of the foot", FOOTSTEPS, append_bytes(_trace("tsv.gz"), b"x")),
    Forgery("a rehearsal that was interrupted", REHEARSED, _interrupt),
    Forgery("no table of a rehearsal", REHEARSED, delete(_random_events)),
    Forgery(
        "no table of an analysed rehearsal",
        REHEARSED,
        in_turn(delete(_random_events), write(inside("derivatives", "a"))),
    ),
    Forgery("tables alone that say PARTICIPANT", ("printed", "imported"), _say_origin("PARTICIPANT")),
    Forgery("tables alone that say nothing", ("printed", "imported"), write(description)),
)
