"""Simulated studies of comparisons: Bradley-Terry observers who differ, and the scale fitted to many studies at once.

Values, and what being first adds, are normal among participants. Scales and errors are those of `statistics.scaling`;
steps and order are tested by Student's t on n - 1 df, as in `comparison.results`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field
from scipy.special import expit, logit, stdtr

from palpate.analysis.designs.comparison.results import CHOSEN
from palpate.analysis.documents.tables import Column, Record, tabulate
from palpate.analysis.power.planned_tests import ABOUT, Answer, Answers, Design, Model, Question, Shown
from palpate.analysis.power.stated import StatedValue, by_task, other_study
from palpate.analysis.published.numbers import Published
from palpate.analysis.reading import dataset
from palpate.analysis.statistics.exact import Floats, Integers
from palpate.analysis.statistics.scaling import FIRST, SECOND, no_smaller
from palpate.experiment.errors import PowerError
from palpate.experiment.protocol.designs.comparison import Comparison
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.settings import load
from palpate.experiment.settings.load import Confined, Text

STEPS, FAR = 40, 15.0
"""The most of Newton's steps, and the value in logits beyond which a scale counts as one without limit."""

SPREAD = 0.5
"""Ours: the SD among participants, in logits, where print tells of none."""

PLANNED = "Bradley-Terry"

PRINTED = "percentages"
"""What print has of choices."""

NUMBERS = (
    "0.7,0.5: how often a material is chosen over the previous one, and how much participants differ (SD, in logits)"
)
"""What two numbers say."""

MEAN = (
    "The values are fitted to the pooled choices of all participants. They are closer together than those of one "
    "participant, and the spread is smaller"
)


@dataclass(frozen=True)
class Observers:
    """Observers in one task: values in logits, shape (M,), what being first adds, and SDs among participants.

    `ranks` are the places of the materials from the least to the most, if that is not the order of the file.
    """

    task: str
    values: Floats
    order: float
    spread: float
    order_spread: float
    ranks: tuple[int, ...] = ()


VALUES = Column("task", left=True), Column("material", left=True), Column("value"), Column("spread", "SD")


@dataclass(frozen=True)
class PairModel(Model):
    """How observers compare in every task whose scale is planned."""

    tasks: tuple[Observers, ...]

    has_stars = False
    undefined = "no finite scale"
    control_name = "alike"

    def control(self, _: Protocol) -> "PairModel":
        """Return observers to whom nothing differs on average, and who differ as much."""
        source = "materials that are alike on average, with the same spread across participants"
        tasks = tuple(replace(one, values=np.zeros_like(one.values), order=0.0) for one in self.tasks)
        return replace(self, source=source, tasks=tasks)

    def answers(self, planned: Design, participants: int, studies: int, random: np.random.Generator) -> Answers:
        """Return the answers to each question; no family is counted."""
        return answers(planned, self, participants, studies, random), {}

    def shown(self, planned: Design, said: tuple[str, ...]) -> Shown:
        """Return the values of each task, with what being first adds, and the SDs among participants."""
        tasks = planned.tasks
        paragraphs = (
            said[0],
            ABOUT["observers"].substitute(repeated=", ".join(f"{one.id} {one.repetitions}" for one in tasks)),
            *said[2:],
        )
        records: list[Record] = [
            {"task": one.task, "material": name, "value": value, "spread": one.spread, "order": one.order,
             "order_spread": one.order_spread}
            for one in self.tasks for name, value in zip(planned.materials, one.values.tolist(), strict=True)
        ]  # fmt: skip
        first: list[Record] = [
            {"task": one.task, "material": "being first", "value": one.order, "spread": one.order_spread}
            for one in self.tasks
        ]
        table = tabulate("Model of comparisons, in logits", VALUES, (*records, *first))
        return paragraphs, (replace(table, records=tuple(records)),)


class StatedPairs(Confined):
    """A model of comparisons as a file states it; spreads are SDs among participants, in logits."""

    format: Literal[1]
    source: Text
    order: float = 0.0
    spread: Annotated[float, Field(ge=0)]
    order_spread: Annotated[float, Field(ge=0)] = 0.0
    values: Annotated[tuple[StatedValue, ...], Field(min_length=2)]


def planned_tasks(protocol: Protocol) -> tuple[list[str], list[str]]:
    """Return the ids of the tasks whose scale is planned, and of the materials. Raises `PowerError` without any."""
    planned = {task for test in protocol.analysis if test.test == PLANNED for task in test.tasks}
    if not planned:
        raise PowerError(
            f"study {protocol.study.id}: got no planned {PLANNED}; allowed: comparisons whose protocol plans that "
            "scale; plan it, or do not use palpate power"
        )
    return [task.id for task in protocol.tasks if task.id in planned], [one.id for one in protocol.materials]


def ranked(protocol: Protocol, values: Floats) -> tuple[int, ...]:
    """Return the places of materials from least to most by their `values`, where the protocol has no order."""
    return () if protocol.table(Comparison).ordered else tuple(np.argsort(values, kind="stable").tolist())


def stated(file: Path, protocol: Protocol) -> PairModel:
    """Return the model of a TOML file."""
    tasks, ids = planned_tasks(protocol)
    stated = load.read(file, StatedPairs)
    observers = [
        Observers(task, at - at.mean(), stated.order, stated.spread, stated.order_spread, ranked(protocol, at))
        for task, at in by_task(file, stated.values, tasks, ids)
    ]
    return PairModel(f"stated in {file.name}: {stated.source}", tuple(observers), _never(observers, ids))


def observer(share: float, spread: float, protocol: Protocol) -> PairModel:
    """Return observers who choose each material over the one before it in this share of trials, and differ by `spread`.

    Raises `PowerError` for a share that is not between 0 and 1.
    """
    if not 0 < share < 1:
        raise PowerError("--model", f"got {share:g},{spread:g}", "give two numbers", allowed="a share between 0 and 1")
    tasks, ids = planned_tasks(protocol)
    values = np.asarray(logit(share) * (np.arange(len(ids)) - (len(ids) - 1) / 2), dtype=np.float64)
    every = tuple(Observers(task, values, 0.0, spread, spread, ranked(protocol, values)) for task in tasks)
    said = (
        f"observers who choose each material over the previous one in a proportion of {share:g} of trials, and whose "
        f"values have an SD of {spread:g} logits"
    )
    return PairModel(said, every, _never(every, ids))


def from_print(printed: Published, protocol: Protocol) -> PairModel:
    """Return the scales of printed percentages; the spread among participants, which nobody prints, is ours."""
    tasks, ids = planned_tasks(protocol)
    place = {**{str(k + 1): k for k in range(len(ids))}, **{name: k for k, name in enumerate(ids)}}
    blocks = {block.task: block for block in printed.choices}
    observers = []
    for task in tasks:
        if task not in blocks:
            raise PowerError(
                f"the tables of {printed.study}: got no percentages of choices in task {task}; allowed: percentages "
                "for every task whose scale is planned; choose another --model"
            )
        wins, trials = np.zeros((len(ids), len(ids))), np.zeros((len(ids), len(ids)))
        for cell in blocks[task].cells:
            low, high = sorted(place[name] for name in cell.pair)
            if low != high:
                wins[high, low], trials[high, low] = float(cell.correct.value), 1.0
        values = scale(wins[None, None], trials).values[0]
        if not np.isfinite(values).all():
            where = f"the percentages of {printed.study}, task {task}"
            raise PowerError(f"{where}: got no finite scale; state one in a TOML file")
        observers.append(Observers(task, values, 0.0, SPREAD, SPREAD, ranked(protocol, values)))
    note = f"no paper prints how much participants differ, so palpate assumes an SD of {SPREAD:g} logits"
    where = " and ".join(dict.fromkeys(blocks[task].where for task in tasks))
    return PairModel(f"percentages from {where} in {printed.source}", tuple(observers), (note, *_never(observers, ids)))


def fitted(folder: Path, protocol: Protocol) -> PairModel:
    """Return the scales of a dataset, with the spread by which errors exceed those of participants who are alike."""
    tasks, ids = planned_tasks(protocol)
    study = dataset.read(folder)
    if study.design != "comparison" or set(ids) != set(study.materials):
        raise other_study(folder, f"comparisons of {', '.join(ids)}", NUMBERS)
    observers = []
    for task in tasks:
        rows = study.trials(task)
        rows = rows[rows["answered"].isin(list(CHOSEN))]
        people = list(dict.fromkeys(rows["participant"].tolist()))
        chosen = rows["answered"].map(CHOSEN).to_numpy()
        told = (chosen == FIRST) | (chosen == SECOND)
        codes = [rows[column].map(dict(zip(of, range(len(of)), strict=True))).to_numpy()[told].astype(np.int64)
                 for column, of in (("participant", people), ("first", ids), ("second", ids))]  # fmt: skip
        wins, trials = (np.zeros((len(people), len(ids), len(ids))) for _ in range(2))
        np.add.at(trials, tuple(codes), 1)
        np.add.at(wins, tuple(codes), chosen[told] == FIRST)
        found = scale(wins[None], trials) if len(people) > 1 else None
        if found is None or not np.isfinite(found.values).all():
            raise PowerError(
                f"{folder}: got no finite scale of two participants in task {task}; allowed: comparisons in which each "
                "material was chosen over some others but not all; state a model in a TOML file"
            )
        beyond = len(people) * (np.diagonal(found.covariance[0]) - np.diagonal(found.alike[0]))
        spread, order_spread = np.sqrt(np.clip([beyond[:-1].mean(), beyond[-1]], 0.0, None)).tolist()
        ranks = ranked(protocol, found.values[0])
        observers.append(Observers(task, found.values[0], float(found.order[0]), spread, order_spread, ranks))
    label = f" ({study.label})" if study.label else ""
    notes = (MEAN, *_never(observers, ids))
    return PairModel(f"fitted to the answers in {folder.name}{label}", tuple(observers), notes, study.label)


def _never(observers: Sequence[Observers], ids: Sequence[str]) -> tuple[str, ...]:
    """Return a sentence on each task whose values do not rise in the order in which its steps are asked for."""
    steps = {one.task: pairwise(one.ranks or range(len(ids))) for one in observers}
    every = {
        one.task: [(ids[a], ids[b]) for a, b in steps[one.task] if one.values[b] <= one.values[a]] for one in observers
    }
    return tuple(
        ABOUT["never in order"].substitute(task=task, pairs=", ".join(f"{a} not below {b}" for a, b in pairs))
        for task, pairs in every.items()
        if pairs
    )


@dataclass(frozen=True)
class Scales:
    """Scales of S studies: values (S, M), which add up to 0, the order effect (S,), and covariances (S, M + 1, M + 1).

    `covariance` is from sums of scores by participant, `alike` for participants who do not differ; NaN without a finite
    scale.
    """

    values: Floats
    order: Floats
    covariance: Floats
    alike: Floats


def scale(wins: Floats | Integers, trials: Floats) -> Scales:
    """Return the Bradley-Terry scale of choices of the first, shape (S, participants, M, M), by first and second.

    `trials` are those of an ordered pair, shape (M, M), or of each participant, shape (participants, M, M).
    """
    return _scales(wins, trials, reduced=False)


def finite(wins: Integers, trials: Floats) -> Scales:
    """Return the scales, as `scale` does, in which one without limit is bias-reduced, as by `scaling.fit`."""
    found = _scales(wins, trials, reduced=False)
    lost = np.isnan(found.order)
    if lost.any():
        reduced = _scales(wins[lost], trials, reduced=True)
        for field in fields(Scales):
            getattr(found, field.name)[lost] = getattr(reduced, field.name)
    return found


def _scales(wins: Floats | Integers, trials: Floats, *, reduced: bool) -> Scales:
    studies, people, items = wins.shape[:3]
    done = np.broadcast_to(trials, (people, items, items)).reshape(people, -1)
    chosen = wins.reshape(studies, people, -1)
    first, second = np.indices((items, items)).reshape(2, -1)
    full = np.eye(items)[first] - np.eye(items)[second]
    used = done.sum(axis=0) > 0
    both = bool((used & used.reshape(items, items).T.ravel()).any())
    design = np.column_stack([full[:, :-1] - full[:, [-1]], np.full(len(full), float(both))])
    total, hits = done.sum(axis=0), chosen.sum(axis=1)
    beta = np.zeros((studies, items))
    ridge = np.diag([0.0] * (items - 1) + [float(not both)])
    for _ in range(STEPS):
        share = expit(beta @ design.T)
        information = np.einsum("ck,sc,cl->skl", design, total * share * (1 - share), design, optimize=True) + ridge
        gaps = hits - total * share
        if reduced:
            inverse = np.linalg.inv(information)
            leverage = total * share * (1 - share) * np.einsum("ck,skl,cl->sc", design, inverse, design, optimize=True)
            gaps = gaps + leverage * (0.5 - share)
        slope = (gaps @ design)[..., None]
        step = np.linalg.solve(information + 1e-12 * np.eye(items), slope)[..., 0]
        step = np.clip(np.where(np.abs(beta).max(axis=1, keepdims=True) > FAR, 0.0, step), -1.0, 1.0)
        beta += step
        if np.abs(step).max() < 1e-11:
            break
    share = expit(beta @ design.T)
    scores = (chosen - done * share[:, None]) @ design
    inverse = np.linalg.inv(information + 1e-12 * np.eye(items))
    meat = np.swapaxes(scores, 1, 2) @ scores * people / max(people - 1, 1)
    if reduced:
        spread = np.stack([no_smaller(*pair) for pair in zip(meat, information, strict=True)])
    else:
        spread = inverse @ meat @ inverse
    back = np.zeros((items + 1, items))
    back[: items - 1, : items - 1], back[items - 1, : items - 1], back[items, items - 1] = np.eye(items - 1), -1.0, 1.0
    wrong = (np.abs(beta).max(axis=1) > FAR)[:, None]
    every = np.where(wrong, np.nan, beta @ back.T)
    covariance = np.where(wrong[..., None], np.nan, back @ spread @ back.T)
    return Scales(every[:, :-1], every[:, -1], covariance, back @ inverse @ back.T)


def draw(model: Observers, trials: Integers, people: int, studies: int, random: np.random.Generator) -> Integers:
    """Return choices of the first of `trials` with each ordered pair, shape (S, participants, M, M)."""
    own = model.values + model.spread * random.standard_normal((studies, people, len(model.values)))
    order = model.order + model.order_spread * random.standard_normal((studies, people, 1, 1))
    return random.binomial(trials, expit(own[..., :, None] - own[..., None, :] + order)).astype(np.int64)


def planned_trials(materials: int, repetitions: int) -> Integers:
    """Return the trials of each ordered pair of a participant: half of a pair's in either order."""
    found = np.full((materials, materials), repetitions // 2, dtype=np.int64)
    np.fill_diagonal(found, repetitions)
    return found


def answers(
    planned: Design, model: PairModel, participants: int, studies: int, random: np.random.Generator
) -> dict[Question, Answer]:
    """Return every step and the order effect of each planned scale, of studies drawn from the model."""
    found: dict[Question, Answer] = {}
    models = {one.task: one for one in model.tasks}
    for task, people in zip(planned.tasks, planned.sizes(participants), strict=True):
        if task.id not in models:
            continue
        trials = planned_trials(len(planned.materials), task.repetitions)
        fitted = finite(draw(models[task.id], trials, people, studies, random), trials.astype(np.float64))
        for number, test in enumerate(planned.tests):
            if test.test == PLANNED and task.id in test.tasks:
                for subject, p in _tested(fitted, planned.materials, models[task.id].ranks, people):
                    found[Question(number, test.test, (task.id,), subject, test.alpha)] = Answer(p=p)
    return found


def _tested(
    found: Scales, materials: tuple[str, ...], ranks: Sequence[int], people: int
) -> Iterator[tuple[str, Floats]]:
    """Yield P of every step, of all together being shown in the order of `ranks`, and of what being first adds."""
    none = np.full(len(found.order), np.nan)
    every = np.where(np.isnan(found.order) | (people < 2), np.nan, 0.0)
    for below, above in pairwise(ranks or range(len(materials))):
        contrast = np.zeros(len(materials) + 1)
        contrast[above], contrast[below] = 1.0, -1.0
        gap = found.values[:, above] - found.values[:, below]
        p = _p(gap, np.einsum("k,skl,l->s", contrast, found.covariance, contrast), people) if people > 1 else none
        every = np.maximum(every, np.where(gap < 0, 1.0, p))
        yield f"{materials[below]} to {materials[above]}", p
    yield "every step, in order", every
    yield "being first", _p(found.order, found.covariance[:, -1, -1], people) if people > 1 else none


def _p(value: Floats, variance: Floats, people: int) -> Floats:
    t = np.abs(value) / np.sqrt(np.where(variance > 1e-14, variance, np.nan))
    return np.asarray(2 * stdtr(people - 1, -t))
