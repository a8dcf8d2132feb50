"""Checks of the participant's buttons: whether they and each of them are there, and how late what they send comes."""

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import closing
from statistics import quantiles

from palpate.experiment.apparatus import opening
from palpate.experiment.apparatus.doctor.checks import judged, passed, refused, unchecked
from palpate.experiment.apparatus.ports import Buttons
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.clock import Clock
from palpate.experiment.errors import Finding, PalpateError, Remedy

LISTEN_S = 3.0
"""How long the buttons are listened to, s."""

LATE_MS = 20.0
"""Within this 95 of 100 lines come, ms: a press is dated by the board's clock, and what comes later only waits."""


PRESS_S = 60.0
"""So long somebody has to press every button, s."""

FEW = 5
"""Delays are reported from so many lines or presses on."""


def checks(rig: Rig, port: str | None, presses: int, *, clock: Clock) -> Iterator[Finding]:
    """Yield whether the buttons are there, how late what they send is read, and which were not pressed so often.

    Without `presses` nobody has to press any. How late a line or press is read, over the least late of a board, or over
    the kernel's time of an input device, is the jitter from press to record; the device's clock takes it out. The
    session's clock goes by itself.
    """
    settings = rig.buttons
    try:
        box = opening.open_buttons(rig, "keys", clock=clock, port=port)
        if box is None or settings is None:
            return
        with closing(box):
            found = _pressed(box, settings.names, presses, clock)
            late_ms = sorted(1e3 * one for one in box.late_s)
            error_s, unnamed = box.error_s, sorted(getattr(box, "unnamed", ()))
    except PalpateError as error:
        yield refused("buttons", error)
        return
    known = "the standard error of press times is unknown"
    if error_s is not None:
        known = f"press times have a standard error of {1e3 * error_s:.2f} ms"
    board = settings.baud is not None or port is not None
    what = f"{len(late_ms)} lines with the board's times" if board else "an input device; Linux times its presses"
    if not board and rig.rig.simulated:
        what = "RECORDED presses, not sent by a device now"
    yield passed("buttons", f"{what}; {known}")
    if len(late_ms) >= FEW:
        yield from _late(late_ms, "lines arrive" if board else "presses are read", board=board)
    if not presses:
        remedy = Remedy("press each button during the check: {}", ("palpate", "doctor", "--rig", "RIG", "--press", "1"))
        yield unchecked("each button", "nobody was asked to press the buttons", remedy)
        return
    lacking = [one for one in settings.names if found[one] < presses]
    often = ", ".join(f"{one}: {found[one]}" for one in settings.names)
    others = f"; keys with the codes {', '.join(map(str, unnamed))}, which [buttons] does not name, were also pressed"
    yield judged(
        "each button",
        not lacking,
        f"presses received: {often}{others if unnamed else ''}",
        allowed=f"{presses} from each within {PRESS_S:g} s",
        remedy=f"check the wires, names and codes of {' '.join(lacking)}",
    )


def _pressed(box: Buttons, names: Sequence[str], presses: int, clock: Clock) -> Counter[str]:
    """Return how often each button was pressed, once all were so often, or after a while."""
    found, ends_ns = Counter[str](), clock.now_ns() + int((PRESS_S if presses else LISTEN_S) * 1e9)
    while clock.now_ns() < ends_ns and not (presses and all(found[one] >= presses for one in names)):
        found.update(one.key for one in box.read())
    return found


def _late(late_ms: Sequence[float], come: str, *, board: bool) -> Iterator[Finding]:
    middle_ms, most_ms = quantiles(late_ms, n=20)[9], quantiles(late_ms, n=20)[18]
    than = "later than the fastest one" if board else "late"
    yield judged(
        "buttons to record",
        most_ms <= LATE_MS,
        f"{come} {middle_ms:.1f} ms {than} (median), 95 % within {most_ms:.1f} ms",
        allowed=f"95 % within {LATE_MS:g} ms",
        remedy="use another USB port, without a hub, and close other programs that load the machine",
    )
