"""Questionnaires before and after a task: asked at the console, item by item, each answer on disk before the next."""

from typing import Literal

from palpate.experiment.desk.questions import Console, Notice, Report
from palpate.experiment.protocol.asked import Asked, Item, Questionnaire
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import entries
from palpate.experiment.session.kind import Log
from palpate.experiment.settings.characters import quoted


def ask(protocol: Protocol, task_id: str, when: Literal["before", "after"], console: Console, log: Log) -> None:
    """Ask every item of a task's questionnaires that has no answer on record yet.

    Raises `PauseAsked` where the session pauses at an item, which is asked again when it goes on.
    """
    for one in protocol.table(Asked).of_task(task_id, when):
        for item in one.items:
            entry = entries.Questioned(questionnaire=one.id, item=item.id, answer=None)
            if entry.step not in log.done.visited:
                log.write(entry.model_copy(update={"answer": _answer(one, item, console)}))


def _answer(questionnaire: Questionnaire, item: Item, console: Console) -> str | int | float | None:
    listed = "".join(f" {number} {value}." for number, value in enumerate(item.values, start=1))
    allowed = "the number or the text of one of these" if item.values else item.allowed
    no_names = " Do not name anyone." if item.answer == "text" else ""
    text = f"{questionnaire.title}: {item.question}{listed} Allowed: {allowed}; leave it blank for no answer.{no_names}"
    while True:
        typed = console.ask(Report(text)).text
        try:
            return item.read(typed)
        except ValueError:
            console.tell(Notice(f"Got {quoted(typed)}, which is not {allowed}."))
