"""Before a session: has the experimenter see that nobody is on the panel, and compares it with its measurement.

A session imports this, and what plays and hears the multisine, only once it compares.
"""

from pathlib import Path

from palpate.experiment.apparatus.panel import drift
from palpate.experiment.apparatus.panel.conditioning import Drifted
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.desk.questions import YES, Agree, Console, Notice
from palpate.experiment.errors import Interrupted


def compare_panel(rig_file: Path, rig: Rig, console: Console) -> tuple[str, Drifted | None]:
    """Have a panel with nobody on it compared with its measurement; return what goes on record, and the most that it
    can have drifted, None without a comparison.

    Raises `Interrupted` if somebody stays on it, and `PalpateError` for a panel or devices that may not be used.
    """
    if not drift.is_heard(rig):
        told = (
            "The panel's response was not checked against its measurement, because no accelerometer is mounted on "
            "the panel."
        )
        console.tell(Notice(f"WARNING: {told}"))
        return told, None
    text = "The panel will move for up to about 14 s. Is it clear of people and objects that do not belong there?"
    if console.ask(Agree(text, "yes, it is clear", "no, cancel")).key != YES:
        raise Interrupted("the panel is not clear; nothing was started", remedy="clear the panel, then start again")
    found, drifted = drift.compare_panel(rig_file, rig)
    warning = "WARNING: " if found.verdict == "warns" else ""
    console.tell(Notice(f"{warning}{found.sentence()}."))
    return f"The experimenter confirmed that nobody was on the panel: {found.observation()}", drifted
