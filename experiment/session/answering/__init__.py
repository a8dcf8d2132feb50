"""Answers by the participant: what a rig needs for them, and their buttons followed while a session lasts."""

from collections.abc import Callable

from palpate.experiment.apparatus.ports import Buttons
from palpate.experiment.apparatus.rig import Rig, needed
from palpate.experiment.clock import Clock
from palpate.experiment.desk.questions import Console, Pressed
from palpate.experiment.errors import RigError, SessionError
from palpate.experiment.protocol.designs import design_of
from palpate.experiment.protocol.models import Protocol


def check_lines(protocol: Protocol) -> None:
    """Raise `SessionError` for a session on lines of text in which participants have keys of their own."""
    if protocol.answers.mode != "oral":
        raise SessionError(
            f"got --lines, but the study has answers.mode = '{protocol.answers.mode}'",
            remedy="run it in a terminal, without --lines",
            allowed="a console, because one terminal cannot serve two people",
        )


def check(protocol: Protocol, rig: Rig) -> None:
    """Raise `RigError` for a rig on which participants cannot answer as a protocol says, before anything is opened.

    A simulated rig needs neither screen nor buttons: a rehearsal has its own.
    """
    mode = protocol.answers.mode
    if mode == "screen" and not rig.rig.simulated:
        needed(rig, "screen", rig.screen, "add it", "because answers.mode is 'screen'")
    if mode == "keys" and not (rig.rig.simulated and rig.buttons is None):
        buttons = needed(rig, "buttons", rig.buttons, "add it", "because answers.mode is 'keys'")
        keys = [key for task in protocol.tasks for key in design_of(task.design).answers(protocol, ())]
        if lacking := sorted(set(keys) - set(buttons.names)):
            raise RigError(
                f"rig '{rig.rig.name}'",
                f"{' '.join(lacking)} missing from its buttons.names",
                "name the buttons after the keys of the protocol's answers",
                allowed=f"all of {' '.join(dict.fromkeys(keys))}",
            )


def followed(buttons: Buttons, console: Console, clock: Clock) -> Callable[[], None]:
    """Return what tells the console of each press since it was called last, within 0.1 s; it raises `ButtonsError`."""

    def follow() -> None:
        for one in buttons.read():
            if (known := buttons.clock_map) is not None:
                ago_ns = clock.now_ns() - known.session_ns(one.device_us)
                console.tell(Pressed(one.key, max(ago_ns, 0), one.device_us, buttons.error_s))

    return follow
