"""The subset of the campaign's part `stalls`, which measures to a tenth of a second when a session falls silent."""

from __future__ import annotations

import pytest

from tests.faults import campaign
from tests.faults.campaign import Size
from tests.faults.stalls import SUBSET

pytestmark = pytest.mark.alone


def test_what_stands_still_leaves_every_limit_held() -> None:
    counts = list(campaign.attacks("stalls", Size.SUBSET))
    # A step that was not reached is no try, and would be no failure.
    assert [one.failures for one in counts if not one.tried] == []
    assert sum(one.tried for one in counts) == len(SUBSET)
    assert [(one.fault, one.failures[:20]) for one in counts if (one.survived, one.lost) != (one.tried, 0)] == []
