"""Reasons that go on record for ever: they name nobody, and say nothing of anybody's health.

A word that tells of health is found in English alone. Names are found where the laboratory keeps them (`people.py`).
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from palpate.experiment.errors import RosterError
from palpate.experiment.settings.characters import quoted

HEALTH = re.compile(
    r"\b(?:ill|illness|sick\w*|disease\w*|disorder\w*|disab\w*|injur\w*|wound\w*|hurt|hurts|hurting|pains?|painful"
    r"|(?:\w*(?:head|tooth|stomach|back|ear) ?)?aches?|migraine\w*|nause\w*|vomit\w*|dizz\w*|faint\w*|fever\w*|flu"
    r"|influenza|covid\w*|infect\w*|cancer\w*|tumou?r\w*|diabet\w*|asthma\w*|allerg\w*|epilep\w*|seizure\w*|stroke"
    r"|pregnan\w*|depress\w*|anxi\w*|panic|psychi\w*|psycho(?:sis|ses|tic\w*|log\w*)|autis\w*|adhd|dementia"
    r"|neuropath\w*|arthrit\w*|diagnos\w*|symptom\w*|medic\w*|drug\w*|surger\w*|hospitals?|hospitali[sz]\w*|doctors?"
    r"|therap\w*|health\w*|unwell|handicap\w*|amput\w*|paraly\w*)\b",
    re.IGNORECASE,
)
"""Words that tell of somebody's health."""

SHORTEST = 3
"""Letters of a part of a name that is looked for: a shorter one is a word of many sentences."""


def check(reason: str, names: Iterable[str]) -> None:
    """Refuse a reason with a word that tells of health, or with a part of one of these `names`.

    Raises `RosterError`, which does not repeat the reason.
    """
    words = {word.casefold() for word in re.findall(r"\w+", reason)}
    parts = {part.casefold() for name in names for part in re.findall(r"\w+", name) if len(part) >= SHORTEST}
    found = HEALTH.search(reason)
    told = f"a word that tells of health, {quoted(found[0])}" if found else "the name of a participant"
    if found or words & parts:
        raise RosterError(
            f"--reason: got {told}; allowed: one line that names no person and no state of health, such as 'asked to "
            "stop'; it stays on record for ever, so say it in other words"
        )
