"""A small valid protocol, so that tests do not change when a published one does; and ways to change it."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from palpate.experiment.protocol.files import ProtocolFile
from palpate.experiment.protocol.models import Protocol

SMALL = """\
format = 4
study = { id = "small", title = "A small study", source = "Nowhere, page 7", participants = 6 }
consent = { required = true, statement = "You may stop at any moment." }
eligibility.criteria = ["Grown up.", "Rested."]

[ethics]
board = "Board of tests"
statement = "Nobody takes part."
approved_on = 2020-02-01
expires_on = 2021-02-01

[duration]
shortest_min = 20
longest_min = 35

[exposure]
vibration_peak_m_s2 = 12.5
masker_level_db_a = 71
session_min = 33

[masker]
noise = "pink"
level_set_by = "participant"
criterion = "Silence but for the noise."

[answers]
mode = "oral"
no_answer_key = "0"
redo_key = "/"
pause_key = "="

[footstep.synthesis]
rate_hz = 4000
samples = 1000
takes = 2
speeds_mm_s = [
    60,
    110,    # the second
    250,
]

[footstep.tactile]
low_hz = 7
high_hz = 420
floor_m_s2 = 0.4
source = "a paper on skin"

[footstep.step]
gate_top_mm = 18
gate_bottom_mm = 9
contact_mm = 0.5

[[materials]]
id = "felt"
key = "f"
spoken = ["felt", "cloth"]
description = "Grey felt."

[[materials]]
id = "cork"
key = "k"
spoken = ["cork"]
description = '''
[[materials]]    # no table: still text
id = "no id"
Brown cork.'''

[task_order]
kind = "counterbalanced"
break_min_s = 61

[[tasks]]
id = "one"
title = "The first"
kind = "footstep"
design = "identification"
stimulus = "virtual"
instruction = "Step."
participants = 6
repetitions = 3
order = { kind = "max-run", max_run = 2 }
[tasks.familiarisation]
min_s = 5
max_s = 55
instruction = "Try it."

[[tasks]]
id = "two"
title = "The second"
kind = "footstep"
design = "identification"
stimulus = "real"
instruction = "Step again."
participants = 4
repetitions = 2
order.kind = "blocked-random"
familiarisation.min_s = 6
familiarisation.max_s = 66
familiarisation.instruction = "Try it again."

[[exclusion]]
id = "gaps"
when = "frames-lost"
limit = 13
action = "repeat-trial"
reason = "too little is known of the step"

[[exclusion]]
id = "gone"
when = "withdrawn"
action = "exclude-participant"
reason = "they left"

[[analysis]]
test = "t against chance"
tasks = ["one", "two"]
chance = 0.5
question = "Better than chance?"

[[analysis]]
test = "ICC"
tasks = ["one"]
form = "ICC(2,1)"
question = "How reliable?"
alpha = 0.01
"""

OKAMOTO2012 = Path(__file__).parents[3] / "protocols" / "okamoto2012.toml"

Where = tuple[str | int, ...]


@cache
def _tables(text: str) -> dict[str, Any]:
    """A text is parsed once, for parsing takes longer than most tests; each caller has tables of its own."""
    return tomllib.loads(text)


def document() -> dict[str, Any]:
    """The small protocol as tables, arrays as tuples."""
    tables: dict[str, Any] = with_tuples(_tables(SMALL))
    return tables


@cache
def protocol() -> Protocol:
    """The small protocol."""
    return ProtocolFile.model_validate(document())


def okamoto2012() -> dict[str, Any]:
    """The published study as tables, arrays as tuples."""
    tables: dict[str, Any] = with_tuples(_tables(OKAMOTO2012.read_text(encoding="utf-8")))
    return tables


def places(value: object, at: Where = ()) -> Iterator[tuple[Where, Any]]:
    """Every path below the root with its value, tables and arrays included."""
    if at:
        yield at, value
    inner = value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, tuple) else ()
    for part, held in inner:
        yield from places(held, (*at, part))


def leaves(value: object) -> Iterator[tuple[Where, Any]]:
    """Every path to a value that is neither table nor array."""
    return ((path, held) for path, held in places(value) if not isinstance(held, Mapping | tuple))


def with_text() -> list[tuple[Where, str]]:
    """Every path of the small protocol that takes free text, with that text; the optional ones too."""
    free = {"title", "source", "statement", "criterion", "description", "instruction", "reason", "question", "form"}
    stated = [(path, held) for path, held in leaves(document()) if path[-1] in free or "criteria" in path]
    return [*stated, (("ethics", "board"), ""), (("ethics", "approval_number"), ""), (("ethics", "contact"), "")]


def changed(value: Any, path: Where, new: object) -> Any:
    """A copy of `value` with `new` at `path`."""
    if not path:
        return new
    part, *rest = path
    if isinstance(part, int):
        return tuple(changed(held, tuple(rest), new) if i == part else held for i, held in enumerate(value))
    return {**value, part: changed(value.get(part), tuple(rest), new)}


def without(value: Any, path: Where) -> Any:
    """A copy of `value` without the key at the end of `path`."""
    *parents, last = path
    table = value
    for part in parents:
        table = table[part]
    return changed(value, tuple(parents), {key: held for key, held in table.items() if key != last})


def with_tuples(value: Any) -> Any:
    """Tables whose arrays are tuples, as a file is read."""
    if isinstance(value, dict):
        return {key: with_tuples(held) for key, held in value.items()}
    if isinstance(value, list):
        return tuple(with_tuples(held) for held in value)
    return value


FAST = {"id": "fast", "when": "speed-above", "limit": 340, "action": "repeat-trial", "reason": "x"}


def before_contact(delay_ms: float, **others: Any) -> dict[str, Any]:
    """The small protocol with a vibration before contact; 25 ms are left of its gate to a foot of 340 mm/s."""
    newest = changed(document(), ("format",), 7)
    beginning = changed(newest, ("tasks", 0, "ahead"), {"delay_ms": delay_ms, **others})
    study: dict[str, Any] = changed(beginning, ("exclusion",), (*newest["exclusion"], FAST))
    return study
