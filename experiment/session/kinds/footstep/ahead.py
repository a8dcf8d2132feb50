"""A vibration before contact on a rig: whether its contact is predicted in time, and well enough.

`fidelity` looks this up for a study of which a task has `ahead`.
"""

from palpate.experiment.apparatus.rig import Rig, tracker_of
from palpate.experiment.errors import Finding, Remedy
from palpate.experiment.protocol.models import Ahead, Protocol, Task
from palpate.experiment.session.kinds.footstep.error_budget import aim_ms
from palpate.experiment.session.kinds.footstep.fidelity import speeds_mm_s

UNSCHEDULED = "its actuator cannot start at a set time"
"""Why a rig plays nothing before contact."""


def refusal(protocol: Protocol, rig: Rig) -> Finding | None:
    """Return why no participant is run on a rig in a study with such tasks; None where they are."""
    tasks = ((task, task.ahead) for task in protocol.tasks)
    found = (_refusal(protocol, rig, task, ahead) for task, ahead in tasks if ahead is not None)
    return next((one for one in found if one is not None), None)


def _refusal(protocol: Protocol, rig: Rig, task: Task, ahead: Ahead) -> Finding | None:
    where, early = f"rig '{rig.rig.name}'", f"{-ahead.delay_ms:g} ms before contact in task '{task.id}'"
    if rig.actuator.driver != "audio":
        what = f"{UNSCHEDULED}, {early}"
        return Finding(what, where, remedy="use an actuator on a channel of the audio device")
    speeds = speeds_mm_s(protocol)
    errors_ms = [aim_ms(protocol, rig, speed, -ahead.delay_ms) for speed in speeds]
    known = [(ms, speed) for ms, speed in zip(errors_ms, speeds, strict=True) if ms is not None]
    if len(known) < len(speeds):
        what = f"below the gate, a foot at {speeds[-1]:.0f} mm/s leaves no time for an onset {early}"
        return Finding(what, where, remedy="raise footstep.step.gate_bottom_mm, or lower the limit of 'speed-above'")
    if ahead.error_max_ms is None:
        return None
    allowed = f"{ahead.error_max_ms:g} ms (tasks.ahead.error_max_ms)"
    if tracker_of(rig).noise_mm is None:
        what = f"its tracker's noise was not measured, so the timing error of an onset {early} is unknown"
        return Finding(what, where, allowed=allowed, remedy="measure it, and write tracker.noise_mm into the rig file")
    worst_ms, speed_mm_s = max(known)
    if worst_ms <= ahead.error_max_ms:
        return None
    what = f"got a standard error of {worst_ms:.1f} ms for an onset {early} at a foot speed of {speed_mm_s:.0f} mm/s"
    plan = ("palpate", "plan", "PROTOCOL", "--rig", "RIG", "--recordings", "FOLDER")
    lower = "use a tracker with less noise or more frames, shorten the output latency, or count only faster steps"
    return Finding(what, where, allowed=allowed, remedy=Remedy(f"{lower}; {{}} shows it", plan, suffices=False))
