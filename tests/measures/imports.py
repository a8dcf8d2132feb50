"""How the modules hang together: circles, arrows upward, and the lines of the trunks and of the wings.

A trunk is the module that it begins at, and every module that one of its modules imports, at the top of the file, in a
function or for the type checker alone, with the `__init__.py` of each room on the way. The session trunk begins at
`session/run.py`, which `palpate run` calls for a participant in the room, and at what that looks up by name for a
footstep. It leaves out the rooms of voice, tapping, servo, contact and stepping, and so what only they import.
The analysis trunk begins at `analyse.py`, and at the design of identification with its figures, and leaves nothing out.

A wing is what would leave the source with it. A module is in one wing at most, and in a trunk as well while a module of
the trunk imports it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Set
from dataclasses import dataclass
from typing import Any

from tests.measures import kinds
from tests.measures.source import PACKAGE, Source, is_inside, module_of

Imports = Set[tuple[str, str]]
"""Pairs of modules: the first one imports the second one."""


@dataclass(frozen=True)
class Trunk:
    """Everything that one module imports."""

    root: str
    without: tuple[str, ...] = ()
    """Rooms that do not count, with what only they import."""
    looked_up: tuple[str, ...] = ()
    """Modules of kinds and designs, which are imported by name."""


TRUNKS: Mapping[str, Trunk] = {
    "session": Trunk(
        "experiment/session/run.py",
        without=(
            "experiment/desk/voice",
            "experiment/session/kinds/tapping",
            "experiment/apparatus/servo",
            "experiment/synthesis/contact",
            "experiment/synthesis/stepping",
        ),
        looked_up=(
            "experiment/dataset/kinds/footstep.py",
            "experiment/protocol/designs/identification.py",
            "experiment/protocol/kinds/footstep.py",
            "experiment/session/kinds/footstep/fidelity.py",
            "experiment/session/kinds/footstep/trials.py",
        ),
    ),
    "analysis": Trunk(
        "analysis/analyse.py", looked_up=("analysis/designs/identification.py", "analysis/report/figures.py")
    ),
}

WINGS: Mapping[str, tuple[str, ...]] = {
    **{name: kinds.own_rooms(name) for name in sorted(kinds.NAMES | kinds.DESIGNS)},
    "voice": (
        "experiment/apparatus/audio/microphone.py",
        "experiment/desk/voice",
        "experiment/rehearsal/voice.py",
        "experiment/rehearsal/wires/mouth.py",
    ),
    "servo": (
        "experiment/apparatus/doctor/force.py",
        *(
            f"experiment/apparatus/servo/{name}.py"
            for name in ("budget", "device", "link", "opening", "process", "record", "rendering", "serving")
        ),
        "experiment/rehearsal/wires/force_device.py",
        "experiment/synthesis/contact",
    ),
    "tapping": (*kinds.own_rooms("tapping"), "experiment/synthesis/tap.py"),
    "footstep": (
        "experiment/dataset/kinds/footstep.py",
        "experiment/dataset/kinds/footstep.toml",
        "experiment/protocol/kinds/footstep.py",
        "experiment/protocol/page/kinds/footstep.py",
        *(f"experiment/recordings/{name}.py" for name in ("manifest", "store", "workflow")),
        "experiment/records/kinds/footstep.json",
        "experiment/records/kinds/footstep.py",
        "experiment/records/transcript/footstep.py",
        "experiment/rehearsal/kinds/footstep",
        *(
            f"experiment/session/kinds/footstep/{name}.py"
            for name in (
                "__init__",
                "doctor",
                "error_budget",
                "fidelity",
                "preparation",
                "scene_cost",
                "stimulus",
                "trials",
                "watch",
            )
        ),
    ),
    "panel": (
        "experiment/apparatus/doctor/sensor.py",
        "experiment/apparatus/panel/calibration.py",
        "experiment/apparatus/panel/drift.py",
        "experiment/apparatus/panel/inverse.py",
        "experiment/apparatus/panel/listening.py",
        "experiment/apparatus/panel/measured.py",
        "experiment/apparatus/panel/movement.py",
        "experiment/apparatus/panel/multisine.py",
        "experiment/desk/panel.py",
        "experiment/session/kinds/footstep/felt.py",
        "experiment/synthesis/felt.py",
    ),
    "presented": (
        "experiment/dataset/kinds/presented.py",
        "experiment/protocol/kinds/presented.py",
        "experiment/protocol/page/kinds/presented.py",
        "experiment/records/kinds/presented.json",
        "experiment/records/kinds/presented.py",
        "experiment/records/transcript/presented.py",
        "experiment/rehearsal/kinds/presented",
        "experiment/session/kinds/presented",
        "experiment/synthesis/signals/waves.py",
    ),
    "stepping": ("experiment/synthesis/stepping",),
    "phase": ("experiment/protocol/kinds/phases.py", "experiment/synthesis/signals/phase.py"),
    "ahead": ("experiment/protocol/kinds/ahead.py", "experiment/session/kinds/footstep/ahead.py"),
    "floor": ("experiment/protocol/kinds/floor.py",),
    "weight": ("experiment/apparatus/doctor/foot_force.py", "experiment/apparatus/wires/foot_force.py"),
    "levels": (
        "experiment/protocol/levels.py",
        "experiment/session/kinds/footstep/levels.py",
        "experiment/study/levels",
    ),
    "training": ("experiment/protocol/designs/training.py", "experiment/session/answering/training.py"),
    "triggers": (
        "experiment/apparatus/doctor/triggers.py",
        *(f"experiment/apparatus/wires/{name}.py" for name in ("lsl", "triggers", "ttl")),
    ),
    "own drivers": ("experiment/apparatus/doctor/own.py", "experiment/apparatus/wires/own"),
    "asked": (
        "experiment/dataset/phenotype.py",
        "experiment/protocol/asked",
        "experiment/session/answering/questionnaires.py",
        "experiment/study/people/facts.py",
    ),
    "tap fit": ("experiment/cli/tap.py", "experiment/recordings/tap_fit.py"),
    "imports": ("experiment/dataset/imports",),
    "identification": (
        "analysis/identification",
        "analysis/designs/identification.json",
        "analysis/designs/identification.py",
        *(
            f"analysis/report/{name}.py"
            for name in (
                "companion_tables",
                "figures",
                "found",
                "identification_sections",
                "played_section",
                "sections",
            )
        ),
    ),
    "audit": (
        *(
            f"analysis/audit/{name}"
            for name in (
                "__init__.py",
                "about.md",
                "audit.py",
                "bounds.py",
                "causes.py",
                "checks.py",
                "evidence.py",
                "intervals.py",
                "mistakes.py",
                "print_lines.py",
            )
        ),
        "analysis/published/paper.py",
    ),
    "prose": ("analysis/audit/sentences.py", "analysis/published/prose.py"),
    "power": ("analysis/power",),
    "numerics": ("analysis/numerics",),
    "validation": ("analysis/validation",),
}
"""The rooms and modules of each, of a kind or a design those of its name unless others are named here: `servo` with
contact, `footstep` with recordings, `audit` with papers, `prose` with what reads their sentences."""


def trunk_modules(trunk: Trunk, imports: Imports) -> set[str]:
    """Return the modules of a trunk."""
    left_out = tuple(module_of(room) for room in trunk.without)
    onward: dict[str, set[str]] = {}
    for one, other in imports:
        if not any(f"{other}.".startswith(f"{room}.") for room in left_out):
            onward.setdefault(one, set()).add(other)
    roots = [module_of(path) for path in (trunk.root, *trunk.looked_up)]
    return {
        room for root in roots for module in {root} | _reachable(root, onward) for room in _module_and_rooms(module)
    }


def _module_and_rooms(module: str) -> Iterable[str]:
    parts = module.split(".")
    return (".".join(parts[:end]) for end in range(1, len(parts) + 1))


def wing_lines(rooms: Iterable[str], sources: Iterable[Source]) -> int:
    """Return the number of lines in the rooms and modules of a wing."""
    rooms = tuple(rooms)
    return sum(source.lines for source in sources if is_inside(source.path, rooms))


def circles(imports: Imports) -> set[str]:
    """Return every set of modules of which each leads to each other one by its imports."""
    onward: dict[str, set[str]] = {}
    for one, other in imports:
        onward.setdefault(one, set()).add(other)
    reached = {module: _reachable(module, onward) for module in onward}
    return {
        ", ".join(sorted({one} | {other for other in reached[one] if one in reached.get(other, set())}))
        for one in onward
        if one in reached[one]
    }


def _reachable(module: str, onward: Mapping[str, set[str]]) -> set[str]:
    found: set[str] = set()
    ahead = list(onward.get(module, ()))
    while ahead:
        if (one := ahead.pop()) not in found:
            found.add(one)
            ahead += onward.get(one, ())
    return found


def upward_imports(imports: Imports, contracts: Iterable[Mapping[str, Any]]) -> set[str]:
    """Return the imports from a room to a higher one, or to one beside it, by the contracts of import-linter."""
    floor: dict[str, int] = {}
    beside: set[tuple[str, str]] = set()
    for contract in contracts:
        if contract["type"] == "layers":
            (package,) = contract["containers"]
            for number, layer in enumerate(contract["layers"]):
                names = [f"{package}.{name.strip(' ()')}" for name in layer.replace(":", "|").split("|")]
                floor |= dict.fromkeys(names, number)
                if "|" in layer:
                    beside |= {(one, other) for one in names for other in names if one != other}

    def room(module: str) -> str:
        return ".".join(module.split(".")[: PACKAGE.count(".") + 3])

    return {
        f"{one} -> {other}"
        for one, other in imports
        if room(one).rpartition(".")[0] == room(other).rpartition(".")[0]
        if room(one) in floor and room(other) in floor
        if floor[room(other)] < floor[room(one)] or (room(one), room(other)) in beside
    }
