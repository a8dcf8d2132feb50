"""What a rehearsal supplies for a kind of trial: who takes part, on which rig, and what is said of the materials."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from palpate.experiment.apparatus.rig import Rig, tracker_of
from palpate.experiment.protocol.models import Protocol, Task

if TYPE_CHECKING:
    from palpate.experiment.rehearsal.participant import SimulatedPerson
    from palpate.experiment.rehearsal.voice import Speaker
    from palpate.experiment.rehearsal.wires.foot import Foot
    from palpate.experiment.rehearsal.wires.panel import CardPanel, Panel
    from palpate.experiment.rehearsal.wires.serial_line import SerialLine


@dataclass(frozen=True)
class Parts:
    """What stands at the far ends of a session's ports; the foot's device was powered at a session time, ns.

    `foot` is None where nothing was opened for it; it may be a hand.
    """

    foot: Foot | None
    powered_ns: int
    panels: Mapping[str | None, Panel | CardPanel]
    rig: Rig
    real_time: bool
    speaker: Speaker | None

    @property
    def panel(self) -> Panel | CardPanel | None:
        """The one panel of a rig without sites; None where nothing is felt."""
        return self.panels.get(None)


def stepping(line: SerialLine, rig: Rig, *, real_time: bool) -> Foot:
    """Return a foot at the far end of a line of a simulated rig's tracker."""
    from palpate.experiment.rehearsal.wires.foot import Foot

    return Foot(line, tracker_of(rig), real_time=real_time)


@dataclass(frozen=True)
class RehearsalKind:
    """A kind of trial in a rehearsal.

    `person` makes the participant of a task from `Parts`, and by keywords from what every `SimulatedPerson` has.
    `generic` returns a sentence on which of the materials are simulated generically; nothing for none. `rig` returns
    the name of the shipped rig that a study is rehearsed on; `lacks_nothing` raises `PalpateError` for a rig without a
    device that a study needs. `prepare` writes into a new dataset what its sessions need, by a seed. `moves` returns
    what moves before the tracker, at the far end of its line.
    """

    person: Callable[..., SimulatedPerson]
    generic: Callable[[Sequence[str]], str]
    rig: Callable[[Protocol], str] = lambda _: "rigs/rehearsal.toml"
    lacks_nothing: Callable[[Rig, Protocol], object] = lambda _rig, _protocol: None
    prepare: Callable[[Path, Protocol, int], object] = lambda _dataset, _protocol, _seed: None
    moves: Callable[..., Foot] = stepping


def rehearsal_kind(task: Task) -> RehearsalKind:
    """Return the kind of a task; no other is imported."""
    module: Any = import_module(f"palpate.experiment.rehearsal.kinds.{task.kind}.participant")
    return cast("RehearsalKind", module.REHEARSAL)
