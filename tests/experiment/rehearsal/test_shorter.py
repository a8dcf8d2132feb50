"""Practice with fewer trials than a session: every shipped study has it, and stays what it is otherwise."""

from __future__ import annotations

import pytest

from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.rehearsal.shorter import shortened

STUDIES = sorted(path.name for path in shipped("okamoto2012.toml").parent.glob("*.toml"))


def trials(protocol: Protocol) -> list[int]:
    return [task.repetitions * len(protocol.presentations(task)) for task in protocol.tasks]


@pytest.mark.parametrize("name", STUDIES)
def test_every_study_is_practiced_with_fewer_trials(name: str) -> None:
    whole = files.load(shipped(name))
    with shortened(shipped(name), 1) as file:
        short = files.load(file)
    assert not file.exists()
    assert max(task.repetitions for task in short.tasks) in (1, 2)
    assert [few < many for few, many in zip(trials(short), trials(whole), strict=True)] == [True] * len(whole.tasks)
    same = {"tasks", "exclusion"}
    assert short.model_dump(exclude=same) == whole.model_dump(exclude=same)
    assert [one.model_dump(exclude={"repetitions"}) for one in short.tasks] == [
        one.model_dump(exclude={"repetitions"}) for one in whole.tasks
    ]


@pytest.mark.parametrize(("repetitions", "limit"), [(5, 18), (10, 36), (1000, 36)])
def test_the_least_answers_fall_with_the_trials(repetitions: int, limit: int) -> None:
    """The paper's protocol asks for 36 answers of 40."""
    with shortened(shipped("okamoto2012.toml"), repetitions) as file:
        assert {rule.when: rule.limit for rule in files.load(file).exclusion}["answers-below"] == limit


def test_without_a_number_it_is_the_protocol_itself() -> None:
    with shortened(shipped("okamoto2012.toml"), None) as file:
        assert file == shipped("okamoto2012.toml")
