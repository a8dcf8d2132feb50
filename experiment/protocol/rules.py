"""What must hold between the fields of a protocol file, beyond the type of each.

Rules read plain tables (arrays as tuples) and ignore missing and mistyped values, so that all errors are reported at
once.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from datetime import date
from importlib import import_module
from itertools import pairwise
from math import comb
from typing import Literal

from palpate.experiment.protocol import designs, kinds
from palpate.experiment.protocol.designs import PlannableTest, design_of
from palpate.experiment.protocol.kinds import is_number, kind_of, list_at, number_at, table_at, tables_at
from palpate.experiment.settings.characters import looks, skeleton
from palpate.experiment.settings.load import MISSING, Broken, Table, written
from palpate.experiment.storage import Place

MAX_COUNTERBALANCED = 6
"""Tasks that may be counterbalanced; more have over 720 orders, and no study balances those."""

LOUDER_KEY, SOFTER_KEY, PROBE_KEY, HEARD_KEY = "+", "-", "p", "h"
"""Keys of the masker's level."""

Mode = Literal["oral", "keys", "screen"]
"""How participants answer: they say it, have buttons of their own, or choose it at their screen."""

OWN_ANSWERS = 7
"""Participants answer themselves in protocols from this format on."""

MAX_COUNTED = 400
"""Trials of a task whose orders are counted exactly: up to here that takes seconds."""

EARLIEST = date(1950, 1, 1)
"""No approval is older: ours; ethics boards are younger."""

DEVICES = {"con", "prn", "aux", "nul", *(f"{kind}{number}" for kind in ("com", "lpt") for number in range(1, 10))}
"""No file or folder of Windows has such a name."""

BESIDE = {
    "levels": "levels",
    "phase": "kinds.phases",
    "ahead": "kinds.ahead",
    "control": "designs.controls",
    "training": "designs.training",
    "asked": "asked",
    "factors": "designs.factors",
    "groups": "designs.groups",
}
"""Keys of a study or a task whose own module has their rules."""

NO_DEVICE = "a name that Windows does not reserve for a device"


def ethics(table: Table) -> Iterator[Broken]:
    """`approved_on` is in 1950 or later, and `expires_on` is after it."""
    approved, expires = table.get("approved_on"), table.get("expires_on")
    if type(approved) is date and approved < EARLIEST:
        yield Broken(("approved_on",), f"a date on or after {EARLIEST}, as on the board's letter")
    # A date with a time is a date too, for Python, and compares with none.
    if type(approved) is type(expires) is date and expires <= approved:
        yield Broken(("expires_on",), f"a date after approved_on ({approved})")


def duration(table: Table) -> Iterator[Broken]:
    """`longest_min` is at least `shortest_min`."""
    yield from _in_order(table, "shortest_min", "longest_min")


def material(table: Table) -> Iterator[Broken]:
    """No material has a name that means a missing value in tables: `n/a`, or one that R or pandas would read so, such
    as `NA`."""
    if (name := table.get("id")) in MISSING:
        yield Broken(("id",), f"any name except '{name}', which means a missing value in tables")


def step(table: Table) -> Iterator[Broken]:
    """`gate_bottom_mm` is less than `gate_top_mm`, and `contact_mm` is less than both."""
    for higher, lower in pairwise(("gate_top_mm", "gate_bottom_mm", "contact_mm")):
        above, below = number_at(table, higher), number_at(table, lower)
        if above is not None and below is not None and below >= above:
            yield Broken((lower,), f"a number less than {higher} ({above})")


def familiarisation(table: Table) -> Iterator[Broken]:
    """`max_s` is at least `min_s`."""
    yield from _in_order(table, "min_s", "max_s")


def order(table: Table) -> Iterator[Broken]:
    """Kind `max-run` needs `max_run`; the other kinds do not have it."""
    kind, limit = table.get("kind"), table.get("max_run")
    if kind == "max-run" and limit is None:
        yield Broken(("max_run",), "a whole number at least 1: kind 'max-run' needs it")
    if kind in ("full-random", "blocked-random") and limit is not None:
        yield Broken(("max_run",), f"no value: only kind 'max-run' has this key, not kind '{kind}'")


UP_DOWN = ("first", "down", "reversals"), ("up", "steps")
EXPECTED = ("thresholds", "spreads_db", "lapses", "guess"), ("precision_db",)
KEYS = {"up-down": UP_DOWN, "quest-plus": EXPECTED, "psi": EXPECTED, "constant": ((), ())}
"""Keys that a method of levels needs, and that it takes."""


def levels(table: Table) -> Iterator[Broken]:
    """`grid`, `thresholds`, `spreads_db` and `lapses` increase, `first` is one of `grid`, and `steps` do not increase.
    `up-down` needs `first`, `down` and `reversals`, and only it may have `up` and `steps`; `quest-plus` and `psi` need
    `thresholds`, `spreads_db`, `lapses` and `guess`, and only they may have `precision_db`. `constant` has none of
    these.
    """
    method, grid, first = table.get("method"), list_at(table, "grid"), number_at(table, "first")
    for key in ("grid", "thresholds", "spreads_db", "lapses"):
        if all(map(is_number, of := list_at(table, key))) and any(high <= low for low, high in pairwise(of)):
            yield Broken((key,), "values in ascending order, each greater than the previous one")
    if all(map(is_number, steps := list_at(table, "steps"))) and any(late > early for early, late in pairwise(steps)):
        yield Broken(("steps",), "steps in descending order, none larger than the previous one")
    if grid and first is not None and first not in grid:
        yield Broken(("first",), f"one of grid: {', '.join(map(str, grid))}")
    if method not in KEYS:
        return
    needed, further = KEYS[method]
    yield from (Broken((key,), f"a value: '{method}' needs it") for key in needed if table.get(key) is None)
    for key in (key for of in (*UP_DOWN, *EXPECTED) for key in of if key not in (*needed, *further)):
        if table.get(key) is not None:
            yield Broken((key,), f"no value: '{method}' does not use it")


def exclusion_rule(table: Table) -> Iterator[Broken]:
    """`withdrawn` and `undelivered` have no limit; the others need one.

    `withdrawn` and `answers-below` exclude a participant; the others repeat or exclude a trial.
    """
    when, limit, action = table.get("when"), table.get("limit"), table.get("action")
    if when in ("withdrawn", "undelivered") and limit is not None:
        yield Broken(("limit",), f"no value: '{when}' needs no limit")
    if when in ("frames-lost", "speed-below", "speed-above", "answers-below") and limit is None:
        yield Broken(("limit",), f"a number at least 0: '{when}' needs it")
    if when in ("withdrawn", "answers-below") and action in ("repeat-trial", "exclude-trial"):
        yield Broken(("action",), f"exclude-participant, because '{when}' is about a participant")
    if when in ("frames-lost", "speed-below", "speed-above", "undelivered") and action == "exclude-participant":
        yield Broken(("action",), f"one of: repeat-trial, exclude-trial, because '{when}' is about a trial")


def planned_test(table: Table) -> Iterator[Broken]:
    """A test (its design, first format) has the keys below; `tasks` and `materials` are as many as it compares."""
    every, name = designs.plannable_tests(), str(table.get("test"))
    test = every.get(name, PlannableTest())
    for key, what, sizes in (
        ("tasks", "each task once", test.tasks),
        ("materials", "another material", test.materials),
    ):
        named = list_at(table, key)
        yield from (Broken((key, i), what) for i, one in enumerate(named) if one in named[:i])
        if named and len(named) not in sizes:
            least = "" if len(sizes) == 1 else "at least "
            yield Broken((key,), f"{least}{sizes.start} {key}, because '{name}' compares them")
    for key in () if name not in every else ("chance", "form", "margin", "correction", "materials", "groups"):
        owners = [f"'{one}'" for one, other in every.items() if key in (*other.needs, *other.takes)]
        if key in test.needs and table.get(key) is None:
            yield Broken((key,), f"a value: '{name}' needs it")
        if f"'{name}'" not in owners and table.get(key) is not None:
            yield Broken((key,), f"no value: only {', '.join(owners)} {'has' if len(owners) == 1 else 'have'} this key")


def protocol(table: Table) -> Iterator[Broken]:
    """All tasks have the same kind and design, and the file contains only the tables for these.

    Ids of materials, tasks and exclusion rules, keys, and phrases in `spoken` are unique: no two look alike, regardless
    of case, blanks and alphabet (for names and phrases, also regardless of accents, 1 or I for l, and 0 for O), and no
    phrase looks like another material's id.

    `consent.voice_recordings` needs `answers.microphone`, which needs the mode `oral`, the only one before format 7.
    `+` and `-` only set the masker. The largest task has as many participants as the study. Tests name tasks in the
    protocol that present the materials they compare. Familiarisation is shorter than `exposure.session_min`. `max-run`
    orders have no more than 400 trials. The limit of `answers-below` is at most the number of trials in the shortest
    task, and that of `speed-above` is greater than that of `speed-below`. At most 6 tasks are counterbalanced.

    A task's `materials` are a subset of the protocol's, in the same order; with only one material, the task's order is
    not `max-run`. A task with `levels` is `virtual` and `blocked-random`, without a rule `answers-below`, and without
    `answers.progress` unless the levels are `constant`.

    A task with `control` must be a virtual identification task, and the task it controls for must be virtual and not
    itself a control; no planned test names a control task. A file in `pictures` always has the same `sha256`.

    Each of `[[asked.people]]` and `[[asked.questionnaires]]` has a unique id, and so has each item; a questionnaire
    names a task. `sharing.facts` lists ids of people's facts that are not text and have separate columns when shared;
    those that are numbers have a `group`. `sharing.questionnaires` lists ids of questionnaires.

    From format 7 on, no study or questionnaire has a name that Windows reserves for a device, such as `aux` or `com1`:
    files are named after them.
    """
    yield from _kinds(table)
    if (number_at(table, "format") or OWN_ANSWERS) >= OWN_ANSWERS and table_at(table, "study").get("id") in DEVICES:
        yield Broken(("study", "id"), NO_DEVICE)
    for name in ("materials", "tasks", "exclusion"):
        yield from _seen_once([((name, i, "id"), one.get("id")) for i, one in tables_at(table, name)], "a unique name")
    yield from _keys(table)
    yield from _spoken(table)
    if table_at(table, "consent").get("voice_recordings") is True and not table_at(table, "answers").get("microphone"):
        yield Broken(("answers", "microphone"), "true: consent.voice_recordings stores what the microphone records")
    yield from _answers(table)
    yield from _participants(table)
    yield from _presented(table)
    yield from _task_limits(table)
    yield from _pictures(table)
    yield from _exclusion_limits(table)
    parts = (table, *(task for _, task in tables_at(table, "tasks")))
    stated = {key for one in parts for key, of in one.items() if of}
    stated |= {"asked"} if table_at(table, "sharing").keys() & {"facts", "questionnaires"} else set()
    for key, module in BESIDE.items():
        if key in stated:
            yield from import_module(f"palpate.experiment.protocol.{module}").broken(table)
    probed = table_at(table_at(table, "masker"), "probe").get("material")
    if probed is not None and probed not in (ids := [one.get("id") for _, one in tables_at(table, "materials")]):
        yield Broken(("masker", "probe", "material"), f"one of the materials: {', '.join(map(str, ids))}")
    tasks = tables_at(table, "tasks")
    if table_at(table, "task_order").get("kind") == "counterbalanced" and len(tasks) > MAX_COUNTERBALANCED:
        allowed = f"fixed, or at most {MAX_COUNTERBALANCED} tasks: the orders of {len(tasks)} tasks cannot be balanced"
        yield Broken(("task_order", "kind"), allowed)


def pairs(table: Table) -> Iterator[Broken]:
    """If trials present two materials, `repetitions` is even, no order is `max-run`, and no task has `materials`."""
    for i, task in tables_at(table, "tasks"):
        if table_at(task, "order").get("kind") == "max-run":
            yield Broken(("tasks", i, "order", "kind"), "one of: full-random, blocked-random, for pairs of materials")
        if (count := number_at(task, "repetitions")) is not None and count % 2:
            yield Broken(
                ("tasks", i, "repetitions"),
                "an even number, so that each pair is presented equally often in both orders",
            )
        if task.get("materials") is not None:
            yield Broken(("tasks", i, "materials"), "no value: a task with pairs presents every material")


def _first(table: Table, key: str, names: Sequence[str]) -> str | None:
    """Return the kind or the design of a study: that of its first task, if it has one."""
    return next((name for _, task in tables_at(table, "tasks") if (name := task.get(key)) in names), None)


def _kinds(table: Table) -> Iterator[Broken]:
    """Yield what kind and design ask, and what tells that there is more than one of either."""
    kind, design = _first(table, "kind", kinds.NAMES), _first(table, "design", designs.NAMES)
    if kind is not None:
        yield from _one(table, "kind", kind, kinds.NAMES)
        yield from kind_of(kind).rules(table)
    if design is not None:
        yield from _one(table, "design", design, designs.NAMES)
        yield from design_of(design).rules(table)
        if min(design_of(design).intervals) > 1:
            yield from pairs(table)
        yield from _tests(table, design)
    if kind is not None and design is not None:
        fit = [name for name in designs.NAMES if {*design_of(name).intervals} & {*kind_of(kind).intervals}]
        for i, _ in tables_at(table, "tasks") if design not in fit else ():
            yield Broken(("tasks", i, "design"), f"one of: {', '.join(fit)}, for tasks of the kind '{kind}'")


def _one(table: Table, key: str, name: str, names: Sequence[str]) -> Iterator[Broken]:
    """Yield tasks of another kind or design than the first one, and the tables of others."""
    for i, task in tables_at(table, "tasks"):
        if task.get(key) in names and task[key] != name:
            yield Broken(("tasks", i, key), f"{name}, as in the first task: all trials of a study have the same {key}")
    for other in names:
        if other != name and table.get(other) is not None:
            yield Broken((other,), f"no table: the {key} of the tasks is '{name}'")


def _tests(table: Table, design: str) -> Iterator[Broken]:
    """Yield planned tests of other designs, and what a file of this format does not have."""
    every, own = designs.plannable_tests(), design_of(design).tests
    for i, test in tables_at(table, "analysis"):
        planned = every.get(name := str(test.get("test")), PlannableTest())
        for key, since in {"test": planned.since, **planned.takes}.items():
            if test.get(key) is not None and (number_at(table, "format") or since) < since:
                yield Broken(("analysis", i, key), f"in format {since} or later: set format = {since}")
        if name not in own:
            yield Broken(("analysis", i, "test"), f"one of: {', '.join(own)}, for tasks with the design '{design}'")


def _answers(table: Table) -> Iterator[Broken]:
    answers = table_at(table, "answers")
    if answers.get("mode") in ("keys", "screen"):
        if (number := number_at(table, "format") or OWN_ANSWERS) < OWN_ANSWERS:
            allowed = f"oral in format {number:g}; to use a different mode, set format = {OWN_ANSWERS}"
            yield Broken(("answers", "mode"), allowed)
        if answers.get("microphone") is True:
            yield Broken(("answers", "microphone"), "false: answers are not spoken")


def _keys(table: Table) -> Iterator[Broken]:
    answers = table_at(table, "answers")
    places: list[tuple[Place, object]] = [
        *((("materials", i, "key"), material.get("key")) for i, material in tables_at(table, "materials")),
        *(place for name in designs.NAMES for place in design_of(name).keys(table)),
        *(place for name in kinds.NAMES for place in kind_of(name).keys(table)),
        *((("answers", name), answers.get(name)) for name in ("no_answer_key", "redo_key", "pause_key")),
    ]
    yield from _seen_once(places, "a unique key", lambda key: (skeleton(key),))
    for path, key in places:
        if key in (LOUDER_KEY, SOFTER_KEY):
            yield Broken(path, f"any key except {LOUDER_KEY} and {SOFTER_KEY}, which set the masker's level")


def _spoken(table: Table) -> Iterator[Broken]:
    places: list[tuple[Place, object]] = [
        (("materials", i, "spoken", j), said)
        for i, material in tables_at(table, "materials")
        for j, said in enumerate(list_at(material, "spoken"))
    ]
    yield from _seen_once(places, "a unique phrase")
    ids: dict[str | int, tuple[str, ...]] = {
        i: looks(name) for i, one in tables_at(table, "materials") if isinstance(name := one.get("id"), str)
    }
    for path, said in places:
        own = {*ids.get(path[1], ())}
        for i, forms in ids.items():
            if isinstance(said, str) and own.isdisjoint(forms) and not {*looks(said)}.isdisjoint(forms):
                yield Broken(path, f"a unique phrase: {written(('materials', i, 'id'))} already has this name")


def _participants(table: Table) -> Iterator[Broken]:
    enrolled = number_at(table_at(table, "study"), "participants")
    wanted = [(i, number_at(task, "participants")) for i, task in tables_at(table, "tasks")]
    counts = [count for _, count in wanted if count is not None]
    if enrolled is None or not counts:
        return
    for i, count in wanted:
        if count is not None and count > enrolled:
            yield Broken(("tasks", i, "participants"), f"at most study.participants ({enrolled})")
    if len(counts) == len(wanted) and max(counts) < enrolled:
        allowed = f"{max(counts)}, the number in the largest task; additional participants would have nothing to do"
        yield Broken(("study", "participants"), allowed)


def _materials(table: Table, task: Table) -> list[str]:
    """Return the ids of the materials that a task presents."""
    own = list_at(task, "materials") or [one.get("id") for _, one in tables_at(table, "materials")]
    return [name for name in own if isinstance(name, str)]


def _presented(table: Table) -> Iterator[Broken]:
    """Yield tasks that present what the protocol has not, and planned tests of other tasks or too few materials."""
    every = _materials(table, {})
    of: list[tuple[object, set[str]]] = []
    for i, task in tables_at(table, "tasks"):
        own = _materials(table, task)
        of.append((task.get("id"), {*own}))
        if own != [name for name in every if name in own]:
            allowed = f"some of the protocol's materials, each once, in the protocol's order: {', '.join(every)}"
            yield Broken(("tasks", i, "materials"), allowed)
    known = [name for name, _ in of if isinstance(name, str)]
    for i, test in tables_at(table, "analysis"):
        for j, task_id in enumerate(list_at(test, "tasks")):
            if isinstance(task_id, str) and task_id not in known:
                yield Broken(("analysis", i, "tasks", j), f"a task in this protocol, one of: {', '.join(known)}")
        sets = [own for name, own in of if len(every) > 1 and name in list_at(test, "tasks")]
        if sets:
            yield from _test_materials(("analysis", i), test, every, sets)


def _test_materials(path: Place, test: Table, every: Sequence[str], sets: Sequence[set[str]]) -> Iterator[Broken]:
    """Yield what a planned test asks of materials that its tasks, each with a set of them, do not present."""
    common, named = set.intersection(*sets), list_at(test, "materials")
    planned = designs.plannable_tests().get(str(test.get("test")), PlannableTest())
    if any(len(one) < planned.each for one in sets):
        yield Broken((*path, "tasks"), f"tasks that each present at least {planned.each} materials")
    for j, name in enumerate(named):
        if isinstance(name, str) and name not in common:
            allowed = f"a material that its tasks present, one of: {', '.join(one for one in every if one in common)}"
            yield Broken((*path, "materials", j), allowed)
    if len(named or common) < (least := planned.common[len(sets) > 1]):
        yield Broken((*path, "materials" if named else "tasks"), f"at least {least} materials that the tasks share")


def _task_limits(table: Table) -> Iterator[Broken]:
    tasks = tables_at(table, "tasks")
    session_min = number_at(table_at(table, "exposure"), "session_min")
    for i, task in tasks:
        longest_s = number_at(table_at(task, "familiarisation"), "max_s")
        count = number_at(task, "repetitions")
        presented = len(_materials(table, task))
        most = MAX_COUNTED // max(presented, 1)
        if table_at(task, "order").get("kind") == "max-run" and presented == 1:
            yield Broken(("tasks", i, "order", "kind"), "one of: full-random, blocked-random, for a single material")
        elif table_at(task, "order").get("kind") == "max-run" and count is not None and count > most:
            allowed = f"at most {most} with the order 'max-run', which allows {MAX_COUNTED} trials in total"
            yield Broken(("tasks", i, "repetitions"), allowed)
        if session_min is not None and longest_s is not None and longest_s >= session_min * 60:
            path = ("tasks", i, "familiarisation", "max_s")
            yield Broken(path, f"a number less than the longest session (exposure.session_min, {session_min * 60} s)")


def _pictures(table: Table) -> Iterator[Broken]:
    hashes: dict[object, object] = {}
    for i, task in tables_at(table, "tasks"):
        for j, one in tables_at(task, "pictures"):
            if (first := hashes.setdefault(one.get("file"), one.get("sha256"))) != one.get("sha256"):
                place = ("tasks", i, "pictures", j, "sha256")
                yield Broken(place, f"the same value everywhere for this file ({first})")


def _exclusion_limits(table: Table) -> Iterator[Broken]:
    tasks, exclusion = tables_at(table, "tasks"), tables_at(table, "exclusion")
    of = [(number_at(task, "repetitions"), len(_materials(table, task))) for _, task in tasks]
    design = design_of(_first(table, "design", designs.NAMES) or designs.NAMES[0])
    shown = design.intervals[0]
    trials = min((n * comb(m + shown - 1, shown) for n, m in of if n is not None), default=0)
    if design.presentations is not None:
        trials = 0
    slowest = [number_at(rule, "limit") for _, rule in exclusion if rule.get("when") == "speed-below"]
    for i, rule in exclusion:
        limit = number_at(rule, "limit")
        if limit is None:
            continue
        if rule.get("when") == "answers-below" and limit > trials > 0:
            yield Broken(("exclusion", i, "limit"), f"at most {trials}, the trials of the shortest task")
        if rule.get("when") == "speed-above" and any(slow is not None and limit <= slow for slow in slowest):
            yield Broken(("exclusion", i, "limit"), "a number greater than the limit of the rule 'speed-below'")


def _seen_once(
    places: Iterable[tuple[Place, object]], what: str, forms_of: Callable[[str], tuple[str, ...]] = looks
) -> Iterator[Broken]:
    first: dict[str, tuple[Place, str]] = {}
    for path, value in places:
        if isinstance(value, str):
            forms = forms_of(value)
            earlier, had = next((first[form] for form in forms if form in first), (path, value))
            if earlier == path:
                first |= dict.fromkeys(forms, (path, value))
            else:
                same = skeleton(had) == skeleton(value)
                has = "already has this value" if same else f"is '{had}', which looks the same"
                yield Broken(path, f"{what}: {written(earlier)} {has}")


def _in_order(table: Table, low: str, high: str) -> Iterator[Broken]:
    least, most = number_at(table, low), number_at(table, high)
    if least is not None and most is not None and most < least:
        yield Broken((high,), f"a number at least {low} ({least})")
