"""A small valid protocol of comparisons, so that tests do not change when a published one does."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from palpate.experiment.protocol.files import ProtocolFile, shipped
from palpate.experiment.protocol.models import Protocol
from tests.experiment.protocol.small import changed, document


def comparing(*, repetitions: int = 2, order: str = "full-random", tie_key: str | None = None) -> dict[str, Any]:
    """Three materials, whose 6 pairs are each presented so often, as tables with arrays as tuples."""
    study = document()
    del study["footstep"]
    task = study["tasks"][0]
    study["materials"] = tuple({"id": name, "description": f"Piece of {name}."} for name in ("felt", "cork", "tin"))
    study["comparison"] = {"quality": "hardness", "first_key": "1", "second_key": "2"}
    if tie_key is not None:
        study["comparison"]["tie_key"] = tie_key
    kept = {key: task[key] for key in ("participants", "familiarisation", "instruction", "title")}
    live = {
        "id": "live",
        "kind": "tapping",
        "design": "comparison",
        "stimulus": "real",
        "repetitions": repetitions,
        "order": {"kind": order},
    }
    study["tasks"] = ({**kept, **live},)
    study["exclusion"] = tuple(rule for rule in study["exclusion"] if rule["when"] == "withdrawn")
    tests = ("Davidson",) if tie_key is not None else ("Bradley-Terry", "Thurstone")
    study["analysis"] = tuple({"test": test, "tasks": ("live",), "question": "How far apart?"} for test in tests)
    return study


def rendering() -> dict[str, Any]:
    """The same with virtual surfaces."""
    study = comparing()
    task = study["tasks"][0]
    study["tasks"] = ({**task, "id": "virtual", "stimulus": "virtual"},)
    study["analysis"] = tuple({**one, "tasks": ("virtual",)} for one in study["analysis"])
    rings = ((60.0, 0.1), (200.0, 0.2), (900.0, 0.5))
    study["exposure"] = {**study["exposure"], "force_peak_n": 2.0}
    study["tapping"] = {
        "switch_key": "s",
        "rate_hz": 2000,
        "stiffness_n_m": 800.0,
        "damping_n_s_m": 5.0,
        "full_m_s2": 40.0,
        "decay_per_s": 100.0,
        "fastest_mm_s": 175.0,
        "surfaces": tuple(
            {"material": one["id"], "attack_hz": hz, "amplitude": part}
            for one, (hz, part) in zip(study["materials"], rings, strict=True)
        ),
    }
    return study


def live_alone(folder: Path) -> Path:
    """Write the shipped study with its live task alone, which needs no device; return the file."""
    text = shipped("wellman1995.toml").read_text("utf-8")
    begin, end = text.index('[[tasks]]\nid = "virtual"'), text.index("# Exclusion rules")
    file = folder / "live.toml"
    file.write_text((text[:begin] + text[end:]).replace('["live", "virtual"]', '["live"]'), "utf-8")
    return file


def protocol(**how: Any) -> Protocol:
    """The protocol of `comparing`."""
    return ProtocolFile.model_validate(comparing(**how))


def varied(key: str, *values: float) -> dict[str, Any]:
    """The same, each surface with a number of its own."""
    study = rendering()
    surfaces = zip(study["tapping"]["surfaces"], values, strict=True)
    study["tapping"]["surfaces"] = tuple({**one, key: value} for one, value in surfaces)
    return study


def delayed(*delays_ms: float) -> dict[str, Any]:
    """The same, each surface with its delay."""
    return varied("delay_ms", *delays_ms)


_MOVED = changed(delayed(-20.0, 0.0, 50.0), ("tapping", "mass_kg"), 2.0)
CROSSED = ProtocolFile.model_validate(varied("crossover_hz", 30.0, 60.0, 120.0))
STUDIES = (
    protocol(tie_key="3"),
    ProtocolFile.model_validate(changed(_MOVED, ("tapping", "force_error_max"), 0.5)),
    CROSSED,
)
"""Together they state every key of taps and of comparisons."""
