"""An error of palpate as a red check: what it got, what is allowed, what to do."""

from __future__ import annotations

import pytest

from palpate.experiment.apparatus.doctor.checks import Check, refused
from palpate.experiment.errors import PalpateError


@pytest.mark.parametrize(
    ("said", "found"),
    [
        (
            "audio.latency: got 40 days; allowed: 0 to 30 days; run it; or not",
            ("audio.latency: got 40 days", "0 to 30 days; run it", "or not"),
        ),
        ("tracker at COM3: cat (7) holds it; close it", ("tracker at COM3: cat (7) holds it", "", "close it")),
        ("nothing to be done", ("nothing to be done", "", "nothing to be done")),
        ("rig.toml: 1 error\n  line 3: bad", ("rig.toml: 1 error line 3: bad", "", "correct that file")),
    ],
)
def test_an_error_is_taken_apart(said: str, found: tuple[str, str, str]) -> None:
    assert refused("part", PalpateError(said)) == Check("part", "red", *found)
