"""Checks of the participant's buttons: whether they are there, and how late what they send comes."""

from collections.abc import Iterator
from contextlib import closing
from statistics import quantiles

from palpate.experiment.apparatus import opening
from palpate.experiment.apparatus.doctor.checks import judged, passed, refused
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.clock import Clock
from palpate.experiment.errors import Finding, PalpateError

LISTEN_S = 3.0
"""How long the buttons are listened to, s."""

LATE_MS = 20.0
"""Within this 95 of 100 lines come, ms: a press is dated by the board's clock, and what comes later only waits."""


def checks(rig: Rig, port: str | None, *, clock: Clock) -> Iterator[Finding]:
    """Yield whether the buttons send their heartbeat, and how late it comes; the session's clock goes by itself.

    How late the lines come, over the least late, is the jitter from press to record; the board's clock takes it out.
    """
    try:
        box = opening.open_buttons(rig, "keys", clock=clock, port=port)
        if box is None:
            return
        with closing(box):
            ends_ns = clock.now_ns() + int(LISTEN_S * 1e9)
            while clock.now_ns() < ends_ns:
                box.read()
            late_ms = sorted(1e3 * one for one in box.late_s)
            error_ms = 1e3 * (box.error_s or 0.0)
    except PalpateError as error:
        yield refused("buttons", error)
        return
    middle_ms, most_ms = quantiles(late_ms, n=20)[9], quantiles(late_ms, n=20)[18]
    yield passed(
        "buttons", f"{len(late_ms)} lines, each dated by the board; a press has a standard error of {error_ms:.2f} ms"
    )
    yield judged(
        "buttons to record",
        most_ms <= LATE_MS,
        f"lines come {middle_ms:.1f} ms later than the least late in the median, 95 of 100 within {most_ms:.1f} ms",
        allowed=f"95 of 100 within {LATE_MS:g} ms",
        remedy="take another USB port, without a hub, and see that no other program loads the machine",
    )
