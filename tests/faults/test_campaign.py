"""The subset of the fault campaign that every change has to survive."""

from __future__ import annotations

import pytest

from tests.faults import campaign
from tests.faults.campaign import PARTS, Size


@pytest.mark.parametrize("part", PARTS)
def test_every_fault_is_survived(part: str) -> None:
    counts = list(campaign.attacks(part, Size.SUBSET))
    assert counts
    for count in counts:
        assert count.tried > 0, count.fault
        assert (count.survived, count.lost) == (count.tried, 0), (count.fault, *count.failures[:20])
