"""The force on record: which cycles are, in which bytes, and how those that are missing are counted."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from palpate.experiment.apparatus.servo.record import AT_ONCE, NEAR_MM, ForceRecord, cycles_of, lost_cycles
from palpate.experiment.apparatus.servo.rendering import NO_FORCE


def test_a_cycle_is_on_record_where_the_hand_is_near_or_pushed() -> None:
    record = ForceRecord()
    far, near = (NEAR_MM + 0.1, 0.0), (NEAR_MM, 0.0)
    assert [record.add(n, n, 1, far, NO_FORCE, NO_FORCE) for n in range(3)] == [b""] * 3
    assert record.add(3, 1_200_000, 2, near, NO_FORCE, NO_FORCE) == b""
    assert record.add(4, 1_600_000, 0, far, (0.5, 0.25), (0.4, 0.2)) == b""
    raw = record.add(5, 2_000_000, 1, far, NO_FORCE, NO_FORCE)
    # As `CYCLE` says, written out: 48 bytes a cycle, little-endian.
    one, other = struct.iter_unpack("<IIqqffffff", raw)
    assert one[:4] == (0, 2, 3, 1_200_000)
    assert other[:4] == (1, 0, 4, 1_600_000)
    assert other[6:] == pytest.approx((0.5, 0.25, 0.4, 0.2))
    cycles = cycles_of(raw, later_ns=7)
    assert cycles["t_ns"].tolist() == [1_200_007, 1_600_007]
    assert cycles["sent_n"].tolist() == [[0.0, 0.0], pytest.approx([0.4, 0.2])]


def test_it_is_handed_over_before_it_grows() -> None:
    record = ForceRecord()
    given = [record.add(n, n, 1, NO_FORCE, NO_FORCE, NO_FORCE) for n in range(200)]
    assert {len(one) for one in given} == {0, AT_ONCE}
    numbers = cycles_of(b"".join([*given, record.take()]))["number"]
    assert numbers.tolist() == list(range(200))


@pytest.mark.parametrize(
    ("numbers", "first", "lost"),
    [([0, 1, 2], 0, 0), ([5, 6, 9], 3, 4), ([7, 8, 0, 1], 7, 0), ([7, 8, 2, 3], 7, 2), ([0], 50, 0)],
)
def test_gaps_are_counted_and_a_servo_that_was_opened_anew_counts_from_zero(
    numbers: list[int], first: int, lost: int
) -> None:
    assert lost_cycles(np.array(numbers), first) == lost
