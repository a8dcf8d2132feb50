"""Vibrations that begin before contact in a protocol: what a task of them breaks, and what its board reads.

`rules` and the page look this up for a study of which a task has `ahead`.
"""

from collections.abc import Iterator
from math import ceil, floor

from palpate.experiment.protocol.blocks import number
from palpate.experiment.protocol.kinds import number_at, table_at, tables_at
from palpate.experiment.protocol.models import Ahead
from palpate.experiment.settings.load import Broken, Table

_BROKEN_OFF = {
    "nothing": (
        "its vibration is canceled and the trial is immediately ready for another step. A vibration that has already "
        "begun plays to its end; this is recorded, and the trial is repeated at the end of its block"
    ),
    "vibration": (
        "its vibration is still played at the last predicted time, if there was one; this is recorded, and the trial "
        "is repeated at the end of its block"
    ),
}


def broken(table: Table) -> Iterator[Broken]:
    """Yield tasks with `ahead` that are no virtual footsteps, or whose gate leaves the fastest foot less time."""
    for i, task in tables_at(table, "tasks"):
        if task.get("ahead") is None:
            continue
        if (task.get("kind"), task.get("stimulus")) != ("footstep", "virtual"):
            yield Broken(("tasks", i, "ahead"), "no value: contact is predicted only for virtual footsteps")
            continue
        yield from _too_early(table, ("tasks", i, "ahead"), -(number_at(table_at(task, "ahead"), "delay_ms") or 0.0))


def _too_early(table: Table, at: tuple[str | int, ...], ahead_ms: float) -> Iterator[Broken]:
    step = table_at(table_at(table, "footstep"), "step")
    bottom_mm, contact_mm = number_at(step, "gate_bottom_mm"), number_at(step, "contact_mm")
    limits = [
        number_at(rule, "limit") for _, rule in tables_at(table, "exclusion") if rule.get("when") == "speed-above"
    ]
    known = [limit for limit in limits if limit]
    if not known:
        yield Broken(at, "no value without an exclusion rule 'speed-above': a fast foot could land before its stimulus")
    elif bottom_mm is not None and contact_mm is not None and (way_mm := bottom_mm - contact_mm) > 0:
        fastest_mm_s = min(known)
        left_ms = way_mm / fastest_mm_s * 1e3
        if ahead_ms > left_ms:
            high_mm, slow_mm_s = ceil(ahead_ms * fastest_mm_s / 1e3 + contact_mm), floor(way_mm / ahead_ms * 1e3)
            least_ms = floor(left_ms * 10) / 10
            yield Broken(
                (*at, "delay_ms"),
                f"at least -{least_ms:g}, the time between gate and contact at {fastest_mm_s:g} mm/s; or set "
                f"footstep.step.gate_bottom_mm to {high_mm:g}, or the limit of 'speed-above' to {slow_mm_s:g}",
            )


def facts(ahead: Ahead) -> Iterator[tuple[str, str]]:
    """Yield what the board reads of a vibration before contact."""
    yield (
        "Worn",
        "the vibrating part is worn on the foot, like the sole of a shoe, so the vibration can be felt before contact",
    )
    yield (
        "Begins",
        f"{number(-ahead.delay_ms)} ms before contact, which is predicted from the movement of the foot below the "
        "gate. The timing error is a few milliseconds, more if the foot slows down; each step's record shows it",
    )
    if ahead.error_max_ms is not None:
        yield (
            "Error allowed",
            f"{number(ahead.error_max_ms)} ms: a step with a larger timing error is repeated at the end of its block, "
            "and no session runs on a rig with a larger expected standard error",
        )
    yield "Broken off", f"If the foot stops, turns back or hesitates on the way down, {_BROKEN_OFF[ahead.broken_off]}."
