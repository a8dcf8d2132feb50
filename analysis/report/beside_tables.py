"""The tests of `identification.beside`, which are ours -> a section of tables and records, each named as ours."""

from __future__ import annotations

import math
from collections.abc import Mapping

from palpate.analysis.documents.tables import Section, Table, interval, number, p_is, probability
from palpate.analysis.identification.beside import Beside, Paired, SlopesLogit
from palpate.analysis.report.plan import TWO_WAY, Standing, marked
from palpate.analysis.statistics.participants import Repeated


def beside_section(found: Beside, stands: Standing, common: tuple[str, ...] = ()) -> Section:
    """Return tests that hold of what the analyses of variance ask, or why there is none, after what is `common`."""
    about = (
        "Ours take participants as the unit, where the analyses of variance take each ratio as independent. Tests "
        "against chance by sign flips, which are ours too, stand beside t."
    )
    missing = (f"There is no {name}: {reason}." for name, reason in found.statements.items())
    mark = stands.ours(TWO_WAY, *found.materials)
    section = Section(
        "beside", "Materials and tasks", (about, *common, *missing), _tables(found), tuple(_records(found))
    )
    return marked(section, mark)


def _tables(found: Beside) -> tuple[Table, ...]:
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


def _records(found: Beside) -> list[dict[str, object]]:
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
