"""Simulated studies of ratings: participants who differ give each material the place of the scale that is nearest.

Where a power law is planned, what they feel is the logarithm of a number, else the number itself. Means, power laws and
agreement are those of `rating.results`.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field
from scipy.linalg import helmert
from scipy.special import stdtr

from palpate.analysis.documents.tables import Column, Record, tabulate
from palpate.analysis.power.planned_tests import ABOUT, Answer, Answers, Design, Model, Question, Shown
from palpate.analysis.power.stated import StatedValue, by_task, other_study
from palpate.analysis.published.numbers import Published
from palpate.analysis.reading import dataset
from palpate.analysis.statistics.exact import Floats, Integers, integers
from palpate.analysis.statistics.icc import icc_tests
from palpate.analysis.statistics.participants import repeated_tests
from palpate.experiment.errors import PowerError
from palpate.experiment.protocol.designs.rating import Rating
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.settings import load
from palpate.experiment.settings.load import Confined, Text

MEANS, AGREEMENT, LAW = "mean ratings", "agreement of ratings", "power law"

PRINTED = "ratings"
"""What print has of answers."""

NUMBERS = (
    "0.8,0.2: the difference between the means of the first and the last material, in scale units, and the SD of "
    "ratings (if a power law is planned: its exponent, and the SD of log10 ratings)"
)
"""What two numbers say."""

FORMS = ("ICC(2,1)", "ICC(3,1)")
"""The intraclass correlations whose estimates are shown: of absolute agreement, and of consistency."""


@dataclass(frozen=True)
class Raters:
    """Raters in one task: what each material, shape (M,), is felt as, in numbers or their log10, and three SDs.

    `level` is the SD among participants of what they feel all as, `spread` that of each material, `scatter` that of a
    participant's single ratings of one.
    """

    task: str
    values: Floats
    level: float
    spread: float
    scatter: float


@dataclass(frozen=True)
class RatingModel(Model):
    """How raters rate, the scale's numbers, whether they feel logarithms, and the log10 of materials' magnitudes."""

    tasks: tuple[Raters, ...]
    scale: tuple[float, ...] = ()
    felt_as_logarithm: bool = False
    magnitudes: tuple[float, ...] = ()

    has_stars = False
    undefined = "no variance"
    control_name = "alike"

    def control(self, _: Protocol) -> "RatingModel":
        """Return raters to whom all materials are alike on average, and who differ as much."""
        source = "materials that are alike on average, with the same spread across participants"
        tasks = tuple(replace(one, values=np.full_like(one.values, one.values.mean())) for one in self.tasks)
        return replace(self, source=source, tasks=tasks)

    def answers(self, planned: Design, participants: int, studies: int, random: np.random.Generator) -> Answers:
        """Return the answers to each question; no family is counted."""
        found: dict[Question, Answer] = {}
        for one, task, people in zip(self.tasks, planned.tasks, planned.sizes(participants), strict=True):
            own = planned.places(task.id)
            given = draw(self, one, task.repetitions, people, studies, random)[..., own, :]
            for number, test in enumerate(planned.tests):
                if task.id in test.tasks:
                    for subject, asks, answer in TESTS[test.test](self, given, own):
                        alpha = test.alpha if asks else None
                        found[Question(number, test.test, (task.id,), subject, alpha)] = answer
        return found, {}

    def shown(self, planned: Design, said: tuple[str, ...]) -> Shown:
        """Return what each material is felt as in each task, and the SDs."""
        unit = "log10 of scale units" if self.felt_as_logarithm else "scale units"
        repeated = ", ".join(f"{one.id} {one.repetitions}" for one in planned.tasks)
        paragraphs = (said[0], ABOUT["raters"].substitute(repeated=repeated), *said[2:])
        records: list[Record] = [
            {"task": one.task, "material": name, "value": value, "level": one.level, "spread": one.spread,
             "scatter": one.scatter}
            for one in self.tasks for name, value in zip(planned.materials, one.values.tolist(), strict=True)
        ]  # fmt: skip
        return paragraphs, (tabulate(f"Model of ratings, in {unit}", VALUES, records),)


VALUES = (
    Column("task", left=True), Column("material", left=True), Column("value"), Column("level", "SD of levels"),
    Column("spread", "of materials"), Column("scatter", "of ratings"),
)  # fmt: skip


def draw(
    model: RatingModel, one: Raters, repetitions: int, people: int, studies: int, random: np.random.Generator
) -> Integers:
    """Return the places on the scale that are given, shape (S, participants, M, repetitions)."""
    felt = one.values[:, None] + one.level * random.standard_normal((studies, people, 1, 1))
    felt = felt + one.spread * random.standard_normal((studies, people, len(one.values), 1))
    felt = felt + one.scatter * random.standard_normal((studies, people, len(one.values), repetitions))
    places = _felt(model, np.array(model.scale))
    return np.searchsorted((places[1:] + places[:-1]) / 2, felt).astype(np.int64)


def _felt(model: RatingModel, numbers: Floats) -> Floats:
    return np.asarray(np.log10(numbers) if model.felt_as_logarithm else numbers)


def _means(model: RatingModel, given: Integers, _: list[int]) -> Iterator[tuple[str, bool, Answer]]:
    means = np.array(model.scale)[given].mean(axis=-1)
    people, materials = means.shape[1:]
    p = np.full(len(means), np.nan) if people < 2 else repeated_tests(means @ helmert(materials).T)[2]
    yield "materials", True, Answer(p=p)


def _agreement(model: RatingModel, given: Integers, _: list[int]) -> Iterator[tuple[str, bool, Answer]]:
    whole, _common = integers([Fraction(f"{one:.12g}") for one in model.scale])
    sums = np.moveaxis(np.array(whole)[given].sum(axis=-1), 2, 0)
    for form in FORMS:
        yield form, False, Answer(estimate=icc_tests(sums, form)[0])


def _law(model: RatingModel, given: Integers, own: list[int]) -> Iterator[tuple[str, bool, Answer]]:
    """Yield whether the mean exponent is other than 0, by Student's t, and the mean exponent itself."""
    known, place = np.unique(np.array(model.magnitudes)[own], return_inverse=True)
    logs = np.log10(np.array(model.scale))[given].mean(axis=-1)
    each = np.stack([logs[..., place == one].mean(axis=-1) for one in range(len(known))], axis=-1)
    apart = known - known.mean()
    exponents = each @ apart / (float(apart @ apart) or np.nan)
    people = exponents.shape[-1]
    sd = exponents.std(axis=-1, ddof=1) if people > 1 else np.full(len(exponents), np.nan)
    t = exponents.mean(axis=-1) / (np.where(sd > 1e-12, sd, np.nan) / np.sqrt(people))
    yield "exponent other than 0", True, Answer(p=2 * stdtr(people - 1, -np.abs(t)))
    yield "mean exponent", False, Answer(estimate=exponents.mean(axis=-1))


TESTS = {MEANS: _means, AGREEMENT: _agreement, LAW: _law}
"""What answers each planned test: subject, whether it has a P, and the answer."""


def _unrated(protocol: Protocol) -> RatingModel:
    """Return what a model has of its protocol, without raters."""
    own = protocol.table(Rating)
    of = {one.material: float(np.log10(one.value)) for one in own.magnitudes}
    magnitudes = tuple(of[material.id] for material in protocol.materials) if of else ()
    scale = tuple(place.value for place in own.scale)
    planned = any(test.test == LAW for test in protocol.analysis)
    return RatingModel("", (), scale=scale, felt_as_logarithm=planned, magnitudes=magnitudes)


def observer(apart: float, spread: float, protocol: Protocol) -> RatingModel:
    """Return raters whose means are so far `apart`, amid the scale, and whose three SDs are each `spread`.

    Materials are one step apart in their order; where a power law is planned, `apart` is its exponent. Raises
    `PowerError` for a spread of 0.
    """
    if not spread > 0:
        raise PowerError("--model", f"got {apart:g},{spread:g}", "give two numbers", allowed="a spread above 0")
    model = _unrated(protocol)
    steps = np.array(model.magnitudes) if model.felt_as_logarithm else np.linspace(0, 1, len(protocol.materials))
    ends = _felt(model, np.array([model.scale[0], model.scale[-1]]))
    values = ends.mean() + apart * (steps - (steps.min() + steps.max()) / 2)
    tasks = tuple(Raters(task.id, values, spread, spread, spread) for task in protocol.tasks)
    what = f"a power law with the exponent {apart:g}" if model.felt_as_logarithm else f"means that span {apart:g}"
    said = f"raters with {what}; palpate assumes the same SD of {spread:g} for participants and for single ratings"
    return replace(model, source=said, tasks=tasks)


class StatedRatings(Confined):
    """A model of ratings as a file states it, in numbers of the scale, or their log10 where a power law is planned."""

    format: Literal[1]
    source: Text
    level: Annotated[float, Field(ge=0)]
    spread: Annotated[float, Field(ge=0)]
    scatter: Annotated[float, Field(ge=0)]
    values: Annotated[tuple[StatedValue, ...], Field(min_length=2)]


def stated(file: Path, protocol: Protocol) -> RatingModel:
    """Return the model of a TOML file."""
    own = load.read(file, StatedRatings)
    ids = [material.id for material in protocol.materials]
    values = by_task(file, own.values, [task.id for task in protocol.tasks], ids)
    tasks = tuple(Raters(task, at, own.level, own.spread, own.scatter) for task, at in values)
    return replace(_unrated(protocol), source=f"stated in {file.name}: {own.source}", tasks=tasks)


def from_print(printed: Published, _: Protocol) -> RatingModel:
    """Raise `PowerError`: palpate holds no printed ratings."""
    raise PowerError(
        f"the tables of {printed.study}", "got no ratings", "choose another --model", allowed=f"a dataset, or {NUMBERS}"
    )


def fitted(folder: Path, protocol: Protocol) -> RatingModel:
    """Return the raters of a dataset, with variances by the mean squares of participants with every material."""
    study = dataset.read(folder)
    scale = [place.answer for place in protocol.table(Rating).scale]
    ids = [material.id for material in protocol.materials]
    if study.design != protocol.tasks[0].design or set(ids) != set(study.materials):
        raise other_study(folder, f"ratings of {', '.join(ids)}", NUMBERS)
    model = _unrated(protocol)
    tasks = []
    for task in protocol.tasks:
        rows = study.trials(task.id)
        rows = rows[rows["answered"].isin(scale)]
        felt = rows.assign(felt=_felt(model, np.asarray(rows["answered"], dtype=np.float64)))
        cells = felt.groupby(["participant", "presented"])["felt"]
        means = cells.mean().unstack().reindex(columns=ids).dropna()
        if len(means) < 2:
            allowed = "two or more participants who rated every material"
            raise PowerError(
                f"{folder}, task {task.id}", f"got {len(means)} participants", "give two numbers", allowed=allowed
            )
        tasks.append(Raters(task.id, means.mean().to_numpy(), *_spreads(means.to_numpy(), cells)))
    label = f" ({study.label})" if study.label else ""
    return replace(
        model, source=f"fitted to the answers in {folder.name}{label}", tasks=tuple(tasks), label=study.label
    )


def _spreads(means: Floats, cells: Any) -> tuple[float, float, float]:
    """Return the SDs of levels, of materials and of single ratings, each at least 0."""
    people, materials = means.shape
    counts, squares = cells.size(), (cells.var(ddof=0) * cells.size()).sum()
    left = int(counts.sum() - len(counts))
    scatter = float(squares) / left if left else 0.0
    apart = means - means.mean(axis=0)
    levels = apart.mean(axis=1, keepdims=True)
    between = materials * float((levels**2).sum()) / (people - 1)
    within = float(((apart - levels) ** 2).sum()) / ((people - 1) * (materials - 1))
    spread = within - scatter * float((1 / counts).mean())
    level, spread, scatter = np.sqrt(np.clip([(between - within) / materials, spread, scatter], 0.0, None)).tolist()
    return level, spread, scatter
