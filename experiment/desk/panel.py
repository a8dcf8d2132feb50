"""Before a session: has the experimenter see that nobody is on the panel, and compares it with its measurement.

A session imports this, and what plays and hears the multisine, only once it compares.
"""

from pathlib import Path

from palpate.experiment.apparatus.panel import drift
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.desk.questions import YES, Agree, Console, Notice
from palpate.experiment.errors import Interrupted


def compare_panel(rig_file: Path, rig: Rig, console: Console) -> tuple[str, float | None]:
    """Have a panel with nobody on it compared with its measurement; return what goes on record, and how much louder it
    is at most, dB, None without a comparison.

    Raises `Interrupted` if somebody stays on it, and `PalpateError` for a panel or devices that may not be used.
    """
    if not drift.is_heard(rig):
        told = "The panel was not compared with its measurement, because no accelerometer stays on it."
        console.tell(Notice(f"WARNING: {told}"))
        return told, None
    text = "The panel is about to move for about 4 s, or 14 s. Is nobody on it, and nothing but what belongs there?"
    if console.ask(Agree(text, "yes, nobody is on it", "no, leave")).key != YES:
        raise Interrupted("somebody is on the panel; nothing was begun", remedy="have them step off, and begin again")
    found, louder_db = drift.compare_panel(rig_file, rig)
    warning = "WARNING: " if found.verdict == "warns" else ""
    console.tell(Notice(f"{warning}{found.sentence()}."))
    return f"Nobody was on the panel, as the experimenter confirmed: {found.observation()}", louder_db
