"""How far a session is, as a console shows it."""

from palpate.experiment.desk.link.wire import RECENT, Standing, Told
from palpate.experiment.records.progress import Progress


def standing(done: Progress) -> Standing:
    """Return what a view says of a session of which so much is done."""
    recent = [
        Told(trial=trial, words=said or "no answer", corrected=trial in done.corrected)
        for trial, said in done.said[-RECENT:]
    ]
    return Standing(
        task=done.header.task,
        purpose=done.header.purpose,
        trials=done.trials,
        answered=len(done.answered),
        remaining=len(done.remaining),
        recent=tuple(recent),
    )
