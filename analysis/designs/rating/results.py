"""Results of ratings: means by material and participant, repeated measures, intraclass correlations, power laws.

A participant's mean ratings are what is compared; a trial is never a unit of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from palpate.analysis.reading.study import Study, Task
from palpate.analysis.statistics.exact import NotDefined
from palpate.analysis.statistics.icc import Icc, icc
from palpate.analysis.statistics.participants import Mean, Repeated, mean, repeated
from palpate.analysis.statistics.psychophysics.magnitude import Power, power_law
from palpate.experiment.errors import DatasetError
from palpate.experiment.protocol.designs.rating import Rating
from palpate.experiment.records.events import NO_ANSWER

if TYPE_CHECKING:
    import pandas as pd

UNNAMED = "what was rated"
"""What stands for the quality where a dataset holds no protocol."""


@dataclass(frozen=True)
class Rated:
    """A material's mean rating over participants, each with their own mean of so many trials together."""

    material: str
    trials: int
    mean: Mean | None


@dataclass(frozen=True)
class Person:
    """A participant's mean rating of each material, None where there is none, and the power law of their ratings."""

    participant: str
    means: tuple[float | None, ...]
    power: Power | None
    statement: str


@dataclass(frozen=True)
class TaskRatings:
    """The ratings of one task; each statement says why what it stands beside is None."""

    task: Task
    trials: int
    unanswered: int
    response_time_s: float | None
    rated: tuple[Rated, ...]
    people: tuple[Person, ...]
    repeated: Repeated | None
    icc: Icc | None
    statement: str
    exponent: Mean | None
    power_statement: str


@dataclass(frozen=True)
class Ratings:
    """Everything that a study of ratings gives; `magnitudes` are those of the materials that have one, in `unit`."""

    materials: tuple[str, ...]
    quality: str
    unit: str | None
    magnitudes: dict[str, float]
    tasks: tuple[TaskRatings, ...]

    def __repr__(self) -> str:
        return f"<Ratings of {self.quality}: {'; '.join(f'{one.task.id}, {one.trials} trials' for one in self.tasks)}>"

    def to_frame(self) -> pd.DataFrame:
        """Return a row for each task and material: trials, participants, their mean, its SD and 95 % interval."""
        import pandas as pd

        rows = [
            {"task": task.task.id, "material": one.material, "magnitude": self.magnitudes.get(one.material),
             "trials": one.trials, "n": one.mean.n if one.mean else 0,
             "mean": getattr(one.mean, "value", None),
             **{key: getattr(one.mean, key, None) for key in ("sd", "low", "high")}}
            for task in self.tasks
            for one in task.rated
        ]  # fmt: skip
        return pd.DataFrame(rows).astype(dict.fromkeys(("magnitude", "mean", "sd", "low", "high"), "float64"))

    def means(self) -> pd.DataFrame:
        """Return a row for each participant, task and material with a rating: their mean rating."""
        import pandas as pd

        rows = [
            (one.participant, task.task.id, material, self.magnitudes.get(material), value)
            for task in self.tasks
            for one in task.people
            for material, value in zip(task.task.presented, one.means, strict=True)
            if value is not None
        ]
        frame = pd.DataFrame(rows, columns=["participant", "task", "material", "magnitude", "mean"])
        return frame.astype({"magnitude": "float64", "mean": "float64"})


def compute(study: Study) -> Ratings:
    """Return every result of a study of ratings. Raises `DatasetError` for answers that are no numbers."""
    answers = {answer for one in study.designs.values() for answer in one.answers}
    if strange := [answer for answer in sorted(answers) if not _is_number(answer)]:
        raise DatasetError(
            f"study {study.id}", f"got the ratings {', '.join(strange)}", "rebuild the dataset", allowed="numbers"
        )
    plans = [rating for part in study.parts if part.protocol and (rating := part.protocol.find(Rating))]
    if any(one != plans[0] for one in plans[1:]):
        raise DatasetError(
            f"study {study.id}",
            "got datasets whose ratings have different scales, qualities or magnitudes",
            "analyze each separately",
            allowed="one table [rating]",
        )
    magnitudes = {one.material: one.value for plan in plans[:1] for one in plan.magnitudes}
    quality, unit = (plans[0].quality, plans[0].unit) if plans else (UNNAMED, None)
    tasks = tuple(_task(study, task, magnitudes) for task in study.tasks if len(study.trials(task.id)))
    return Ratings(study.materials, quality, unit, magnitudes, tasks)


def _is_number(answer: str) -> bool:
    try:
        return bool(np.isfinite(float(answer)))
    except ValueError:
        return False


def _task(study: Study, task: Task, magnitudes: dict[str, float]) -> TaskRatings:
    trials = study.trials(task.id)
    rated = trials[trials["answered"] != NO_ANSWER]
    numbers = rated.assign(rating=rated["answered"].astype("float64"))
    present = set(rated["participant"])
    table = numbers.pivot_table("rating", "participant", "presented").reindex(
        index=[who for who in study.participants if who in present], columns=list(task.presented)
    )
    people = tuple(_person(who, row, rated, magnitudes) for who, row in zip(table.index, table.to_numpy(), strict=True))
    whole = table.dropna().to_numpy()
    found, agreement, statement = None, None, ""
    try:
        (found,) = repeated(whole, ("materials",))
        agreement = icc(whole.T.tolist())
    except NotDefined as error:
        statement = str(error)
    exponents = np.array([one.power.exponent for one in people if one.power])
    why = "" if len(exponents) else next((one.statement for one in people), "there are no ratings")
    times = rated["response_time_s"].dropna()
    return TaskRatings(
        task=task,
        trials=len(trials),
        unanswered=len(trials) - len(rated),
        response_time_s=float(times.median()) if len(times) else None,
        rated=tuple(_material(name, table[name].dropna().to_numpy(), rated) for name in task.presented),
        people=people,
        repeated=found,
        icc=agreement,
        statement=statement,
        exponent=mean(exponents) if len(exponents) else None,
        power_statement=why,
    )


def _material(name: str, means: np.ndarray, rated: pd.DataFrame) -> Rated:
    return Rated(name, int((rated["presented"] == name).sum()), mean(means) if len(means) else None)


def _person(who: str, means: np.ndarray, rated: pd.DataFrame, magnitudes: dict[str, float]) -> Person:
    own = rated[rated["participant"] == who]
    known = tuple(None if np.isnan(one) else float(one) for one in means)
    if not magnitudes:
        return Person(who, known, None, "the protocol does not state magnitudes")
    try:
        x, y = (np.array(one, dtype=np.float64) for one in (own["presented"].map(magnitudes), own["answered"]))
        return Person(who, known, power_law(x, y), "")
    except NotDefined as error:
        return Person(who, known, None, str(error))
