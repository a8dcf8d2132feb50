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
            "At enrolment participants are asked the following about themselves; nobody has to answer. The answers "
            "stand under a number in a file of their own and in the table of participants. Both go with a withdrawal, "
            "and what stays on record tells nobody what was answered."
        )
        for one in asked.people:
            shared = protocol.sharing is not None and one.id in protocol.sharing.facts
            yield Gap()
            yield facts(*_question(one), ("Reason", Free(one.reason)), ("Shared", "yes" if shared else "no"))
            if one.group is not None:
                yield facts(("Groups", f"of {one.group:g}, in what is shared"))
        yield Gap()
    for form in asked.questionnaires:
        yield Said(
            f"{'Before the familiarisation' if form.when == 'before' else 'After the last trial'} of task {form.task} "
            "participants are asked the following; nobody has to answer. The answers are kept with the trials."
        )
        shared = protocol.sharing is not None and form.id in protocol.sharing.questionnaires
        yield facts(
            ("Questionnaire", Free(form.title)),
            ("Id", form.id),
            ("Shared", "yes, but for texts" if shared else "no"),
        )
        for item in form.items:
            yield Gap()
            yield facts(*_question(item))
        yield Gap()
    if asked.touch:
        shared = protocol.sharing is not None and TOUCH in protocol.sharing.questionnaires
        yield Said(
            "Before the familiarisation of every task it is recorded what the skin touches; nobody has to answer. This "
            f"is kept with the trials, and {'shared, but for texts' if shared else 'not shared'}."
        )
        for item in asked.touch:
            yield Gap()
            yield facts(*_question(item))
        yield Gap()


def _question(one: Question) -> Iterator[tuple[str, str | Free]]:
    yield "Column", one.id
    yield "Question", Free(one.question)
    yield "Answer", f"one of {', '.join(map(named, one.values))}" if one.answer == "choice" else one.allowed
