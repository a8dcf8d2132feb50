"""Was the sound masked? Answers to tasks whose vibration sounds and is not felt, against chance, apart from others.

Whoever knows such a stimulus has heard it. If nobody does, each answer is a guess, right with chance: all right answers
together, and those of each participant, are binomial but for the balance of the order, which makes their variance
n/(n - 1) of it at most. A share is shown to be at chance where its interval over participants ends less than a margin
above chance.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Literal

import numpy as np
from scipy.special import bdtrc

from palpate.analysis.documents.tables import (
    Column,
    Record,
    Section,
    bounds,
    joined,
    p_is,
    plural,
    probability,
    tabulate,
)
from palpate.analysis.reading.study import Study, chance
from palpate.analysis.statistics.exact import NotDefined
from palpate.analysis.statistics.inference import holm
from palpate.analysis.statistics.shares import Limits, first_limits
from palpate.analysis.statistics.sign_flips import sign_flip

if TYPE_CHECKING:
    from palpate.experiment.protocol.models import Control

ALPHA = 0.025
"""Of the test of all answers, and of that of single participants: a control that nobody hears warns in 5 % at most."""

COLUMNS = (
    Column("task", left=True), Column("of", "control of", left=True), Column("participants"), Column("trials"),
    Column("right"), Column("share"), Column(("low", "high"), "95 % CI", show=lambda *ends: bounds(Limits(*ends))),
    Column("chance"), Column("margin"), Column("p_binomial", "binomial: P", show=probability),
    Column("p_sign_flip", "sign flips: P", show=probability),
    Column("p_single", "lowest P of a participant", show=probability), Column("verdict", left=True),
)  # fmt: skip

Verdict = Literal["at chance", "above chance", "not shown"]


@dataclass(frozen=True)
class Controlled:
    """What a control shows of the task `of`.

    `right` of `trials` are of all `participants`, `share` is the mean over them. `p_binomial` and `p_single`, the least
    of any participant, Holm-adjusted, are one-sided; `above` are participants whose own is below `ALPHA`. `p_sign_flip`
    is two-sided and decides nothing.
    """

    task: str
    of: str
    participants: int
    trials: int
    right: int
    share: float
    interval: Limits | None
    chance: float
    margin: float
    p_binomial: float
    p_sign_flip: float
    p_single: float
    above: tuple[str, ...]

    @property
    def verdict(self) -> Verdict:
        """Whether answers are shown to be at chance, or above, or neither."""
        if min(self.p_binomial, self.p_single) < ALPHA:
            return "above chance"
        high = None if self.interval is None else self.interval.high
        return "at chance" if high is not None and high < self.chance + self.margin else "not shown"

    @property
    def sentence(self) -> str:
        """The verdict in words, with share, interval and tests."""
        limits = "" if self.interval is None else f", 95 % CI {bounds(self.interval)}"
        found = (
            f"{self.right} of {plural(self.trials, 'trial')} right, mean proportion {self.share:.3f}{limits}, chance "
            f"{self.chance:.4g}, exact binomial {p_is(self.p_binomial)}, sign-flip test {p_is(self.p_sign_flip)}"
        )
        name = f"{self.task}, a control of {self.of},"
        match self.verdict:
            case "at chance":
                return f"Task {name} was at chance, within {self.margin:g}: {found}."
            case "above chance":
                who = f" Above chance individually: {joined(self.above)}." if self.above else ""
                return (
                    f"Warning: task {name} was above chance ({found}). Nothing could be felt in that task, so "
                    f"participants may have answered {self.of} by sound.{who}"
                )
            case _:
                return (
                    f"Warning: task {name} was not shown to be at chance, within {self.margin:g}: {found}. "
                    f"The sound of {self.of} may not have been masked."
                )


def apart(study: Study) -> tuple[Study, tuple[Controlled, ...]]:
    """Return a study without its controls, and what these show; a study of controls alone as it is."""
    controls = _controls(study)
    left = ~study.attempts["task"].isin(controls)
    if not controls or not (study.attempts["included"] & left).any():
        return study, ()
    rest = replace(
        study,
        attempts=study.attempts[left].reset_index(drop=True),
        tasks=tuple(task for task in study.tasks if task.id not in controls),
        designs={task: one for task, one in study.designs.items() if task not in controls},
        touched={key: one for key, one in study.touched.items() if key[1] not in controls},
    )
    found = (_controlled(study, task, control) for task, control in controls.items())
    return rest, tuple(one for one in found if one is not None)


def _controls(study: Study) -> dict[str, Control]:
    protocols = [part.protocol for part in study.parts if part.protocol is not None]
    known = {task.id: task.control for one in protocols for task in one.tasks if task.control is not None}
    return {task.id: known[task.id] for task in study.tasks if task.id in known}


def _controlled(study: Study, task: str, control: Control) -> Controlled | None:
    from palpate.analysis.identification.confusion import confusion_of

    matrix = confusion_of(study, task)
    trials = matrix.counts.sum(axis=(1, 2))
    right = np.trace(matrix.counts, axis1=1, axis2=2)
    if not trials.sum():
        return None
    guessed = chance(study, task)
    own = holm(np.array([_p_above(int(a), int(n), guessed) for a, n in zip(right, trials, strict=True)]))
    shares = right / trials
    try:
        interval = first_limits(right, trials, float(guessed))
    except NotDefined:
        interval = None
    return Controlled(
        task=task,
        of=control.of,
        participants=len(trials),
        trials=int(trials.sum()),
        right=int(right.sum()),
        share=float(shares.mean()),
        interval=interval,
        chance=float(guessed),
        margin=control.margin,
        p_binomial=_p_above(int(right.sum()), int(trials.sum()), guessed),
        p_sign_flip=sign_flip(shares.tolist(), guessed, np.random.default_rng(1)).p,
        p_single=float(own.min()),
        above=tuple(who for who, p in zip(matrix.participants, own, strict=True) if p < ALPHA),
    )


def _p_above(right: int, trials: int, guessed: Fraction) -> float:
    """Return the probability that guesses are right so often or more often."""
    return float(bdtrc(right - 1, trials, float(guessed))) if right else 1.0


def control_section(found: tuple[Controlled, ...]) -> tuple[Section, ...]:
    """Return what controls show, in sentences and one table; none without a control."""
    if not found:
        return ()
    text = (
        "In a control task, the vibration sounds as it does in the other task but does not reach the skin. P of the "
        "binomial test and of single participants (Holm) is exact and one-sided; its null hypothesis is that "
        "everyone guesses. Control tasks are left out of every other section."
    )
    records = [*_records(found)]
    table = tabulate("Controls", COLUMNS, records, standing="planned")
    return (Section("control", "Was the sound masked?", (*(one.sentence for one in found), text), (table,)),)


def _records(found: tuple[Controlled, ...]) -> Iterator[Record]:
    for one in found:
        limits = one.interval
        yield {
            "task": one.task, "of": one.of, "participants": one.participants, "trials": one.trials, "right": one.right,
            "share": one.share, "low": limits and limits.low, "high": limits and limits.high, "chance": one.chance,
            "margin": one.margin, "p_binomial": one.p_binomial, "p_sign_flip": one.p_sign_flip,
            "p_single": one.p_single, "verdict": one.verdict,
        }  # fmt: skip
