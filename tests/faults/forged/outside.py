"""Forgeries of what stands outside of a dataset, and of its own log of anchors; and questions that verify refuses."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

from palpate.experiment.dataset import build, checks, register
from palpate.experiment.dataset.register import Kept
from tests.experiment.dataset.studies import make_study
from tests.faults.forged.case import (
    Act,
    At,
    Case,
    Forgery,
    append_bytes,
    ask_register,
    copy_file,
    delete,
    first_journal,
    forge_line,
    in_turn,
    inside,
    last_lines_cut,
    log,
    make_folder,
    people,
    random_journal,
    replace_text,
    roster,
    write,
)
from tests.faults.forged.studies import read_lines, write_chain

ANCHORED = ("visits", "anchored", "people", "pairs")


def _register(case: Case) -> Path:
    return case.outside("register")


def _ask(name: str) -> Act:
    """Ask with this register."""
    return lambda case: case.registers.append(case.outside(name))


def _ask_inside(case: Case) -> None:
    """Ask with a copy of the register that stands in the dataset, by a path that does not say so at once."""
    copy_file(_register, inside("sourcedata", "register"))(case)
    case.registers.append(case.root / "sourcedata" / "sub-01" / ".." / "register")


def _ask_number(change: Callable[[str], str] = str) -> Act:
    """Ask with a line of the lab book, changed."""

    def act(case: Case) -> None:
        lines = case.outside("book").read_text("utf-8").splitlines()
        case.numbers.append(change(case.choose("number", lines)))

    return act


def _mistyped(digits: int) -> Callable[[str], str]:
    """Each of the first so many digits becomes the next one."""

    def change(line: str) -> str:
        number = line.split()[-1].replace("-", "")
        return "".join(f"{(int(one, 16) + 1) % 16:x}" for one in number[:digits]) + number[digits:]

    return change


def _answers_anew(case: Case) -> None:
    """The first two answers of a journal change places; its chain, head and tables are made anew."""
    path = random_journal(case)
    lines = read_lines(path)
    first, second = [entry for _, entry in lines if entry["kind"] == "answer"][:2]
    first["answered"], second["answered"] = second["answered"], first["answered"]
    write_chain(path, lines)
    build.build(case.root)


def _cut_every_file(case: Case) -> None:
    for path in (roster(case), *case.journals()):
        write_chain(path, read_lines(path)[:-1])


def _delete_participant(case: Case) -> None:
    """The first participant's sessions are deleted, with all that knows of them in the dataset."""
    folder = first_journal(case).parent
    for path in (folder, case.root / folder.name):
        shutil.rmtree(path)
    for file in (log(case), people(case)):
        file.unlink()
    build.build(case.root)


def _ask_register_of(**how: Any) -> Act:
    """Ask with a register that has the anchor of another dataset."""

    def act(case: Case) -> None:
        other = make_study(case.outside("other"), sessions=1, **how)
        register.enter(checks.anchor(other.root), other.root, case.outside("elsewhere"), None)
        case.registers.append(case.outside("elsewhere"))

    return act


Anchors = list[dict[str, Any]]
"""The anchors of a register, with their signatures."""


def _change_anchors(at: At, change: Callable[[Anchors], Anchors]) -> Act:
    def act(case: Case) -> None:
        path = at(case)
        kept = change([json.loads(line) for line in path.read_text("utf-8").splitlines()])
        path.write_text("".join(json.dumps(one, separators=(",", ":")) + "\n" for one in kept), "utf-8")

    return act


def _other_file(kept: Anchors) -> Anchors:
    kept[-1]["anchor"]["prefixes"][-1]["file"] = "sourcedata/sub-09/sub-09_task-live_journal.jsonl"
    return kept


def _no_prefixes(kept: Anchors) -> Anchors:
    kept[-1]["anchor"]["prefixes"] = []
    return kept[-1:]


def _other_first_line(kept: Anchors) -> Anchors:
    kept[-1]["anchor"]["prefixes"][0] |= {"lines": 1, "sha256": "0" * 64}
    return kept


def _two_days(kept: Anchors) -> Anchors:
    """The last anchor twice: of one day, and of a later one with the first file alone."""
    first, second = (json.loads(json.dumps(kept[-1])) for _ in range(2))
    first["anchor"]["anchored_utc"] = "2001-10-01T00:00:00+00:00"
    second["anchor"]["anchored_utc"] = "2001-10-03T00:00:00+00:00"
    second["anchor"]["prefixes"] = second["anchor"]["prefixes"][:1]
    return [first, second]


def _sign(*then: Act, key: str = "key.pub") -> Act:
    """Sign an anchor in a new register; then something happens, and one asks with a key."""

    def act(case: Case) -> None:
        for name in ("key", "other"):
            made = ("ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", "lab", "-f", str(case.outside(name)))
            subprocess.run(made, check=True)
        _register(case).unlink()
        register.enter(checks.anchor(case.root), case.root, _register(case), case.outside("key"))
        in_turn(*then, ask_register)(case)
        case.signer = case.outside(key)

    return act


def _add_unsigned(case: Case) -> None:
    register.append(_register(case), Kept(anchor=checks.anchor(case.root)))


def _ask_signer_alone(case: Case) -> None:
    case.signer = case.outside("key.pub")


TORN = b'{"anchor":{"anchored_utc":'

FORGERIES = (
    Forgery("nothing, with a register", ANCHORED, ask_register),
    Forgery(
        "nothing, with two registers",
        ANCHORED,
        in_turn(copy_file(_register, lambda case: case.outside("again")), _ask("again"), ask_register),
    ),
    Forgery(
        "nothing, with anchors of two days", ANCHORED, in_turn(_change_anchors(_register, _two_days), ask_register)
    ),
    Forgery("nothing, with a line of the lab book", ANCHORED, _ask_number()),
    Forgery("a number with a digit mistyped", ANCHORED, _ask_number(_mistyped(1))),
    Forgery("a number with three digits mistyped", ANCHORED, _ask_number(_mistyped(3))),
    Forgery("a number of two digits", ANCHORED, _ask_number(lambda _: "17")),
    Forgery("a number that the log lacks", ANCHORED, in_turn(delete(log), _ask_number())),
    Forgery("a journal's line anew, with a register", ANCHORED, in_turn(forge_line(random_journal), ask_register)),
    Forgery("a roster's line anew, with a register", ANCHORED, in_turn(forge_line(roster), ask_register)),
    Forgery(
        "answers and their table anew, no log, with a register",
        ANCHORED,
        in_turn(delete(log), _answers_anew, ask_register),
    ),
    Forgery(
        "a journal's last lines cut off, with a register",
        ANCHORED,
        in_turn(last_lines_cut(random_journal), ask_register),
    ),
    Forgery("every file a line shorter, with a register", ANCHORED, in_turn(_cut_every_file, ask_register)),
    Forgery(
        "a participant deleted, with a register", ("anchored", "visits"), in_turn(_delete_participant, ask_register)
    ),
    Forgery("no sourcedata, with a register", ANCHORED, in_turn(delete(inside("sourcedata")), ask_register)),
    Forgery("a register of another dataset of the study", ("anchored", "visits"), _ask_register_of(seed=2)),
    Forgery("a register of another study", ANCHORED, _ask_register_of(study="another")),
    Forgery("a register inside of the dataset", ANCHORED, _ask_inside),
    Forgery("a register that is not there", ANCHORED, _ask("absent")),
    Forgery("a protocol as a register", ANCHORED, _ask("study.toml")),
    Forgery(
        "a register with a line that is no anchor",
        ANCHORED,
        in_turn(append_bytes(_register, TORN + b"\n"), ask_register),
    ),
    Forgery(
        "a register without an anchor that can be read", ANCHORED, in_turn(write(_register, TORN + b"\n"), ask_register)
    ),
    Forgery(
        "a register with a file that is not there",
        ANCHORED,
        in_turn(_change_anchors(_register, _other_file), ask_register),
    ),
    Forgery(
        "a register with another first line",
        ANCHORED,
        in_turn(_change_anchors(_register, _other_first_line), ask_register),
    ),
    Forgery(
        "a register with an anchor of no file",
        ANCHORED,
        in_turn(_change_anchors(_register, _no_prefixes), ask_register),
    ),
    Forgery("a log without an anchor that can be read", ANCHORED, write(log, "{}\n")),
    Forgery("a log with a line that is no anchor", ANCHORED, append_bytes(log, b"{}\n")),
    Forgery("a log of another study", ("anchored",), replace_text(log, '"okamoto2012"', '"other"')),
    Forgery("a folder in the place of the log", ANCHORED, make_folder(log)),
    Forgery("no log", ANCHORED, delete(log)),
    Forgery("a signed register", ("anchored", "pairs"), _sign()),
    Forgery("a register with an unsigned anchor", ("anchored", "pairs"), _sign(_add_unsigned)),
    Forgery("a signed register that was changed", ("anchored", "pairs"), _sign(_change_anchors(_register, _two_days))),
    Forgery("a register that another key signed", ("anchored", "pairs"), _sign(key="other.pub")),
    Forgery("a private key to check with", ("anchored", "pairs"), _sign(key="key")),
    Forgery("no key to check with", ("anchored", "pairs"), _sign(key="absent")),
    Forgery("a key without a register", ANCHORED, _ask_signer_alone),
    Forgery("no dataset", ANCHORED, delete(inside("."))),
)
