"""Tables of what participants are asked, for protocols of tests; nobody exists who answers them."""

import tomllib
from typing import Any

PEOPLE = """[[asked.people]]
id = "age"
question = "How old are you, in years?"
answer = "number"
least = 18
most = 89
unit = "years"
group = 10
reason = "Sensitivity to vibration falls with age."

[[asked.people]]
id = "sex"
question = "Which sex were you assigned at birth?"
answer = "choice"
values = ["female", "male", "other"]
reason = "The journal asks for it."

[[asked.people]]
id = "experience"
question = "How much have you used such displays?"
answer = "scale"
least = 1
most = 5
reason = "Practice changes answers."

[[asked.people]]
id = "sport"
question = "Which sport do you do?"
answer = "text"
reason = "Sports without shoes change the sole."
"""

INCOME = """[[asked.people]]
id = "income"
question = "How much do you earn?"
answer = "text"
reason = "None."
"""

SHARING = """[sharing]
statement = "May your trials be shared?"
smallest_group = 1
facts = ["age", "sex"]
"""


def asking(*tables: str) -> dict[str, str]:
    """Texts to put in place of others in the shipped protocol, so that it has these tables."""
    return {"format = 4": "format = 7", "[duration]": "\n".join((*tables, "[duration]"))}


FORMS = """[[asked.questionnaires]]
id = "before"
title = "Before the trials"
task = "virtual"
when = "before"

[[asked.questionnaires.items]]
id = "tired"
question = "How tired are you?"
answer = "scale"
least = 1
most = 7

[[asked.questionnaires.items]]
id = "shoes"
question = "What did you wear this morning?"
answer = "choice"
values = ["shoes", "sandals", "nothing"]

[[asked.questionnaires]]
id = "afterwards"
title = "After the trials"
task = "virtual"
when = "after"

[[asked.questionnaires.items]]
id = "minutes"
question = "How long did it seem?"
answer = "number"
least = 0
unit = "min"

[[asked.questionnaires.items]]
id = "words"
question = "What was it like?"
answer = "text"
"""


TOUCH = """[[asked.touch]]
id = "skin_temperature"
question = "Temperature of the sole, measured"
answer = "number"
least = 10
most = 45
unit = "°C"

[[asked.touch]]
id = "footwear"
question = "What is between skin and panel?"
answer = "choice"
values = ["nothing", "sock", "shoe"]

[[asked.touch]]
id = "posture"
question = "How do they stand?"
answer = "text"
"""


def asked(task: str) -> dict[str, Any]:
    """The table of both, with the questionnaires of this task, as models have arrays."""
    found: dict[str, Any] = _frozen(tomllib.loads(f"{PEOPLE}\n{FORMS}"))["asked"]
    forms = tuple({**form, "task": task} for form in found["questionnaires"])
    return {**found, "questionnaires": forms}


def _frozen(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _frozen(inner) for key, inner in value.items()}
    return tuple(map(_frozen, value)) if isinstance(value, list) else value
