"""Protocol files of formats 2 and 3 as newer ones have them, and back for their canonical form.

There a task named its kind alone, which stood for its design too: `comparison` was tapping. `[comparison.virtual]` said
how surfaces are rendered, and each of `[[materials]]` how it rings.
"""

from collections.abc import Mapping
from typing import Any

from palpate.experiment.protocol.kinds import list_at, table_at
from palpate.experiment.settings.load import Table
from palpate.experiment.storage import Place

RINGS = ("attack_hz", "amplitude")

TASKS = {
    "comparison": {"kind": "tapping", "design": "comparison"},
    "footstep": {"kind": "footstep", "design": "identification"},
}
"""What a task has instead of its kind."""


def renewed(table: Table) -> Table:
    """Return a document of an older format as one of format 4; what is not as it was then stays as it is."""
    tasks = tuple(_task(one) for one in list_at(table, "tasks"))
    made = {**table, "tasks": tasks} if tasks else table
    comparison = table_at(table, "comparison")
    if "virtual" not in comparison:
        return made
    virtual, every = comparison["virtual"], list_at(table, "materials")
    materials = [one for one in every if isinstance(one, Mapping)]
    rings = [{"material": one.get("id")} | {key: one[key] for key in RINGS if key in one} for one in materials]
    if isinstance(virtual, Mapping) and any(len(ring) > 1 for ring in rings):
        virtual = {**virtual, "surfaces": tuple(rings)}
    return {
        **made,
        "comparison": {key: value for key, value in comparison.items() if key != "virtual"},
        "tapping": virtual,
        "materials": tuple(_without_rings(one) for one in every) if every else table.get("materials"),
    }


def _task(task: Any) -> Any:
    kind = task.get("kind") if isinstance(task, Mapping) else None
    return {**task, **TASKS[kind]} if isinstance(kind, str) and kind in TASKS else task


def _without_rings(material: Any) -> Any:
    if not isinstance(material, Mapping):
        return material
    return {key: value for key, value in material.items() if key not in RINGS}


def stated(place: Place, _: Table) -> Place:
    """Return where a document of an older format states what stands at `place` of the renewed one."""
    match place:
        case ("tapping", "surfaces", int(i), "material"):
            return ("materials", i, "id")
        case ("tapping", "surfaces", *rest):
            return ("materials", *rest)
        case ("tapping", *rest):
            return ("comparison", "virtual", *rest)
        case ("tasks", i, "design"):
            return ("tasks", i, "kind")
    return place


LATER = ("surfaces", "force_error_max")
"""Keys of `[tapping]` that `[comparison.virtual]` had not."""


def restore(document: dict[str, Any]) -> None:
    """Put back into the plain form of a protocol what its older format has elsewhere; it loses no key."""
    tapping, kinds = document["tapping"], {own["kind"]: kind for kind, own in TASKS.items()}
    rings = {one["material"]: one for one in tapping["surfaces"]} if tapping else {}
    for material in document["materials"]:
        material |= {key: rings.get(material["id"], {}).get(key) for key in RINGS}
    for task in document["tasks"]:
        task["kind"] = kinds.get(task["kind"], task["kind"])
    if document["comparison"] is not None:
        virtual = {key: value for key, value in tapping.items() if key not in LATER} if tapping else None
        document["comparison"]["virtual"] = virtual
