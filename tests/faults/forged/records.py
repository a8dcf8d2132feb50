"""What `palpate verify` reports of each forged dataset, in words that no draw and no place of a folder changes."""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from random import Random

from palpate.experiment.dataset import verify
from palpate.experiment.dataset.outside.signatures import Signer
from palpate.experiment.errors import PalpateError
from tests.faults.forged import beside, chains, outside, tables
from tests.faults.forged.case import Case, Forgery
from tests.faults.forged.studies import CLEAN, Clean
from tests.faults.wrong import ALONE, WRONG, Act, copied

SEED = 33

DRAWN = {
    "a folder of another study",
    "a folder of a study with another seed",
    "events of no journal",
    "a trace of no journal",
}
"""Of `WRONG`, what is found depends on which of their tasks participants do first, and so on draws."""


def _wrong(name: str, act: Act) -> Forgery:
    return Forgery(name, ("study",), lambda case: act(case.study, case.study.file.parent))


FORGERIES: tuple[Forgery, ...] = (
    # One of those that are refused in the same words.
    *(_wrong(one.name, one.act) for one in {one.said: one for one in WRONG if one.name not in DRAWN}.values()),
    *(_wrong(name, act) for name, act in ALONE.items()),
    *chains.FORGERIES,
    *beside.FORGERIES,
    *tables.FORGERIES,
    *outside.FORGERIES,
)


@dataclass(frozen=True)
class Line:
    """A finding: whether it holds, the file or the thing that it is about, and what it says."""

    word: str
    where: str
    text: str

    def __str__(self) -> str:
        return f"{self.word} {self.where}: {self.text}"


@dataclass(frozen=True)
class Record:
    """What `verify` reports of a dataset, with the exit code of the command.

    `number` is 0 where the dataset is clean, and `places` say where in its structure it was forged. `sentences` are
    title and verdict, or the error alone where nothing could be checked.
    """

    number: int
    forgery: str
    base: str
    places: tuple[str, ...]
    code: int
    findings: tuple[Line, ...]
    sentences: tuple[str, ...]


def _base(forgery: Forgery) -> str:
    """Return the clean dataset of a forgery, by its name alone: another forgery in the list changes no other."""
    return Random(f"{SEED} {forgery.name}").choice(forgery.bases)


def run(numbers: Collection[int] = ()) -> list[Record]:
    """Forge the datasets with these numbers, by default all; return what is reported of the clean ones and of them."""
    # In memory where that can be: nothing here has to outlive a power cut.
    with tempfile.TemporaryDirectory(dir=next(Path("/dev").glob("shm"), None)) as folder:
        return list(_Bench(Path(folder).resolve()).records(numbers))


class _Bench:
    """Makes each clean dataset in a folder when it is first needed, and each forged one from a copy of it."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._made: dict[str, Clean] = {}

    def records(self, numbers: Collection[int] = ()) -> Iterator[Record]:
        asked = [(number, one) for number, one in enumerate(FORGERIES, start=1) if not numbers or number in numbers]
        for base in CLEAN:
            if not numbers or any(_base(one) == base for _, one in asked):
                yield self._record(Case(self._clean(base).study, Random(SEED)), base)
        for number, forgery in asked:
            yield self._forged(number, forgery)

    def _clean(self, base: str) -> Clean:
        if base not in self._made:
            self._made[base] = CLEAN[base](self._folder / base.replace(" ", "-"))
        return self._made[base]

    def _forged(self, number: int, forgery: Forgery) -> Record:
        base, folder = _base(forgery), self._folder / "forged"
        shutil.rmtree(folder, ignore_errors=True)
        case = Case(copied(self._clean(base).study, folder), Random(f"{SEED} place {forgery.name}"))
        try:
            forgery.act(case)
            return self._record(case, base, number, forgery.name)
        except Exception as error:
            error.add_note(f"forgery {number}: {forgery.name}, in {base}")
            raise

    def _record(self, case: Case, base: str, number: int = 0, forgery: str = "nothing") -> Record:
        findings: Iterable[Line] = ()
        try:
            signer = None if case.signer is None else Signer(case.signer)
            report = verify.verify(case.root, case.registers, case.numbers, signer)
            findings = (Line(one["word"], one["item"], one["text"]) for one in report.records())
            code, sentences = int(report.refused > 0), (report.title, *report.verdict)
        except PalpateError as error:
            code, sentences = error.exit_code, (str(error),)
        words = _Words(case, self._made[base])
        return Record(
            number,
            forgery,
            base,
            tuple(case.places),
            code,
            tuple(words.in_order(Line(one.word, words.plain(one.where), words.plain(one.text)) for one in findings)),
            tuple(map(words.plain, sentences)),
        )


@dataclass(frozen=True)
class _Words:
    """Takes out of a text what differs from run to run, from version to version, or with every draw."""

    case: Case
    clean: Clean

    def plain(self, text: str) -> str:
        """Return a text in one line, without paths of this machine, hashes, days of the run, and drawn orders."""
        text = text.replace(str(self.case.root), "<study>").replace(str(self.case.study.file.parent), "<outside>")
        text = re.sub(r"\b([0-9a-f]{4}-){3}[0-9a-f]{4}\b|\b[0-9a-f]{8,}\b", "<hash>", text)
        text = re.sub(r"\b20[2-8]\d-\d\d-\d\d(T[\d:+]+)?", "<time>", text)
        text = re.sub(r"\bpalpate \d+(\.\w+)+", "palpate <version>", text)
        text = re.sub(r"(sub-(\w+?)_task-)(\w+?)(?=_)", self._task, text)
        text = re.sub(r"(participant (\w+), task )(\w+)", self._task, text)
        if self.clean.drawn:
            text = re.sub(r"\d+(?= (lines?|steps?|bytes)\b)", "<n>", text)
        return "; ".join(line.strip() for line in text.splitlines())

    def _task(self, found: re.Match[str]) -> str:
        """Return a participant's task by its place, since their order is drawn; somebody unknown has none."""
        before, participant, task = found.groups()
        tasks = self.clean.tasks.get(participant)
        if tasks is None:
            return f"{before}<task>"
        return f"{before}<{tasks.index(task) + 1}>" if task in tasks else str(found[0])

    def in_order(self, findings: Iterable[Line]) -> Iterator[Line]:
        """Yield findings as they were reported, but sorted where several in a row are about one participant.

        Their order is that of the names of tasks, and so says which task was drawn to be the first.
        """
        for _, some in groupby(findings, key=lambda one: one.where.rpartition("_task-")[0] or one):
            yield from sorted(some, key=str)
