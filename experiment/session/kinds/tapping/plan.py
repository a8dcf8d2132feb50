"""What a task of taps needs, and how right its force is, for `palpate plan`."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass

from palpate.experiment.apparatus.rig import Rig, tracker_of
from palpate.experiment.apparatus.servo import budget, passivity
from palpate.experiment.apparatus.servo.opening import servo_of
from palpate.experiment.protocol.kinds.tapping import Tapping
from palpate.experiment.protocol.models import Protocol, Task
from palpate.experiment.session.kinds.tapping.virtual import limit_n
from palpate.experiment.synthesis.contact.force import ForceBudget

REAL = ("screen and keys", "journal")
VIRTUAL = (*REAL, "tracker", "servo, in a separate process", "actuator", "exposure account")
ABOUT = (
    "Force on a SIMULATED hand (300 N/m, 2 N s/m, 10 g) that the device moves: rms error as each cause is added, "
    "relative to the block's law within the force limit and, in the last row, relative to the whole law."
)


@dataclass(frozen=True)
class TapPlan:
    """What one task needs; `block` says in words what its block asks of the device, empty for real samples."""

    task: str
    title: str
    needs: tuple[str, ...]
    block: str = ""
    force: ForceBudget | None = None
    refused: str = ""

    def as_dict(self) -> dict[str, object]:
        """Return the plan for JSON."""
        rows = None if self.force is None else self.force.rows()
        return {"task": self.task, "needs": list(self.needs), "block": self.block, "force": rows}

    def text(self) -> str:
        """Return the plan as lines of text."""
        lines = [f"Task {self.task}: {self.title}"]
        if self.refused:
            lines += ["", f"    REFUSED for participants: {self.refused}"]
        lines += ["", "needs", *(f"  {need}" for need in self.needs)]
        if self.block:
            lines += ["", self.block, "", *([budget.UNKNOWN] if self.force is None else [ABOUT, self.force.sentence()])]
        shown = [part for line in lines for part in (textwrap.wrap(line, 120, subsequent_indent="    ") or [""])]
        return "\n".join([*shown, "", *self.force.lines()] if self.force is not None else shown)


def plan(*, protocol: Protocol, rig: Rig, task: Task) -> TapPlan:
    """Plan a task on a rig. Raises `RigError` for a rig without a force device, where surfaces are virtual."""
    if task.stimulus == "real":
        return TapPlan(task.id, task.title, REAL)
    virtual, device, tracker = protocol.table(Tapping), servo_of(rig), tracker_of(rig)
    bears, block = passivity.judged(virtual, device, tracker)
    most, at_most_n = virtual.force_error_max, limit_n(protocol, rig)
    force = budget.force_budget(virtual, device, tracker, limit_n=at_most_n)
    right = most is None or (force is not None and force.worst.error <= most)
    refused = "" if right else str(budget.refusal(virtual, "", rig=rig.rig.name))
    return TapPlan(task.id, task.title, VIRTUAL, block, force, refused if bears else "the rig cannot render the block")
