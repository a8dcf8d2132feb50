"""Results of comparisons -> sections: tables of the report, the records behind them, and every formula by its name."""

from collections.abc import Mapping
from dataclasses import asdict, replace
from functools import partial

from palpate.analysis.comparison.results import Beside, Compared, Scaled, Share, TaskComparisons
from palpate.analysis.documents.tables import Section, Table, interval, number, p_is, plural
from palpate.analysis.published.numbers import Published
from palpate.analysis.reading.study import Study
from palpate.analysis.report import plan
from palpate.analysis.report.found import UNNAMED, compared_section, more
from palpate.analysis.report.sections import formulas

LAWS = {
    "bradley-terry": ("Bradley-Terry", "in logits"),
    "thurstone": ("Thurstone's case V", "in standard deviations of a difference"),
    "davidson": ("Davidson", "with ties, in logits"),
}
"""The name of each law, and more about it. A protocol writes the same name with capitals, as `str.title` gives it."""

FIT = (
    "The P of a deviance takes all answers as independent and every participant as having the same scale, and needs "
    "many answers of each kind: where participants differ it is too small, and where some pairs are nearly always told "
    "right it is too large."
)


def sections(study: Study, results: Compared, printed: Published | None = None) -> tuple[Section, ...]:
    """Return every section, in reading order: what was found, what was planned, results by their standing, checks."""
    stands = plan.standing(study, printed)
    in_print = [task for task in results.tasks if task.in_print is not None]
    pairs = _pairs(results)
    # Right choices are printed, or lie behind a planned scale.
    tests = (plan.PAIRS, *map(str.title, LAWS))
    against = [stands.of_any(tests, task.task.id) for task in results.tasks]
    parts = {
        stands.results: (plan.marked(pairs, *against), _scales(results, stands)),
        "Exploratory": (plan.marked(_bias(results), plan.EXPLORATORY),),
        "Checks": ((plan.marked(_in_print(study, results, in_print), plan.DESCRIPTIVE),) if in_print else ()),
        "": (plan.exclusions_section(study),),
    }
    return (
        compared_section(study, results, ", ".join(dict.fromkeys(against))),
        _overview(study, results),
        *(replace(section, part=part) for part, of in parts.items() for section in of),
    )


def percent(share: Share) -> str:
    """Return a share in whole percent, or `-` without a trial."""
    return "-" if share.value is None else f"{100 * share.value:.0f}"


def _with_interval(share: Share) -> str:
    if share.interval is None:
        return "-"
    return f"{percent(share)} ({100 * share.interval.low:.0f} to {100 * share.interval.high:.0f})"


def _overview(study: Study, results: Compared) -> Section:
    rows = tuple(
        {"task": task.task.id, "title": task.task.title, "participants": len(task.participants), "trials": task.trials,
         "without_answer": task.unanswered}
        for task in results.tasks
    )  # fmt: skip
    found = plan.overview(study, rows, partial(plan.done_of_comparisons, results))
    by = "" if results.quality == UNNAMED else f" by their {results.quality}"
    about = (
        f"Pairs of materials were compared{by}. From the least to the most the protocol has "
        f"{', '.join(results.materials)}."
    )
    first, *rest = found.paragraphs
    return replace(found, paragraphs=(first, about, *rest))


def _pairs(results: Compared) -> Section:
    about = (
        "It does not matter which of two materials was presented first. Intervals are exact, of 95 % (Clopper and "
        "Pearson), and take all trials as independent. Where a material was compared with itself, the first is named "
        "in 50 % by guessing."
    )
    records: list[Mapping[str, object]] = [
        {"task": task.task.id, "low": results.materials[pair.low], "high": results.materials[pair.high],
         "right": pair.right.count, "ties": pair.ties, "trials": pair.right.trials, "share": pair.right.value,
         "share_low": pair.right.interval.low if pair.right.interval else None,
         "share_high": pair.right.interval.high if pair.right.interval else None}
        for task in results.tasks for pair in task.pairs
    ]  # fmt: skip
    tables = tuple(_matrix(results, task) for task in results.tasks)
    return Section("pairs", "Right choices by pair", (), tables, tuple(records), aside=(about,))


def _matrix(results: Compared, task: TaskComparisons) -> Table:
    count = len(results.materials)
    rows = tuple(
        (material, *(_with_interval(task.pair(low, high).right) if low <= high else "" for low in range(count)))
        for high, material in enumerate(results.materials)
    )
    each = sorted({pair.right.trials for pair in task.pairs})
    between = f"{each[0]} to {each[-1]}" if len(each) > 1 else f"{each[0]}"
    notes = [
        f"A cell says how often the row was named as having {more(results)} than the column, and on the "
        "diagonal how often the first was named."
    ]
    notes += [f"A cell is of {between} trials, by {plural(len(task.participants), 'participant')} together."]
    if ties := sum(pair.ties for pair in task.pairs):
        notes.append(f"{plural(ties, 'trial')} ended in a tie; these count as trials and are right for nobody.")
    if task.unanswered:
        notes.append(f"{plural(task.unanswered, 'trial')} without an answer count nowhere.")
    same = frozenset((place, place + 1) for place in range(count))
    title = f"{task.task.title}: percent right (95 % CI)"
    return Table(title, ("", *results.materials), rows, marked=same, notes=tuple(notes), matrix=True)


def _in_print(study: Study, results: Compared, tasks: list[TaskComparisons]) -> Section:
    """Return the printed percentages beside those of the dataset."""
    found = [(task, task.in_print) for task in tasks if task.in_print is not None]
    about = (
        "The paper prints neither counts nor intervals, and does not say what the cells of a material with itself "
        "count; they stand here beside the choices of the one presented first."
    )
    if study.label:
        about += f" This dataset is a {study.origin}: its answers say nothing of the paper's participants."
    tables = tuple(
        Table(
            f"{task.task.title}: {table.where} of the paper",
            ("pair", "printed", "here", "difference"),
            tuple(_beside(results, cell) for cell in table.cells),
            notes=(
                f"Pearson's r over the {len(table.cells)} cells is {number(table.r)}, and over those of two materials "
                f"{number(table.r_of_two)}.",
            ),
        )
        for task, table in found
    )
    records = tuple(
        {"task": task.task.id, "low": results.materials[cell.low], "high": results.materials[cell.high],
         "printed_percent": cell.percent, "percent": cell.here}
        for task, table in found for cell in table.cells
    )  # fmt: skip
    return Section("printed", "Beside the printed percentages", (about,), tables, records)


def _beside(results: Compared, cell: Beside) -> tuple[str, ...]:
    pair = f"{results.materials[cell.high]} and {results.materials[cell.low]}"
    here, off = ("-", "-") if cell.here is None else (f"{cell.here:.0f}%", f"{cell.here - cell.percent:+.0f}")
    return pair, cell.printed, here, off


def _bias(results: Compared) -> Section:
    about = (
        "Where both samples are of one material, nothing but chance and a leaning to the first or second place can "
        "tell them apart."
    )
    paragraphs = [about]
    tables, records = [], []
    for task in results.tasks:
        of = task.first_of_same
        if of.trials:
            paragraphs.append(
                f"In {task.task.id} the first was named in {of.count} of {of.trials} such trials: {_with_interval(of)} "
                "percent (95 % CI, all trials taken as independent)."
            )
        rows = [(one.participant, _with_interval(one.right), _with_interval(one.first_of_same)) for one in task.people]
        header = ("participant", "right, of two materials", "first, of one material")
        tables.append(Table(f"{task.task.title}: each participant, percent (95 % CI)", header, tuple(rows)))
        records += [
            {"task": task.task.id, "participant": f"sub-{one.participant}", "right": one.right.count,
             "trials_of_two": one.right.trials, "first": one.first_of_same.count,
             "trials_of_one": one.first_of_same.trials}
            for one in task.people
        ]  # fmt: skip
    return Section("bias", "Bias to the first, and each participant", tuple(paragraphs), tuple(tables), tuple(records))


def _scales(results: Compared, stands: plan.Standing) -> Section:
    about = (
        f"A scale of {results.quality} gives each material a value, so that the first of a pair is chosen by the "
        "difference of the values and by what being first adds. Values add up to zero. Intervals are of 95 %, with "
        "participants as the units (standard errors from the sum of scores of each, Student's t with one degree of "
        "freedom less than participants)."
    )
    paragraphs: list[str] = []
    tables, records = [], []
    for task in results.tasks:
        for one in task.scales:
            if one.scale is None:
                paragraphs.append(f"{task.task.id}: there is no scale of {LAWS[one.law][0]}: {one.statement}.")
                continue
            mark = stands.of(one.law.title(), task.task.id)
            tables.append(replace(_scale(results, task, one), standing=mark))
            records += [
                {"task": task.task.id, "law": one.law, "of": name, **asdict(value)}
                for name, value in (*zip(results.materials, one.values, strict=True), ("first", one.order))
                if value is not None
            ]
    name = f"Scales of {results.quality}"
    return Section("scales", name, tuple(paragraphs), tuple(tables), tuple(records), aside=(about, FIT))


def _scale(results: Compared, task: TaskComparisons, one: Scaled) -> Table:
    steps = ("", *(number(step.value, 2) for step in one.steps)), ("", *(interval(step, 2) for step in one.steps))
    rows = tuple(
        (material, number(value.value, 2), interval(value, 2), step, limits)
        for material, value, step, limits in zip(results.materials, one.values, *steps, strict=True)
    )
    notes = []
    if one.order is not None:
        notes.append(f"Being presented first adds {number(one.order.value, 2)} ({interval(one.order, 2)}).")
    if one.scale is not None and one.scale.tie is not None:
        notes.append(f"The logarithm of the odds of a tie between two equals is {number(one.scale.tie, 2)}.")
    if one.scale is not None and one.p is not None:
        notes.append(
            f"The deviance from the observed frequencies of the ordered pairs is {number(one.scale.deviance, 1)} with "
            f"{plural(one.scale.df, 'degree')} of freedom, {p_is(one.p)}."
        )
    header = ("material", "value", "95 % CI", "above the one before", "95 % CI")
    return Table(f"{task.task.title}: {', '.join(LAWS[one.law])}", header, rows, notes=tuple(notes))


def methods() -> tuple[tuple[str, str], ...]:
    """Return the name and formula of everything that these sections hold."""
    return formulas("comparison_methods.md")
