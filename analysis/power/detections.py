"""Simulated studies of detection at one level: observers without a bias, whose d' differs.

Signals are felt with normal noise of one variance. d' and its mean over participants are those of `detection.results`;
that it is other than 0 is tested by Student's t.
"""

from dataclasses import dataclass, replace
from math import sqrt
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field
from scipy.special import ndtr, ndtri, stdtr

from palpate.analysis.designs.detection import results
from palpate.analysis.documents.tables import Column, Record, tabulate
from palpate.analysis.power.planned_tests import Answer, Answers, Design, Model, Question, Shown
from palpate.analysis.power.stated import StatedValue, by_task, other_study
from palpate.analysis.published.numbers import Published
from palpate.analysis.reading import dataset
from palpate.analysis.statistics.exact import Floats
from palpate.experiment.errors import PowerError
from palpate.experiment.protocol.designs.detection import Detection, signals
from palpate.experiment.protocol.models import Protocol, Task
from palpate.experiment.settings import load
from palpate.experiment.settings.load import Confined, Text

PLANNED = "sensitivity"

PRINTED = "answers to signals"
"""What print has of answers."""

NUMBERS = "1.5,0.5: the mean d' of every signal, and the SD of d' across participants"
"""What two numbers say."""

VALUES = Column("task", left=True), Column("signal", left=True), Column("value", "mean d'"), Column("spread", "SD")


@dataclass(frozen=True)
class Detectors:
    """Observers in one task: the mean d' of each signal, the SD among participants, and the trials of each of them.

    `shown` are trials of each signal, `others` those without one: catch trials, or with two intervals the half of the
    trials in which it is the second.
    """

    task: str
    values: dict[str, float]
    spread: float
    shown: int
    others: int
    two_intervals: bool


@dataclass(frozen=True)
class DetectionModel(Model):
    """How participants detect the signals of every task without levels whose d' is planned."""

    tasks: tuple[Detectors, ...]

    has_stars = False
    undefined = "no variance"
    control_name = "undetected"

    def control(self, _: Protocol) -> "DetectionModel":
        """Return observers who detect nothing on average, and who differ as much."""
        source = "signals with a mean d' of 0, with the same spread across participants"
        tasks = tuple(replace(one, values=dict.fromkeys(one.values, 0.0)) for one in self.tasks)
        return replace(self, source=source, tasks=tasks)

    def answers(self, planned: Design, participants: int, studies: int, random: np.random.Generator) -> Answers:
        """Return the answers to each question; no family is counted."""
        found: dict[Question, Answer] = {}
        sizes = dict(zip((task.id for task in planned.tasks), planned.sizes(participants), strict=True))
        for one in self.tasks:
            people = sizes[one.task]
            mean, p = _tested(draw(one, people, studies, random), people)
            for number, test in enumerate(planned.tests):
                if test.test != PLANNED or one.task not in test.tasks:
                    continue
                for place, signal in enumerate(one.values):
                    asked = number, test.test, (one.task,)
                    found[Question(*asked, f"{signal}: d' other than 0", test.alpha)] = Answer(p=p[..., place])
                    found[Question(*asked, f"{signal}: mean d'", None)] = Answer(estimate=mean[..., place])
        return found, {}

    def shown(self, planned: Design, said: tuple[str, ...]) -> Shown:  # noqa: ARG002
        """Return the mean d' of each signal in each task, and the SD among participants."""
        trials = "; ".join(f"{one.task}: {one.shown} of each signal, {one.others} without it" for one in self.tasks)
        about = (
            "Observers have no bias, and d' is normally distributed across participants; the table shows its mean and "
            f"SD. Trials per participant: {trials}. No one withdraws, and no exclusion rule is applied."
        )
        records: list[Record] = [
            {"task": one.task, "signal": signal, "value": value, "spread": one.spread}
            for one in self.tasks for signal, value in one.values.items()
        ]  # fmt: skip
        return (said[0], about, *said[2:]), (tabulate("Model of detection", VALUES, records),)


def draw(one: Detectors, people: int, studies: int, random: np.random.Generator) -> Floats:
    """Return d' of each participant and signal as it is analysed, shape (S, participants, signals)."""
    own = np.array(list(one.values.values()))
    own = own + one.spread * random.standard_normal((studies, people, len(own)))
    if one.two_intervals:
        hit, alarm = ndtr(own / sqrt(2)), ndtr(-own / sqrt(2))
    else:
        # One criterion for all signals, which is amid their mean and nothing.
        criterion = own.mean(axis=-1, keepdims=True) / 2
        hit, alarm = ndtr(own - criterion), ndtr(-criterion)
    hits, alarms = random.binomial(one.shown, hit), random.binomial(one.others, alarm)
    apart = ndtri((hits + 0.5) / (one.shown + 1)) - ndtri((alarms + 0.5) / (one.others + 1))
    return np.asarray(apart / (sqrt(2) if one.two_intervals else 1.0))


def _tested(d: Floats, people: int) -> tuple[Floats, Floats]:
    """Return mean and P over participants, each of shape (S, signals)."""
    mean = d.mean(axis=1)
    sd = d.std(axis=1, ddof=1) if people > 1 else np.full_like(mean, np.nan)
    t = mean / (np.where(sd > 1e-12, sd, np.nan) / sqrt(people))
    return mean, np.asarray(2 * stdtr(people - 1, -np.abs(t)))


def _planned(protocol: Protocol) -> list[Task]:
    """Return the tasks without levels whose d' is planned. Raises `PowerError` without any, or without catch trials."""
    named = {task for test in protocol.analysis if test.test == PLANNED for task in test.tasks}
    found = [task for task in protocol.tasks if task.id in named and task.levels is None]
    own = protocol.table(Detection)
    if not found or (own.intervals == 1 and not own.catch_trials):
        got = "got catch_trials = 0" if found else f"got no planned {PLANNED} for a task without levels"
        raise PowerError(f"study {protocol.study.id}", got, "plan it", allowed="d', with trials that have no signal")
    return found


def _detectors(protocol: Protocol, task: Task, values: dict[str, float], spread: float) -> Detectors:
    own = protocol.table(Detection)
    each, two = task.repetitions * own.signal_trials, own.intervals == 2
    shown, others = (each // 2, each // 2) if two else (each, task.repetitions * own.catch_trials)
    return Detectors(task.id, values, spread, shown, others, two)


def observer(d: float, spread: float, protocol: Protocol) -> DetectionModel:
    """Return observers with a mean d' of every signal, and an SD among them."""
    tasks = tuple(
        _detectors(protocol, task, dict.fromkeys(signals(protocol, task), d), spread) for task in _planned(protocol)
    )
    return DetectionModel(f"a mean d' of {d:g}, with an SD of {spread:g} across participants", tasks)


class StatedDetection(Confined):
    """A model of detection as a file states it: the mean d' of each signal, and its SD among participants."""

    format: Literal[1]
    source: Text
    spread: Annotated[float, Field(ge=0)]
    values: Annotated[tuple[StatedValue, ...], Field(min_length=1)]


def stated(file: Path, protocol: Protocol) -> DetectionModel:
    """Return the model of a TOML file."""
    own = load.read(file, StatedDetection)
    tasks = []
    for task in _planned(protocol):
        ids = signals(protocol, task)
        ((_, at),) = by_task(file, own.values, [task.id], ids)
        values = dict(zip(ids, at.tolist(), strict=True))
        tasks.append(_detectors(protocol, task, values, own.spread))
    return DetectionModel(f"stated in {file.name}: {own.source}", tuple(tasks))


def from_print(printed: Published, _: Protocol) -> DetectionModel:
    """Raise `PowerError`: palpate holds no printed detections."""
    allowed = f"a dataset, or {NUMBERS}"
    raise PowerError(f"the tables of {printed.study}", f"got no {PRINTED}", "choose another --model", allowed=allowed)


def fitted(folder: Path, protocol: Protocol) -> DetectionModel:
    """Return the observers of a dataset: means of d', and the SD that exceeds what d' of few trials varies by."""
    study = dataset.read(folder)
    if study.design != protocol.tasks[0].design:
        raise other_study(folder, PRINTED, NUMBERS)
    found = {of.task.id: of.tracks for of in results.compute(study).tasks}
    tasks = []
    for task in _planned(protocol):
        values, spreads = dict[str, float](), list[float]()
        for signal in signals(protocol, task):
            own = [one.by_level[0].d for one in found.get(task.id, ()) if one.signal == signal and one.by_level]
            d = np.array([(one.d, one.se or 0.0) for one in own if one is not None]).reshape(-1, 2)
            if len(d) < 2:
                got, allowed = f"got d' of {signal} from {len(d)} participants", "two or more"
                raise PowerError(f"{folder}, task {task.id}", got, "give two numbers", allowed=allowed)
            values[signal] = float(d[:, 0].mean())
            spreads.append(float(d[:, 0].var(ddof=1) - (d[:, 1] ** 2).mean()))
        tasks.append(_detectors(protocol, task, values, sqrt(max(float(np.mean(spreads)), 0.0))))
    label = f" ({study.label})" if study.label else ""
    source = f"fitted to the answers in {folder.name}{label}"
    return DetectionModel(source, tuple(tasks), label=study.label)
