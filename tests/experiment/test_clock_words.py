"""How long something lasts, as a person would say it."""

from __future__ import annotations

import pytest

from palpate.experiment.clock import minutes


@pytest.mark.parametrize(
    ("lasts_s", "words"), [(20, "20 s"), (300, "5 min"), (90.2, "1 min 30 s"), (59.7, "1 min"), (0, "0 s")]
)
def test_minutes_and_seconds_are_said_as_a_person_would(lasts_s: float, words: str) -> None:
    assert minutes(lasts_s) == words
