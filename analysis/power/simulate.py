"""How many participants a study needs: the power of each planned test, from whole simulated studies.

A chunk's random stream depends on seed, model, size and chunk alone. Chunks run on cores (joblib) or a Dask cluster.
"""

from __future__ import annotations

import re
import signal
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import import_module, metadata
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import numpy as np

from palpate.analysis import designs, published
from palpate.analysis.identification.planned import EQUIVALENCE
from palpate.analysis.power.planned_tests import (
    FLIPS,
    MOST_CONFUSED,
    REPEATED,
    Answer,
    Design,
    Model,
    Question,
    design,
    fewest,
    otherwise,
)
from palpate.analysis.statistics.inference import wilson
from palpate.experiment import storage
from palpate.experiment.errors import PowerError
from palpate.experiment.protocol import asked
from palpate.experiment.protocol.models import Protocol

if TYPE_CHECKING:
    import pandas as pd

LABEL = "SIMULATED studies"
"""The label on everything: no participant took part in any of these studies."""

Kind = Literal["model", "guessing"]
KINDS: tuple[Kind, ...] = ("model", "guessing")
"""Answers from the choice model, and the control under which every null hypothesis holds."""

CHUNK_STUDIES = 1000
CHUNK_CELLS = 2_000_000
"""A chunk holds `CHUNK_STUDIES` studies, or fewer where their counts would be more than `CHUNK_CELLS`."""

MOST_PARTICIPANTS, MOST_STUDIES = 1000, 1_000_000


@dataclass(frozen=True)
class Chunk:
    """Studies of one size under one model that are simulated in one go."""

    design: Design
    model: Model
    kind: Kind
    participants: int
    number: int
    studies: int
    seed: int


@dataclass(frozen=True)
class Tally:
    """Counts of the studies' answers to one question.

    `significant` have P below alpha, `above` of these a mean above chance, `undefined` no P or estimate; in `family`
    some test of the family has such a mean. `estimates` are in the order of studies.
    """

    studies: int
    significant: int
    above: int | None
    undefined: int
    estimates: array[float] | None = None
    family: int | None = None


@dataclass(frozen=True)
class Row:
    """One question at one number of participants under one model."""

    question: Question
    kind: Kind
    participants: int
    tally: Tally

    @property
    def power(self) -> float | None:
        """The share of all studies with P below alpha; None where there is no P."""
        return None if self.question.alpha is None else self.tally.significant / self.tally.studies

    @cached_property
    def interval(self) -> tuple[float, float] | None:
        """Wilson's interval of the power: its Monte Carlo error."""
        if self.question.alpha is None:
            return None
        limits = wilson(self.tally.significant, self.tally.studies)
        return limits.low, limits.high

    @cached_property
    def quantiles(self) -> tuple[float, float, float] | None:
        """The 2.5 %, 50 % and 97.5 % quantiles of the estimates; None without estimates."""
        if not self.tally.estimates:
            return None
        low, middle, high = np.quantile(self.tally.estimates, (0.025, 0.5, 0.975)).tolist()
        return low, middle, high


@dataclass(frozen=True)
class Needed:
    """The smallest size tried from which on the power reaches the target, by the estimate, and `surely` by its limit.

    `earliest` may suffice untried: one above the last size whose upper limit is below, and at least that with a P below
    alpha.
    """

    likely: int | None
    earliest: int | None
    surely: int | None


@dataclass(frozen=True)
class Recommended:
    """The fewest participants tried with whom every planned test reaches the target, but those of `lacking`.

    `participants` is None where no test does.
    """

    participants: int | None
    lacking: tuple[Question, ...]


@dataclass(frozen=True)
class Power:
    """What was simulated, and its results."""

    study: str
    design: Design
    model: Model
    participants: tuple[int, ...]
    studies: int
    seed: int
    target: float
    rows: tuple[Row, ...]
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        return f"<Power, {self.label}, of {self.study}: {len(self.questions)} questions, sizes {self.participants}>"

    def to_frame(self) -> pd.DataFrame:
        """Return a row for each question, model (or "guessing", whose power is the type I error) and size; SIMULATED.

        `correction` is that of P, "Holm" or "none". Beside `power` stand Wilson's 95 % limits, its Monte Carlo error;
        all are NaN where an estimate is wanted.
        """
        import pandas as pd

        rows = [
            (row.question.plan + 1, row.question.test, ", ".join(row.question.tasks), row.question.subject,
             "Holm" if row.question.adjusted else "none", row.question.alpha, row.kind, row.participants,
             row.tally.studies, row.power, *(row.interval or (None, None)), row.tally.undefined,
             row.quantiles and row.quantiles[1])
            for row in self.rows
        ]  # fmt: skip
        columns = ("planned_test", "test", "tasks", "subject", "correction", "alpha", "model", "participants",
                   "studies", "power", "low", "high", "undefined", "median")  # fmt: skip
        return pd.DataFrame(rows, columns=columns).astype(dict.fromkeys(("alpha", "power", "low", "high"), "float64"))

    @property
    def label(self) -> str:
        """What stands on everything made from this: that it is simulated, and after what if not participants."""
        return f"{LABEL}, after: {self.model.label}" if self.model.label else LABEL

    @property
    def questions(self) -> tuple[Question, ...]:
        """Every question, in the order of the protocol."""
        return tuple(dict.fromkeys(row.question for row in self.rows))

    def row(self, question: Question, participants: int, kind: Kind = "model") -> Row | None:
        """Return one row, or None where this question is not asked at this number of participants."""
        return self._places.get((question, participants, kind))

    def by_size(self, question: Question) -> list[Row]:
        """Return the rows of one question under the model, by number of participants."""
        return [row for size in self.participants if (row := self.row(question, size))]

    def recommended(self) -> Recommended:
        """Return the one number of participants to plan with: that of all tests, as the protocol plans them."""
        reached = {one: self.needed(one).likely for one in self.questions if _planned(self, one)}
        enough = [size for size in reached.values() if size is not None]
        return Recommended(max(enough, default=None), tuple(one for one, size in reached.items() if size is None))

    @cached_property
    def _places(self) -> dict[tuple[Question, int, Kind], Row]:
        return {(row.question, row.participants, row.kind): row for row in self.rows}

    def needed(self, question: Question) -> Needed:
        """Return how many participants reach the target."""
        rows = self.by_size(question)
        low = {row.participants: row.interval[0] for row in rows if row.interval}
        high = {row.participants: row.interval[1] for row in rows if row.interval}
        likely = {row.participants: row.power for row in rows if row.power is not None}
        likely_at, high_at, low_at = (_reached(values, self.target) for values in (likely, high, low))
        below = [size for size in high if high_at is not None and size < high_at]
        if high_at is None:
            return Needed(likely_at, None, low_at)
        return Needed(likely_at, max(max(below, default=0) + 1, fewest(question, self.design, high_at)), low_at)


def _planned(result: Power, question: Question) -> bool:
    """Return whether a question has the P that the protocol plans, and a subject that was chosen beforehand."""
    others = (other for other in result.questions if other.plan == question.plan and other.subject == question.subject)
    corrected = result.design.tests[question.plan].correction is not None or question.test == EQUIVALENCE
    last = question.adjusted or not (corrected and any(other.adjusted for other in others))
    ours = question.subject.endswith((FLIPS, MOST_CONFUSED)) or question.test == REPEATED
    return question.alpha is not None and last and corrected >= question.adjusted and not ours


def find(name: str, protocol: Protocol) -> Model:
    """Return the model called `name`: `published`, a study's id, a dataset's folder, a TOML file, or two numbers.

    Raises `PowerError` for no such model, one that lacks a task or a material, a scale without a limit, or where no
    test can be simulated; `DatasetError` or `ProtocolError` for a dataset or file that cannot be read.
    """
    planned, path, own = designs.planned_design(protocol), Path(name), name == "published"
    if not planned.power:
        raise PowerError(
            f"study {protocol.study.id}",
            f"no model simulates answers for the design '{planned.name}'",
            "give a study with another design, or name a model's module in `power` of its design",
        )
    models = import_module(planned.power)
    found: Model
    if printed := published.load(protocol.study.id if own else name):
        found = models.from_print(printed, protocol)
    elif path.is_dir():
        found = models.fitted(path, protocol)
    elif not own and (path.suffix == ".toml" or path.exists()):
        found = models.stated(path, protocol)
    elif numbers := re.fullmatch(r"(\d*\.?\d+),(\d*\.?\d+)", name):
        found = models.observer(float(numbers[1]), float(numbers[2]), protocol)
    else:
        allowed = (
            f"the id of a study whose printed {models.PRINTED} palpate contains, the folder of a dataset, a TOML file, "
            f"or two numbers, {models.NUMBERS}"
        )
        if own:
            what, remedy = "palpate has no printed numbers for it", "state with --model how participants answer"
            raise PowerError(f"study {protocol.study.id}", what, remedy, allowed=allowed)
        what = f"got no model of that name for study {protocol.study.id}"
        raise PowerError(f"--model {name}", what, "give one of these", allowed=allowed)
    return found


def prepare(
    protocol: Protocol, model: str, alpha: float | None = None, alike: float | None = None
) -> tuple[Design, Model]:
    """Return what is planned, at `alpha` in place of each test's own, and the model named. Raises `PowerError`.

    `alike` is the share of the variance between participants that is common to all tasks and materials.
    """
    if alpha is not None and not 0 < alpha < 1:
        raise PowerError("--alpha", f"got {alpha}", "give one", allowed="a number between 0 and 1")
    for place, test in enumerate(protocol.analysis):
        values = asked.values(protocol, test.groups) if test.groups else ()
        if len(values) > 2:
            got, remedy = f"a fact with {len(values)} values", "plan a fact with two values, or simulate it yourself"
            raise PowerError(f"analysis[{place}].groups", got, remedy, allowed="two values, for groups of equal size")
    protocol = _without_controls(protocol)
    chosen = find(model, protocol) if alike is None else find(model, protocol).together(alike)
    printed = published.load(model) or published.load(protocol.study.id)
    return design(protocol, printed.pairs() if printed else {}, alpha), chosen


def _without_controls(protocol: Protocol) -> Protocol:
    return protocol.model_copy(update={"tasks": tuple(one for one in protocol.tasks if one.control is None)})


Runner = Callable[
    [Callable[[Chunk], dict[Question, Tally]], Sequence[Chunk]], Iterator[tuple[int, dict[Question, Tally]]]
]
"""Runs chunks somewhere, and returns the results with their places, in any order."""


def run(
    protocol: Protocol,
    planned: Design,
    model: Model,
    *,
    participants: Sequence[int],
    studies: int,
    seed: int,
    target: float,
    runner: Runner,
    total: Callable[[int], None] = lambda _: None,
    tick: Callable[[], None] = lambda: None,
) -> Power:
    """Return the power at every size in `participants`, from `studies` simulated studies under each model.

    `runner` runs the chunks, `total` gets their number, `tick` follows each. Raises `PowerError` for sizes or numbers
    not allowed.
    """
    sizes = tuple(sorted(set(participants)))
    _check(sizes, studies, target, planned)
    models: dict[Kind, Model] = {"model": model, "guessing": model.control(_without_controls(protocol))}
    chunks = list(_chunks(planned, models, sizes, studies, seed))
    total(len(chunks))
    done: dict[int, dict[Question, Tally]] = {}
    for place, tallies in runner(simulate, chunks):
        done[place] = tallies
        tick()
    rows: dict[tuple[Kind, int], dict[Question, list[Tally]]] = {}
    for place, chunk in enumerate(chunks):
        held = rows.setdefault((chunk.kind, chunk.participants), {})
        for question, tally in done[place].items():
            held.setdefault(question, []).append(tally)
    found = tuple(
        Row(question, kind, size, _together(tallies))
        for (kind, size), questions in rows.items()
        for question, tallies in questions.items()
    )
    notes = (*model.notes, *otherwise(planned, {question.plan for rows in rows.values() for question in rows}))
    return Power(protocol.study.id, planned, model, sizes, studies, seed, target, found, notes)


def simulate(chunk: Chunk) -> dict[Question, Tally]:
    """Draw the studies of one chunk, and return the tally of each question."""
    key = (KINDS.index(chunk.kind), chunk.participants, chunk.number)
    random = np.random.Generator(np.random.PCG64(np.random.SeedSequence(chunk.seed, spawn_key=key)))
    every, families = chunk.model.answers(chunk.design, chunk.participants, chunk.studies, random)
    return {question: replace(_tally(question, one), family=families.get(question)) for question, one in every.items()}


def _chunks(
    planned: Design, models: Mapping[Kind, Model], sizes: Sequence[int], studies: int, seed: int
) -> Iterator[Chunk]:
    materials = len(planned.materials)
    for kind, model in models.items():
        for size in sizes:
            cells = materials * (materials + 1) * sum(planned.sizes(size))
            most = max(1, min(CHUNK_STUDIES, CHUNK_CELLS // cells))
            for number, first in enumerate(range(0, studies, most)):
                yield Chunk(planned, model, kind, size, number, min(most, studies - first), seed)


def _tally(question: Question, found: Answer) -> Tally:
    if question.alpha is not None and found.p is not None:
        significant = found.p < question.alpha
        undefined = np.isnan(found.p)
        above = None if found.above is None else int(np.count_nonzero(significant & found.above))
        hits, studies = int(np.count_nonzero(significant)), len(found.p)
    elif found.estimate is not None:
        undefined, above, hits, studies = np.isnan(found.estimate), None, 0, len(found.estimate)
    estimates = None if found.estimate is None else array("d", found.estimate[~np.isnan(found.estimate)])
    return Tally(studies, hits, above, int(np.count_nonzero(undefined)), estimates)


def _together(tallies: Sequence[Tally]) -> Tally:
    estimates = [tally.estimates for tally in tallies if tally.estimates is not None]
    above = [tally.above for tally in tallies if tally.above is not None]
    family = [tally.family for tally in tallies if tally.family is not None]
    return Tally(
        studies=sum(tally.studies for tally in tallies),
        significant=sum(tally.significant for tally in tallies),
        above=sum(above) if above else None,
        undefined=sum(tally.undefined for tally in tallies),
        estimates=array("d", chain.from_iterable(estimates)) if estimates else None,
        family=sum(family) if family else None,
    )


def _reached(values: dict[int, float], target: float) -> int | None:
    """Return the smallest size that reaches the target, as does every larger one."""
    found = None
    for size in sorted(values, reverse=True):
        if values[size] < target:
            break
        found = size
    return found


def check_studies(studies: int) -> None:
    """Raise `PowerError` for a number of studies that is not simulated."""
    if not 1 <= studies <= MOST_STUDIES:
        raise PowerError("--studies", f"got {studies}", "give a number between them", allowed=f"1 to {MOST_STUDIES}")


def _check(sizes: Sequence[int], studies: int, target: float, planned: Design) -> None:
    if not 0 < target < 1:
        raise PowerError("--target", f"got {target}", "give one", allowed="a number between 0 and 1")
    if not sizes or sizes[0] < 1 or sizes[-1] > MOST_PARTICIPANTS:
        got = ", ".join(map(str, sizes)) or "none"
        raise PowerError("--participants", f"got {got}", "give some", allowed=f"numbers from 1 to {MOST_PARTICIPANTS}")
    check_studies(studies)
    for task in planned.tasks:
        answers = len(planned.materials) ** 2 * sizes[-1] * task.repetitions
        if answers >= 2**31:
            got = f"got {answers} answers to task {task.id} in one study's matrix"
            most = f"fewer than {2**31}, whose squares are exact"
            raise PowerError(f"--participants {sizes[-1]}", got, "try fewer participants", allowed=most)


Work = TypeVar("Work")
Result = TypeVar("Result")

PATIENCE = "10s"
"""The time that a scheduler may take to answer."""


def _leave_interrupts() -> None:
    """Leave Ctrl-C, which reaches every process of a terminal, to the one that began this worker and ends it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def on_cores(work: Callable[[Work], Result], chunks: Sequence[Work], jobs: int = 0) -> Iterator[tuple[int, Result]]:
    """Yield the results of `work` on this machine, `jobs` at a time, with 0 for one on each core.

    Raises `PowerError` if the operating system ended a worker process.
    """
    from joblib import Parallel, cpu_count, delayed

    jobs = min(jobs or cpu_count(), len(chunks))
    if jobs <= 1:
        yield from ((place, work(chunk)) for place, chunk in enumerate(chunks))
        return
    try:
        with storage.safe_path():
            parallel = Parallel(n_jobs=jobs, return_as="generator_unordered", initializer=_leave_interrupts)
            yield from parallel(delayed(_placed)(work, place, chunk) for place, chunk in enumerate(chunks))
    except BrokenProcessPool as error:
        raise PowerError(
            f"--jobs {jobs}: the operating system ended a worker process, perhaps because memory ran out; "
            "use fewer jobs"
        ) from error


def on_cluster(work: Callable[[Work], Result], chunks: Sequence[Work], address: str) -> Iterator[tuple[int, Result]]:
    """Yield the results of `work` on the Dask cluster whose scheduler has this address.

    Raises `PowerError` without Dask, scheduler or workers, for other software, or a lost worker.
    """
    try:
        from distributed import Client, as_completed
        from distributed.client import FutureCancelledError
        from distributed.comm.core import CommClosedError
        from distributed.scheduler import KilledWorker
    except ImportError:
        raise PowerError("--scheduler: Dask is not installed here; install palpate[cluster], then try again") from None
    try:
        client = Client(address, timeout=PATIENCE)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise PowerError(
            f"--scheduler {address}: got no answer ({error}); allowed: the address of a running Dask scheduler, such "
            "as tcp://10.0.0.1:8786; start one, or leave --scheduler out"
        ) from None
    with client:
        try:
            _same_software(address, client.run(_versions_of(tuple(software()))))
            futures = client.map(_placed, [work] * len(chunks), range(len(chunks)), chunks, pure=False)
            for future in as_completed(futures):  # type: ignore[no-untyped-call]
                yield future.result()
                future.release()
        except (KilledWorker, CommClosedError, FutureCancelledError) as error:
            reason = next(iter(str(error).splitlines()), type(error).__name__)
            raise PowerError(f"--scheduler {address}: lost the cluster ({reason}); try again") from error


def software() -> dict[str, str]:
    """Return the versions of what the numbers depend on, name -> version."""
    return {name: metadata.version(name) for name in ("palpate", "numpy", "scipy")}


def _versions_of(names: tuple[str, ...]) -> Callable[[], dict[str, str]]:
    """Return a function that finds versions on a worker; it is sent whole, so the worker needs none of the packages."""

    def versions() -> dict[str, str]:
        from importlib import metadata

        found = {}
        for name in names:
            try:
                found[name] = metadata.version(name)
            except metadata.PackageNotFoundError:
                found[name] = "none"
        return found

    return versions


def _placed(work: Callable[[Work], Result], place: int, chunk: Work) -> tuple[int, Result]:
    return place, work(chunk)


def _same_software(address: str, workers: dict[str, Any]) -> None:
    if not workers:
        raise PowerError(f"--scheduler {address}: got a cluster without workers; start one there, then try again")
    ours = software()
    for worker, theirs in workers.items():
        if theirs != ours:
            raise PowerError(
                f"--scheduler {address}: worker {worker} got {theirs}; allowed: {ours}, so that results are the same "
                "everywhere; install the same versions there"
            )
