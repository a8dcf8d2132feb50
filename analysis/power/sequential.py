"""Designs with several looks at the answers: stopping bounds, and what they cost and find in simulated studies.

Spending functions (Lan and DeMets 1983, Biometrika 70, 659-663) are O'Brien and Fleming's or Pocock's; bounds follow by
quadrature (Armitage, McPherson and Rowe 1969, J. R. Stat. Soc. A 132, 235-244), and apply to P. A Bayes factor design
stops at enough JZS evidence either way. Part of a participant's spread is common to all tasks and materials.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations
from pathlib import Path
from typing import Any, Literal, cast, get_args

import numpy as np
from scipy.special import betaincinv, ndtr, ndtri, stdtr

from palpate.analysis.documents import page
from palpate.analysis.documents.output import publish
from palpate.analysis.documents.tables import Column, Record, Section, tabulate
from palpate.analysis.documents.tables import text as in_terminal
from palpate.analysis.power import simulate
from palpate.analysis.power.choice_models import ChoiceModel
from palpate.analysis.power.planned_tests import ABOUT, FLIPS, Design, Model
from palpate.analysis.statistics.exact import Floats, Integers
from palpate.analysis.statistics.inference import log_bayes_factor, wilson
from palpate.analysis.statistics.sign_flips import sign_flip_tests
from palpate.experiment.errors import PowerError

Rule = Literal["obrien-fleming", "pocock", "bayes"]

MOST = 1000
"""The most participants of a study."""

NODES, CHUNK = 200, 1000
"""Nodes of the quadrature between two bounds, and the studies that are drawn at a time."""

EVIDENCE = 6.0
"""The Bayes factor, for or against, at which a design stops (Schoenbrodt and Wagenmakers 2018); ours among theirs."""


def spent(rule: Rule, fraction: float, alpha: float) -> float:
    """Return how much of a two-sided alpha is used up when this fraction of the participants is in."""
    if rule == "pocock":
        return alpha * math.log(1 + (math.e - 1) * fraction)
    return float(2 * (2 - 2 * ndtr(-ndtri(alpha / 4) / math.sqrt(fraction)))) if fraction < 1 else alpha


def bounds(rule: Rule, fractions: Sequence[float], alpha: float) -> Floats:
    """Return the two-sided normal bound of each look at these fractions of the participants, rising to 1."""
    found: list[float] = []
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    places, mass = np.zeros(1), np.ones(1)
    before, used = 0.0, 0.0
    for fraction in fractions:
        wide = math.sqrt(fraction - before)
        wanted = spent(rule, fraction, alpha) - used

        def crossing(c: float, wide: float = wide, places: Floats = places, mass: Floats = mass) -> float:
            return float(mass @ (ndtr((places - c) / wide) + ndtr((-c - places) / wide)))

        low, high = 0.0, 12.0
        while low < (middle := (low + high) / 2) < high:
            low, high = (middle, high) if crossing(middle) > wanted else (low, middle)
        found.append(middle / math.sqrt(fraction))
        new = middle * nodes
        kernel = np.exp(-(((new[:, None] - places) / wide) ** 2) / 2) / (wide * math.sqrt(2 * math.pi))
        places, mass = new, (kernel @ mass) * weights * middle
        before, used = fraction, used + wanted
    return np.array(found)


def thresholds(people: int, evidence: float) -> tuple[float, float]:
    """Return the |t| from which on BF10 is at least `evidence`, and that up to which BF01 is, or -1 where none is."""

    def where(log: float) -> float:
        low, high = 0.0, 1e3
        if log_bayes_factor(0.0, people) > log:
            return -1.0
        while low < (middle := (low + high) / 2) < high:
            low, high = (middle, high) if log_bayes_factor(middle, people) < log else (low, middle)
        return middle

    return where(math.log(evidence)), where(-math.log(evidence))


ALPHA, ALIKE = 0.05, 0.5
"""The level where no test against chance is planned, and the share of spread in common where none is given: ours."""


@dataclass(frozen=True)
class Outcome:
    """One question: the shares of studies stopped at each look with a finding, (K,), and without, by evidence for none.

    `control` are the findings of the control at each look; `mean` and `control_mean` the participants on average.
    """

    subject: str
    found: tuple[float, ...]
    none: tuple[float, ...]
    mean: float
    control: tuple[float, ...]
    control_mean: float


@dataclass(frozen=True)
class Sequential:
    """A design with looks, what it was simulated with, and its outcomes; `levels` are the P of each look, if any."""

    study: str
    source: str
    label: str
    rule: Rule
    looks: tuple[int, ...]
    alpha: float
    alike: float
    studies: int
    seed: int
    levels: tuple[float, ...]
    outcomes: tuple[Outcome, ...]


def run(
    planned: Design,
    model: Model,
    *,
    study: str,
    rule: str,
    looks: Sequence[int],
    alike: float | None,
    studies: int,
    seed: int,
    total: Callable[[int], None] = lambda _: None,
    tick: Callable[[], None] = lambda: None,
) -> Sequential:
    """Return what a design with these looks finds, in `studies` SIMULATED studies under the model and the control.

    `alike` is as in `draw`, by default `ALIKE`. `total` gets the number of steps, `tick` follows each. Raises
    `PowerError`: looks that are not two or more, rising, from 3 on, another rule, a number out of bounds, or a model of
    pairs.
    """
    if not isinstance(model, ChoiceModel):
        got, allowed = f"got comparisons of study {study}", "trials in which a material is named"
        raise PowerError("--looks", got, "leave --looks out", allowed=allowed)
    if rule not in get_args(Rule):
        raise PowerError("--rule", f"got {rule}", "give one", allowed=", ".join(get_args(Rule)))
    chosen = cast("Rule", rule)
    alike = model.together(ALIKE if alike is None else alike).alike
    simulate.check_studies(studies)
    if len(looks) < 2 or list(looks) != sorted(set(looks)) or not 3 <= looks[0] <= looks[-1] <= MOST:
        got, allowed = ", ".join(map(str, looks)), f"two or more increasing numbers of participants, from 3 to {MOST}"
        raise PowerError("--looks", f"got {got}", "give such", allowed=allowed)
    alpha = next((test.alpha for test in planned.tests if test.test == "t against chance"), ALPHA)
    levels: list[float] = []
    if chosen != "bayes":
        levels = (2 * ndtr(-bounds(chosen, [look / looks[-1] for look in looks], alpha))).tolist()
    total(2 * -(-studies // CHUNK))
    counted: dict[str, list[Floats]] = {}
    for kind in (0, 1):
        for part, first in enumerate(range(0, studies, CHUNK)):
            random = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(7, kind, part))))
            right = draw(planned, model, looks[-1], min(CHUNK, studies - first), alike, bool(kind), random)
            for subject, stops in _stopped(planned, right, chosen, looks, levels):
                held = counted.setdefault(subject, [np.zeros((2, len(looks))) for _ in range(2)])
                held[kind] += stops
            tick()
    outcomes = [
        Outcome(subject, tuple(found), tuple(none), _mean(own / studies, looks), tuple((control[0] / studies).tolist()),
                _mean(control / studies, looks))
        for subject, (own, control) in counted.items()
        for found, none in [(own / studies).tolist()]
    ]  # fmt: skip
    label = f"{simulate.LABEL}, after: {model.label}" if model.label else simulate.LABEL
    return Sequential(study, model.source, label, chosen, tuple(looks), alpha, alike, studies, seed, tuple(levels),
                      tuple(outcomes))  # fmt: skip


def draw(
    planned: Design,
    model: ChoiceModel,
    people: int,
    studies: int,
    alike: float,
    control: bool,
    random: np.random.Generator,
) -> list[Integers]:
    """Return right answers of each task, shape (materials, studies, participants), by participants who differ.

    `alike` is the share of the normal behind a participant's spread that is common to all tasks and materials.
    """
    level = random.standard_normal((studies, people))
    found = []
    for task, answers in zip(planned.tasks, model.tasks, strict=True):
        counts = np.zeros((len(planned.materials), studies, people), dtype=np.int64)
        for i in planned.places(task.id):
            spread = float(answers.spread[i])
            share = float(_chance(planned, task.id)) if control else float(answers.shares[i, i])
            own = math.sqrt(alike) * level + math.sqrt(1 - alike) * random.standard_normal((studies, people))
            shares: Any = share
            if spread > 0 and 0 < share < 1:
                shares = betaincinv(share * (1 / spread - 1), (1 - share) * (1 / spread - 1), ndtr(own))
            counts[i] = random.binomial(task.repetitions, shares, size=(studies, people))
        found.append(counts)
    return found


def _chance(planned: Design, task: str) -> Fraction:
    told = (test.chance for test in planned.tests if task in test.tasks and test.chance is not None)
    return Fraction(repr(next(told, None) or 1 / len(planned.materials))).limit_denominator(1000)


def _stopped(
    planned: Design, right: Sequence[Integers], rule: Rule, looks: Sequence[int], levels: Sequence[float]
) -> Iterator[tuple[str, Integers]]:
    """Yield how many studies stop at each look with a finding and for none, shape (2, K), by what is asked."""
    evidence = [thresholds(look, EVIDENCE) for look in looks] if rule == "bayes" else []

    def stops(values: Floats, flips: Callable[[int], Floats] | None = None) -> Integers:
        open_ = np.ones(len(values), dtype=bool)
        found = np.zeros((2, len(looks)), dtype=np.int64)
        for k, look in enumerate(looks):
            part = values[:, :look]
            sd = part.std(axis=1, ddof=1)
            t = np.abs(part.mean(axis=1)) / np.where(sd > 1e-12, sd / math.sqrt(look), np.nan)
            if rule == "bayes":
                hit, none = t >= evidence[k][0], t <= evidence[k][1]
            else:
                p = flips(look) if flips else 2 * stdtr(look - 1, -t)
                hit, none = p <= levels[k], np.zeros(len(values), dtype=bool)
            found[0, k], found[1, k] = (open_ & hit).sum(), (open_ & none).sum()
            open_ &= ~(hit | none)
        return found

    for task, counts in zip(planned.tasks, right, strict=True):
        chance = _chance(planned, task.id)
        for place in planned.places(task.id):
            name, own = f"{planned.materials[place]}, {task.id}", counts[place]
            yield name, stops(own / task.repetitions - float(chance))
            if rule != "bayes":
                trials = task.repetitions

                def flips(look: int, own: Integers = own, trials: int = trials, chance: Fraction = chance) -> Floats:
                    return sign_flip_tests(own[:, :look], trials, chance)

                yield f"{name}{FLIPS}", stops(own / trials - float(chance), flips)
    for (one, first), (other, second) in combinations(zip(planned.tasks, right, strict=True), 2):
        if places := planned.places(one.id, other.id):
            gaps = first[places].mean(axis=0) / one.repetitions - second[places].mean(axis=0) / other.repetitions
            yield f"{one.id} - {other.id}, paired (companion)", stops(gaps)


def _mean(shares: Floats, looks: Sequence[int]) -> float:
    """Return the participants on average: those who do not stop take part to the last look."""
    stopped = shares.sum(axis=0)
    stopped[-1] = 1 - stopped[:-1].sum()
    return float(stopped @ np.array(looks))


def _share(share: float, low: float, high: float) -> str:
    return f"{share:.3f} ({low:.3f}-{high:.3f})"


OUTCOMES = (
    Column("of", left=True), Column(("power", "power_low", "power_high"), "power", show=_share),
    Column(("type_i_error", "type_i_low", "type_i_high"), "type I error", show=_share),
    Column("participants", "n", 1), Column("participants_control", "n, control", 1),
)  # fmt: skip


def section(result: Sequential) -> Section:
    """Return the design and its outcomes."""
    looks = ", ".join(map(str, result.looks))
    how = {
        "obrien-fleming": "alpha is spent according to the O'Brien-Fleming function",
        "pocock": "alpha is spent according to the Pocock function",
        "bayes": f"a question stops when the Bayes factor for or against a difference is {EVIDENCE:g} or more",
    }[result.rule]
    levels = f" P must be at most {', '.join(f'{level:.5f}' for level in result.levels)}." if result.levels else ""
    paragraphs = (
        f"{result.studies} SIMULATED studies of {result.study} have looks at {looks} participants, all of whom do "
        f"every task; {how}.{levels} Seed {result.seed}. Source of the answers: {result.source}.",
        f"{ABOUT['together'].substitute(alike=f'{result.alike:g}')} In the control studies, participants differ as "
        "much but answer at chance level, so any findings are type I errors. Each question stops independently.",
    )
    found_at, none_at = (tuple(f"{what}_at_{look}" for look in result.looks) for what in ("found", "none"))
    records: list[Record] = []
    for one in result.outcomes:
        power, error = sum(one.found), sum(one.control)
        own, control = (wilson(round(share * result.studies), result.studies) for share in (power, error))
        records.append(
            {"of": one.subject, "rule": result.rule, "power": power, "power_low": own.low,
             "power_high": own.high, "type_i_error": error, "type_i_low": control.low, "type_i_high": control.high,
             "participants": one.mean,
             "participants_control": one.control_mean,
             **dict(zip(found_at, one.found, strict=True)), **dict(zip(none_at, one.none, strict=True))}
        )  # fmt: skip
    columns = (
        *OUTCOMES,
        Column(found_at, f"found at {looks}", show=lambda *shares: " ".join(f"{share:.2f}" for share in shares)),
        *([Column(none_at, "for none", show=lambda *shares: f"{sum(shares):.3f}")] if result.rule == "bayes" else []),
    )
    note = "n is the mean number of participants. Brackets show Wilson's 95 % interval for the Monte Carlo error."
    same = "If all participants have the same ratio, t is not defined and finds nothing; sign flips still have a P."
    fewest = next(people for people in range(3, MOST) if log_bayes_factor(0.0, people) <= -math.log(EVIDENCE))
    bayes = (
        "A Bayes factor is not a test: its type I error rate is not controlled and depends on the looks.",
        f"Enough evidence for no difference needs {fewest} participants or more: "
        f"{f'looks before {fewest}' if result.looks[-1] >= fewest else 'these looks'} cannot stop for no difference.",
    ) * (result.rule == "bayes")  # fmt: skip
    return Section("looks", "Design with looks", paragraphs, (tabulate("", columns, records, (note, same, *bayes)),))


def text(result: Sequential) -> str:
    """Return everything for a terminal."""
    return "\n\n\n".join([result.label, in_terminal(section(result)), result.label])


def as_dict(result: Sequential) -> dict[str, Any]:
    """Return every number, for JSON."""
    records = [dict(record) for record in section(result).records]
    return {"label": result.label, "levels": list(result.levels), "looks_rows": records}


def write(result: Sequential, out: Path) -> tuple[Path, ...]:
    """Write the table (CSV, Markdown, LaTeX) into a folder; return the files. Raises `DatasetError` as `publish`."""
    return publish(out, page.tables([section(result)], result.label), result.label, "power")
