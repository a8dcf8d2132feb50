"""Rig files of a laboratory whose devices the tests provide."""

from __future__ import annotations

import re
import shutil
from datetime import date
from pathlib import Path

from experiment.protocol.shipped import shipped

NOISE_MM = 0.1
"""The tracker's noise that they state, mm."""


def write_rig(folder: Path, name: str, **changed: str) -> Path:
    """A rig file of a laboratory, calibrated today, with the tracker's noise; `changed` replaces values by key."""
    text = shipped(f"rigs/{name}.toml").read_text("utf-8").replace("simulated = true", "simulated = false")
    text = text.replace(
        "[tracker]", f"[tracker]\nnoise_mm = {NOISE_MM}\ncalibrated_on = {date.today()}\ncalibration_days = 30"
    )
    text = re.sub(r"(?s)\[accelerometer\].*", "", text) if name == "rehearsal" else text
    for key, value in changed.items():
        text, count = re.subn(rf"(?m)^{key} = \S+", f"{key} = {value}", text)
        assert count, key
    shutil.copy(shipped("rigs/rehearsal-response.csv"), folder)
    path = folder / "rig.toml"
    path.write_text(text, "utf-8")
    return path
