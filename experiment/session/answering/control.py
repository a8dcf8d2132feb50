"""Before a control's trials the experimenter confirms what keeps the vibration from the skin; before others, that it is
gone.
"""

from palpate.experiment.desk.questions import YES, Agree, Console
from palpate.experiment.errors import PauseAsked
from palpate.experiment.protocol.models import Protocol, Task
from palpate.experiment.records.entries import Note
from palpate.experiment.session.kind import Log


def confirm(protocol: Protocol, task: Task, console: Console, log: Log) -> None:
    """Have the arrangement of a study with a control confirmed, on record. Raises `PauseAsked` where it is not so."""
    if task.stimulus != "virtual":
        return
    if (control := task.control) is not None:
        told = f"Task {task.id} is a control: no vibration may reach the skin. {control.arrangement.strip()}"
    else:
        others = [one for one in protocol.tasks if one.control is not None and one.control.of == task.id]
        if not others:
            return
        removed = f"the arrangement for {', '.join(one.id for one in others)} has been removed"
        told = f"Task {task.id} is not a control: {removed}."
    if console.ask(Agree(f"{told} Is this correct?", "yes, it is", "no, pause")).key != YES:
        raise PauseAsked("the arrangement for the control is not in place")
    log.write(Note(trial=None, text=f"The experimenter confirmed: {' '.join(told.split())}"))
