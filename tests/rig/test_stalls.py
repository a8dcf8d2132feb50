"""The subset of the campaign's part `stalls`, which measures to a tenth of a second when a session falls silent."""

from __future__ import annotations

import pytest

from tests.faults import campaign
from tests.faults.campaign import Size

pytestmark = pytest.mark.alone


def test_what_stands_still_leaves_every_limit_held() -> None:
    counts = list(campaign.attacks("stalls", Size.SUBSET))
    assert counts
    assert [(one.fault, one.failures[:20]) for one in counts if (one.survived, one.lost) != (one.tried, 0)] == []
