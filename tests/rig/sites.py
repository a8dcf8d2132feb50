"""A small study of where on the body a vibration was felt, and a simulated rig with an output for each site."""

from __future__ import annotations

import re
from pathlib import Path

from palpate.experiment.protocol.files import shipped

SITES = """
[[presented.sites]]
name = "palm"
place = "The middle of the left palm."
peak_m_s2 = 6.0

[[presented.sites]]
name = "wrist"
place = "The inner side of the left wrist, 2 cm from the fold."
peak_m_s2 = 12.0

"""
AT = {"low hum": "palm", "high hum": "wrist", "rustle": "palm", "knock": "wrist"}
"""Where each material's stimulus is felt."""

ACTUATOR = """
[sites.actuator]
driver = "audio"
rate_hz = 48000
full_scale_m_s2 = {full_scale}
low_hz = 20
high_hz = 1000
"""
LATENCY = """
[sites.latency]
output_ms = 2.667
input_ms = 2.667
loopback_gain = 1.0
calibrated_on = 2026-11-21
calibration_days = 30
"""
ON_RIG = f"""
[[sites]]
name = "palm"
channel = 4
loopback = 3
{LATENCY}{ACTUATOR.format(full_scale=40.0)}
[[sites]]
name = "wrist"
channel = 3
loopback = 2
{LATENCY}{ACTUATOR.format(full_scale=25.0)}
"""


def sited(repetitions: int = 3) -> str:
    """The shipped study of presented stimuli, two of its stimuli at each of two sites."""
    text = shipped("presented.toml").read_text("utf-8").replace("repetitions = 10", f"repetitions = {repetitions}")
    for material, site in AT.items():
        text = text.replace(f'material = "{material}"\n', f'material = "{material}"\nsite = "{site}"\n', 1)
    return text.replace("[[presented.stimuli]]", f"{SITES}[[presented.stimuli]]", 1)


def at_once(text: str) -> str:
    """The study with hardly a wait, for real time."""
    for key, value in (("min_s", "0"), ("max_s", "0.01"), ("break_min_s", "0"), ("gap_s", "0.1")):
        text = re.sub(rf"(?m)^{key} = \S+", f"{key} = {value}", text)
    return text.replace('set_off = "experimenter"', 'set_off = "clock"')


def card_rig(folder: Path) -> Path:
    """A simulated rig behind a sound card with an output and a loopback for each site, beside its response table."""
    text = shipped("rigs/headless.toml").read_text("utf-8").replace("format = 2", "format = 6", 1)
    text = text[: text.index("[tracker]")] + text[text.index("[actuator]") :]
    table = shipped("rigs/rehearsal-response.csv")
    (folder / table.name).write_bytes(table.read_bytes())
    path = folder / "rig.toml"
    path.write_text(text + ON_RIG, "utf-8")
    return path
