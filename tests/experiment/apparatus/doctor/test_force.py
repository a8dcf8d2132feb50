"""The doctor before a force device: whether it answers, in time and often enough, and whether it bears the block."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.doctor import force
from palpate.experiment.apparatus.rig import tracker_of
from palpate.experiment.apparatus.servo.opening import servo_of
from palpate.experiment.apparatus.servo.settings import ServoRig
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.errors import Finding, RigError
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.rehearsal.wires.force_device import ForceDeviceProcess

RIG = rigs.load(shipped("rigs/tapping.toml"))
DEVICE = RIG.servo
PAPER = files.load(shipped("wellman1995.toml"))


def changed(**keys: float | None) -> ServoRig:
    assert DEVICE is not None
    return DEVICE.model_copy(update=keys)


def looked_at(
    address: str, device: ServoRig | None = None, protocol: Protocol | None = PAPER, hz: int = 500
) -> dict[str, Finding]:
    tracker = tracker_of(RIG).model_copy(update={"rate_hz": hz})
    rig = RIG.model_copy(update={"servo": device or changed(), "tracker": tracker})
    found = force.checks(rig, address, protocol=protocol, clock=MonotonicClock())
    return {check.check: check for check in found}


def test_a_device_that_answers_is_told_with_limit_and_block(
    monkeypatch: pytest.MonkeyPatch, approved: SnapshotAssertion
) -> None:
    monkeypatch.setattr(force, "ASKS_S", 0.1)
    with ForceDeviceProcess() as device:
        # However long a busy machine lets the simulated device wait for its turn.
        found = looked_at(device.address, changed(answer_ms=60_000.0, damping_n_s_m=110.0, tip_mass_kg=None))
        alone = looked_at(device.address, changed(answer_ms=60_000.0), protocol=None)
    assert list(found) == ["force device", "force answers", "force rate", "force limit", "force felt", "block"]
    assert {found[name].verdict for name in ("force device", "force answers", "force limit", "block")} == {"passes"}
    assert found["force limit"].what == approved
    assert found["force rate"].allowed == "2500 per second, minus 1 %"
    assert alone["force rate"].allowed == "500 per second, minus 1 %"
    assert alone["force limit"].verdict == "unknown"


def test_nobody_there_is_red_with_what_to_do(approved: SnapshotAssertion) -> None:
    found = looked_at("127.0.0.1:1")["force device"]
    assert found.verdict == "refuses"
    assert found.remedy == approved


@pytest.mark.parametrize("name", ["laboratory", "rehearsal"])
def test_a_rig_that_renders_no_surface_is_red_before_a_study_of_them_alone(name: str) -> None:
    """The words are those of `palpate check --rig` and of a session."""
    rig = rigs.load(shipped(f"rigs/{name}.toml"))
    with pytest.raises(RigError) as refused:
        servo_of(rig)
    (found,) = force.checks(rig, None, protocol=PAPER, clock=MonotonicClock())
    assert (found.check, found.verdict) == ("virtual surfaces", "refuses")
    assert replace(found, check="") == refused.value.finding
    for other in (None, files.load(shipped("okamoto2012.toml"))):
        assert list(force.checks(rig, None, protocol=other, clock=MonotonicClock())) == []


def test_a_device_that_would_give_energy_to_the_hand_is_red() -> None:
    """Of a device whose mass is not known, at a tracker's 500 Hz: K T / 2 + C are 102.5 N s/m."""
    found = looked_at("127.0.0.1:1", changed(damping_n_s_m=102.4, tip_mass_kg=None))["block"]
    assert found.verdict == "refuses"
    assert "102.5 N s/m" in found.what
    assert looked_at("127.0.0.1:1", changed(damping_n_s_m=102.6, tip_mass_kg=None))["block"].verdict == "passes"
    assert looked_at("127.0.0.1:1", hz=2500)["block"].verdict == "passes"


@pytest.mark.parametrize(
    ("waited_ms", "verdicts"),
    [
        ([0.1] * 100, ("passes", "passes")),
        ([0.1] * 99, ("passes", "passes")),
        ([0.1] * 98, ("passes", "refuses")),
        ([0.1] * 99 + [2.1], ("refuses", "passes")),
        ([], ("refuses", "refuses")),
    ],
)
def test_answers_are_judged_by_the_latest_and_the_rate_by_how_many(
    waited_ms: list[float], verdicts: tuple[str, str]
) -> None:
    found = force.answers(np.array(waited_ms), changed(answer_ms=2.0), rate_hz=100)
    assert tuple(check.verdict for check in found) == verdicts
