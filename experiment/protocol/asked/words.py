"""What a board's page says of what participants are asked; `page` looks this up for a protocol that asks something."""

from collections.abc import Iterator

from palpate.experiment.protocol.asked import TOUCH, Asked, Question
from palpate.experiment.protocol.blocks import Block, Free, Gap, Said, facts, named
from palpate.experiment.protocol.models import Protocol


def recorded(protocol: Protocol) -> Iterator[Block]:
    """Yield what the board reads of it."""
    asked = protocol.table(Asked)
    if asked.people:
        yield Said(
            "At enrollment, participants are asked the following about themselves; answering is optional. The "
            "answers are stored under a number, both in a separate file and in the participants table. Both copies "
            "are deleted if the participant withdraws, and the remaining record does not reveal the answers."
        )
        for one in asked.people:
            shared = protocol.sharing is not None and one.id in protocol.sharing.facts
            yield Gap()
            yield facts(*_question(one), ("Reason", Free(one.reason)), ("Shared", "yes" if shared else "no"))
            if one.group is not None:
                yield facts(("Groups", f"of {one.group:g}, in the shared data"))
        yield Gap()
    for form in asked.questionnaires:
        yield Said(
            f"{'Before the familiarization' if form.when == 'before' else 'After the last trial'} of task "
            f"{form.task}, participants are asked the following; answering is optional. The answers are stored with "
            "the trials."
        )
        shared = protocol.sharing is not None and form.id in protocol.sharing.questionnaires
        yield facts(
            ("Questionnaire", Free(form.title)),
            ("Id", form.id),
            ("Shared", "yes, except free text" if shared else "no"),
        )
        for item in form.items:
            yield Gap()
            yield facts(*_question(item))
        yield Gap()
    if asked.touch:
        shared = protocol.sharing is not None and TOUCH in protocol.sharing.questionnaires
        yield Said(
            "Before the familiarization of every task, the experimenter records what the skin touches; answering is "
            "optional. The answers are stored with the trials and "
            f"{'shared, except free text' if shared else 'not shared'}."
        )
        for item in asked.touch:
            yield Gap()
            yield facts(*_question(item))
        yield Gap()


def _question(one: Question) -> Iterator[tuple[str, str | Free]]:
    yield "Column", one.id
    yield "Question", Free(one.question)
    yield "Answer", f"one of {', '.join(map(named, one.values))}" if one.answer == "choice" else one.allowed
