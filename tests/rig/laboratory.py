"""A laboratory whose devices the tests provide, and its rig files."""

from __future__ import annotations

import hashlib
import re
from datetime import date
from pathlib import Path

import numpy as np

from palpate.experiment.apparatus import host, rig
from palpate.experiment.apparatus.panel.movement import COLUMNS
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.wires.foot import Foot, trajectory
from palpate.experiment.rehearsal.wires.panel import Panel
from tests.plugged import PluggedLine
from tests.rig.faults import Faults

NOISE_MM = 0.1
"""The tracker's noise that they state, mm."""

SPEED_MM_S = 200.0
"""Of the foot, through the gate."""


STOPS = """
[stops]
emergency = "a switch beside the panel cuts the amplifier's power"
limit = "a fuse of 1 A"
tried_on = {day}
tried_days = 30
"""


MEASURED = """[actuator.measured]
response = "panel.csv"
response_sha256 = "{digest}"
load = "nobody"
full_scale_m_s2 = {full_m_s2}
low_hz = 10.0
high_hz = 500.0
resonances_hz = []
loudest = 0.2
check_peak = 0.05
compression_db = 0.0
accelerometer_m_s2 = 100.0
calibrated_on = {day}
calibration_days = 30

[tracker]"""


def measured(text: str, folder: Path) -> str:
    """The text of a rig file whose panel was measured today, with the table of its response in its folder."""
    rows = "".join(f"{hz},50,0,0.01,1\n" for hz in range(5, 2001, 5))
    table = f"# Measured with nobody on the panel.\n{','.join(COLUMNS)}\n{rows}".encode()
    (folder / "panel.csv").write_bytes(table)
    stated_m_s2 = re.search(r"(?m)^full_scale_m_s2 = (\S+)", text.partition("[accelerometer]")[0])
    full_m_s2 = stated_m_s2[1] if stated_m_s2 else "50.0"
    stated = MEASURED.format(digest=hashlib.sha256(table).hexdigest(), full_m_s2=full_m_s2, day=date.today())
    return re.sub(r"(?m)^format = \d+", "format = 4", text, count=1).replace("[tracker]", stated, 1)


def write_rig(folder: Path, name: str, **changed: str) -> Path:
    """A rig file of a laboratory, calibrated and tried today, with the tracker's noise; `changed` replaces values.

    No table of it says that it is simulated.
    """
    text = shipped(f"rigs/{name}.toml").read_text("utf-8").replace("simulated = true", "simulated = false")
    text = text.replace(
        "[tracker]", f"[tracker]\nnoise_mm = {NOISE_MM}\ncalibrated_on = {date.today()}\ncalibration_days = 30"
    )
    text = re.sub(r"(?s)\[accelerometer\].*", "", text) if name == "rehearsal" else text
    for key, value in changed.items():
        text, count = re.subn(rf"(?m)^{key} = \S+", f"{key} = {value}", text)
        assert count, key
    table = shipped("rigs/rehearsal-response.csv").read_bytes().replace(b"# SIMULATED f", b"# F")
    (folder / "rehearsal-response.csv").write_bytes(table)
    text = re.sub('response_sha256 = "[0-9a-f]+"', f'response_sha256 = "{hashlib.sha256(table).hexdigest()}"', text)
    path = folder / "rig.toml"
    path.write_text(measured(text, folder) + STOPS.format(day=date.today()), "utf-8")
    return path


HURRIED = {"READY_S": (0.05, 0.1), "SPEAKS_LOG_S": (-2.0, 0.1)}
"""A simulated participant who needs no time to get ready and hardly any to answer, by their names in its module."""


class Laboratory:
    """What stands there: a panel, and a line to a foot that steps when the tracker is drained, as it is when armed."""

    def __init__(self, panel: Panel, line: PluggedLine) -> None:
        self.panel = panel
        self.line = line
        self.settings = rig.tracker_of(rig.load(shipped("rigs/rehearsal.toml")))
        self.steps = 0
        self.resting = False
        """The foot does not step when the tracker is drained next: it rests on the panel."""
        self.faults: dict[int, Faults] = {}
        """What goes wrong, by the step's number from 1."""
        self.power()

    def power(self, sole_mm: float = 0.0) -> None:
        """The device begins to send, its clock at zero; as a device does, whatever the machine is busy with."""
        with host.raised():
            self.foot = Foot(self.line, self.settings, real_time=True, sole_mm=sole_mm)

    def drained(self) -> None:
        """The tracker listens anew."""
        if not self.resting:
            self.step()
        self.resting = False

    def step(self) -> None:
        self.steps += 1
        step = trajectory(np.random.default_rng(3), SPEED_MM_S, hesitation="none")
        self.foot.step(step, 0, self.faults.get(self.steps))
