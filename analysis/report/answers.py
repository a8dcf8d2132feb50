"""Results -> the first screen: each planned question with its one answer, its warnings, and how sure the data are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from palpate.analysis.documents.tables import (
    Asked,
    Column,
    Record,
    Section,
    bounds,
    ends,
    interval,
    joined,
    number,
    p_at_most,
    p_is,
    probability,
    tabulate,
)
from palpate.analysis.report.plan import (
    ICC,
    ONE_WAY,
    PLANNED,
    TWO_WAY,
    Standing,
    T,
    exclusions_section,
    first_question,
)
from palpate.analysis.statistics.sign_flips import DRAWS

if TYPE_CHECKING:
    from palpate.analysis.identification.planned import Line, Planned
    from palpate.analysis.identification.results import ComponentReliability, MaterialTest, Results, TaskResult
    from palpate.analysis.reading.study import Study
    from palpate.analysis.statistics.anova import Anova, Effect
    from palpate.analysis.statistics.participants import Misfit
    from palpate.analysis.statistics.shares import Limits

QUESTIONS = {
    T: "Are answers correct more often than by chance?",
    ONE_WAY: "Can participants distinguish the two materials?",
    TWO_WAY: "Do the tasks differ?",
    ICC: "How reliable are the mean ratios?",
}
"""What a test asks where no protocol words it."""

TWO_WAY_ERRS = (
    "Ratios count as independent; the error depends on how participants differ (methods: Type I error). No other "
    "test: {}."
)
ONE_WAY_ERRS = "Four ratios of each participant count as independent; P is not exact."
BY_FLIPS = "The report's {} can err more often (methods: Type I error)."
OVER = {
    "any population": "At least one participant's answers look more like guessing than like the others'. The "
    "interval for {} is therefore valid for any population of participants.",
    "trials": "With one participant, the interval for {} is across that participant's trials (Clopper-Pearson).",
}
"""What an interval is of, unless of participants who differ in one way."""

TWO_ALONE = "There are only two participants, so the intervals are wide."
MISFIT = 0.001
"""Where P of a model's fit is below, the first screen warns."""

LOOSE = (
    "The smaller group varies more than the other ({}), so P is no less than Welch's t gives on the df of the smaller "
    "group. Near 0 or 1 this is still too low (methods: Type I error)."
)

UNDEFINED = "No answer: this test is not defined for this plan and these data."


def answers_section(study: Study, results: Results, stands: Standing, limits: tuple[str, ...]) -> Section:
    """Return the questions with their answers, what `limits` them, what rules left out, and how sure this is."""
    asked = tuple(_answers(study, results, stands))
    said = (*limits, *_misfits(results), left_and_sure(study))
    return Section("answers", "Questions and answers", said, asked=asked)


def _misfits(results: Results) -> Iterator[str]:
    """Yield of which tasks the similarity-choice model does not fit the answers."""
    for one in results.identifications:
        if one.choice and one.choice.misfit and one.choice.misfit.p < MISFIT:
            tested = misfit_words(one.choice.misfit)
            yield (
                f"Warning: the similarity-choice model does not fit {one.task} ({tested}), so its similarities and "
                "biases do not describe these answers."
            )


def misfit_words(one: Misfit) -> str:
    """Return the test of a model's fit in print."""
    return f"F({one.df1}, {one.df2}) = {one.f:.2f}, {p_is(one.p)}"


RIGLESS = ("RECONSTRUCTION", "IMPORTED")
NO_RIG = "No rig is on record, so its effect on the stimuli is unknown."

VERIFY = "`palpate verify`"
"""What checks a dataset."""


def left_and_sure(study: Study, verify: str = VERIFY) -> str:
    """Return what was left out by rule, and how sure the data are, which `verify` checks."""
    return " ".join(
        [*exclusions_section(study).paragraphs, *[NO_RIG] * (study.origin in RIGLESS), how_sure(study, verify)]
    )


def how_sure(study: Study, verify: str = VERIFY) -> str:
    """Return whether the plan was sealed, which anchors the data have, and that `verify` checks them."""
    known = [part for part in study.parts if part.protocol is not None]
    if not known:
        return "The dataset has no protocol, so there is no record of what was planned."
    said = dict.fromkeys(f"Protocol: {part.sealed}." for part in known)
    anchors = [anchor for part in study.parts for anchor in part.anchors]
    if not anchors:
        return f"{' '.join(said)} The dataset has no anchor, so nothing proves that its data are unchanged."
    which = f"anchor {anchors[0]}" if len(anchors) == 1 else f"{len(anchors)} anchors, the latest {anchors[-1]}"
    return (
        f"{' '.join(said)} The dataset has {which}; compare it with your lab book. {verify} checks the data "
        f"against {'it' if len(anchors) == 1 else 'them'}."
    )


def _answers(study: Study, results: Results, stands: Standing) -> Iterator[Asked]:
    """Yield each planned test with its question and one answer, or else the tests in print, or two others."""
    planned = {one.plan: one for one in results.planned}
    plans = tuple(dict.fromkeys(study.plans()))
    for plan in plans:
        question, mark = first_question(plan), stands.mark(plan.test, *plan.tasks)
        if plan in planned:
            yield _answer(planned[plan], question, mark)
        else:
            yield _published(plan.test, plan.tasks, question, mark, plan.alpha, results, stands)
    tasks = tuple(task.task.id for task in results.tasks)
    known = {test for test, _ in stands.printed} & set(QUESTIONS) or {T, TWO_WAY}
    for test, question in QUESTIONS.items() if not plans else ():
        if test in known:
            pairs = {pair.pair for pair in results.pairs if stands.of_pair(pair) != "exploratory"}
            if test == ONE_WAY and len(pairs) == 1:
                question = question.replace("the two materials", joined(*pairs))
            yield _published(test, tasks, question, stands.mark(test, *tasks), 0.05, results, stands)


@dataclass(frozen=True)
class Words:
    """What a planned test over participants says: what it shows, or does not, how, and of which tasks."""

    shown: str
    other: str
    how: str
    tasks: str = " and "


DIFFERS = "shown to differ", "not shown to differ"
WORDS = {
    "sign flips against chance": Words("above chance", "not shown to be above chance", "Exact sign-flip tests"),
    "sign flips between tasks": Words(*DIFFERS, "Exact sign-flip tests of participants who did both tasks", " minus "),
    "sign flips between materials": Words(*DIFFERS, "Exact sign-flip tests"),
    "repeated measures": Words("shown", "not shown", "Repeated-measures ANOVA with the Huynh-Feldt correction"),
    "logit with participants": Words(
        "shown", "not shown", "Wald F test of a logit model in which participants vary by material and task",
    ),
    "equivalence": Words("shown to be equivalent", "not shown to be equivalent", "Two one-sided t-tests", " minus "),
    "order of tasks": Words(
        "shown to depend on order", "not shown to depend on order", "Exact test of which task each did first",
    ),
    "difference of groups": Words(*DIFFERS, "Permutation test of group membership with Welch's t"),
}  # fmt: skip
"""By the name of the test."""

FEW = 4
"""So many lines that show nothing are shown with their numbers; of more the first screen has the names."""


def _answer(one: Planned, question: str, mark: str) -> Asked:
    """Return the answer of a planned test over participants."""
    words = WORDS[one.plan.test]
    said = [
        f"{_capital(words.tasks.join(tasks))}: {_groups(one, words, tasks)}."
        for tasks in dict.fromkeys(line.tasks for line in one.lines)
    ]
    family = "" if one.plan.correction is None else f"; P is Holm-adjusted across the {one.plan.correction}"
    levels = {line.interval.confidence for line in one.lines if line.interval}
    limits = "".join(f", with {100 * level:g} % CI" for level in levels)
    people = " to ".join(dict.fromkeys(f"{pick(line.n for line in one.lines)}" for pick in (min, max) if one.lines))
    said += [f"{words.how} (n = {people}){limits}{family}."] * bool(one.lines)
    said += [f"No test of {name}: {why}." for name, why in one.statements.items()]
    return Asked(question, " ".join(said), mark, tuple(weak(one)))


def _capital(text: str) -> str:
    """Return a text that begins a sentence."""
    return text[:1].upper() + text[1:]


def _groups(one: Planned, words: Words, tasks: tuple[str, ...]) -> str:
    """Return what is shown of these tasks, then what is not."""
    chance = "" if one.plan.chance is None else f" ({one.plan.chance:.3g})"
    within = "" if one.plan.margin is None else f" within {one.plan.margin:g}"
    parts: list[str] = []
    for shown, word in ((True, words.shown), (False, words.other)):
        if those := [line for line in one.lines if line.tasks == tasks and line.shown == shown]:
            bare = not shown and len(those) > FEW
            listed = joined([line.subject if bare else _line(line) for line in those])
            of = f" for {listed}" if those[0].subject else f": {listed}"
            parts.append(f"{word}{'' if parts else chance}{within}{of}")
    return "; ".join(parts)


def _line(line: Line) -> str:
    """Return a line in short: its value with the interval or its F, and the P that is planned."""
    p = p_is(line.p if line.p_holm is None else line.p_holm)
    if line.df is not None and line.f is not None:
        return f"{line.subject} (F({line.df[0]}, {line.df[1]}) = {line.f:.2f}, {p})"
    limits = "" if line.interval is None else f"{bounds(line.interval, 2)}, "
    return f"{line.subject} {share(line.value, line.interval)} ({limits}{p})".lstrip()


def weak(one: Planned) -> Iterator[str]:
    """Yield what weakens the answer of a planned test."""
    yield from _rough([(line.subject or " and ".join(line.tasks), line.n, line.interval) for line in one.lines])
    if drawn := [line.error for line in one.lines if line.error]:
        yield f"P is from {DRAWS:,} random sign flips or permutations; its standard error is at most {max(drawn):.1g}."
    if loose := [f"{line.subject} in {' and '.join(line.tasks)}" for line in one.lines if line.loose]:
        yield LOOSE.format(joined(loose))
    if lacking := [line for line in one.lines if not line.shown and (line.least or 0.0) >= one.plan.alpha]:
        names = joined([" of ".join(filter(None, (line.subject, " and ".join(line.tasks)))) for line in lacking])
        yield f"So few participants have a nonzero difference that P cannot fall below alpha for {names}."


PLANNED_LINES = (
    Column("test", left=True), Column("tasks", left=True), Column("of", left=True), Column("n"), Column("value"),
    Column(("low", "high"), "interval"), Column("f", "F", 2), Column("df"), Column("p", "P", show=probability),
    Column("p_holm", "P (Holm)", show=probability), Column("alpha", show="{:g}".format), Column("shown", left=True),
)  # fmt: skip


def planned_sections(results: Results) -> tuple[Section, ...]:
    """Return a table with every line of the planned tests over participants, where there are any."""
    records: list[Record] = [
        {"test": one.plan.test, "tasks": ", ".join(line.tasks), "of": line.subject or None, "n": line.n,
         "value": line.value, **ends(line.interval), "confidence": line.interval and line.interval.confidence,
         "f": line.f, "df": None if line.df is None else f"{line.df[0]}, {line.df[1]}", "p": line.p,
         "p_holm": line.p_holm, "least": line.least, "error": line.error, "alpha": one.plan.alpha,
         "shown": "shown" if line.shown else "not shown"}
        for one in results.planned
        for line in one.lines
    ]  # fmt: skip
    why = tuple(
        f"{one.plan.test}, {name}: {reason}." for one in results.planned for name, reason in one.statements.items()
    )
    lacking: list[Record] = [
        {"test": one.plan.test, "tasks": ", ".join(one.plan.tasks), "of": name, "statement": reason}
        for one in results.planned
        for name, reason in one.statements.items()
    ]
    table = tabulate("", PLANNED_LINES, records, standing=PLANNED)
    section = Section("planned", "Planned tests", why, (table,) if records else (), tuple(lacking))
    return (section,) if results.planned else ()


def _published(
    test: str, tasks: tuple[str, ...], question: str, mark: str, level: float, results: Results, stands: Standing
) -> Asked:
    """Return the answer to a question that a published test asks."""
    match test:
        case "t against chance":
            if found := [one for one in map(results.task, tasks) if one is not None]:
                weak = (
                    BY_FLIPS.format("t-test"),
                    *_rough([(test.material, test.result.n, test.interval) for one in found for test in one.tests]),
                )
                said = " ".join(_materials_above(one, level) for one in found)
                return Asked(question, said, f"{mark}; companion test", weak)
        case "one-way ANOVA":
            if answers := tuple(_told_apart(results, tasks, stands, level)):
                return Asked(question, " ".join(answers), f"{mark} test", (ONE_WAY_ERRS,))
        case "two-way ANOVA" if len(results.tasks) > 1:
            return _tasks_differ(results, question, mark, level)
        case "ICC" if results.components and results.components.by_k[0][2] is not None:
            return _reliable(results.components, question, f"{mark} test")
    return Asked(question, UNDEFINED, mark)


def _rough(found: Sequence[tuple[str, int, Limits | None]]) -> Iterator[str]:
    """Yield which intervals, each of a subject and so many participants, are not what they are elsewhere."""
    known = [(subject, n, limits.over) for subject, n, limits in found if limits is not None]
    for over, what in OVER.items():
        if names := dict.fromkeys(subject for subject, _, of in known if of == over):
            yield what.format(joined(list(names)))
    if any(n == 2 and of == "participants" for _, n, of in known):
        yield TWO_ALONE


def _reliable(found: ComponentReliability, question: str, mark: str) -> Asked:
    """Return the ICC of the mean of all participants, and that of one of them."""
    both = list(zip(found.by_k, found.intervals, strict=True))
    parts = [
        f"{number(value)} (95 % CI {interval(limits)}) for {f'the mean of {k} participants' if k > 1 else 'one'}"
        for (k, _, value), limits in (both[0], both[-1])
    ]
    said = f"ICC from variance components: {'; '.join(parts)}."
    return Asked(question, said, mark, ("The reliability of a mean rises with its number of participants.",))


def share(value: float | None, limits: Limits | None) -> str:
    """Return a mean share in print, in words where an end of its interval is open."""
    if limits is None or (limits.low is not None and limits.high is not None):
        return number(value, 2)
    return "all wrong" if limits.low is None else "all right"


def _materials_above(task: TaskResult, level: float) -> str:
    """Return which materials sign flips, which hold, show above chance, with mean ratios and intervals."""
    shown = [test for test in task.tests if task.shows_above(test, task.flip(test), level)]
    others = [test for test in task.tests if test not in shown and test.result.mean is not None]
    parts = []
    if shown:
        most = max(p for test in shown if (p := task.flip(test)) is not None)
        parts.append(f"above chance ({task.chance:.3g}) for {listed(shown)}; exact sign-flip tests, {p_at_most(most)}")
    if others:
        parts.append(f"not shown to be above chance for {listed(others)}")
    return f"{_sample(task)}: {'; '.join(parts) or 'no answers'}."


def _sample(task: TaskResult) -> str:
    """Return a task that begins a sentence, with its number of participants."""
    return f"{_capital(task.task.id)} (n = {len(task.confusion.participants)})"


def listed(tests: Sequence[MaterialTest]) -> str:
    """Return mean ratios with their intervals, the first of which says what they are."""
    parts = []
    for place, test in enumerate(tests):
        limits = f", {'' if place else '95 % CI '}{bounds(test.interval, 2)}" if test.interval else ""
        parts.append(f"{test.material} ({share(test.result.mean, test.interval)}{limits})")
    return joined(parts)


def _told_apart(results: Results, tasks: tuple[str, ...], stands: Standing, level: float) -> Iterator[str]:
    for pair in results.pairs:
        if pair.task not in tasks or stands.of_pair(pair) == "exploratory" or pair.anova is None:
            continue
        effect = pair.anova.effects[0]
        task = results.task(pair.task)
        if task is not None and effect.f is not None and effect.p is not None:
            differ = "differ" if effect.p < level else "are not shown to differ"
            how = f"one-way ANOVA of their four answer ratios, {_effect(pair.anova, effect)}"
            yield f"{_sample(task)}: answers to {joined(pair.pair)} {differ} ({how})."


def _effect(anova: Anova, effect: Effect) -> str:
    """Return F, P, and partial eta squared with its interval, in print."""
    size = anova.eta_squared(effect)
    part = f"; partial η² {number(size.value, 2)}, 90 % CI {interval(size, 2)}" if size else ""
    return f"F({effect.df}, {anova.residual.df}) = {number(effect.f, 2)}, {p_is(effect.p or 0.0)}{part}"


def _tasks_differ(results: Results, question: str, mark: str, level: float) -> Asked:
    """Return the paired comparison of the participants who did both, or, without any, the two-way ANOVA."""
    paired = [
        f"{_capital(one.first)} minus {one.second}: {number(one.test.mean)} (95 % CI {interval(one.interval)}; "
        f"exact sign-flip test, {p_is(one.flip.p)}, n = {one.test.n}), "
        f"{'shown' if one.flip.p < level else 'not shown'} to differ."
        for one in results.beside.paired
        if one.test.mean is not None
    ]
    if paired:
        weak = BY_FLIPS.format("two-way ANOVA")
        return Asked(question, " ".join(paired), f"{mark}; companion test", (weak,))
    if not results.two_way or (effect := results.two_way[1].effects[0]).f is None or effect.p is None:
        return Asked(question, f"No test is defined: {results.two_way_statement or 'F is not defined'}.", mark)
    from palpate.analysis.identification.companion_tests import COMPARISON

    means = [
        f"{task.task.id} {sum(test.result.mean or 0.0 for test in task.tests) / len(task.tests):.2f}, "
        f"n = {len(task.confusion.participants)}"
        for task in results.tasks
    ]
    differ = "differ" if effect.p < level else "are not shown to differ"
    said = f"Mean ratios ({joined(means)}) {differ} (two-way ANOVA, {_effect(results.two_way[1], effect)})."
    missing, compared = results.beside.statements, COMPARISON.format(*(task.task.id for task in results.tasks))
    why = missing.get(compared) or next(iter(missing.values()), "nobody did both tasks")
    return Asked(question, said, f"{mark} test", (TWO_WAY_ERRS.format(why),))
