"""The study of Okamoto et al. with ratings: its virtual task with three materials, rated by how rough they feel."""

from __future__ import annotations

import tomllib
from typing import Any

from palpate.experiment.protocol.files import ProtocolFile, shipped
from palpate.experiment.protocol.models import Protocol
from tests.experiment.protocol.small import document, with_tuples

MATERIALS = ("copy paper", "polypropylene", "aluminum foil")


def study() -> dict[str, Any]:
    """Tables as in a file: five places, physical magnitudes, every planned test of ratings."""
    made = tomllib.loads(shipped("okamoto2012.toml").read_text("utf-8"))
    (task,) = (one for one in made["tasks"] if one["stimulus"] == "virtual")
    ours = [one for one in made["materials"] if one["id"] in MATERIALS]
    assert len(ours) == len(MATERIALS), [one["id"] for one in made["materials"]]
    planned = [("mean ratings", "Do they differ?"), ("agreement of ratings", "Do participants agree?"),
               ("power law", "By which power does roughness grow?")]  # fmt: skip
    return made | {
        "format": 7,
        "study": made["study"] | {"id": "rated", "participants": task["participants"]},
        "tasks": [task | {"design": "rating", "kind": "footstep", "repetitions": 4}],
        "materials": [{key: value for key, value in one.items() if key not in ("key", "spoken")} for one in ours],
        "answers": made["answers"] | {"microphone": False},
        "exclusion": [rule for rule in made["exclusion"] if rule["when"] != "answers-below"],
        "rating": {
            "quality": "roughness",
            "scale": [
                {"key": str(value), "value": value, **({"label": label} if label else {})}
                for value, label in zip(range(1, 6), ("not at all", "", "", "", "very"), strict=True)
            ],
            "standard": ours[0]["id"],
            "modulus": 2,
            "unit": "m/s^2",
            "magnitudes": [{"material": one["id"], "value": 2.0**place} for place, one in enumerate(ours)],
        },
        "analysis": [{"test": test, "tasks": [task["id"]], "question": question} for test, question in planned],
    }


def protocol(**changed: Any) -> Protocol:
    return ProtocolFile.model_validate(with_tuples(study() | changed))


def _small() -> Protocol:
    made = document()
    materials = tuple({key: one[key] for key in ("id", "description")} for one in made["materials"])
    magnitudes = tuple({"material": one["id"], "value": 1.5 + place} for place, one in enumerate(materials))
    rating = with_tuples(study()["rating"]) | {"standard": "felt", "magnitudes": magnitudes}
    planned = ({"test": "mean ratings", "tasks": ("one",), "question": "Do they differ?"},)
    tasks = tuple(one | {"design": "rating"} for one in made["tasks"])
    changed = {"format": 7, "materials": materials, "rating": rating, "tasks": tasks, "analysis": planned}
    return ProtocolFile.model_validate(made | changed)


STUDIES = (_small(),)
"""It states every key of ratings."""
