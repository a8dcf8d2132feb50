"""A copy of a clean dataset, the files inside of it, and the changes that several forgeries make to them."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import TypeVar

from palpate.experiment import storage
from palpate.experiment.dataset.register import LOG
from palpate.experiment.protocol import approval
from tests.experiment.dataset.studies import MadeStudy
from tests.faults.anchors import forge
from tests.faults.forged.studies import read_lines, write_chain

T = TypeVar("T")


@dataclass
class Case:
    """A copy of a clean study, with all that stands in its folder, and what `verify` is asked about it.

    `rng` chooses places. They are counted within the structure of the dataset, such as line 3 of 17, and so stay the
    same when orders of trials, hashes and times change.
    """

    study: MadeStudy
    rng: Random
    places: list[str] = field(default_factory=list)
    registers: list[Path] = field(default_factory=list)
    numbers: list[str] = field(default_factory=list)
    signer: Path | None = None

    @property
    def root(self) -> Path:
        """The dataset."""
        return self.study.root

    def outside(self, name: str) -> Path:
        """Return a path beside the dataset."""
        return self.study.file.with_name(name)

    def choose(self, what: str, among: Sequence[T]) -> T:
        """Return one of several at random, and record which one."""
        number = self.rng.randrange(len(among))
        self.places.append(f"{what} {number + 1} of {len(among)}")
        return among[number]

    def journals(self) -> list[Path]:
        """Return the journals, by participant and then in the order of the tasks, which is drawn."""
        return sorted(storage.journals(self.root), key=lambda path: (path.parent, _position(path)))


def _position(path: Path) -> int:
    position: int = json.loads(path.read_bytes().split(b"\n")[0])["entry"]["task_position"]
    return position


Act = Callable[[Case], None]
At = Callable[[Case], Path]
"""Gives a path of a case."""


@dataclass(frozen=True)
class Forgery:
    """What is forged, and the clean datasets of which it can be one; the seed chooses among them."""

    name: str
    bases: tuple[str, ...]
    act: Act


def protocol(case: Case) -> Path:
    return storage.protocol_path(case.root)


def seal(case: Case) -> Path:
    return approval.seal_path(protocol(case))


def roster(case: Case) -> Path:
    return storage.roster_path(case.root)


def plan(case: Case) -> Path:
    return storage.plan_path(case.root)


def log(case: Case) -> Path:
    return case.root / LOG


def random_journal(case: Case) -> Path:
    return case.choose("journal", case.journals())


def first_journal(case: Case) -> Path:
    return case.journals()[0]


def rig(case: Case) -> Path:
    """The rig of the first journal."""
    return storage.rig_path(first_journal(case))


def events(case: Case) -> Path:
    """The table of the first journal."""
    return events_table(case, first_journal(case))


def events_table(case: Case, journal: Path) -> Path:
    """Return the table of a journal, which need not be there."""
    return case.root / journal.parent.name / "beh" / journal.name.replace("_journal.jsonl", "_events.tsv")


def sidecar(case: Case) -> Path:
    return events(case).with_suffix(".json")


def people(case: Case) -> Path:
    return case.root / "participants.tsv"


def description(case: Case) -> Path:
    return case.root / "dataset_description.json"


def inside(*parts: str) -> At:
    """Return what gives this path of the dataset."""
    return lambda case: case.root.joinpath(*parts)


def in_turn(*acts: Act) -> Act:
    """Do one after the other."""

    def act(case: Case) -> None:
        for one in acts:
            one(case)

    return act


def delete(at: At) -> Act:
    """Delete a file or a folder."""
    return lambda case: storage.remove(at(case))


def make_folder(at: At) -> Act:
    """Put a folder in the place of a file."""

    def act(case: Case) -> None:
        path = at(case)
        path.unlink()
        path.mkdir()

    return act


def replace_text(at: At, old: str, new: str, most: int = 1) -> Act:
    """Replace a text that stands in a file."""

    def act(case: Case) -> None:
        path = at(case)
        text = path.read_text("utf-8")
        assert old in text, (path, old)
        path.write_text(text.replace(old, new, most), "utf-8")

    return act


def write(at: At, content: str | bytes = "") -> Act:
    """Write a file, in the place of what it holds."""

    def act(case: Case) -> None:
        path = at(case)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content.encode() if isinstance(content, str) else content)

    return act


def append_bytes(at: At, content: bytes) -> Act:
    """Add bytes to the end of a file."""

    def act(case: Case) -> None:
        with at(case).open("ab") as file:
            file.write(content)

    return act


def set_key(at: At, key: str, value: object) -> Act:
    """Give a key of a JSON object another value."""

    def act(case: Case) -> None:
        path = at(case)
        storage.write_json(path, {**json.loads(path.read_bytes()), key: value})

    return act


def copy_file(at: At, to: At) -> Act:
    """Copy a file."""

    def act(case: Case) -> None:
        shutil.copy(at(case), to(case))

    return act


def last_lines_cut(at: At) -> Act:
    """Cut one to three lines off the end of a journal or a roster, and make its head anew."""

    def act(case: Case) -> None:
        path = at(case)
        write_chain(path, read_lines(path)[: -case.choose("lines less:", range(1, 4))])

    return act


def forge_line(at: At) -> Act:
    """Change a line's time, and make anew what knows its hash: chains, heads and headers, and no anchor."""

    def act(case: Case) -> None:
        path = at(case)
        forge(case.root, path, case.choose("line", range(1, len(read_lines(path)) + 1)))

    return act


def ask_register(case: Case) -> None:
    """Ask with the register beside the dataset."""
    case.registers.append(case.outside("register"))
