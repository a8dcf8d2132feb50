"""How a step's speed lies to the range that a protocol asks for."""

from __future__ import annotations

from typing import Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.experiment.desk.messages import Pace
from palpate.experiment.protocol.models import ExclusionRule
from palpate.experiment.session.kinds.footstep.trials import pace


def rule(when: Literal["speed-below", "speed-above", "frames-lost"], limit: float) -> ExclusionRule:
    return ExclusionRule(id=when, when=when, limit=limit, action="repeat-trial", reason="It is so.")


BOTH = (rule("frames-lost", 3), rule("speed-below", 50), rule("speed-above", 300))


@pytest.mark.parametrize(
    ("speed_mm_s", "told"),
    [(49.9, "slow"), (50.0, "right"), (175.0, "right"), (300.0, "right"), (300.1, "fast")],
)
def test_a_speed_at_a_limit_is_in_range_as_the_rule_has_it(speed_mm_s: float, told: Pace) -> None:
    assert pace(speed_mm_s, BOTH) == told


@given(speed_mm_s=st.floats(0.1, 10_000))
def test_without_a_rule_about_speed_nothing_is_told(speed_mm_s: float) -> None:
    assert pace(speed_mm_s, BOTH[:1]) is None
    assert pace(speed_mm_s, ()) is None


@given(speed_mm_s=st.floats(0.1, 10_000), limit_mm_s=st.floats(1, 1_000))
def test_one_rule_leaves_the_other_end_open(speed_mm_s: float, limit_mm_s: float) -> None:
    assert pace(speed_mm_s, [rule("speed-below", limit_mm_s)]) == ("slow" if speed_mm_s < limit_mm_s else "right")
    assert pace(speed_mm_s, [rule("speed-above", limit_mm_s)]) == ("fast" if speed_mm_s > limit_mm_s else "right")
