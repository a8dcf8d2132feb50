"""What is to be recorded, from the protocol or otherwise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from palpate.experiment.errors import RecordingError
from palpate.experiment.protocol.files import load as load_protocol
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.recordings.store import plan
from tests.approved import Refuses


@pytest.fixture(scope="module")
def protocol(repository_root: Path) -> Protocol:
    return load_protocol(repository_root / "protocols" / "okamoto2012.toml")


def test_a_plan_takes_the_protocols_speeds_and_takes_or_others(protocol: Protocol) -> None:
    own = plan(protocol, source="s", simulated=False)
    assert (own.speeds_mm_s, own.takes, len(own.conditions())) == ((50.0, 100.0, 200.0, 300.0), 3, 5 * 4 * 3)
    fresh = plan(protocol, source="s", simulated=False, speeds_mm_s=(150.0, 250.0, 400.0), takes=10)
    assert len(fresh.conditions()) == 5 * 3 * 10


@pytest.mark.parametrize(
    "speeds", [(400.0, 150.0), (100.0, 100.0), (9.5, 50.0), (-1.0,), (np.nan,), (100.0, np.inf), (1e4 + 1,)]
)
def test_speeds_that_do_not_rise_or_that_no_foot_has_are_refused(
    protocol: Protocol, speeds: tuple[float, ...], refuses: Refuses
) -> None:
    with refuses(RecordingError):
        plan(protocol, source="s", simulated=False, speeds_mm_s=speeds)


@pytest.mark.parametrize("takes", [0, -1, 101])
def test_no_take_is_refused(protocol: Protocol, takes: int) -> None:
    with pytest.raises(RecordingError, match=f"takes: got {takes}; allowed: 1 to 100"):
        plan(protocol, source="s", simulated=False, takes=takes)
