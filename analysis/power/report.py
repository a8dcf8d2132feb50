"""What `palpate power` prints and writes: tables, and a plot with a panel for each planned test and task."""

import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import ceil
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes

from palpate.analysis.documents import page
from palpate.analysis.documents.drawing import COLUMN_STYLE, LINES, Sheet, colour, key, marker, sheet
from palpate.analysis.documents.output import publish
from palpate.analysis.documents.tables import Column, Record, Section, Table, number, tabulate
from palpate.analysis.documents.tables import text as in_terminal
from palpate.analysis.identification.planned import EQUIVALENCE
from palpate.analysis.power.planned_tests import ABOUT, ADJUSTED, Question
from palpate.analysis.power.simulate import Kind, Power, Row, software

ABOUT_POWER = ABOUT["power"].substitute()
IN_BRACKETS = ABOUT["brackets"].substitute()
T = "t against chance"


def sections(result: Power) -> tuple[Section, ...]:
    """Return what was simulated, the participants needed, then every number."""
    return (
        _studies(result),
        _needed(result),
        _by_size(result, "model", "power", "Power by number of participants", ABOUT_POWER),
        _by_size(result, "guessing", "control", "Control: type I error", ABOUT[result.model.control_name].substitute()),
        *_estimates(result),
        _undefined(result),
    )


def subject(question: Question) -> str:
    """Return what a question asks about, in a few words."""
    return _subject(question.subject, ADJUSTED if question.adjusted else "")


def _subject(of: str, p: str) -> str:
    return f"{of} ({p})" if p == ADJUSTED else of


def title(question: Question) -> str:
    """Return the planned test and its tasks."""
    return f"{question.test}, {' and '.join(question.tasks)}"


def _studies(result: Power) -> Section:
    shares = [f"{task.id} {task.participants} of {result.design.participants}" for task in result.design.tasks]
    trials = [f"{task.id} {task.repetitions}" for task in result.design.tasks]
    paragraphs = (
        f"{result.studies} SIMULATED studies of {result.study} were run at each size, with seed {result.seed}. "
        f"Source of the answers: {result.model.source}.",
        ABOUT["studies"].substitute(shares=", ".join(shares), trials=", ".join(trials)),
        *(f"{note[0].upper()}{note[1:]}." if not note.endswith(".") else note for note in result.notes),
    )
    return Section("model", "Simulated studies", *result.model.shown(result.design, paragraphs))


def _needed(result: Power) -> Section:
    plan, has_stars = _as_planned(result), result.model.has_stars
    records, counted = list[Record](), []
    for question in result.questions:
        at, control = result.row(question, plan), result.row(question, plan, "guessing")
        if question.alpha is None or at is None or control is None:
            continue
        needed = result.needed(question)
        counted += [at, control]
        wrong = control.tally.above, control.tally.family
        above, family = (None if count is None else count / control.tally.studies for count in wrong)
        records.append(
            {**_named(question), "participants_planned": plan, "power_planned": at.power,
             "type_i_error_planned": control.power, "type_i_error_above_planned": above,
             "type_i_error_of_family_planned": family, "target": result.target, "participants_needed": needed.likely,
             "at_earliest": needed.earliest, "surely": needed.surely, "planned": at, "control": control}
        )  # fmt: skip
    alphas = ", ".join(dict.fromkeys(f"{question.alpha:g}" for question in result.questions if question.alpha))
    notes: tuple[str, ...] = (
        ABOUT["needed"].substitute(
            plan=plan, alphas=alphas, target=f"{result.target:g}", tried=_listed(result.participants)
        ),
    )
    if has_stars:
        notes += (ABOUT["stars"].substitute(),)
    beyond = f"more than {result.participants[-1]}"

    def size(likely: int | None, earliest: int | None, surely: int | None) -> str:
        return beyond if earliest is None else f"{likely or beyond} ({earliest} to {surely or beyond})"

    last = (
        *(STARS if has_stars else ()),
        Column(("participants_needed", "at_earliest", "surely"), f"n for {result.target:g}", show=size),
    )
    table = tabulate("", (*NEEDED, *last), records, (*notes, IN_BRACKETS), in_print={"planned", "control"})
    short = tabulate("", (*NEEDED_IN_SHORT, *last), records, (*notes, *_error(counted)))
    said = (_recommended(result), *_ceiling(result, plan))
    return Section("needed", "Participants needed", said, (table,), brief=(short,))


def _recommended(result: Power) -> str:
    """Return the one number of participants to plan with, and which tests it leaves short of the target."""
    found, target = result.recommended(), f"{result.target:g}"
    short = "; ".join(f"{title(one)}: {subject(one)}" for one in found.lacking)
    if found.participants is None:
        return ABOUT["none suffices"].substitute(most=result.participants[-1], target=target)
    told = ABOUT["short" if found.lacking else "recommended"]
    return told.substitute(n=found.participants, target=target, most=result.participants[-1], short=short)


def _shown(row: Row | None) -> str:
    if row is None or row.power is None or row.interval is None:
        return "-"
    return f"{row.power:.3f} ({row.interval[0]:.3f}-{row.interval[1]:.3f})"


TESTED = (
    Column(("test", "tasks"), "test", show="{}, {}".format, left=True),
    Column(("of", "p"), "of", show=_subject, left=True),
)  # fmt: skip
NEEDED = (
    *TESTED, Column("alpha", show="{:g}".format), Column("planned", "power", show=_shown),
    Column("control", "type I error", show=_shown),
)  # fmt: skip
NEEDED_IN_SHORT = (*TESTED, Column("power_planned", "power"), Column("type_i_error_planned", "type I"))
STARS = Column("type_i_error_above_planned", "above"), Column("type_i_error_of_family_planned", "any")

OFTEN = 0.05
"""Share of studies without a t from which on it is told before the tables (ours)."""


def _ceiling(result: Power, plan: int) -> tuple[str, ...]:
    """Return a sentence on the t-tests that are often not defined, because all participants give the same ratio."""
    often = []
    for question in result.questions:
        row = result.row(question, plan)
        if question.test == T and not question.adjusted and row and _reason(result, row) == "no variance":
            share = row.tally.undefined / row.tally.studies
            often += [f"{subject(question)}, {question.tasks[0]} {100 * share:.0f} %"] * (share > OFTEN)
    if not often:
        return ()
    return (ABOUT["ceiling"].substitute(plan=plan, often="; ".join(often)),)


def _by_size(result: Power, kind: Kind, slug: str, name: str, about: str) -> Section:
    rows = [row for row in result.rows if row.kind == kind and row.question.alpha is not None]
    questions = list(dict.fromkeys(row.question for row in rows))
    tables, brief = [], []
    for group in dict.fromkeys((question.plan, question.tasks) for question in questions):
        asked = [question for question in questions if (question.plan, question.tasks) == group]
        tables.append(_sizes_table(result, kind, asked, _shown, (IN_BRACKETS,)))
        plain = [question for question in asked if not question.adjusted]
        error = _error([row for row in rows if row.question in plain])
        brief.append(_sizes_table(result, kind, plain, lambda row: number(row.power if row else None), error))
    return Section(slug, name, (about,), tuple(tables), tuple(map(_record, rows)), tuple(brief))


def _sizes_table(
    result: Power, kind: Kind, questions: Sequence[Question], shown: Callable[[Row | None], str], notes: tuple[str, ...]
) -> Table:
    # Questions may have one name.
    places = {f"{place}": question for place, question in enumerate(questions)}
    columns = Column("n", left=True), *(Column(place, subject(one), show=shown) for place, one in places.items())
    records: list[Record] = [
        {"n": _sizes(result, size), **{place: result.row(one, size, kind) for place, one in places.items()}}
        for size in result.participants
    ]
    of_tasks = ", ".join(task.id for task in result.design.tasks)
    apart = any(len(set(result.design.sizes(size))) > 1 for size in result.participants)
    sizes = (f"n is the number of participants in the study ({of_tasks}).",) if apart else ()
    return replace(tabulate(title(questions[0]), columns, records, (*sizes, *notes)), records=())


def _error(rows: Sequence[Row]) -> tuple[str, ...]:
    """Return the Monte Carlo error of shares that are shown without their intervals."""
    reaches = [
        reach
        for row in rows
        if row.power is not None and row.interval is not None
        for reach in (row.power - row.interval[0], row.interval[1] - row.power)
    ]
    if not reaches:
        return ()
    return (
        f"Monte Carlo error: Wilson's 95 % intervals extend at most {ceil(max(reaches) * 1000) / 1000:.3f} to either "
        "side; they do not include the uncertainty of the choice model. --out and --json give each interval.",
    )


ESTIMATES = (
    Column(("of", "p", "tasks"), "form", show=lambda of, p, tasks: f"{_subject(of, p)}, {tasks}", left=True),
    Column("answers", left=True), Column("participants", "n"), Column("median"),
    Column(("low", "high"), "95 % of studies", show=lambda low, high: f"{number(low)} to {number(high)}"),
)  # fmt: skip
UNDEFINED = (
    *TESTED, Column("answers", left=True),
    Column("participants", "n"), Column("undefined", "studies"),
    Column(("undefined", "studies"), "share", show=lambda count, studies: number(count / studies, 4)),
    Column("reason", "because", left=True),
)  # fmt: skip


def _estimates(result: Power) -> tuple[Section, ...]:
    records: list[Record] = [
        {**_simulated(row), "studies": row.tally.studies, "undefined": row.tally.undefined, "median": middle,
         "low": low, "high": high}
        for row in result.rows if row.tally.estimates is not None
        for low, middle, high in (row.quantiles or (None, None, None),)
    ]  # fmt: skip
    if not records:
        return ()
    about = "A coefficient without a test has no power; the table shows the spread of its estimates instead."
    few = [record for record in records if record["participants"] == _as_planned(result)]
    brief = (tabulate("", ESTIMATES, few),)
    return (Section("estimates", "Estimates of reliability", (about,), (tabulate("", ESTIMATES, records),), (), brief),)


def _undefined(result: Power) -> Section:
    records: list[Record] = [
        {**_simulated(row), "undefined": row.tally.undefined, "studies": row.tally.studies,
         "reason": _reason(result, row)}
        for row in result.rows if row.tally.undefined
    ]  # fmt: skip
    if not records:
        return Section("undefined", "Not defined", ("Every test is defined in every study.",))
    every = [record for record in records if record["p"] != ADJUSTED]
    worst: dict[tuple[object, ...], Record] = {}
    for record in every:
        question = tuple(record[key] for key in ("planned_test", "tasks", "of", "answers"))
        if record["undefined"] > worst.setdefault(question, record)["undefined"]:
            worst[question] = record
    about = "The statistic is not defined for these simulated studies; they count as finding nothing."
    say = "Sizes at which this was most frequent" if len(every) > len(worst) else ""
    brief = tabulate(say, UNDEFINED, (record for record in worst.values() if record["answers"] == "model"))
    table = replace(tabulate("", UNDEFINED, every), records=tuple(records))
    return Section("undefined", "Not defined", (about,), (table,), (), (brief,))


def _reason(result: Power, row: Row) -> str:
    sizes = zip(result.design.tasks, result.design.sizes(row.participants), strict=True)
    alone = all(size < 2 for task, size in sizes if task.id in row.question.tasks)
    if alone or row.question.test != EQUIVALENCE or len(row.question.tasks) < 2:
        return "one participant" if alone else result.model.undefined
    return f"{result.model.undefined}, or tasks near 0 or 1"


def _record(row: Row) -> Mapping[str, object]:
    low, high = row.interval or (None, None)
    return {
        **_simulated(row), "studies": row.tally.studies, "significant": row.tally.significant,
        "of_these_above_chance": row.tally.above, "family_above_chance": row.tally.family,
        "undefined": row.tally.undefined, "share": row.power, "low": low, "high": high,
    }  # fmt: skip


def _simulated(row: Row) -> dict[str, object]:
    return {**_named(row.question), "answers": row.kind, "participants": row.participants}


def _named(question: Question) -> dict[str, object]:
    return {
        "planned_test": question.plan + 1, "test": question.test, "tasks": " and ".join(question.tasks),
        "of": question.subject, "p": ADJUSTED if question.adjusted else "unadjusted", "alpha": question.alpha,
    }  # fmt: skip


def _sizes(result: Power, size: int) -> str:
    """Return a size, with the sizes of the tasks where they differ."""
    of_tasks = result.design.sizes(size)
    return str(size) if set(of_tasks) == {size} else f"{size} ({', '.join(map(str, of_tasks))})"


def _as_planned(result: Power) -> int:
    """Return the size tried that is nearest to the protocol's number of participants."""
    return min(result.participants, key=lambda size: (abs(size - result.design.participants), size))


def _listed(sizes: tuple[int, ...]) -> str:
    if len(sizes) > 2 and sizes == tuple(range(sizes[0], sizes[-1] + 1)):
        return f"{sizes[0]} to {sizes[-1]}"
    return ", ".join(map(str, sizes))


PANEL_IN, LINE_IN, LETTERS = 1.75, 0.13, 24
"""The height of a panel without its legend, and the height and the letters of a line in a legend of two columns."""

QUIET = "#57606a"


def plot(result: Power) -> Sheet:
    """Return the plot of power and of the estimates of reliability by number of participants."""
    panels: dict[tuple[int, tuple[str, ...]], list[Question]] = {}
    for question in result.questions:
        if not question.adjusted:
            panels.setdefault((question.plan, question.tasks), []).append(question)
    with mpl.rc_context(COLUMN_STYLE):
        heights = []
        for questions in panels.values():
            lines = [_name(question).count("\n") + 1 for question in questions]
            half = ceil(len(lines) / 2)
            # The legend has its title, and rows as high as their longest name.
            heights.append(PANEL_IN + LINE_IN * (2 + max(sum(lines[:half]), sum(lines[half:]))))
        drawn, every = sheet(heights, "Power, with its Monte Carlo interval", result.label)
        for axes, questions in zip(every, panels.values(), strict=True):
            (estimates if questions[0].alpha is None else powers)(axes, result, questions)
        said = "Power of each planned test by number of participants; the bands are Wilson's 95 % intervals."
        return Sheet("power", "power", said, drawn)


def powers(axes: Axes, result: Power, questions: Sequence[Question]) -> None:
    """Draw the power of each question by number of participants, with its Monte Carlo interval as a band."""
    for i, question in enumerate(questions):
        rows = result.by_size(question)
        limits = [row.interval or (0.0, 0.0) for row in rows]
        values = [(low, row.power or 0.0, high) for row, (low, high) in zip(rows, limits, strict=True)]
        _curve(axes, i, [row.participants for row in rows], values, _name(question))
    for level, style, name in ((result.target, "--", "target"), (questions[0].alpha or 0.0, ":", "alpha")):
        axes.axhline(level, color=QUIET, linestyle=style, linewidth=0.8)
        beside = axes.get_yaxis_transform()
        axes.text(1.01, level, f"{name}\n{level:g}", transform=beside, va="center", color=QUIET)
    axes.set_ylim(0, 1.02)
    _frame(axes, result, questions, "power")


def estimates(axes: Axes, result: Power, questions: Sequence[Question]) -> None:
    """Draw the median of the estimates by number of participants, with a band that holds 95 % of the studies."""
    for i, question in enumerate(questions):
        rows = [row for row in result.by_size(question) if row.quantiles]
        values = [row.quantiles or (0.0, 0.0, 0.0) for row in rows]
        _curve(axes, i, [row.participants for row in rows], values, _name(question))
    axes.set_ylim(top=1.02)
    _frame(axes, result, questions, "estimate: median, 95 %")


def _curve(axes: Axes, i: int, sizes: Sequence[int], values: Sequence[tuple[float, float, float]], label: str) -> None:
    axes.fill_between(sizes, [v[0] for v in values], [v[2] for v in values], color=colour(i), alpha=0.25, linewidth=0)
    style: Any = {"color": colour(i), "marker": marker(i), "markersize": 3.5, "clip_on": False}
    axes.plot(sizes, [v[1] for v in values], LINES[i % len(LINES)], label=label, **style)


def _frame(axes: Axes, result: Power, questions: Sequence[Question], what: str) -> None:
    axes.set_xlim(0, max(result.participants) * 1.03)
    axes.set_xlabel("participants in the study", labelpad=1)
    axes.set_ylabel(what)
    key(axes, title=title(questions[0]))


def _name(question: Question) -> str:
    return textwrap.fill(subject(question), LETTERS)


def text(result: Power) -> str:
    """Return everything for a terminal; the participants needed stand last."""
    parts = sorted(sections(result), key=lambda section: section.slug == "needed")
    shown = [in_terminal(section) for section in parts if section.slug != "control"]
    return "\n\n\n".join([result.label, *shown, result.label])


def as_dict(result: Power) -> dict[str, Any]:
    """Return every number, for JSON; None where it is not defined."""
    return {
        "label": result.label, "study": result.study, "model": result.model.source, "notes": list(result.notes),
        "participants": list(result.participants), "studies": result.studies, "seed": result.seed,
        "target": result.target, "recommended": result.recommended().participants, "software": software(),
        **{f"{section.slug}_rows": [dict(record) for record in section.records] for section in sections(result)},
    }  # fmt: skip


def write(result: Power, out: Path) -> tuple[Path, ...]:
    """Write tables (CSV, Markdown, LaTeX) and the plot (PNG, SVG) into a folder, and return the files.

    Raises `DatasetError`: the folder is within a dataset, a file is in the way, or the file system refuses.
    """
    files = page.tables(sections(result), result.label) | page.drawings([plot(result)])
    return publish(out, files, result.label, "power")
