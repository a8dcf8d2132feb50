"""Whether a device bears a block: b > K T / 2 + |C| (Colgate and Schenkel 1997), as the paper's block is judged."""

from __future__ import annotations

from typing import Any

from syrupy.assertion import SnapshotAssertion

from palpate.experiment.apparatus.servo import settings
from palpate.experiment.apparatus.servo.settings import ServoRig
from palpate.experiment.errors import RigError
from palpate.experiment.protocol.kinds.tapping import Tapping
from tests.approved import Refuses

DEVICE: dict[str, Any] = {
    "driver": "force-tcp",
    "address": "127.0.0.1:4713",
    "full_scale_n": 3.0,
    "damping_n_s_m": 110.0,
    "delay_ms": 0.0,
    "answer_ms": 20.0,
}
PAPER = Tapping(
    switch_key="s",
    rate_hz=2500,
    stiffness_n_m=2500.0,
    damping_n_s_m=100.0,
    full_m_s2=50.0,
    decay_per_s=100.0,
    fastest_mm_s=175.0,
)


def device(**changed: Any) -> ServoRig:
    return ServoRig.model_validate(DEVICE | changed)


def test_the_papers_block_needs_100_5_n_s_m(approved: SnapshotAssertion) -> None:
    """2500 N/m * 400 us / 2 + 100 N s/m."""
    assert settings.judged(PAPER, device(damping_n_s_m=100.51))[0]
    fits, why = settings.judged(PAPER, device(damping_n_s_m=100.49))
    assert not fits
    assert why == approved


def test_the_largest_stiffness_is_told(approved: SnapshotAssertion) -> None:
    """(110 - 100) * 2 / 400 us."""
    assert settings.judged(PAPER, device())[1] == approved


def test_a_force_that_comes_late_asks_for_more() -> None:
    """A spring alone that comes n periods late asks for K T / 2 (2 n + 1), at low frequencies: 5 * 0.5 N s/m."""
    spring = PAPER.model_copy(update={"damping_n_s_m": 0.0})
    assert settings.judged(spring, device(delay_ms=0.8, damping_n_s_m=2.51))[0]
    assert not settings.judged(spring, device(delay_ms=0.8, damping_n_s_m=2.49))[0]


def test_participants_are_refused_beyond_it(refuses: Refuses) -> None:
    settings.refuse_beyond(PAPER, device(), rig="ours")
    with refuses(RigError):
        settings.refuse_beyond(PAPER, device(damping_n_s_m=5.0), rig="ours")
