"""One wrong number as the single cause of several that disagree.

Values that test and row allow are tried, swapped rows and cells, and one participant or trial more or fewer. The cause
that settles most conflicts, and brings none, is taken, of equals the least likely by chance, then checked.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from itertools import combinations

from palpate.analysis.audit.bounds import Work, totals
from palpate.analysis.audit.checks import Checks, is_in, ratio_subject, stars_of
from palpate.analysis.audit.evidence import FromPrint
from palpate.analysis.audit.intervals import Interval, either, outward, sum_of
from palpate.analysis.audit.mistakes import SWAPPED, TENFOLD, Line, Verdict, mistake_words, slips
from palpate.analysis.published.numbers import Key, PrintedCell, PrintedScores, PrintedT, PrintedTable, Published
from palpate.analysis.published.printed import Printed
from palpate.experiment.errors import PublishedError

CONFLICTS: tuple[Verdict, ...] = ("differs", "impossible")

MOST_CAUSES = 10
"""Causes that are looked for in one file; where there are more, the numbers are better compared by hand."""

FEWEST = 2
"""Conflicts that a cause has to settle: one alone is settled by many numbers, and keeps its own line."""

MOST_VALUES = 40
"""Values that a number is tried with; where its test leaves more open, it says too little."""

MOST_EACH = 2
"""Cells that one cause puts right and of which each is named where their row is added; swapped rows are named once."""

MOST_TRIED = 1_000_000
"""Means and variances that the search for causes may try; counted as `evidence.MOST_WORK` is."""

Place = tuple[str, str, str, str]
"""Of a line: where it stands, its task, its subject and its quantity."""


@dataclass(frozen=True)
class Cause:
    """What may be wrong: cells by key with mean and SD, or a task's number; its chance, and the conflicts it ends."""

    text: str
    by_chance: float
    cells: Mapping[Key, Mapping[str, str]] = field(default_factory=dict)
    tasks: tuple[str, ...] = ()
    quantity: str = ""
    value: int = 0
    settles: int = 0


def find(published: Published, evidence: FromPrint) -> tuple[Published, FromPrint, tuple[Cause, ...]]:
    """Return the printed numbers and their evidence with what is wrong put right, and what that was."""
    found: list[Cause] = []
    work, left = Work(MOST_TRIED), evidence.work
    try:
        while len(found) < MOST_CAUSES and (cause := _best(published, evidence, work)):
            published, evidence = _right(published, evidence, cause, work)
            found.append(cause)
    except PublishedError:
        # The search has tried what it may; what it has found stands.
        pass
    return published, evidence.working_with(published, work=left), tuple(found)


def accused(lines: Iterable[Line], printed: Published, causes: Sequence[Cause]) -> Iterator[Line]:
    """Yield the lines of a study that was put right with the wrong numbers as printed, each accused."""
    wrong: dict[Place, tuple[str, str, str]] = {}
    rows: dict[tuple[str, str], dict[str, None]] = {}
    for cause in causes:
        settled = f"{cause.text}; correcting this resolves {cause.settles} conflicts"
        for cell in printed.tables():
            held = {"mean": cell.mean.text, "SD": cell.sd.text if cell.sd else "", "stars": cell.stars or "none"}
            for name, right in cause.cells.get(cell.key, {}).items():
                wrong[cell.where, cell.task, cell.subject, name] = held[name], right or "none", settled
                if name != "stars":
                    told = f"with {right} instead of {held[name]}" if len(cause.cells) <= MOST_EACH else cause.text
                    rows.setdefault((cell.task, f"row of {cell.presented}"), {})[told] = None
        for task in printed.task:
            if task.id in cause.tasks:
                number = getattr(task, cause.quantity)
                yield Line(
                    "Tasks", task.id, cause.quantity, cause.quantity, str(number), str(cause.value),
                    cause.value, cause.value, "differs", settled,
                )  # fmt: skip
    for line in lines:
        place = line.where, line.task, line.subject, line.quantity
        if place in wrong:
            text, right, reason = wrong[place]
            value = None if line.quantity == "stars" else Printed(right).value
            yield replace(line, printed=text, recomputed=right, low=value, high=value, verdict="differs", reason=reason)
        elif line.quantity == "row" and (line.task, line.subject) in rows:
            with_ = " and ".join(rows[line.task, line.subject])
            own = [cell for cell in printed.tables() if (cell.where, f"row of {cell.presented}") == place[::2]]
            text = added([cell for cell in own if cell.task == line.task])
            yield replace(line, printed=text, reason="; ".join(filter(None, [line.reason, with_])))
        else:
            yield line


def added(row: Sequence[PrintedCell]) -> str:
    """Return the means of a row and their sum, as they are printed."""
    return f"{' + '.join(cell.mean.text for cell in row)} = {float(sum(cell.mean.exact for cell in row)):.4g}"


def _best(published: Published, evidence: FromPrint, work: Work) -> Cause | None:
    everything = _conflicts(published, evidence, None)
    if not everything:
        return None
    before: dict[tuple[Key, ...], frozenset[Place]] = {}
    best: tuple[int, float, Cause] | None = None
    for cause in _possible(published, evidence, everything):
        keys = tuple(cause.cells) or None
        if keys is None:
            old = everything
        else:
            if keys not in before:
                before[keys] = _conflicts(published, evidence, keys)
            old = before[keys]
        if len(old) < (best[0] if best else FEWEST):
            continue
        other, its = _right(published, evidence, cause, work)
        new = _conflicts(other, its, keys)
        settled = old - new
        if new - old or any(place in new for place in _own(other, cause)) or len(settled) < FEWEST:
            continue
        if best is None or (len(settled), -cause.by_chance) > (best[0], -best[1]):
            best = len(settled), cause.by_chance, replace(cause, settles=len(settled))
    return best[2] if best else None


def _own(published: Published, cause: Cause) -> Iterator[Place]:
    """Yield the places of the cells that a cause changes, and of their tests."""
    for key in cause.cells:
        for cell in published.cells_by_key.get(key, ()):
            yield from ((cell.where, cell.task, cell.subject, name) for name in ("mean", "SD", "stars"))
        for test in published.tests_by_key.get(key, ()):
            yield from ((test.where, test.task, test.material, name) for name in (f"t({test.df})", "P"))


def _conflicts(published: Published, evidence: FromPrint, keys: Sequence[Key] | None) -> frozenset[Place]:
    """Return the places of all conflicts, or of those that have to do with the cells with these keys."""
    checks = Checks(published, evidence, diagnose=False)
    if keys is None:
        lines = [*checks.lines()]
        named = {cell.key[:2] for cell in published.tables()}
    else:
        cells = [cell for key in keys for cell in published.cells_by_key.get(key, ())[:1]]
        lines = [line for cell in cells for line in checks.about(cell)] + [*checks.ratios_of(cells)]
        named = {key[:2] for key in keys}
    found = {(one.where, one.task, one.subject, one.quantity) for one in lines if one.verdict in CONFLICTS}
    return frozenset(found | set(_rows(published, named)))


def _rows(published: Published, named: set[tuple[str, str]]) -> Iterator[Place]:
    """Yield the rows whose means cannot add up."""
    for table in published.table:
        for presented, row in by_row(published, table).items():
            if table.complete and (table.task, presented) in named and left_by(published, row, None) is None:
                yield table.where, table.task, f"row of {presented}", "row"


def by_row(published: Published, table: PrintedTable) -> dict[str, list[PrintedCell]]:
    """Return the cells of a table by what was presented."""
    rows: dict[str, list[PrintedCell]] = {}
    for cell in published.cells_of(table):
        rows.setdefault(cell.presented, []).append(cell)
    return rows


def left_by(published: Published, row: Sequence[PrintedCell], but: Key | None) -> Interval | None:
    """Return what the means of a row leave for the cell `but`; without it, 0 where they add up to 1, or None."""
    task = published.task_named(row[0].task)
    others = [cell for cell in row if cell.key != but]
    if task is None or task.trials is None:
        rest = sum_of(either(cell.mean) for cell in others).times(Fraction(-1)).plus(Interval(Fraction(1), Fraction(1)))
    else:
        every = task.participants * task.trials
        sums = [totals(either(cell.mean), task.participants, task.trials) for cell in others]
        if not all(sums):
            return None
        low, high = every - sum(max(one) for one in sums), every - sum(min(one) for one in sums)
        rest = Interval(Fraction(low, every), Fraction(high, every))
    if but is None:
        return rest if rest.holds(Fraction(0)) else None
    return rest


def _possible(published: Published, evidence: FromPrint, conflicts: frozenset[Place]) -> Iterator[Cause]:
    """Yield what may be wrong where there are conflicts, the likeliest kinds first."""
    yield from _of_tasks(published, conflicts)
    subjects = {(place[1], place[2]) for place in conflicts}
    for table in published.table:
        rows = by_row(published, table)
        doubtful = {
            cell.key
            for row in rows.values()
            for cell in row
            if {(cell.task, cell.subject), (cell.task, f"row of {cell.presented}")} & subjects
            or (cell.presented == cell.answered and (cell.task, cell.presented) in subjects)
        }
        yield from _swapped_rows(published, rows, doubtful | _in_ratios(published, rows, subjects))
        yield from _swapped_cells(rows, doubtful)
        for row in rows.values():
            for cell in row:
                if cell.key in doubtful and evidence.misreading(cell) is None:
                    left = left_by(published, row, cell.key) if table.complete else None
                    others = [one for other in rows.values() for one in other if one is not cell]
                    yield from _values(published, cell, left, others)
    for block in published.score:
        for cell in published.cells_of(block):
            if (cell.task, cell.subject) in subjects and evidence.misreading(cell) is None:
                yield from _values(published, cell, None, ())


def _in_ratios(
    published: Published, rows: Mapping[str, Sequence[PrintedCell]], subjects: set[tuple[str, str]]
) -> set[Key]:
    """Return the keys of the cells of which an F in conflict is computed."""
    ratios = [one for one in published.anovas if (one.task or "both", ratio_subject(one)) in subjects]
    return {cell.key for row in rows.values() for cell in row if any(is_in(one, cell) for one in ratios)}


def _decimals(own: Printed, others: Iterable[Printed | None]) -> int:
    """Return with how many decimals a number should be printed: as the others are, for its own point may be wrong."""
    texts = [one.text for one in others if one] or [own.text]
    return max(len(text.rstrip("%").partition("e")[0].partition(".")[2]) + 2 * text.endswith("%") for text in texts)


def _swapped_rows(
    published: Published, rows: Mapping[str, Sequence[PrintedCell]], doubtful: set[Key]
) -> Iterator[Cause]:
    for one, other in combinations(rows, 2):
        above, below = ({cell.answered: cell for cell in rows[name]} for name in (one, other))
        if set(above) == set(below) and {cell.key for cell in (*rows[one], *rows[other])} & doubtful:
            pairs = [(above[name], below[name]) for name in above]
            text = f"the rows of {one} and {other} are swapped"
            yield from _exchanges(text, 0.01, pairs)
            if not any(cell.stars for cell in (*rows[one], *rows[other])):
                yield _with_stars(published, next(_exchanges(f"{text}, without their stars", 0.01, pairs)))


def _with_stars(published: Published, cause: Cause) -> Cause:
    """Return an exchange of rows with the stars that the printed P of their tests earn."""
    cells = dict(cause.cells)
    for key in cause.cells:
        for test in published.tests_by_key.get(key, ())[:1]:
            levels = [one for one in published.levels if test.t.exact > 0 or not one.above]
            mark = stars_of(test.p, levels) if test.p else "none"
            cells[key] = {**cells[key], "stars": mark.removeprefix("none")}
    return replace(cause, cells=cells)


def _swapped_cells(rows: Mapping[str, Sequence[PrintedCell]], doubtful: set[Key]) -> Iterator[Cause]:
    cells = [cell for row in rows.values() for cell in row]
    for first, second in combinations(cells, 2):
        near = first.presented == second.presented or first.answered == second.answered
        if near and {first.key, second.key} & doubtful and first.mean.text != second.mean.text:
            names = f"{first.subject} and {second.subject}"
            yield from _exchanges(f"the cells {names} are swapped", 0.02, [(first, second)])


def _exchanges(text: str, by_chance: float, pairs: Sequence[tuple[PrintedCell, PrintedCell]]) -> Iterator[Cause]:
    """Yield the exchange of cells without their stars, and with them where these differ."""
    numbers: dict[Key, dict[str, str]] = {}
    stars: dict[Key, dict[str, str]] = {}
    for pair in pairs:
        for cell, other in (pair, pair[::-1]):
            sd = {"SD": other.sd.text} if other.sd and cell.sd and other.sd.text != cell.sd.text else {}
            mean = {"mean": other.mean.text} if other.mean.text != cell.mean.text else {}
            moved = {"stars": other.stars or ""} if (other.stars or "") != (cell.stars or "") else {}
            numbers |= {cell.key: {**mean, **sd}} if mean or sd else {}
            stars |= {cell.key: {**mean, **sd, **moved}} if mean or sd or moved else {}
    yield Cause(text, by_chance, numbers)
    if stars != numbers:
        yield Cause(f"{text}, together with their stars", by_chance, stars)


def _values(
    published: Published, cell: PrintedCell, left: Interval | None, others: Sequence[PrintedCell]
) -> Iterator[Cause]:  # fmt: skip
    """Yield other means and SDs of a cell: those that its test, and what its row has `left`, leave open."""
    tests, task = published.tests_by_key.get(cell.key, ()), published.task_named(cell.task)
    means: list[Interval] = [left] if left else []
    means += [either(one.mean) for one in published.cells_by_key.get(cell.key, ()) if not one.in_table]
    sds: list[Interval] = []
    if tests and cell.sd is not None and tests[0].t.exact:
        n = task.participants if task else tests[0].df + 1
        means.append(_mean_of_t(tests[0], either(cell.sd), n))
        sds += _sd_of_t(tests[0], either(cell.mean), n)
    held: tuple[tuple[str, list[Interval], Printed | None, Iterable[Printed | None]], ...] = (
        ("mean", means, cell.mean, (one.mean for one in others)),
        ("SD", sds, cell.sd, (one.sd for one in others)),
    )
    for name, spans, old, beside in held:
        if old is not None:
            places, percent = _decimals(old, beside), old.text.endswith("%")
            for text in dict.fromkeys(text for span in spans for text in _texts(span, places, percent=percent)):
                if Printed(text).exact != old.exact:
                    kind, by_chance = _kind(name, old, Printed(text), cell, task.participants if task else 0)
                    yield Cause(
                        mistake_words(f"{kind}: {text} would fit", by_chance % 1), by_chance, {cell.key: {name: text}}
                    )


def _mean_of_t(test: PrintedT, sd: Interval, n: int) -> Interval:
    """Return the mean of `n` participants that gives the printed t with this SD."""
    t, null = either(test.t), float(test.null)
    ends = [float(a) * float(b) / math.sqrt(n) for a in (t.low, t.high) for b in (sd.low, sd.high)]
    return outward(null + min(ends), null + max(ends))


def _sd_of_t(test: PrintedT, mean: Interval, n: int) -> list[Interval]:
    """Return the SD of `n` participants that gives the printed t with this mean; none where t may be zero."""
    gap = sorted(abs(float(end - test.null)) for end in (mean.low, mean.high))
    size = sorted(abs(float(end)) for end in (either(test.t).low, either(test.t).high))
    root = math.sqrt(n)
    return [outward(gap[0] * root / size[1], gap[1] * root / size[0])] if size[0] > 0 else []


def _texts(span: Interval, places: int, *, percent: bool) -> list[str]:
    """Return the numbers with so many decimals in the interval, or next to its ends; none where there are too many."""
    unit = Fraction(1, 10**places)
    low, high = math.floor(Fraction(span.low) / unit), math.ceil(Fraction(span.high) / unit)
    if high - low > MOST_VALUES or low < 0:
        return []
    if percent:
        return [f"{float(100 * step * unit):.{max(places - 2, 0)}f}%" for step in range(low, high + 1)]
    return [f"{float(step * unit):.{places}f}" for step in range(low, high + 1)]


def _kind(name: str, printed: Printed, right: Printed, cell: PrintedCell, n: int) -> tuple[str, float]:
    """Return by what mistakes a number became the printed one, and the share of wrong numbers that they would fit."""
    found: dict[str, float] = {}
    if name == "SD":
        trials = cell.scale.items if cell.scale and not cell.is_score else 0
        share = max(0.0, cell.mean.value * (1 - cell.mean.value))
        for text, value in (
            ("it is the variance", right.value**2),
            ("it is the standard error", right.value / math.sqrt(max(n, 1))),
            ("it is the population SD", right.value * math.sqrt(max(n - 1, 0) / max(n, 1))),
            (
                "it is the SD of a binomial distribution over one participant's trials",
                math.sqrt(share / max(trials, 1)),
            ),
            ("it is the SD of a binomial distribution over all trials", math.sqrt(share / max(n * trials, 1))),
        ):
            if abs(value - printed.value) <= printed.unit / 2 + right.unit / 2 * ("binomial" not in text):
                found[text] = 0.02
    for power in (2, 1, -1, -2):
        if abs(right.exact * Fraction(10) ** power - printed.exact) <= printed.exact_unit / 2:
            found["it was printed as a percentage" if power == 2 and name == "mean" else TENFOLD] = 0.01
    made: dict[str, list[Fraction]] = {}
    for slip, text in slips(printed.text):
        made.setdefault(slip, []).append(Printed(text).exact)
    digits = sum(sign.isdigit() for sign in printed.text.lstrip("0."))
    fitting = {slip: len(values) / 10 ** max(digits, 1) for slip, values in made.items() if right.exact in values}
    found |= {slip: min(share, 0.99) for slip, share in fitting.items() if not found or slip == SWAPPED}
    return ("; or ".join(found), min(found.values())) if found else ("no simple mistake explains it", 1.0)


def _of_tasks(published: Published, conflicts: frozenset[Place]) -> Iterator[Cause]:
    in_task = {task.id: sum(place[1] == task.id for place in conflicts) for task in published.task}
    for task in published.task:
        if in_task[task.id] >= 3:
            for n in (task.participants - 1, task.participants + 1):
                if n > 1:
                    text = f"all printed numbers for the task fit {n} participants better"
                    yield Cause(text, 0.05, tasks=(task.id,), quantity="participants", value=n)
    for trials in dict.fromkeys(task.trials for task in published.task if task.trials):
        tasks = tuple(task.id for task in published.task if task.trials == trials)
        if sum(in_task[id_] for id_ in tasks) >= 3:
            for other in (trials - 1, trials + 1):
                if other > 0:
                    text = f"the printed numbers fit {other} trials better"
                    yield Cause(text, 0.05, tasks=tasks, quantity="trials", value=other)


def _right(published: Published, evidence: FromPrint, cause: Cause, work: Work) -> tuple[Published, FromPrint]:
    """Return the printed numbers and their evidence as they would be without what is wrong."""
    fields = {name: getattr(published, name) for name in type(published).model_fields}
    if cause.tasks:
        fields["task"] = tuple(
            task.model_copy(update={cause.quantity: cause.value}) if task.id in cause.tasks else task
            for task in published.task
        )
    for name in ("table", "score") if cause.cells else ():
        fields[name] = tuple(_block(block, cause.cells) for block in fields[name])
    # `model_copy` would keep what the model has computed of its fields.
    changed = Published.model_construct(**fields)
    return changed, evidence.working_with(changed, cause.cells, cause.tasks, work)


def _block(block: PrintedTable | PrintedScores, cells: Mapping[Key, Mapping[str, str]]) -> PrintedTable | PrintedScores:
    """Return a table or a list of scores with other means and SDs."""
    changed = []
    for cell in block.cells:
        parts = cells.get((block.task, cell.presented, cell.answered), {})
        update = {name.lower(): text if name == "stars" else Printed(text) for name, text in parts.items()}
        changed.append(cell.model_copy(update=update))
    return block.model_copy(update={"cells": tuple(changed)})
