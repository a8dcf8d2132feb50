"""What one task needs, decided from the task alone, and the opening of just that."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from palpate.experiment.protocol.models import Protocol, Task
from palpate.experiment.session.kind import session_kind

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from palpate.experiment.apparatus.rig import Rig
    from palpate.experiment.synthesis.signals.noise import Colour


@dataclass(frozen=True)
class Scene:
    """What a task needs.

    Stimuli are made from the spectra of `materials`, those of the task and of the masker's probe, with the task's
    `phase`, for what shakes (`actuator`). `masker` is the noise's color, None for none, and a microphone may listen
    to answers (`listens`).
    """

    actuator: bool
    materials: tuple[str, ...]
    masker: Colour | None
    listens: bool
    phase: str | None = None

    @property
    def synthesis(self) -> bool:
        """Whether stimuli are made from recordings."""
        return bool(self.materials)

    def sounds(self, rig: Rig) -> bool:
        """Return whether anything of an audio device is needed: headphones, a microphone, or an output that shakes."""
        return self.masker is not None or self.listens or (self.actuator and rig.actuator.driver == "audio")


def plan(*, protocol: Protocol, task_id: str) -> Scene:
    """Decide what task `task_id` needs."""
    task, whole = protocol.task(task_id), virtual(protocol)
    if task.masker is not None:
        whole = replace(whole, masker=None if task.masker == "none" else task.masker)
    if task.stimulus == "virtual":
        return replace(whole, materials=_played(protocol, [task]), phase=task.phase)
    return replace(whole, actuator=False, materials=())


def virtual(protocol: Protocol) -> Scene:
    """Return what all tasks with virtual stimuli need together, or one that presented every material."""
    every = [task.model_copy(update={"materials": None}) for task in protocol.tasks]
    return Scene(
        actuator=True,
        materials=_played(protocol, [task for task in protocol.tasks if task.stimulus == "virtual"] or every),
        masker=protocol.masker.noise,
        listens=protocol.answers.microphone,
    )


def played(protocol: Protocol, task_ids: Collection[str] | None = None) -> list[Scene]:
    """Return the scene of a task with virtual stimuli (of `task_ids`, if given) for each choice of materials, phase."""
    virtual_ids = [t.id for t in protocol.tasks if t.stimulus == "virtual" and (task_ids is None or t.id in task_ids)]
    each = [plan(protocol=protocol, task_id=one) for one in virtual_ids] or [virtual(protocol)]
    return list({(scene.materials, scene.phase): scene for scene in each}.values())


def _played(protocol: Protocol, tasks: Sequence[Task]) -> tuple[str, ...]:
    """Return the materials of which these tasks play recordings."""
    wanted = {material for task in tasks for material in session_kind(task).recorded(protocol, [task])}
    return tuple(material.id for material in protocol.materials if material.id in wanted)


def masker_samples(*, colour: Colour, rate_hz: int, seconds: float) -> NDArray[np.float64]:
    """Return a round of the masker's noise, rms 1, shape (n,), the same in all sessions. Raises `SynthesisError`."""
    import numpy as np

    from palpate.experiment.synthesis.signals.noise import noise

    drawn = np.random.default_rng(0)
    return noise(colour=colour, samples=round(seconds * rate_hz), rate_hz=rate_hz, rng=drawn)
