"""A small valid protocol of presented stimuli that has every key of its table."""

from __future__ import annotations

from typing import Any

from palpate.experiment.protocol.files import ProtocolFile
from palpate.experiment.protocol.models import Protocol
from tests.experiment.protocol.small import changed, document

WAVES: tuple[dict[str, Any], ...] = (
    {"sinusoid": {"frequency_hz": 60.0, "amplitude_m_s2": 3.0, "lasts_s": 0.25}, "ramp_s": 0.02},
    {"decaying": {"frequency_hz": 90.0, "amplitude_m_s2": 4.0, "decay_per_s": 30.0, "lasts_s": 0.25}},
    {"noise": {"low_hz": 40.0, "high_hz": 300.0, "rms_m_s2": 0.5, "seed": 7, "lasts_s": 0.25}},
    {"sweep": {"from_hz": 30.0, "to_hz": 240.0, "amplitude_m_s2": 2.0, "by": "octaves", "lasts_s": 0.5}},
    {"pulses": {"every_s": 0.125, "cycle_hz": 100.0, "amplitude_m_s2": 1.5, "lasts_s": 0.5}},
    {"silence": {"lasts_s": 0.125}},
)
RECORDED: dict[str, Any] = {
    "recorded": {"file": "felt.wav", "sha256": "0" * 64, "full_scale_m_s2": 20.0, "begins_s": 0.375, "lasts_s": 0.625}
}
"""A part that needs a file beside the protocol's."""


def presenting(
    *, repetitions: int = 2, set_off: str = "experimenter", first: tuple[dict[str, Any], ...] = WAVES[:1]
) -> dict[str, Any]:
    """The small study with a stimulus for each material: `first`, then all waves; arrays are tuples."""
    study = document()
    del study["footstep"]
    names = [one["id"] for one in study["materials"]]
    parts = [first, *(WAVES for _ in names[1:])]
    stimuli = tuple({"material": name, "parts": own} for name, own in zip(names, parts, strict=True))
    study["format"] = 7
    study["presented"] = {
        "set_off": set_off,
        "gap_s": 0.5,
        "pause_s": 0.75,
        "left_out_max": 0.5,
        "stimuli": stimuli,
    }
    task = study["tasks"][0]
    study["tasks"] = ({**task, "kind": "presented", "repetitions": repetitions, "order": {"kind": "blocked-random"}},)
    study["study"] = {**study["study"], "participants": task["participants"]}
    kept = ("undelivered", "withdrawn")
    study["exclusion"] = tuple(rule for rule in study["exclusion"] if rule["when"] in kept)
    study["analysis"] = tuple(one for one in study["analysis"] if one["tasks"] == (task["id"],))
    return study


def protocol(**how: Any) -> Protocol:
    """The protocol of `presenting`."""
    return ProtocolFile.model_validate(presenting(**how))


SITES: tuple[dict[str, Any], ...] = (
    {"name": "palm", "place": "The left palm.", "peak_m_s2": 4.5},
    {"name": "wrist", "place": "The left wrist.", "peak_m_s2": 5.0},
)


def sited(*at: str) -> dict[str, Any]:
    """The small study of `presenting` with its stimuli at sites, in the order of the file."""
    study = presenting()
    stimuli = study["presented"]["stimuli"]
    sites = [at[i % len(at)] for i in range(len(stimuli))]
    placed = tuple({**one, "site": site} for one, site in zip(stimuli, sites, strict=True))
    return {**study, "presented": {**study["presented"], "sites": SITES, "stimuli": placed}}


TRAINING: dict[str, Any] = {"trials": 12, "feedback": True, "criterion": {"right": 4, "of": 5, "unmet": "end"}}

STUDIES: tuple[Protocol, ...] = (
    ProtocolFile.model_validate(changed(presenting(first=(WAVES[0], RECORDED)), ("tasks", 0, "training"), TRAINING)),
)
