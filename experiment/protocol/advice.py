"""Legal but odd settings of a protocol: shown on the board's page and never refused, so that datasets stay readable."""

from collections.abc import Iterator
from itertools import pairwise
from math import factorial

from palpate.experiment.errors import Finding, mismatch
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.settings.load import written

ROUNDED = 0.025
"""A chance this near to that of a guess is one that was rounded, of itself: 0.17 for 1/6, 0.33 for 1/3."""

LEAST_S = 5.0
"""A trial takes a step, a stimulus and an answer that is keyed twice: less time than this is no plan; ours."""


def advice(protocol: Protocol) -> tuple[Finding, ...]:
    """Return each value that deserves a second look: its field, what it is, and what it would be as a rule."""
    checks = (_consent, _chances, _open_anovas, _band, _orders, _duration)
    return tuple(problem for check in checks for problem in check(protocol))


def _consent(protocol: Protocol) -> Iterator[Finding]:
    if not protocol.consent.required:
        allowed = "as a rule true: without it a session begins although nobody has agreed on record"
        yield mismatch("consent.required", None, "false", allowed)


def _chances(protocol: Protocol) -> Iterator[Finding]:
    count = len(protocol.materials)
    for place, test in enumerate(protocol.analysis):
        if test.chance is not None and abs(test.chance * count - 1) > ROUNDED:
            allowed = (
                f"as a rule {1 / count:.4g}: who guesses among {count} materials is right in one of {count} trials"
            )
            yield mismatch(written(("analysis", place, "chance")), None, f"{test.chance:g}", allowed)


def _open_anovas(protocol: Protocol) -> Iterator[Finding]:
    """Give each planned one-way ANOVA that does not name its materials."""
    for place, test in enumerate(protocol.analysis):
        if test.test == "one-way ANOVA" and test.materials is None:
            allowed = "as a rule the two materials that it compares: without them its table is exploratory"
            yield mismatch(written(("analysis", place, "materials")), None, "none", allowed)


def _band(protocol: Protocol) -> Iterator[Finding]:
    if protocol.footstep is None:
        return
    high_hz, rate_hz = protocol.footstep.tactile.high_hz, protocol.footstep.synthesis.rate_hz
    if high_hz > rate_hz / 2:
        allowed = (
            f"as a rule at most {rate_hz / 2:g}, half of footstep.synthesis.rate_hz: recordings hold no frequency above"
        )
        yield mismatch("footstep.tactile.high_hz", None, f"{high_hz:g}", allowed)


def _orders(protocol: Protocol) -> Iterator[Finding]:
    """Yield each group with the same tasks that cannot be divided equally among their orders."""
    if protocol.task_order.kind != "counterbalanced":
        return
    ends = sorted({0, *(task.participants for task in protocol.tasks)})
    for first, last in pairwise(ends):
        own = [place for place, task in enumerate(protocol.tasks) if task.participants >= last]
        people, orders = last - first, factorial(len(own))
        if people % orders:
            field = next(place for place in own if protocol.tasks[place].participants == last)
            told = f"{last}, so that {people} do {len(own)} tasks"
            allowed = (
                f"as a rule a multiple of {orders} who do them: each of their {orders} orders as often as any other"
            )
            yield mismatch(written(("tasks", field, "participants")), None, told, allowed)


def _duration(protocol: Protocol) -> Iterator[Finding]:
    if protocol.duration is None:
        return
    trials = sum(map(protocol.trials, protocol.tasks))
    besides_s = sum(task.familiarisation.min_s for task in protocol.tasks)
    besides_s += protocol.task_order.break_min_s * (len(protocol.tasks) - 1)
    least_min = (besides_s + LEAST_S * trials) / 60
    if protocol.duration.longest_min < least_min:
        taken = f"{trials} trials of {LEAST_S:g} s, familiarisation and breaks"
        allowed = f"as a rule at least {least_min:.0f}, which {taken} take"
        yield mismatch("duration.longest_min", None, f"{protocol.duration.longest_min:g}", allowed)
