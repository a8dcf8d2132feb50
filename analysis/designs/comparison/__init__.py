"""Comparison: a trial presents two materials, and asks in which of them there is more of something.

A study whose answers are places in a pair comes in. For each task, the shares of right choices, what presenting a
sample first adds, and scales of what was compared go out, each with its interval or the reason why there is none, with
the sections and figures that show them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from palpate.analysis.designs import AnalysisDesign, Described
from palpate.analysis.designs.comparison import results
from palpate.analysis.designs.comparison.by_number import REDUCED, WORDS, crossovers, delays, factors
from palpate.analysis.designs.comparison.estimates import Estimate
from palpate.analysis.designs.comparison.force import force_sections
from palpate.analysis.designs.comparison.results import (
    AUTHORS,
    LAWS,
    UNNAMED,
    Compared,
    Scaled,
    Share,
    TaskComparisons,
    choices_words,
    first_scale,
    more,
    percent,
)
from palpate.analysis.designs.comparison.unordered import each
from palpate.analysis.documents.page import ON_METHODS
from palpate.analysis.documents.tables import (
    Asked,
    Column,
    Record,
    Section,
    Table,
    blocks,
    count_of,
    crossed,
    ends,
    formulas,
    interval,
    joined,
    number,
    p_is,
    plural,
    tabulate,
    without_keys,
)
from palpate.analysis.published.numbers import Published
from palpate.analysis.reading.dataset import Say
from palpate.analysis.reading.study import Study
from palpate.analysis.report import plan
from palpate.analysis.report.answers import FEW, left_and_sure
from palpate.analysis.report.heard import heard_sections
from palpate.experiment.errors import DatasetError
from palpate.experiment.protocol.designs import comparison as asked

if TYPE_CHECKING:
    from palpate.experiment.protocol.models import PlannedTest

ABOUT = blocks(Path(__file__).with_name("about.md"))

NEIGHBORS = (
    Column("task", left=True), Column("of", "neighbours", left=True), Column(("right", "trials"), show=count_of),
    Column("share", "", show=lambda share: "-" if share is None else f"{100 * share:.0f} %"),
    Column("step", decimals=2), Column(("low", "high"), "95 % CI", 2),
)  # fmt: skip


def _with_interval(share: Share) -> str:
    if share.interval is None:
        return "-"
    return f"{percent(share)} ({100 * share.interval.low:.0f} to {100 * share.interval.high:.0f})"


BESIDE_PRINT = (
    Column(("high", "low"), "pair", show="{} and {}".format, left=True), Column("printed"),
    Column("percent", "here", show=lambda here: "-" if here is None else f"{here:.0f}%"),
    Column(("percent", "printed_percent"), "difference",
           show=lambda here, printed: "-" if here is None else f"{here - printed:+.0f}"),
)  # fmt: skip
PEOPLE = (
    Column("participant", show=lambda who: who.removeprefix("sub-"), left=True),
    Column("share_right", "right, of two materials", show=_with_interval),
    Column("share_first", "first, of one material", show=_with_interval),
)  # fmt: skip
VALUES = (
    Column("of", "material", left=True), Column("value", decimals=2), Column(("low", "high"), "95 % CI", 2),
    Column("step", "above the previous", 2), Column(("step_low", "step_high"), "95 % CI", 2),
)  # fmt: skip
FIT = ABOUT["fit"].substitute()


def sections(study: Study, results: Compared, printed: Published | None) -> tuple[Section, ...]:
    """Return every section, in reading order: what was found, what was planned, results by their standing, checks."""
    stands = plan.standing(study, printed)
    in_print = [task for task in results.tasks if task.in_print is not None]
    beside = (_in_print(study, results, in_print),) if in_print else ()
    pairs = _pairs(results)
    # Right choices are printed, or lie behind a planned scale.
    tests = (plan.PAIRS, *map(str.title, LAWS))
    against = [stands.of_any(tests, task.task.id) for task in results.tasks]
    parts = {
        stands.results: (
            plan.marked(pairs, *against),
            _scales(results, stands),
            *factors(results, stands),
            *delays(results, stands),
            *crossovers(results, stands),
        ),
        "Exploratory": (plan.marked(_bias(results), plan.EXPLORATORY),),
        plan.EXCLUDED: (plan.exclusions_section(study),),
        ON_METHODS: tuple(
            plan.marked(one, plan.DESCRIPTIVE) for one in (*beside, *force_sections(study), *heard_sections(study))
        ),
    }
    return (
        _answers(study, results, stands),
        _answers_section(study, results, ", ".join(dict.fromkeys(against))),
        _overview(study, results),
        *(replace(section, part=part) for part, of in parts.items() for section in of),
    )


def _answers(study: Study, results: Compared, stands: plan.Standing) -> Section:
    """Return the planned scales, or else the first of each task, with their steps and what weakens them."""
    planned: dict[tuple[str, tuple[str, ...]], str] = {
        (test.test, test.tasks): plan.first_question(test) for test in study.plans()
    }
    for task in results.tasks if not planned else ():
        of = "what was compared" if results.quality == UNNAMED else results.quality
        planned[task.scales[0].law.title(), (task.task.id,)] = f"How far apart in {of} are the materials?"
    asked = []
    for (law, tasks), question in planned.items():
        said, warnings = [], []
        if law in WORDS:
            said = [f"{task.task.id}: {WORDS[law](task)}" for task in results.tasks if task.task.id in tasks]
            asked.append(Asked(question, " ".join(said), stands.mark(law, *tasks)))
            continue
        for task in (one for one in results.tasks if one.task.id in tasks):
            one = next((one for one in task.scales if one.law == law.lower()), None)
            if one is None or one.scale is None:
                said.append(f"{task.task.id}: no scale{f', because {_why(one, results)}' if one else ''}.")
                continue
            said.append(f"{task.task.id}: {' '.join(_steps(one, results))}")
            warnings += [f"{task.task.id}: {REDUCED}"] * one.scale.reduced
            if one.p is not None and one.p < 0.001:
                warnings.append(f"{task.task.id}: the scale does not fit the answers (deviance, {p_is(one.p)}).")
        asked.append(Asked(question, " ".join(said), stands.mark(law, *tasks), tuple(warnings)))
    return Section("answers", "Questions and answers", (left_and_sure(study),), asked=tuple(asked))


def _overview(study: Study, results: Compared) -> Section:
    rows = tuple(
        {"task": task.task.id, "title": task.task.title, "participants": len(task.participants), "trials": task.trials,
         "without_answer": task.unanswered}
        for task in results.tasks
    )  # fmt: skip
    found = plan.overview(study, rows, partial(_scale_words, results), (*map(str.title, LAWS), *WORDS))
    by = "" if results.quality == UNNAMED else f" by their {results.quality}"
    about = (
        f"Pairs of materials were compared{by}. The protocol's order, from least to most, is "
        f"{', '.join(results.materials)}."
    )
    if not results.ordered:
        about = f"Pairs of {', '.join(results.materials)} were compared{by}; the protocol gives them no order."
    first, *rest = found.paragraphs
    return replace(found, paragraphs=(first, about, *rest))


def _answers_section(study: Study, results: Compared, mark: str) -> Section:
    """Return what was asked and found, a table with a `mark`: how often pairs were told right, and steps of a scale."""
    paragraphs = [*plan.planned_questions(study)]
    paragraphs += [" ".join(_compared(task, results)) for task in results.tasks]
    if not results.ordered:
        return Section("found", plan.FOUND, tuple(paragraphs), (each(results, mark),))
    records: list[Record] = []
    for task in results.tasks:
        scaled = first_scale(task)
        for low in range(len(results.materials) - 1):
            right, step = task.pair(low, low + 1).right, scaled.steps[low] if scaled else None
            records.append(
                {"task": task.task.id, "of": f"{results.materials[low + 1]} above {results.materials[low]}",
                 "right": right.count, "trials": right.trials, "share": right.value,
                 "law": scaled.law if scaled else None, "step": step.value if step else None, **ends(step),
                 "also_in": "pairs.csv, scales.csv"}
            )  # fmt: skip
    laws = {scaled.law for task in results.tasks if (scaled := first_scale(task))}
    of = f", and their step on the {joined([AUTHORS[law] for law in sorted(laws)])} scale" if laws else ""
    notes = (f"Neighbors in {results.quality}: how often the choice was right{of}, with participants as the unit.",)
    table = tabulate("Neighbors", NEIGHBORS, records, notes, standing=mark)
    return Section("found", plan.FOUND, tuple(paragraphs), (table,))


def _why(missing: Scaled, results: Compared) -> str:
    """Return why there is no scale."""
    if not missing.part:
        return missing.statement
    part = [results.materials[place] for place in missing.part]
    others = [name for name in results.materials if name not in part]
    return f"{joined(part)} and {joined(others)} were never compared with each other"


def _compared(task: TaskComparisons, results: Compared) -> Iterator[str]:
    people = plural(len(task.participants), "participant")
    two = [pair.right for pair in task.pairs if not pair.same]
    right, trials = sum(of.count for of in two), sum(of.trials for of in two)
    shares = [one.right.value for one in task.people if one.right.value is not None]
    yield f"{task.task.title} ({people})."
    if trials and results.ordered:
        among = f"; {100 * min(shares):.0f} to {100 * max(shares):.0f} % across participants" if len(shares) > 1 else ""
        yield (
            f"The sample with {more(results)} was named in {right} of {trials} trials with two materials "
            f"({100 * right / trials:.0f} %{among})."
        )
    scaled = first_scale(task)
    if scaled is None:
        yield from (f"There is no scale: {_why(one, results)}." for one in task.scales[:1])
    else:
        yield from _steps(scaled, results)
        if scaled.scale and scaled.scale.reduced:
            yield REDUCED
    same = task.first_of_same
    if same.interval is not None:
        limits = f"{100 * same.interval.low:.0f} to {100 * same.interval.high:.0f}"
        share = f"{100 * same.count / same.trials:.0f} %"
        yield f"When both samples were of the same material, the first was named in {share} ({limits})."


def _steps(scaled: Scaled, results: Compared) -> Iterator[str]:
    """Yield which neighbours stand in the assumed order on a scale, which in the other, and which in neither."""
    names = results.materials
    told = [(f"{names[place + 1]} above {names[place]}", step) for place, step in enumerate(scaled.steps)]
    known = [(name, step) for name, step in told if step.low is not None and step.high is not None]
    if not known:
        yield f"The {AUTHORS[scaled.law]} scale has no intervals, because these need several participants."
        return
    groups: dict[str, list[str]] = {}
    if not results.ordered or (len(known) > FEW and any(_side(step) == "below" for _, step in known)):
        yield _in_order(scaled, results)
        return
    for name, step in known:
        groups.setdefault(_side(step), []).append(f"{name} ({number(step.value, 2)}, {interval(step, 2)})")
    said = {
        "above": "On the {} scale, the assumed order is shown for {}.",
        "below": "On the {} scale, the reverse order is shown for {}.",
        "not": "On the {} scale, no difference is shown for {}.",
    }
    for side, sentence in said.items():
        if side in groups:
            yield sentence.format(AUTHORS[scaled.law], joined(groups[side]))


def _in_order(scaled: Scaled, results: Compared) -> str:
    """Return where each material lies, of those that stand in no order, or many in another than was assumed."""
    rising = sorted(zip(results.materials, scaled.values, strict=True), key=lambda one: one[1].value or 0.0)
    where = joined([f"{name} ({number(one.value, 2)}, {interval(one, 2)})" for name, one in rising])
    return f"From low to high on the {AUTHORS[scaled.law]} scale (mean 0): {where}."


def _side(step: Estimate) -> str:
    """Return where the interval of a step lies: above 0, below 0, or neither."""
    if step.low is not None and step.low > 0:
        return "above"
    return "below" if step.high is not None and step.high < 0 else "not"


def _scale_words(results: Compared, test: PlannedTest) -> str:
    """Return in words what was run of a planned scale."""
    said = []
    if test.test in WORDS:
        said = [WORDS[test.test](one) for one in results.tasks if one.task.id in test.tasks]
        return "; ".join(said) or "not run: no trials"
    for task in test.tasks:
        found = next((one for one in results.tasks if one.task.id == task), None)
        scale = next((one for one in found.scales if one.law == test.test.lower()), None) if found else None
        if found is None:
            said.append(f"{task} not run: no trials")
        elif scale is None:
            said.append(f"{task} not run: the study's answers need another scale")
        elif scale.scale is None:
            said.append(f"{task} run without a scale: {_why(scale, results)}")
        else:
            said.append(f"{task} run: its table has the scale")
    return "; ".join(said)


def _pairs(results: Compared) -> Section:
    about = ABOUT["pairs"].substitute()
    tables = tuple(_matrix(results, task) for task in results.tasks)
    return Section("pairs", f"{choices_words(results)} by pair", (), tables, aside=(about,))


def _matrix(results: Compared, task: TaskComparisons) -> Table:
    records: list[Record] = [
        {"task": task.task.id, "low": results.materials[pair.low], "high": results.materials[pair.high],
         "right" if results.ordered else "named": pair.right.count, "ties": pair.ties,
         "trials": pair.right.trials, "share": pair.right.value,
         **ends(pair.right.interval, "share_"), "cell": pair.right}
        for pair in task.pairs
    ]  # fmt: skip
    columns = (
        Column("", left=True),
        *(Column(name, show=lambda pair: _with_interval(pair["cell"])) for name in results.materials),
    )
    each = sorted({pair.right.trials for pair in task.pairs})
    between = f"{each[0]} to {each[-1]}" if len(each) > 1 else f"{each[0]}"
    notes = [
        f"A cell shows how often the row was named as having {more(results)} than the column. The diagonal shows how "
        "often the first sample was named."
    ]
    notes += [f"Each cell has {between} trials, pooled across {plural(len(task.participants), 'participant')}."]
    if ties := sum(pair.ties for pair in task.pairs):
        for_nobody = " without a right choice" if results.ordered else ", and neither was named"
        notes.append(f"{plural(ties, 'trial')} ended in a tie; these count as trials{for_nobody}.")
    if task.unanswered:
        notes.append(f"Not counted: {plural(task.unanswered, 'trial')} without an answer.")
    neighbors = range(len(results.materials) if results.ordered else 0)
    same = frozenset((place, place + 1) for place in neighbors)
    title = f"{task.task.title}: percent {'right' if results.ordered else 'named'} (95 % CI)"
    table = tabulate(title, columns, crossed(records, "high", "low"), notes, marked=same)
    return replace(table, matrix=True, records=without_keys(records, {"cell"}))


def _in_print(study: Study, results: Compared, tasks: list[TaskComparisons]) -> Section:
    """Return the printed percentages beside those of the dataset."""
    found = [(task, task.in_print) for task in tasks if task.in_print is not None]
    about = (
        "The paper prints neither counts nor intervals, and does not explain the cells that compare a material with "
        "itself. These cells are shown next to how often the first sample was chosen."
    )
    if study.label:
        about += f" This dataset is a {study.origin}: its answers are not evidence about the paper's participants."
    tables = []
    for task, table in found:
        records: list[Record] = [
            {"task": task.task.id, "low": results.materials[cell.low], "high": results.materials[cell.high],
             "printed": cell.printed, "printed_percent": cell.percent, "percent": cell.here}
            for cell in table.cells
        ]  # fmt: skip
        note = (
            f"Pearson's r is {number(table.r)} across the {len(table.cells)} cells, and {number(table.r_of_two)} "
            "across those of two materials."
        )
        title = f"{task.task.title}: {table.where} of the paper"
        tables.append(tabulate(title, BESIDE_PRINT, records, [note], in_print={"printed"}))
    return Section("printed", "Comparison with the printed percentages", (about,), tuple(tables))


def _bias(results: Compared) -> Section:
    about = (
        "If both samples are of the same material, the choice can depend only on chance and on a bias toward the "
        "first or second sample."
    )
    paragraphs = [about]
    tables = []
    for task in results.tasks:
        of = task.first_of_same
        if of.trials:
            paragraphs.append(
                f"In {task.task.id}, the first was named in {of.count} of {of.trials} such trials: "
                f"{_with_interval(of)} percent (95 % CI, treating all trials as independent)."
            )
        records: list[Record] = [
            {"task": task.task.id, "participant": f"sub-{one.participant}", "right": one.right.count,
             "trials_of_two": one.right.trials, "first": one.first_of_same.count,
             "trials_of_one": one.first_of_same.trials,
             "share_right": one.right, "share_first": one.first_of_same}
            for one in task.people
        ]  # fmt: skip
        title = f"{task.task.title}: each participant, percent (95 % CI)"
        columns = PEOPLE if results.ordered else tuple(one for one in PEOPLE if one.key != "share_right")
        if not results.ordered:
            records = list(without_keys(records, {"right", "trials_of_two", "share_right"}))
        tables.append(tabulate(title, columns, records, in_print={"share_right", "share_first"}))
    return Section("bias", "Bias toward the first, and each participant", tuple(paragraphs), tuple(tables))


def _scales(results: Compared, stands: plan.Standing) -> Section:
    about = ABOUT["scales"].substitute(quality=results.quality)
    paragraphs: list[str] = []
    tables = []
    for task in results.tasks:
        for one in task.scales:
            if one.scale is None:
                paragraphs.append(f"{task.task.id}: there is no scale ({LAWS[one.law][0]}): {_why(one, results)}.")
                continue
            mark = stands.mark(one.law.title(), task.task.id)
            tables.append(_scale(results, task, one, mark))
    name = f"Scales of {results.quality}"
    return Section("scales", name, tuple(paragraphs), tuple(tables), aside=(about, FIT))


def _scale(results: Compared, task: TaskComparisons, one: Scaled, standing: str) -> Table:
    values: list[Record] = [
        {"task": task.task.id, "law": one.law, "of": name, **asdict(value)}
        for name, value in (*zip(results.materials, one.values, strict=True), ("first", one.order))
        if value is not None
    ]
    steps: list[Record] = [{}, *({"step": step.value, **ends(step, "step_")} for step in one.steps)]
    records = [{**value, **step} for value, step in zip(values, steps, strict=False)]
    notes = []
    if one.order is not None:
        notes.append(f"Being presented first adds {number(one.order.value, 2)} ({interval(one.order, 2)}) to a value.")
    if one.scale is not None and one.scale.tie is not None:
        notes.append(f"The log odds of a tie between two equal materials are {number(one.scale.tie, 2)}.")
    if one.scale is not None and one.scale.reduced:
        notes.append(REDUCED)
    if one.scale is not None and one.p is not None:
        notes.append(
            f"The deviance from the observed frequencies of the ordered pairs is {number(one.scale.deviance, 1)} with "
            f"{plural(one.scale.df, 'degree')} of freedom, {p_is(one.p)}."
        )
    title = f"{task.task.title}: {', '.join(LAWS[one.law])}"
    columns = VALUES if results.ordered else VALUES[:3]
    return replace(tabulate(title, columns, records, notes, standing=standing), records=tuple(values))


def methods() -> tuple[tuple[str, str], ...]:
    """Return the name and formula of everything that these sections hold."""
    return formulas(Path(__file__).with_name("methods.md"))


def _compute(study: Study, printed: Published | None, dissimilarities: Path | None, _say: Say) -> Compared:
    if dissimilarities is not None:
        raise DatasetError(study.id, "got --dissimilarities and comparisons", "leave it out", allowed="one of them")
    return results.compute(study, printed)


def _numbers(found: Compared) -> dict[str, Any]:
    return {"quality": found.quality, "ordered": found.ordered, "tasks": found.tasks}


def _export(study: Study, frame: pd.DataFrame, exclusions: pd.DataFrame) -> tuple[dict[str, pd.DataFrame], Described]:
    return {"trials.csv": _trials(study, frame), "pairs.csv": _counts(study), "exclusions.csv": exclusions}, {}


def _trials(study: Study, frame: pd.DataFrame) -> pd.DataFrame:
    place = {material: index for index, material in enumerate(study.materials)}
    ahead = frame["first"].map(place) - frame["second"].map(place)
    wanted = pd.Series(np.where(ahead > 0, asked.FIRST, asked.SECOND), index=frame.index)
    answers = {answer for one in study.designs.values() for answer in one.answers}
    judged = frame["answered"].isin(answers) & (ahead != 0) & results.is_ordered(study)
    frame["right"] = (frame["answered"] == wanted).astype("Int64").where(judged)
    return frame


def _counts(study: Study) -> pd.DataFrame:
    names = {"first_named": asked.FIRST, "second_named": asked.SECOND, "ties": asked.TIE}
    keys = ["participant", "task", "first", "second"]
    included = study.attempts[study.attempts["included"]]
    counted = included.assign(**{name: (included["answered"] == said).astype(int) for name, said in names.items()})
    return counted.groupby(keys, sort=False)[list(names)].sum().reset_index()


DESIGN = AnalysisDesign(
    name="comparison",
    trials="comparisons",
    function="compare",
    compute=_compute,
    sections=lambda study, found, printed, _: sections(study, found, printed),
    numbers=_numbers,
    further=lambda _: (),
    methods=methods,
    export=_export,
    figures="palpate.analysis.designs.comparison.figures",
    power="palpate.analysis.power.comparisons",
)
