"""Rating: a trial presents one material, and asks how much of a quality it has.

A study whose answers are numbers comes in. Mean ratings by material and participant, repeated measures, intraclass
correlations and power laws go out, with the sections and figures that show them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from palpate.analysis.designs import AnalysisDesign, Described
from palpate.analysis.designs.rating import results
from palpate.analysis.designs.rating.results import UNNAMED, Ratings, TaskRatings
from palpate.analysis.documents.page import ON_METHODS
from palpate.analysis.documents.tables import (
    Asked,
    Column,
    Record,
    Section,
    formulas,
    number,
    p_is,
    plural,
    span,
    tabulate,
)
from palpate.analysis.published.numbers import Published
from palpate.analysis.reading.dataset import Say
from palpate.analysis.reading.study import Study
from palpate.analysis.report import plan
from palpate.analysis.report.answers import left_and_sure
from palpate.analysis.report.heard import heard_sections
from palpate.experiment.errors import DatasetError

if TYPE_CHECKING:
    import pandas as pd

    from palpate.analysis.statistics.icc import IccForm
    from palpate.experiment.protocol.models import PlannedTest

MEANS, AGREEMENT, POWER = "mean ratings", "agreement of ratings", "power law"
"""The tests that a protocol may plan."""

QUESTIONS = {
    MEANS: "Do the materials differ in {}?",
    AGREEMENT: "How well do participants agree on {}?",
    POWER: "With what exponent does {} grow?",
}
"""What a test asks where no protocol words it."""

OF_MATERIALS = (
    Column("task", left=True), Column("material", left=True),
    Column("magnitude", show=lambda one: "-" if one is None else f"{one:g}"),
    Column("n", "participants"), Column("trials"), Column("mean", decimals=2), Column("sd", decimals=2),
    Column(("low", "high"), "95 % CI", 2),
)  # fmt: skip
FORMS = (
    Column("task", left=True), Column("mcgraw_wong", "form", left=True), Column("model", left=True),
    Column("value", "ICC", 2), Column(("low", "high"), "95 % CI", 2),
)  # fmt: skip
EXPONENTS = (
    Column("task", left=True), Column("participant", left=True), Column("exponent", decimals=2),
    Column("constant", decimals=2), Column("r_squared", "r²", 2), Column("statement", "", left=True, show=str),
)  # fmt: skip


def sections(study: Study, found: Ratings, printed: Published | None, _: Section | None) -> tuple[Section, ...]:
    """Return every section, in reading order: what was found, what was planned, results by their standing, checks."""
    stands = plan.standing(study, printed)
    ids = [task.task.id for task in found.tasks]
    parts = {
        stands.results: (
            plan.marked(_means(found), plan.mark_of(stands, MEANS, ids)),
            plan.marked(_people(found), plan.DESCRIPTIVE),
            plan.marked(_agreement(found), plan.mark_of(stands, AGREEMENT, ids)),
            plan.marked(_power(found), plan.mark_of(stands, POWER, ids)),
        ),
        plan.EXCLUDED: (plan.exclusions_section(study),),
        ON_METHODS: tuple(plan.marked(one, plan.DESCRIPTIVE) for one in heard_sections(study)),
    }
    return (
        _answers(study, found, stands),
        _overview(study, found),
        *(replace(section, part=part) for part, of in parts.items() for section in of),
    )


def _answers(study: Study, found: Ratings, stands: plan.Standing) -> Section:
    """Return each planned test with its one answer, or else those that the ratings allow."""
    planned = {(test.test, test.tasks): plan.first_question(test) for test in study.plans()}
    ids = tuple(task.task.id for task in found.tasks)
    if not planned:
        tests = [MEANS, AGREEMENT, *[POWER] * bool(found.magnitudes)]
        planned = {(test, ids): QUESTIONS[test].format(found.quality) for test in tests}
    asked = tuple(
        Asked(
            question,
            _sentences(test, found, tasks),
            stands.mark(test, *tasks),
        )
        for (test, tasks), question in planned.items()
    )
    return Section("answers", "Questions and answers", (left_and_sure(study),), asked=asked)


def _sentences(test: str, found: Ratings, tasks: Sequence[str]) -> str:
    return " ".join(_answer(test, task) for task in found.tasks if task.task.id in tasks)


def _answer(test: str, task: TaskRatings) -> str:
    """Return the answer of one task in a sentence."""
    name = task.task.id
    if test == POWER:
        if (exponent := task.exponent) is None:
            return f"{name}: no exponent, because {task.power_statement}."
        limits = "" if exponent.low is None else f" ({span(exponent.low, exponent.high, 2)})"
        return (
            f"{name}: the mean exponent of {plural(exponent.n, 'participant')} is {number(exponent.value, 2)}{limits}."
        )
    if task.repeated is None or task.icc is None:
        return f"{name}: no answer, because {task.statement}."
    if test == AGREEMENT:
        one = _form(task, "ICC(A,1)")
        limits = span(one.low, one.high, 2)
        return f"{name}: ICC(A,1) = {number(one.value, 2)} ({limits}) from {task.icc.raters} participants."
    return f"{name}: {_f(task)}; {_extremes(task)}."


def _form(task: TaskRatings, name: str) -> IccForm:
    return next(one for one in (task.icc.forms if task.icc else ()) if one.mcgraw_wong == name)


def _f(task: TaskRatings) -> str:
    of = task.repeated
    if of is None or of.f is None or of.p is None or of.epsilon is None:
        return "F is not defined"
    return f"F({of.df1 * of.epsilon:.2f}, {of.df2 * of.epsilon:.2f}) = {of.f:.2f}, {p_is(of.p)}"


def _extremes(task: TaskRatings) -> str:
    known = sorted((one.mean.value, one.material) for one in task.rated if one.mean)
    (least, low), (most, high) = known[0], known[-1]
    return f"mean ratings range from {number(least, 2)} ({low}) to {number(most, 2)} ({high})"


def _overview(study: Study, found: Ratings) -> Section:
    rows = tuple(
        {"task": task.task.id, "title": task.task.title, "participants": len(task.people), "trials": task.trials,
         "without_answer": task.unanswered}
        for task in found.tasks
    )  # fmt: skip

    def done(test: PlannedTest) -> str:
        return (
            " ".join(_answer(test.test, task) for task in found.tasks if task.task.id in test.tasks)
            or "not run: no trials"
        )

    section = plan.overview(study, rows, done, (AGREEMENT, POWER))
    of = "" if found.quality == UNNAMED else f" by their {found.quality}"
    times = [
        f"In {task.task.id}, the median response time was {task.response_time_s:.2f} s."
        for task in found.tasks
        if task.response_time_s is not None
    ]
    first, *rest = section.paragraphs
    return replace(section, paragraphs=(first, f"Materials were rated{of}.", *times, *rest))


def _means(found: Ratings) -> Section:
    records: list[Record] = [
        {"task": task.task.id, "material": one.material,
         **({"magnitude": found.magnitudes.get(one.material)} if found.magnitudes else {}),
         "trials": one.trials, "n": one.mean.n if one.mean else 0, "mean": one.mean and one.mean.value,
         "sd": one.mean and one.mean.sd, "low": one.mean and one.mean.low, "high": one.mean and one.mean.high}
        for task in found.tasks
        for one in task.rated
    ]  # fmt: skip
    notes = ["Means of the participants' means; SD and interval are across participants."]
    notes += [f"Magnitudes are in {found.unit}."] * bool(found.magnitudes)
    tests = tuple(
        f"{task.task.id}: {_f(task)}{f' ({task.statement})' if task.statement else ''}." for task in found.tasks
    )
    return Section("ratings", "Mean ratings", tests, (tabulate("Mean ratings", OF_MATERIALS, records, notes),))


def _people(found: Ratings) -> Section:
    columns = (
        Column("task", left=True),
        Column("participant", left=True),
        *(Column(name, decimals=2) for name in found.materials),
    )
    records: list[Record] = [
        {"task": task.task.id, "participant": f"sub-{one.participant}",
         **dict(zip(task.task.presented, one.means, strict=True))}
        for task in found.tasks
        for one in task.people
    ]  # fmt: skip
    return Section("people", "Each participant", (), (tabulate("Mean ratings of each participant", columns, records),))


def _agreement(found: Ratings) -> Section:
    records: list[Record] = [
        {"task": task.task.id, **asdict(form)} for task in found.tasks if task.icc for form in task.icc.forms
    ]
    missing = tuple(f"{task.task.id}: no ICC, because {task.statement}." for task in found.tasks if task.icc is None)
    tables = (tabulate("Agreement of participants on the materials", FORMS, records),) if records else ()
    return Section("agreement", "Agreement", missing, tables)


def _power(found: Ratings) -> Section:
    records: list[Record] = [
        {"task": task.task.id, "participant": f"sub-{one.participant}",
         **(asdict(one.power) if one.power else dict.fromkeys(("exponent", "constant", "r_squared"))),
         "statement": one.statement}
        for task in found.tasks
        for one in task.people
    ]  # fmt: skip
    said = tuple(_answer(POWER, task) for task in found.tasks)
    tables = (tabulate("Power law of each participant", EXPONENTS, records),) if found.magnitudes else ()
    return Section("power-law", "Power law", said, tables)


def methods() -> tuple[tuple[str, str], ...]:
    """Return the name and formula of everything that these sections hold."""
    return formulas(Path(__file__).with_name("methods.md"))


def _compute(study: Study, _: Published | None, dissimilarities: Path | None, _say: Say) -> Ratings:
    if dissimilarities is not None:
        raise DatasetError(study.id, "got --dissimilarities and ratings", "leave it out", allowed="one of them")
    return results.compute(study)


def _numbers(found: Ratings) -> dict[str, Any]:
    return {"quality": found.quality, "unit": found.unit, "magnitudes": found.magnitudes, "tasks": found.tasks}


def _export(
    study: Study, frame: pd.DataFrame, exclusions: pd.DataFrame
) -> tuple[Mapping[str, pd.DataFrame], Described]:
    found = results.compute(study)
    answers = {answer for one in study.designs.values() for answer in one.answers}
    frame["rating"] = frame["answered"].where(frame["answered"].isin(answers)).astype("float64")
    frame["magnitude"] = frame["presented"].map(found.magnitudes).astype("float64")
    return {"trials.csv": frame, "ratings.csv": found.means(), "exclusions.csv": exclusions}, {}


DESIGN = AnalysisDesign(
    name="rating",
    trials="ratings",
    function="rate",
    compute=_compute,
    sections=sections,
    numbers=_numbers,
    further=lambda _: (),
    methods=methods,
    export=_export,
    figures="palpate.analysis.designs.rating.figures",
    power="palpate.analysis.power.ratings",
)
