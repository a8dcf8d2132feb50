"""Taps on real samples, a kind of trial: have both laid out, ask at once, and say what goes on record."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, field
from datetime import date
from typing import TYPE_CHECKING

from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.desk.questions import Place
from palpate.experiment.protocol.models import Protocol, Task
from palpate.experiment.records.entries import PlannedTrial, Trace
from palpate.experiment.records.kinds.tapping import ForceTrace, PairLaidOut
from palpate.experiment.session.kind import FarEnds, Kind, KindDevices, Lent, Seen, SessionKind, Sitting

if TYPE_CHECKING:
    from palpate.experiment.apparatus.audio.stream import AudioStream


@dataclass(frozen=True)
class ComparisonDevices:
    """Implements `KindDevices`: real samples need no device."""

    def begin(self, lent: Lent) -> Comparisons:
        return Comparisons(lent)


def open_comparisons(sitting: Sitting, stream: AudioStream | None, ends: FarEnds, opened: ExitStack) -> KindDevices:
    """Open what a task needs: nothing for real samples; otherwise as `laboratory.open_laboratory`."""
    if sitting.protocol.task(sitting.task_id).stimulus == "real":
        return ComparisonDevices()
    from palpate.experiment.session.kinds.tapping.virtual import open_surfaces

    return open_surfaces(sitting, stream, ends, opened)


@dataclass
class Comparisons(Kind):
    """Each attempt is one pair of samples, tried at will; question and response times begin once both are laid out."""

    lent: Lent
    _laid: PairLaidOut | None = field(default=None, init=False)

    def ready(self, planned: PlannedTrial, attempt: int, answered_ns: int | None) -> None:  # noqa: ARG002
        """Have the samples of the pair laid out, the one that is presented first at the first place."""
        if self.lent.limits.end_reason():
            return
        self.lent.console.ask(Place(planned.trial, planned.presented))
        self._laid = PairLaidOut(
            trial=planned.trial, attempt=attempt, presented=planned.presented, laid_ns=self.lent.clock.now_ns()
        )

    def watch(self, waiting: Callable[[], AbstractContextManager[None]]) -> Seen:  # noqa: ARG002
        """Return at once that both samples lie there: no device follows what the participant does with them."""
        laid, self._laid = self._laid, None
        if laid is None:
            raise RuntimeError("no pair is watched before it was laid out")
        return Seen(laid, answerable_ns=laid.laid_ns)


def _recorded(protocol: Protocol, tasks: Sequence[Task]) -> set[str]:  # noqa: ARG001
    """Return none: a virtual surface rings by a closed form."""
    return set()


def _frames(task: Task) -> type[Trace] | None:
    return None if task.stimulus == "real" else ForceTrace


def _check_rig(protocol: Protocol, rig: Rig, today: date) -> None:
    """Real samples need no rig; what renders surfaces is judged by `_judge`."""


_VIRTUAL = "palpate.experiment.session.kinds.tapping.virtual"
KIND = SessionKind(open_comparisons, _recorded, _check_rig, _VIRTUAL, _VIRTUAL, _frames)
