"""What is ours of right answers -> sections: tests beside the analyses of variance, contrasts, equivalence, lapses."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, replace

from scipy.special import expit

from palpate.analysis.documents.tables import (
    Column,
    Record,
    Section,
    Table,
    bayes_factor,
    ends,
    number,
    p_is,
    probability,
    side_by_side,
    span,
    tabulate,
)
from palpate.analysis.identification.companion_tests import (
    MARGIN,
    Beside,
    Contrast,
    Equivalent,
    Marginal,
    Paired,
    SlopesLogit,
)
from palpate.analysis.identification.results import Results
from palpate.analysis.report.plan import ABOUT, TWO_WAY, Standing, marked
from palpate.analysis.statistics.participants import Jackknife, Repeated
from palpate.analysis.statistics.sign_flips import DRAWS, SignFlip


def _versus(*names: str) -> str:
    return " - ".join(names)


def _odds_ratio(log_odds: float) -> str:
    return number(math.exp(log_odds), 2)


def _odds_ratios(low: float, high: float) -> str:
    return span(math.exp(low), math.exp(high), 2)


P, HOLM = Column("p", "P", show=probability), Column("p_holm", "P (Holm)", show=probability)
LOG_ODDS = Column("log_odds", "log odds"), Column("error", "SE")
REPEATED = (
    Column("task", show=lambda task: "every task" if task == "all" else task, left=True),
    Column("source", left=True), Column("n"),
    Column("f", "F", 2), Column(("df", "df2"), "df", show=lambda *df: ", ".join(map(str, df))), Column("epsilon", "ε"),
    P, Column("p_uncorrected", "P, ε = 1", show=probability),
)  # fmt: skip
PAIRED = (
    Column("task", "tasks", left=True), Column("n"), Column("mean", "difference"), Column(("low", "high"), "95 % CI"),
    Column("sd", "SD"),
    Column("t", decimals=2), Column("df"), P, Column("cohens_d", "d", 2),
    Column(("d_low", "d_high"), "95 % CI of d", 2), Column("p_sign_flip", "sign flips: P", show=probability),
)  # fmt: skip
LOGIT = (
    Column("source", "term", left=True), Column("log_odds", "odds ratio", show=_odds_ratio),
    Column(("log_odds", "se"), "95 % CI", show=lambda mean, se: _odds_ratios(mean - 1.96 * se, mean + 1.96 * se)),
)  # fmt: skip
MEANS = (
    Column("task", left=True), Column("material", "presented", left=True), *LOG_ODDS,
    Column(("low", "high"), "95 % CI"), Column("log_odds", "share", show=lambda log_odds: number(expit(log_odds))),
    Column(("low", "high"), "95 % CI", show=lambda low, high: span(expit(low), expit(high))),
)  # fmt: skip
LAPSED = (
    Column("of", "presented", left=True), Column("lapse", "lapses"), Column(("lapse_low", "lapse_high"), "95 % CI"),
    Column("bias", "bias to it"), Column(("bias_low", "bias_high"), "95 % CI"),
)  # fmt: skip
CONTRASTS = (
    Column(("first", "second"), "difference", show=_versus, left=True), *LOG_ODDS,
    Column("log_odds", "odds ratio", show=_odds_ratio), Column(("low", "high"), "95 % CI", show=_odds_ratios),
    Column("t", decimals=2), Column("df"), P, HOLM,
)  # fmt: skip


def beside_section(found: Beside, stands: Standing, common: tuple[str, ...] = ()) -> Section:
    """Return tests that hold of what the analyses of variance ask, or why there is none, after what is `common`."""
    about = (
        "Companion tests use participants as the unit; the analyses of variance treat each ratio as independent. "
        "Exact sign-flip tests against chance are in the same table as t."
    )
    missing = (f"There is no {name}: {reason}." for name, reason in found.statements.items())
    mark = stands.ours(TWO_WAY, *found.materials)
    logit: Record = {"analysis": "logit by participant, material and task (companion)", "task": "all"}
    lines = [(task, line) for task, of in found.materials.items() for line in of]
    lines += [("all", line) for line in found.both]
    tables = [_repeated(lines), _paired(found.paired), *([_logit(found.logit, logit)] if found.logit else ())]
    tested: list[Record] = []
    if found.logit:
        tested = [
            {**logit, "source": term.name, "f": term.f, "df": term.df1, "df2": term.df2, "p": term.p}
            for term in found.logit.terms
        ]
        tested += [{**logit, "source": f"SD, {name}", "sd": sd} for name, sd in found.logit.sds.items()]
    shown = tuple(table for table in tables if table.rows)
    return marked(Section("beside", "Materials and tasks", (about, *common, *missing), shown, tuple(tested)), mark)


def _repeated(lines: Iterable[tuple[str, Repeated]]) -> Table:
    records: list[Record] = [
        {"analysis": "repeated measures (companion)", "task": task, "source": line.effect, "n": line.n, "f": line.f,
         "df": line.df1, "df2": line.df2, "epsilon": line.epsilon, "p": line.p, "p_uncorrected": line.p_uncorrected,
         "epsilon_greenhouse_geisser": line.greenhouse_geisser}
        for task, line in lines
    ]  # fmt: skip
    note = "Only participants with every material in every task are included. P has the Huynh-Feldt correction."
    return tabulate("Repeated measures: correct ratios, with participants as the unit", REPEATED, records, [note])


def _paired(pairs: Iterable[Paired]) -> Table:
    records: list[Record] = [
        {"analysis": "paired tasks (companion)", "task": _versus(one.first, one.second), "n": one.test.n,
         "mean": one.test.mean, **ends(one.interval),
         "sd": one.test.sd, "t": one.test.t, "df": one.test.df, "p": one.test.p,
         "cohens_d": one.test.d, **ends(one.d, "d_"), "p_sign_flip": one.flip.p}
        for one in pairs
    ]  # fmt: skip
    notes = [f"{_versus(one.first, one.second)}: {one.test.statement}." for one in pairs if one.test.statement]
    notes += sampled((_versus(one.first, one.second), one.flip) for one in pairs)
    notes.append(
        "If a proportion is below 0.1 or above 0.9, the interval allows for participants unlike these, so it can "
        "include 0 even when the tests find a difference."
    )
    return tabulate("Paired: mean correct ratios of participants who did both tasks", PAIRED, records, notes)


def sampled(flips: Iterable[tuple[str, SignFlip | None]]) -> list[str]:
    """Return which P of sign flips are from drawn signs, by the names of their tests."""
    return [
        f"{name}: P (sign flips) is from {DRAWS:,} random sign flips, with a standard error of {flip.error:.1g}."
        for name, flip in flips
        if flip and flip.error is not None
    ]


def _logit(found: SlopesLogit, kind: Record) -> Table:
    records: list[Record] = [
        {**kind, "source": name, "log_odds": estimate, "se": error}
        for name, (estimate, error) in found.coefficients.items()
    ]
    tests = "; ".join(f"{t.name}: F({t.df1}, {t.df2}) = {t.f:.2f}, {p_is(t.p)}" for t in found.terms)
    notes = (
        f"Wald tests: {tests}.",
        f"SDs of the log odds across participants: {_named(found.sds)}.",
    )
    title = f"Logit model in which {found.participants} participants vary in level, by material and by task"
    return tabulate(title, LOGIT, records, notes)


def _named(sds: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {sd:.2f}" for name, sd in sds.items())


def contrasts_section(results: Results) -> Section:
    """Return the marginal means of right answers, and what differs between materials and between tasks."""
    found, why = results.marginal
    if found is None:
        return Section("contrasts", "Marginal means and contrasts", (f"There are no marginal means: {why}.",))
    tables = tuple(table for table in _tables(found) if table.rows)
    return Section("contrasts", "Marginal means and contrasts", _about(found), tables)


def equivalence_section(results: Results) -> Section:
    """Return whether tasks, and materials, are shown to be the same within a margin."""
    found = results.equivalences
    about = (
        ABOUT["equivalence"].substitute(),
        *(f"{why[0].upper()}{why[1:]}." for why in found.statements),
    )
    own = (
        f"palpate, not the protocol, sets this margin of {MARGIN:g} (one answer in ten), so the test is exploratory. "
        "Margins that were planned are listed with the planned tests."
    )
    tasks = (
        "Each participant's proportion correct in the first task minus that in the second, for participants who did "
        f"both. P (Holm) is adjusted across the materials. {own}"
    )
    pairs = ABOUT["equivalence of pairs"].substitute(own=own)
    tables = (
        _equivalent("Equivalence of tasks: proportion correct", "tasks", "presented", found.tasks, tasks),
        _equivalent("Indistinguishable pairs of materials", "task", "pair", found.pairs, pairs),
    )
    return Section("equivalence", "Equivalence", about, tuple(table for table in tables if table.rows))


def _equivalent(title: str, tasks: str, what: str, of: Iterable[Equivalent], note: str) -> Table:
    records = [{"tasks": one.tasks, "of": one.subject, **asdict(one.result), "p_holm": one.p_holm} for one in of]
    columns = (
        Column("tasks", tasks, show=lambda names: _versus(*names), left=True), Column("of", what, left=True),
        Column("n"), Column("mean", "difference" if tasks == "tasks" else "discrimination"), Column("sd", "SD"),
        Column(("low", "high"), "90 % CI"),
        Column("margin", show="{:g}".format),
        P, HOLM, Column("log_bf01", "BF01", show=bayes_factor),
    )  # fmt: skip
    return tabulate(title, columns, records, [note])


def _about(found: Marginal) -> tuple[str, ...]:
    left_out = " and ".join(f"{material} in {task}" for task, material in found.left_out)
    return (
        ABOUT["contrasts"].substitute(participants=found.participants, sds=_named(found.sds)),
        *(f"The odds of {left_out} are zero or infinite and omitted: all answers were right, or all wrong."
          for _ in found.left_out[:1]),
    )  # fmt: skip


def _tables(found: Marginal) -> tuple[Table, ...]:
    means = [{"table": "mean", **asdict(one)} for one in found.means]
    note = "Limits come from Student's t with n - 1 degrees of freedom."
    held = (
        "In SIMULATED studies of 6 to 25 participants (nominal: 5 %), each test rejected a true null in {often}, least "
        "often with 6. The odds ratio and its interval are not adjusted."
    )
    pairs = "P (Holm) is adjusted across the pairs within each task. "
    every = "P (Holm) is adjusted across all rows of this table. "
    return (
        tabulate("Marginal means of proportion correct", MEANS, means, [note]),
        _contrasts("materials within a task", "task", found.materials, pairs + held.format(often=MATERIALS)),
        _contrasts("tasks within a material", "presented", found.tasks, every + held.format(often=TASKS)),
    )


def lapses_section(results: Results, materials: tuple[str, ...]) -> Section:
    """Return what the bias and lapse model says of each task: who lapses, at what, and what is named then."""
    tables = []
    about = ABOUT["lapses"].substitute(held=LAPSES)
    for one in results.identifications:
        if (found := one.lapses) is None:
            continue
        model = found.model
        records = [
            _lapse(one.task, quantity, material, value, limits)
            for quantity, values, intervals in (
                ("lapse", model.lapses, found.lapses),
                ("bias", model.biases, found.biases),
            )
            for material, value, limits in zip(materials, values.tolist(), intervals, strict=True)
        ]
        records.append(_lapse(one.task, "lapse", "all", model.lapse, found.lapse))
        further = [_lapse(one.task, f"G2 on {model.df} df", "all", model.g2, None)]
        further += [_lapse(one.task, "known", f"participant {who}", known, None) for who, known in found.known.items()]
        notes = [f"G² = {model.g2:.2f}, {model.df} df. There is no P, because participants differ."]
        if found.guessing:
            notes.append(
                "Not shown to do better than guessing (one-tailed, 5 %, each tested alone): "
                f"{', '.join(found.guessing)}."
            )
        title = f"{one.task}: biases and lapses"
        table = tabulate(title, LAPSED, side_by_side(records), notes)
        tables.append(replace(table, records=(*records, *further)))
    return Section("lapses", "Biases and lapses", (about,), tuple(tables))


def _lapse(task: str, quantity: str, of: str, value: float, limits: Jackknife | None) -> Record:
    return {"task": task, "quantity": quantity, "of": of, "value": value, **ends(limits)}


LAPSES, MATERIALS, TASKS = "91 to 97 %", "2 to 6 %", "0 to 5 %"
"""How often the jackknife of lapses covered, and contrasts erred, in `tests.benchmarks`."""


def _contrasts(name: str, within: str, of: Iterable[Contrast], note: str) -> Table:
    records = [{"table": name, **asdict(one)} for one in of]
    return tabulate(name[:1].upper() + name[1:], (Column("within", within, left=True), *CONTRASTS), records, [note])
