"""Planned against done: what the protocol plans, what was run of it, what was left out, and how each table stands."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields, replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

from palpate.analysis.documents.tables import Column, Record, Section, blocks, number, p_is, plural, tabulate
from palpate.analysis.published.numbers import Published
from palpate.analysis.reading.study import AGAIN, Exclusion, Study, sentences

if TYPE_CHECKING:
    from palpate.analysis.identification.planned import Planned
    from palpate.analysis.identification.results import PairTest, Results, TaskResult
    from palpate.analysis.statistics.anova import Anova
    from palpate.experiment.protocol.models import ExclusionRule, PlannedTest

ABOUT = blocks(Path(__file__).with_name("about.md"))
"""What sections say of how they were made, by name."""

PLANNED, PUBLISHED, OURS, EXPLORATORY, DESCRIPTIVE = "planned", "published", "companion", "exploratory", "descriptive"

T, ONE_WAY, TWO_WAY, ICC = "t against chance", "one-way ANOVA", "two-way ANOVA", "ICC"
CHANCE = T, "sign flips against chance"
DIFFER = TWO_WAY, "sign flips between tasks"

MARKS = ABOUT["marks"].substitute()

BESIDE = "Tests with participants as units"
"""The part of a report that holds what palpate adds to the published tests."""

WHEN = {
    "frames-lost": "more than {} frames lost",
    "speed-below": "speed below {} mm/s",
    "speed-above": "speed above {} mm/s",
    "undelivered": "stimulus not delivered",
    "answers-below": "fewer than {} answers in a task",
    "withdrawn": "participant withdrew",
}

ACTION = {"repeat-trial": "repeats the trial", "exclude-trial": "trial", "exclude-participant": "participant"}


@dataclass(frozen=True)
class Standing:
    """Tests, each with a task, that protocols plan and the paper prints, and pairs of planned one-way ANOVAs."""

    planned: frozenset[tuple[str, str]]
    printed: frozenset[tuple[str, str]]
    asked: frozenset[tuple[str, frozenset[str]]]

    @property
    def results(self) -> str:
        """The name of the part of a report that holds what was planned or published, or all if neither is known."""
        return f"{' and '.join(_marks(self.planned, self.printed))} results".lstrip().capitalize()

    def mark(self, test: str, *tasks: str) -> str:
        """Return the mark of a test of these tasks."""
        return self.of_any([test], *tasks)

    def of_any(self, tests: Iterable[str], *tasks: str) -> str:
        """Return the mark of what belongs to several tests of these tasks."""
        these = set(product(tests, tasks))
        return ", ".join(_marks(these & self.planned, these & self.printed)) or EXPLORATORY

    def of_pair(self, pair: PairTest) -> str:
        """Return the mark of a one-way ANOVA, exploratory where neither plan nor paper name its two materials."""
        printed = (ONE_WAY, pair.task) in self.printed and "published" in pair.chosen
        return ", ".join(_marks((pair.task, frozenset(pair.pair)) in self.asked, printed)) or EXPLORATORY

    def ours(self, test: str, *tasks: str) -> str:
        """Return the mark of a test of ours that asks what this test of these tasks asks."""
        return OURS if self.mark(test, *tasks) != EXPLORATORY else f"{OURS}, {EXPLORATORY}"


def _marks(planned: object, printed: object) -> list[str]:
    return [mark for mark, known in ((PLANNED, planned), (PUBLISHED, printed)) if known]


def standing(study: Study, printed: Published | None) -> Standing:
    """Return what is planned, and what the paper prints, of this study; of its reconstruction alone: others are new."""
    tasks = [task.id for task in study.tasks]
    planned = {(plan.test, task) for plan in study.plans() for task in plan.tasks}
    asked = {(task, frozenset(plan.materials)) for plan in study.plans() if plan.materials for task in plan.tasks}
    found: set[tuple[str, str]] = set()
    if printed is not None and study.origin == "RECONSTRUCTION":
        found |= {(T, table.task) for table in printed.table if table.task}
        found |= {(T, one.task) for one in printed.tests if one.task}
        found |= {(ONE_WAY, one.task) for one in printed.one_way}
        found |= {(TWO_WAY, task) for task in tasks if printed.two_way}
        found |= {(ICC, task) for task in tasks if printed.icc}
        found |= {(PAIRS, one.task) for one in printed.choices}
    return Standing(frozenset(planned), frozenset(found), frozenset(asked))


PAIRS = "right choices"
"""What stands in print of comparisons; no protocol plans it as a test."""


FOUND = "What was found"
"""The title of the first section of a report."""


def planned_questions(study: Study) -> list[str]:
    """Return the planned questions as one paragraph, or nothing where none is known."""
    questions = dict.fromkeys(first_question(plan) for plan in study.plans() if plan.test != "ICC")
    return [f"Asked: {' '.join(questions)}"] * bool(questions)


def first_question(plan: PlannedTest) -> str:
    """Return the first question in the words of a planned test, without how it is to be answered."""
    return " ".join(plan.question.split()).split("? ")[0].rstrip("?") + "?"


def alpha(study: Study, tests: Container[str], *tasks: str) -> float:
    """Return the level of significance that is planned first for one of these tests of these tasks, or else 0.05."""
    found = (plan.alpha for plan in study.plans() if plan.test in tests and set(plan.tasks) & set(tasks))
    return next(found, 0.05)


def marked(section: Section, *marks: str) -> Section:
    """Return the section with a mark at each table that lacks one: one for each, or the same for all.

    A brief table has the mark of the table with its key, or else the first.
    """
    wanted = marks if len(marks) == len(section.tables) else marks[:1] * len(section.tables)
    found = tuple(zip(section.tables, wanted, strict=True))
    tables = tuple(replace(table, standing=table.standing or mark) for table, mark in found)
    by_key = {table.key: mark for table, mark in found if table.key}
    first = marks[0] if marks else ""
    brief = tuple(replace(table, standing=table.standing or by_key.get(table.key, first)) for table in section.brief)
    return replace(section, tables=tables, brief=brief)


def mark_of(stands: Standing, test: str, tasks: Sequence[str]) -> str:
    """Return the mark of what a table has of several tasks: one, or that of each."""
    marks = {task: stands.mark(test, task) for task in tasks}
    return (
        next(iter(marks.values()))
        if len(set(marks.values())) == 1
        else "; ".join(f"{task}: {mark}" for task, mark in marks.items())
    )


def icc_marks(study: Study, stands: Standing, results: Results) -> tuple[str, ...]:
    """Return a mark for each table of an ICC: where the plan names variance components, the forms are exploratory."""
    mark = stands.mark(ICC, *(task.task.id for task in results.tasks))
    named = any(plan.form and "variance" in plan.form.casefold() for plan in study.plans() if plan.test == ICC)
    of_forms = EXPLORATORY if named and results.components else mark
    return (of_forms,) * len(results.reliabilities) + (mark,) * (results.components is not None)


def _of_planned(count: int, planned: int | None) -> str:
    return f"{count}" if planned is None else f"{count} of {planned}"


TASKS = (
    Column("task", left=True), Column("title", left=True),
    Column(("participants", "participants_planned"), show=_of_planned),
    Column(("trials", "trials_planned"), show=_of_planned), Column("without_answer", "no answer"),
    Column("chance", show=lambda chance: f"{chance:.4g}"),
)  # fmt: skip
TESTS = (
    Column("test", left=True), Column("tasks", left=True), Column("alpha"), Column("stars", "stars by", left=True),
    Column("done", "what was run", left=True), Column("question", "question and form", left=True, brief=False),
)  # fmt: skip


def overview(
    study: Study, rows: tuple[Record, ...], done: Callable[[PlannedTest], str], estimates: Container[str]
) -> Section:
    """Return participants, trials and tests, those planned beside those done.

    `rows` has a record for each task as analysed; `done` says what was run of a planned test, of which `estimates` have
    no level of significance.
    """
    records = [{**row, **_counts(study, row["task"])} for row in rows]
    planned = any(record["participants_planned"] is not None for record in records)
    notes = ("Analyzed, of those planned.",) * planned
    tables = [tabulate("Participants and trials", TASKS, records, notes, standing=DESCRIPTIVE)]
    brief = list(tables)
    if tests := list(_tests(study, done, estimates)):
        for shown, short in ((tables, False), (brief, True)):
            table = tabulate("Planned tests", TESTS, tests, brief=short, standing=PLANNED)
            shown.append(replace(table, records=()))
    paragraphs = (
        f"{study.title}. The study is {study.id}, with {plural(len(study.participants), 'participant')} in the "
        "dataset.",
        *_source(study),
        *sentences(study),
    )
    return Section("overview", "Planned and done", paragraphs, tuple(tables), brief=tuple(brief), aside=(MARKS,))


def _counts(study: Study, task: str) -> dict[str, int | None]:
    """Return how many participants and trials of a task are planned, None where no protocol says it."""
    protocols = [part.protocol for part in study.parts if task in part.tasks]
    found = [(one.task(task), one) for one in protocols if one is not None and task in [each.id for each in one.tasks]]
    if len(found) < len(protocols) or not found:
        return {"participants_planned": None, "trials_planned": None}
    return {
        "participants_planned": sum(each.participants for each, _ in found),
        "trials_planned": sum(one.trials(each) * each.participants for each, one in found),
    }


def _source(study: Study) -> list[str]:
    """Return a sentence on where the plan stands and whether it was sealed, for each part that holds one."""
    known = [part for part in study.parts if part.protocol is not None]
    if not known and len(study.parts) == 1:
        return ["The plan is unknown, because the dataset has no protocol."]
    several, told = len(study.parts) > 1, []
    for part in known:
        file = part.versions[-1].file if part.versions else "protocol.toml"
        told.append(f"The plan{f' of {part.name}' if several else ''} is sourcedata/{file}; {part.sealed}.")
    return told


def _tests(study: Study, done: Callable[[PlannedTest], str], estimates: Container[str]) -> Iterator[Record]:
    found: dict[str, tuple[PlannedTest, list[str]]] = {}
    for part in study.parts:
        for plan in part.protocol.analysis if part.protocol else ():
            found.setdefault(plan.model_dump_json(), (plan, []))[1].append(part.name)
    for plan, parts in found.values():
        where = f" ({', '.join(parts)} only)" if len(parts) < len(study.parts) else ""
        yield {
            "test": plan.test, "tasks": ", ".join(plan.tasks) + where,
            "alpha": None if plan.test in estimates else f"{plan.alpha:g}",
            "stars": None if plan.chance is None else "P" if plan.correction is None else f"Holm, {plan.correction}",
            "done": done(plan), "question": " ".join(f"{plan.question} {plan.form or ''}".split()),
        }  # fmt: skip


def done_of(results: Results, plan: PlannedTest) -> str:
    """Return in words what was run of a planned test of identifications."""
    if (planned := next((one for one in results.planned if one.plan == plan), None)) is not None:
        return _shown_of(planned)
    match plan.test:
        case "t against chance":
            return "; ".join(_against_chance(task, results.task(task), plan.alpha) for task in plan.tasks)
        case "one-way ANOVA":
            return "; ".join(_one_way(task, plan, results) for task in plan.tasks)
        case "two-way ANOVA":
            if not results.two_way:
                return f"not run: {results.two_way_statement}"
            return f"run: {_outcome(results.two_way[1], 'tasks, type II, ')}"
        case "ICC":
            if results.components is not None and (value := results.components.by_k[0][2]) is not None:
                return f"run: variance-component ICC {number(value)}; its table lists every form"
            if any(one.icc for one in results.reliabilities):
                return "run: its table lists every form"
            return "not run: no ICC is defined"
    return "not run: the trials are not comparisons of two stimuli"


def _shown_of(planned: Planned) -> str:
    why = "; ".join(f"{name} not run: {reason}" for name, reason in planned.statements.items())
    shown = sum(line.shown for line in planned.lines)
    run = [f"run: {shown} of {len(planned.lines)} shown"] * bool(planned.lines)
    return "; ".join([*run, *([why] if why else [])])


def _against_chance(task: str, found: TaskResult | None, level: float) -> str:
    if found is None:
        return f"{task} not run: no trials"
    tested = [test for test in found.tests if test.result.p is not None]
    above = sum(found.shows_above(test, test.p_holm if found.correction else test.result.p, level) for test in tested)
    flips = sum(found.shows_above(test, found.flip(test), level) for test in found.tests)
    missing = [test for test in found.tests if test.result.p is None]
    why = f", not defined for {', '.join(test.material for test in missing)}" if missing and tested else ""
    of = f"{above} of {len(found.tests)} materials shown above chance" if tested else "the t-test is not defined"
    by_flips = f"{flips} by exact sign-flip tests" if tested else f"{flips} shown above chance by exact sign-flip tests"
    ours = f", and {by_flips}" if any(test.flip for test in found.tests) else ""
    return f"{task} run: {of}{ours}{why}"


def _one_way(task: str, plan: PlannedTest, results: Results) -> str:
    found = [pair for pair in results.pairs if pair.task == task]
    if not found:
        return f"{task} not run: {NEVER}"
    asked = next((pair for pair in found if set(pair.pair) == set(plan.materials or ())), None)
    if asked is not None:
        return f"{task} run: {_outcome(asked.anova)}"
    tested, outcome = " and ".join(found[0].pair), _outcome(found[0].anova)
    return f"{task} run for {tested}, the most confused pair (not the planned one): {outcome}"


NEVER = "no single pair of its materials was confused most often"
"""Why a task has no one-way ANOVA."""

NONE_OF_TWO_WAY = "two-way, all types"


def undefined(results: Results) -> Iterator[tuple[str, str, str]]:
    """Yield the kind and the task of each ANOVA that is missing, and why."""
    for pair in results.pairs:
        if reason := pair.anova.statement if pair.anova else pair.statement:
            yield "one-way", pair.task, reason
    yield from ((each.kind, "all", each.statement) for each in results.two_way if each.statement)
    if results.two_way_statement:
        yield NONE_OF_TWO_WAY, "all", results.two_way_statement
    tested = {pair.task for pair in results.pairs}
    yield from (("one-way", task.task.id, NEVER) for task in results.tasks if task.task.id not in tested)


def _outcome(anova: Anova | None, of: str = "") -> str:
    if anova is None or (effect := anova.effects[0]).f is None or effect.p is None:
        return "F is not defined"
    return f"{of}F({effect.df}, {anova.residual.df}) = {effect.f:.2f}, {p_is(effect.p)}"


EXCLUSIONS = (
    Column("participant", left=True), Column("task", left=True), Column("trial"), Column("attempt"),
    Column("rule", left=True), Column("reason", left=True),
)  # fmt: skip


EXCLUDED = "Excluded attempts"

RULES = (
    Column("rule", left=True), Column("count", "excluded"), Column("action", "what it excludes", left=True),
    Column("when", left=True),
)  # fmt: skip


def exclusions_section(study: Study) -> Section:
    """Return everything that was left out: by rule with counts, those of the protocol that left out nothing too."""
    records = tuple({**asdict(one), "participant": f"sub-{one.participant}"} for one in study.exclusions)
    count = len(study.attempts) - int(study.attempts["included"].sum())
    total = len(study.attempts)
    about = (
        f"{count:,} of {total:,} attempts were excluded; {total - count:,} trials are analyzed."
        if records
        else f"All {total:,} attempts (one per trial) are analyzed."
    )
    by_rule = _by_rule(study)
    brief = replace(tabulate("Rules", RULES, by_rule), records=())
    if not records:
        shown = (replace(brief, standing=_rules_standing(study)),) if by_rule else ()
        # A table without a row could not say what the dataset is.
        none = {**dict.fromkeys(field.name for field in fields(Exclusion)), "reason": "nothing was left out"}
        return Section("exclusions", EXCLUDED, (about, *_unasked(study)), shown, further=(none,))
    each = replace(tabulate("", EXCLUSIONS, map(asdict, study.exclusions)), records=records)
    brief = replace(brief, notes=("The report and exclusions.csv list each one.",))
    section = Section("exclusions", EXCLUDED, (about, *_unasked(study)), (each,), brief=(brief,), folded=True)
    return marked(section, _rules_standing(study))


def _rules_standing(study: Study) -> str:
    return PLANNED if any(part.protocol for part in study.parts) else DESCRIPTIVE


def _by_rule(study: Study) -> list[Record]:
    """Return each rule with its count, what it leaves out, and when: those of the protocols first, then others."""
    times = Counter(one.rule for one in study.exclusions)
    rules: dict[str, ExclusionRule] = {}
    for part in study.parts:
        for rule in part.protocol.exclusion if part.protocol else ():
            rules.setdefault(rule.id, rule)
    records: list[Record] = [
        {"rule": rule.id, "count": None if rule.action == "repeat-trial" else times.pop(rule.id, 0),
         "action": ACTION[rule.action],
         "when": WHEN[rule.when].format("" if rule.limit is None else f"{rule.limit:g}")}
        for rule in rules.values()
    ]  # fmt: skip
    whole = {one.rule for one in study.exclusions if one.trial is None}
    named = {AGAIN: "attempt was repeated", "no data": "no events in the dataset", "withdrawn": "withdrew"}
    records += [
        {"rule": rule, "count": count, "action": "participant" if rule in whole else "attempt",
         "when": named.get(rule, "-")}
        for rule, count in times.items()
    ]  # fmt: skip
    return records


def _unasked(study: Study) -> list[str]:
    """Return a sentence for each rule and task with trials that stay in because the rule cannot judge them."""
    counts: Counter[tuple[str, str, str]] = Counter()
    totals = study.attempts.loc[study.attempts["counted"], "task"].value_counts()
    for one in study.unasked:
        counts[one.rule, one.missing, one.task] += one.trials
    return [
        f"The rule {rule} could not be applied to {trials} of {totals[task]} trials of {task}, because they have no "
        f"record of {missing}; these trials stay in the analysis."
        for (rule, missing, task), trials in counts.items()
    ]
