"""What a task of presented stimuli needs, and what a rig makes of each, for `palpate plan`."""

from __future__ import annotations

import textwrap
from dataclasses import asdict, dataclass
from pathlib import Path

from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.protocol.models import Protocol, Task
from palpate.experiment.session.kinds.presented import fidelity
from palpate.experiment.session.kinds.presented.fidelity import Made

NEEDS = ("screen and keys", "journal", "actuator", "exposure account")


@dataclass(frozen=True)
class PresentedPlan:
    """What one task needs, and what a rig makes of its stimuli; `refused` is empty where participants may be run.

    `unknown` says that nobody measured what the rig carries, so that it is taken to carry all.
    """

    task: str
    title: str
    stimuli: tuple[Made, ...]
    refused: str
    unknown: str

    def as_dict(self) -> dict[str, object]:
        """Return the plan for JSON."""
        return {
            "task": self.task,
            "needs": list(NEEDS),
            "stimuli": [asdict(one) for one in self.stimuli],
            "refused": self.refused,
            "unknown": self.unknown,
        }

    def text(self) -> str:
        """Return the plan as lines of text."""
        lines = [f"Task {self.task}: {self.title}"]
        if self.refused:
            lines += ["", f"    REFUSED for participants: {self.refused}"]
        lines += [
            "",
            "needs",
            *(f"  {need}" for need in NEEDS),
            "",
            f"stimuli: {self.unknown}; if it carries all frequencies" if self.unknown else "stimuli",
            *(f"  {one.words}" for one in self.stimuli),
        ]
        return "\n".join(
            part for line in lines for part in (textwrap.wrap(line, 120, subsequent_indent="    ") or [""])
        )


def plan(*, protocol: Protocol, rig: Rig, task: Task) -> PresentedPlan:
    """Plan a task on a rig. Raises as `fidelity.on_rig`."""
    every = fidelity.on_rig(protocol=protocol, rig=rig, rig_folder=rig.folder or Path())
    refused = next(fidelity.refusals(protocol, rig, every), None)
    own = tuple(one for one in every if one.material in protocol.materials_of(task))
    unknown = "" if fidelity.is_known(protocol, rig) else fidelity.UNKNOWN
    return PresentedPlan(task.id, task.title, own, "" if refused is None else refused.sentence(), unknown)
