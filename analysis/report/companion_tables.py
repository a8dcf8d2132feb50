"""What is ours of right answers -> sections: tests beside the analyses of variance, contrasts, equivalence, lapses."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict

from scipy.special import expit

from palpate.analysis.documents.tables import Section, Table, bayes_factor, interval, number, p_is, probability
from palpate.analysis.identification.beside import Beside, Paired, SlopesLogit
from palpate.analysis.identification.contrasts import MARGIN, Contrast, Equivalences, Equivalent, Marginal
from palpate.analysis.identification.results import Results
from palpate.analysis.report.plan import TWO_WAY, Standing, marked
from palpate.analysis.statistics.participants import Jackknife, Repeated


def beside_section(found: Beside, stands: Standing, common: tuple[str, ...] = ()) -> Section:
    """Return tests that hold of what the analyses of variance ask, or why there is none, after what is `common`."""
    about = (
        "Ours take participants as the unit, where the analyses of variance take each ratio as independent. Tests "
        "against chance by sign flips, which are ours too, stand beside t."
    )
    missing = (f"There is no {name}: {reason}." for name, reason in found.statements.items())
    mark = stands.ours(TWO_WAY, *found.materials)
    section = Section(
        "beside",
        "Materials and tasks",
        (about, *common, *missing),
        _beside_tables(found),
        tuple(_beside_records(found)),
    )
    return marked(section, mark)


def _beside_tables(found: Beside) -> tuple[Table, ...]:
    """Return a table of repeated measures, of paired tasks and of the logit; one without rows is left out."""
    lines = [(task, line) for task, of in found.materials.items() for line in of]
    lines += [("every task", line) for line in found.both]
    rows = tuple(
        (task, line.effect, str(line.n), number(line.f, 2), f"{line.df1}, {line.df2}", number(line.epsilon),
         probability(line.p), probability(line.p_uncorrected))
        for task, line in lines
    )  # fmt: skip
    header = ("task", "source", "n", "F", "df", "ε", "P", "P, ε = 1")
    notes = (
        "Participants with every material, and every task, count. P has the correction of Greenhouse and Geisser. In "
        "SIMULATED studies, at a nominal 5 %, it erred in 2 to 3 % with 6 participants, and in 3 to 5 % from 10 on.",
    )
    repeated = Table("Repeated measures: correct ratios, with participants as the unit", header, rows,
                     left=frozenset({0, 1}), notes=notes)  # fmt: skip
    tables = [repeated, _paired(found.paired), *([_logit(found.logit)] if found.logit else ())]
    return tuple(table for table in tables if table.rows)


def _paired(pairs: tuple[Paired, ...]) -> Table:
    rows = tuple(
        (f"{one.first} - {one.second}", str(one.test.n), number(one.test.mean), number(one.test.sd),
         number(one.test.t, 2), str(one.test.df), probability(one.test.p), number(one.test.d, 2), interval(one.d, 2),
         probability(one.flip.p))
        for one in pairs
    )  # fmt: skip
    header = ("tasks", "n", "difference", "SD", "t", "df", "P", "d", "95 % CI of d", "sign flips: P")
    notes = tuple(f"{one.first} - {one.second}: {one.test.statement}." for one in pairs if one.test.statement)
    said = (
        "In SIMULATED studies, at a nominal 5 %, t erred in 4 to 6 %, and sign flips in 1 to 2 % with 6 "
        "participants and in 3 to 5 % from 10 on.",
    )
    title = "Paired: mean correct ratios of participants who did both tasks"
    return Table(title, header, rows, notes=(*notes, *said))


def _logit(found: SlopesLogit) -> Table:
    rows = tuple(
        (name, number(math.exp(estimate), 2),
         f"{math.exp(estimate - 1.96 * error):.2f} to {math.exp(estimate + 1.96 * error):.2f}")
        for name, (estimate, error) in found.coefficients.items()
    )  # fmt: skip
    tests = "; ".join(f"{t.name}: F({t.df1}, {t.df2}) = {t.f:.2f}, {p_is(t.p)}" for t in found.terms)
    spread = ", ".join(f"{name} {sd:.2f}" for name, sd in found.sds.items())
    notes = (
        f"Wald tests: {tests}.",
        f"The SDs of the log odds among participants are: {spread}.",
        "In 60 SIMULATED studies of each size, from 6 to 25 participants, the tests erred in 0 to 8 %, at a nominal "
        "5 %.",
    )
    title = f"Logit in which {found.participants} participants differ in level, by material and by task"
    return Table(title, ("term", "odds ratio", "95 % CI"), rows, notes=notes)


def _beside_records(found: Beside) -> list[dict[str, object]]:
    """Return the records of every table, with full precision."""
    records = [_repeated(task, line) for task, lines in found.materials.items() for line in lines]
    records += [_repeated("all", line) for line in found.both]
    for one in found.paired:
        low, high = (one.d.low, one.d.high) if one.d else (None, None)
        records.append(
            {"analysis": "paired tasks (ours)", "task": f"{one.first} - {one.second}", "n": one.test.n,
             "mean": one.test.mean, "sd": one.test.sd, "t": one.test.t, "df": one.test.df, "p": one.test.p,
             "cohens_d": one.test.d, "d_low": low, "d_high": high, "p_sign_flip": one.flip.p}
        )  # fmt: skip
    if found.logit:
        kind: Mapping[str, object] = {"analysis": "logit by participant, material and task (ours)", "task": "all"}
        for name, (estimate, error) in found.logit.coefficients.items():
            records.append({**kind, "source": name, "log_odds": estimate, "se": error})
        for term in found.logit.terms:
            records.append({**kind, "source": term.name, "f": term.f, "df": term.df1, "df2": term.df2, "p": term.p})
        records += [{**kind, "source": f"SD, {name}", "sd": sd} for name, sd in found.logit.sds.items()]
    return records


def _repeated(task: str, line: Repeated) -> dict[str, object]:
    return {
        "analysis": "repeated measures (ours)", "task": task, "source": line.effect, "n": line.n, "f": line.f,
        "df": line.df1, "df2": line.df2, "epsilon": line.epsilon, "p": line.p, "p_uncorrected": line.p_uncorrected,
    }  # fmt: skip


def contrasts_section(results: Results) -> Section:
    """Return the marginal means of right answers, and what differs between materials and between tasks."""
    found, why = results.marginal
    if found is None:
        return Section("contrasts", "Marginal means and contrasts", (f"There are no marginal means: {why}.",))
    records: list[Mapping[str, object]] = [{"table": "mean", **asdict(one)} for one in found.means]
    for name, of in (("materials within a task", found.materials), ("tasks within a material", found.tasks)):
        records += [{"table": name, **asdict(one)} for one in of]
    keys = dict.fromkeys(key for record in records for key in record)
    same = tuple({key: record.get(key) for key in keys} for record in records)
    tables = tuple(table for table in _tables(found) if table.rows)
    return Section("contrasts", "Marginal means and contrasts", _about(found), tables, same)


def equivalence_section(results: Results) -> Section:
    """Return whether tasks, and materials, are shown to be the same within a margin."""
    found = results.equivalences
    about = (
        "That a test finds no difference does not show that there is none. These tests, which are ours, ask whether a "
        "difference lies within a margin, either way: two one-sided t-tests with participants as the unit, whose P is "
        "below 0.05 where the 90 % interval lies within the margin. BF01 is the JZS Bayes factor for no difference at "
        "all over some; above 1 it favours none. In SIMULATED studies whose true difference was the margin, the tests "
        f"erred in {EQUIVALENT}, at a nominal 5 %.",
        *(f"{why[0].upper()}{why[1:]}." for why in found.statements),
    )
    tables = tuple(table for table in _equivalences(found) if table.rows)
    records = tuple(
        {"tasks": " and ".join(one.tasks), "of": one.subject, "planned": one.planned, **asdict(one.result),
         "p_holm": one.p_holm}
        for one in (*found.tasks, *found.pairs)
    )  # fmt: skip
    return Section("equivalence", "Equivalence", about, tables, records)


def _equivalences(found: Equivalences) -> tuple[Table, ...]:
    own = (
        "The margin is that of the protocol where it says planned. Elsewhere it is ours, "
        f"{MARGIN:g}, one answer in ten, and the test is exploratory."
    )
    tasks = (
        "Each participant's share of right answers in the first task less that in the second, of those who did both. "
        f"P (Holm) is adjusted over the materials. {own}"
    )
    pairs = (
        "Told apart is how much more often a material was named when it was presented than when the other one of the "
        "pair was, the mean of both: 1 for a pair that is always told apart, 0 for one that is not at all. P (Holm) is "
        f"adjusted over the pairs of a task. {own}"
    )
    return (
        _equivalent("Ours, the same in both tasks: right answers", "tasks", "presented", found.tasks, tasks),
        _equivalent("Ours, not told apart: pairs of materials", "task", "pair", found.pairs, pairs),
    )


def _equivalent(title: str, tasks: str, what: str, of: Sequence[Equivalent], note: str) -> Table:
    rows = tuple(
        (" - ".join(one.tasks), one.subject, str(one.result.n), number(one.result.mean), number(one.result.sd),
         f"{one.result.low:.3f} to {one.result.high:.3f}",
         f"{one.result.margin:g}, {'planned' if one.planned else 'exploratory'}", probability(one.result.p),
         probability(one.p_holm), bayes_factor(one.result.log_bf01))
        for one in of
    )  # fmt: skip
    header = (tasks, what, "n", "difference", "SD", "90 % CI", "margin", "P", "P (Holm)", "BF01")
    header = header if len(of) == 0 or len(of[0].tasks) > 1 else (*header[:3], "told apart", *header[4:])
    return Table(title, header, rows, left=frozenset({0, 1, 6}), notes=(note,))


EQUIVALENT = "0 to 5 %"
"""How often the equivalence tests erred in `tests.benchmarks.inference`."""


def _about(found: Marginal) -> tuple[str, ...]:
    spread = ", ".join(f"{name} {sd:.2f}" for name, sd in found.sds.items())
    left_out = " and ".join(f"{material} in {task}" for task, material in found.left_out)
    return (
        f"All of this is ours: means and differences of log odds, from a logit in which {found.participants} "
        "participants differ in level, by material, by task and by each material in each task. It is the model with "
        "participants that holds: with random intercepts alone a quarter of SIMULATED studies err, at a nominal 5 %, "
        "and GEE has fewer degrees of freedom than there are means where participants are few. The share is that of a "
        f"participant in the middle, not the mean share. The SDs of the log odds among participants are: {spread}.",
        *(f"Without a limit, and left out, are the odds of {left_out}: all answers were right, or all wrong."
          for _ in found.left_out[:1]),
    )  # fmt: skip


def _tables(found: Marginal) -> tuple[Table, ...]:
    rows = tuple(
        (one.task, one.material, number(one.log_odds), number(one.error), f"{one.low:.3f} to {one.high:.3f}",
         number(expit(one.log_odds)), f"{expit(one.low):.3f} to {expit(one.high):.3f}")
        for one in found.means
    )  # fmt: skip
    header = ("task", "presented", "log odds", "SE", "95 % CI", "share", "95 % CI")
    note = "Limits are those of Student's t on n - 1 degrees of freedom."
    means = Table("Ours, marginal means of right answers", header, rows, left=frozenset({0, 1}), notes=(note,))
    held = (
        "In SIMULATED studies of 6 to 25 participants, at a nominal 5 %, one of these tests erred in {often}, least "
        "often with 6. Odds ratio and its interval are not adjusted."
    )
    pairs = "P (Holm) is adjusted over the pairs of one task. "
    every = "P (Holm) is adjusted over all rows of this table. "
    return (
        means,
        _contrasts("Ours, materials within a task", "task", found.materials, pairs + held.format(often=MATERIALS)),
        _contrasts("Ours, tasks within a material", "presented", found.tasks, every + held.format(often=TASKS)),
    )


def lapses_section(results: Results, materials: tuple[str, ...], remark: tuple[str, ...]) -> Section:
    """Return what the bias and lapse model says of each task: who lapses, at what, and what is named then."""
    tables: list[Table] = []
    records: list[Mapping[str, object]] = []
    about = (
        "Ours: each trial is known, or lapses and is guessed, by a bias that is the same for all materials. Lapses "
        "above 1 are fewer right answers than such guesses give. A G² far above its df says that wrong answers "
        "follow which materials are alike, and not a bias alone; lapses and biases then explain little. "
        f"Intervals are jackknives over participants, which held the truth in {LAPSES} of SIMULATED studies."
    )
    for one in results.identifications:
        if (found := one.lapses) is None:
            continue
        model = found.model
        rows = [
            (material, number(lapse), interval(limits), number(bias), interval(limits_of_bias))
            for material, lapse, limits, bias, limits_of_bias in zip(
                materials, model.lapses.tolist(), found.lapses, model.biases.tolist(), found.biases, strict=True
            )
        ]
        rows.append(("all", number(model.lapse), interval(found.lapse), "", ""))
        notes = [f"G² = {model.g2:.2f}, {model.df} df. It has no P, because participants differ."]
        if found.guessing:
            notes.append(
                "Not shown to have known any trial, at 5 % and one-tailed, each taken alone: "
                f"{', '.join(found.guessing)}."
            )
        title = f"Ours, {one.task}: biases and lapses"
        header = ("presented", "lapses", "95 % CI", "bias to it", "95 % CI")
        tables.append(Table(title, header, tuple(rows), notes=tuple(notes)))
        for quantity, values, limits_of in (
            ("lapse", model.lapses, found.lapses), ("bias", model.biases, found.biases)
        ):  # fmt: skip
            for material, value, limits in zip(materials, values.tolist(), limits_of, strict=True):
                records.append(_lapse(one.task, quantity, material, value, limits))
        records.append(_lapse(one.task, "lapse", "all", model.lapse, found.lapse))
        records.append(_lapse(one.task, f"G2 on {model.df} df", "all", model.g2, None))
        records += [_lapse(one.task, "known", f"participant {who}", known, None) for who, known in found.known.items()]
    return Section("lapses", "Biases and lapses", (about, *remark), tuple(tables), tuple(records))


def _lapse(task: str, quantity: str, of: str, value: float, limits: Jackknife | None) -> dict[str, object]:
    low, high = (limits.low, limits.high) if limits else (None, None)
    return {"task": task, "quantity": quantity, "of": of, "value": value, "low": low, "high": high}


LAPSES = "91 to 97 %"
"""How often the jackknife of lapses covered in `tests.benchmarks.inference`."""

MATERIALS, TASKS = "2 to 6 %", "0 to 5 %"
"""How often the contrasts erred in `tests.benchmarks.inference`."""


def _contrasts(title: str, within: str, of: Sequence[Contrast], note: str) -> Table:
    rows = tuple(
        (one.within, f"{one.first} - {one.second}", number(one.log_odds), number(one.error),
         number(math.exp(one.log_odds), 2), f"{math.exp(one.low):.2f} to {math.exp(one.high):.2f}",
         number(one.t, 2), str(one.df), probability(one.p), probability(one.p_holm))
        for one in of
    )  # fmt: skip
    header = (within, "difference", "log odds", "SE", "odds ratio", "95 % CI", "t", "df", "P", "P (Holm)")
    return Table(title, header, rows, left=frozenset({0, 1}), notes=(note,))
