"""How short the way is from a foot's speed to the limited samples of a device."""

from __future__ import annotations

import sys
from pathlib import Path
from types import FrameType

import pytest

from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.panel import conditioning
from palpate.experiment.apparatus.panel.conditioning import Conditioner, open_drive
from palpate.experiment.apparatus.panel.pcm import PcmActuator
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.rehearsal.kinds.footstep import recorded_takes
from palpate.experiment.session import scene
from palpate.experiment.session.kinds.footstep import preparation
from palpate.experiment.session.kinds.footstep.stimulus import Sounder, Sounding

MOST_CALLS, MOST_MODULES = 12, 5
"""Before stimuli were values there were 27 calls in 10 modules, counted in the same way."""


def calls(sounding: Sounding, speed_mm_s: float) -> list[tuple[str, str]]:
    """The functions of `experiment` that one preparation calls, by module and name."""
    called: list[tuple[str, str]] = []

    def note(frame: FrameType, event: str, _: object) -> None:
        module = str(frame.f_globals.get("__name__"))
        if event == "call" and module.startswith("palpate.experiment."):
            called.append((module, frame.f_code.co_name))

    sys.setprofile(note)
    try:
        sounding.prepare(speed_mm_s)
    finally:
        sys.setprofile(None)
    return called


@pytest.mark.parametrize("volts", [True, False])
def test_a_preparation_from_gate_speed_to_limiter_is_a_dozen_calls_in_five_modules(tmp_path: Path, volts: bool) -> None:
    protocol, rig_file = files.load(shipped("okamoto2012.toml")), shipped("rigs/rehearsal.toml")
    actuator, limit_m_s2 = rigs.load(rig_file).actuator, protocol.exposure.vibration_peak_m_s2
    recordings = recorded_takes.make_recordings(tmp_path / "r", protocol=protocol, seed=1).parent
    planned = scene.plan(protocol=protocol, task_id="virtual")
    materials = preparation.open_stimuli(
        scene=planned, protocol=protocol, recordings=recordings, output_rate_hz=actuator.rate_hz
    )
    drive = open_drive(rig_file.parent, actuator, limit_m_s2=limit_m_s2, materials=materials) if volts else None
    condition = Conditioner(full_scale=actuator.full_scale, limit_m_s2=limit_m_s2, drive=drive)
    panel = PcmActuator("127.0.0.1:4711", condition, rate_hz=actuator.rate_hz)
    sounding = Sounding(Sounder(materials, panel), "copy paper", lambda us: round(us * 1e3), ManualClock(0))
    sounding.prepare(120.0)
    for speed_mm_s in (50.0, 171.3, 299.0):
        called = calls(sounding, speed_mm_s)
        assert (conditioning.__name__, "limit") in called
        assert len(called) <= MOST_CALLS, called
        assert len({module for module, _ in called}) <= MOST_MODULES, called
