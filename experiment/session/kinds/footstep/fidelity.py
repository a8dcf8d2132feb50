"""What a rig makes of a study's recordings: the error budget of each material at the speeds that count.

`palpate plan` shows it; sessions, `palpate check` and `palpate doctor` refuse a rig that leaves out more than the
protocol allows. It measures what a session would hand over; voltages are shaped for each speed
(`synthesis/voltages.py`).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from functools import partial
from importlib import import_module
from math import inf, sqrt
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from palpate.experiment.apparatus.panel.validity import refuse_unmeasured
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.errors import Finding, Remedy, RigError
from palpate.experiment.protocol.kinds.footstep import Footstep
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.session import scene as scenes
from palpate.experiment.session.kinds.footstep import preparation

if TYPE_CHECKING:
    from palpate.experiment.apparatus.panel.conditioning import Played
    from palpate.experiment.synthesis.budget import Budget
    from palpate.experiment.synthesis.crinkle import CrinkleSpectra

AHEAD = "palpate.experiment.session.kinds.footstep.ahead"

SPEEDS = 10
"""At so many speeds of the foot, evenly spaced by ratio, and at those recorded, where the spectra bend."""

BEYOND = 1.5
"""Where a protocol counts a foot of any speed: from the slowest recorded divided by this to this times the fastest."""


@dataclass(frozen=True)
class Fidelity:
    """The budgets of one material at each speed, mm/s."""

    speeds_mm_s: tuple[float, ...]
    budgets: tuple[Budget, ...]


def speeds_mm_s(protocol: Protocol) -> tuple[float, ...]:
    """Return speeds from the slowest to the fastest foot that a protocol counts, mm/s."""
    recorded, fastest = protocol.table(Footstep).synthesis.speeds_mm_s, preparation.fastest_mm_s(protocol)
    slow = [rule.limit for rule in protocol.exclusion if rule.when == "speed-below" and rule.limit]
    slowest = max(slow, default=recorded[0] / BEYOND)
    fastest = recorded[-1] * BEYOND if fastest == inf else max(fastest, slowest)
    bends = (v for v in recorded if slowest <= v <= fastest)
    return tuple(sorted({*np.geomspace(slowest, fastest, SPEEDS).tolist(), *bends}))


def played(
    spectra: dict[str, CrinkleSpectra], *, protocol: Protocol, rig: Rig, rig_folder: Path
) -> dict[str, list[Played]]:
    """Return what a rig is handed of each material at each of `speeds_mm_s`, by the material's id.

    Raises `RigError` for the response tables.
    """
    from palpate.experiment.apparatus.panel.conditioning import open_conditioner, open_drive

    limit_m_s2, actuator = protocol.exposure.vibration_peak_m_s2, rig.actuator
    drive = open_drive(rig_folder, actuator, limit_m_s2=limit_m_s2)
    condition = open_conditioner(rig, limit_m_s2=limit_m_s2, drive=drive)
    prepared = preparation.prepare_stimuli(spectra, protocol=protocol, output_rate_hz=actuator.rate_hz)
    speeds = speeds_mm_s(protocol)
    return {material: [condition(basis.at(v)) for v in speeds] for material, basis in prepared.items()}


def fidelity(
    *, scene: scenes.Scene, protocol: Protocol, rig: Rig, rig_folder: Path, recordings: Path
) -> dict[str, Fidelity]:
    """Return the fidelity of each material that a scene plays, by its id.

    Raises `RecordingError` for a missing or unusable recording, and as `played`.
    """
    spectra = preparation.load_spectra(scene=scene, protocol=protocol, recordings=recordings)
    every = played(spectra, protocol=protocol, rig=rig, rig_folder=rig_folder)
    speeds = speeds_mm_s(protocol)
    return {material: Fidelity(speeds, tuple(one.budget()[0] for one in each)) for material, each in every.items()}


def carried_hz(rig: Rig, rig_folder: Path) -> tuple[float, float] | None:
    """Return the range in which a rig's panel was measured, Hz, if it was. Raises `RigError` or `RecordingError`."""
    from palpate.experiment.apparatus.panel.conditioning import INVERSE
    from palpate.experiment.apparatus.panel.response_table import parse
    from palpate.experiment.apparatus.rig import response_table

    if rig.actuator.inverse_ahead_ms is not None:
        low_hz, high_hz = import_module(INVERSE).BAND_HZ
        return low_hz, high_hz
    if (shaping := rig.actuator.shaping) is None:
        return rig.actuator.carries_hz
    measured = parse(rig_folder / shaping.response, response_table(rig_folder, shaping)).frequencies_hz
    return float(measured[0]), float(measured[-1])


def judged(
    *, protocol: Protocol, rig: Rig, rig_folder: Path, recordings: Path, task_ids: Collection[str] | None = None
) -> str:
    """Return in words the most that a rig leaves out of what these tasks, or all, present.

    Raises `RigError` for more than the protocol allows of any task, and otherwise as `fidelity`.
    """
    carries_hz = carried_hz(rig, rig_folder)
    of = None if protocol.table(Footstep).synthesis.left_out_max is not None else task_ids
    given = partial(fidelity, protocol=protocol, rig=rig, rig_folder=rig_folder, recordings=recordings)
    worst = most_left_out([given(scene=one) for one in scenes.played(protocol, of)], carries_hz)
    if (refused := refusal(protocol, rig, worst, carries_hz)) is not None:
        raise RigError.at(refused)
    return worst.sentence(carries_hz, recordings)


def judge(
    *, protocol: Protocol, rig: Rig, rig_file: Path, recordings: Path, task_ids: Collection[str], today: date
) -> str:
    """Return what `judged` says of a rig for tasks. Raises `RigError` too for a panel that was not measured lately."""
    refuse_unmeasured(rig_file, rig, today)
    return judged(protocol=protocol, rig=rig, rig_folder=rig_file.parent, recordings=recordings, task_ids=task_ids)


UNKNOWN = "the frequencies that its actuator carries were not measured"


@dataclass(frozen=True)
class MostLeftOut:
    """The largest share (rms) that a rig leaves out of any vibration: in words, and by remedy what that would lower.

    What of a vibration is left is `weaker` besides, in words, where limits take it down, or off where an inverse misses
    some of it; empty where neither is so.
    """

    share: float
    told: str
    remedies: tuple[tuple[str, float], ...]
    weaker: str

    def sentence(self, carries_hz: tuple[float, float] | None, recordings: Path) -> str:
        """Return in words the most that is left out of these recordings, and whether it is known what is carried."""
        from palpate.experiment.recordings import manifest

        known = f"at most {self.told} is left out" if self.share >= SHOWN else "nothing is left out"
        known += " of these SIMULATED recordings" if manifest.is_simulated(recordings) else ""
        known += f"; {self.weaker}" if self.weaker else ""
        return known if carries_hz else f"{UNKNOWN}; if it carries all frequencies, {known}"


def most_left_out(fidelities: Sequence[Mapping[str, Fidelity]], carries_hz: tuple[float, float] | None) -> MostLeftOut:
    """Return what a rig leaves out at most of the materials of scenes, at any speed that counts, and by what."""
    every = [
        (each, v, material)
        for found in fidelities
        for material, of in found.items()
        for v, each in zip(of.speeds_mm_s, of.budgets, strict=True)
    ]
    budget, speed_mm_s, material = max(every, key=lambda one: one[0].left_out)
    down, at_mm_s, of_material = max(every, key=lambda one: one[0].taken_down)
    off, off_mm_s, off_material = max(every, key=lambda one: one[0].inverse)
    taken = f"{down.taken_down:.1%} (rms) of {of_material} at {at_mm_s:.0f} mm/s"
    missed = f"{off.inverse:.1%} (rms) of {off_material} at {off_mm_s:.0f} mm/s, has a gain of {off.gain:.3g} at "
    missed += f"{off.gain_hz:.0f} Hz, and moves the panel by {off.before:.1%} before onset"
    said = [f"the limits of the panel and amplifier remove up to {taken}"] if down.taken_down >= WEAKER else []
    said += [f"the inverse of the panel's response misses up to {missed}"] if off.inverse >= WEAKER else []
    weaker = "; ".join(said)
    if budget.left_out < SHOWN:
        return MostLeftOut(budget.left_out, "nothing", (), weaker)
    parts = [(float(getattr(budget, field)), name, remedy) for field, name, remedy in causes(carries_hz)[:LEAVING_OUT]]
    counting = [part for part in parts if part[0] >= max(parts)[0] / 2]
    why = ", ".join(f"{share:.0%} {name}" for share, name, _ in counting)
    told = f"{budget.left_out:.2%} (rms) of {material} at {speed_mm_s:.0f} mm/s ({why})"
    return MostLeftOut(budget.left_out, told, tuple((remedy, share) for share, _, remedy in counting), weaker)


def refusal(protocol: Protocol, rig: Rig, worst: MostLeftOut, carries_hz: tuple[float, float] | None) -> Finding | None:
    """Return why no participant is run on a rig that leaves out so much, or is late; None where both are allowed."""
    most = protocol.table(Footstep).synthesis.left_out_max
    if most is None or (worst.share <= most and carries_hz is not None):
        ahead = any(task.ahead for task in protocol.tasks)
        return cast("Finding | None", import_module(AHEAD).refusal(protocol, rig)) if ahead else None
    what = UNKNOWN
    remedy: Remedy | str = "measure the panel, and write actuator.low_hz and high_hz into the rig file"
    if worst.share > most:
        what = f"got {worst.told} left out"
        plan = ("palpate", "plan", "PROTOCOL", "--rig", "RIG", "--recordings", "FOLDER")
        remedy = Remedy(f"use {_remedy(worst, most)}; {{}} shows the whole budget", plan, suffices=False)
    allowed = f"{most * 100:.6g}% (footstep.synthesis.left_out_max)"
    return Finding(what, f"rig '{rig.rig.name}'", allowed=allowed, remedy=remedy)


def _remedy(worst: MostLeftOut, most: float) -> str:
    """Return each remedy that is enough for the vibration of which most is left out, or all where none is."""
    alone = [(remedy, sqrt(max(worst.share**2 - share**2, 0.0))) for remedy, share in worst.remedies]
    if enough := [f"{remedy} (this leaves out {rest:.2%})" for remedy, rest in alone if rest <= most]:
        return ", or ".join(enough)
    rest = sqrt(max(worst.share**2 - sum(share**2 for _, share in worst.remedies), 0.0))
    return f"{' and '.join(remedy for remedy, _ in alone)} (this leaves out {rest:.2%})"


LEAVING_OUT = 5
"""So many of the causes, the first, leave something out; the others change all of a stimulus."""


def causes(carries_hz: tuple[float, float] | None) -> tuple[tuple[str, str, str], ...]:
    """Return each share of a budget by its field, what it is called, and what would lower it."""
    low, high = [f"{end:g} Hz" for end in carries_hz] if carries_hz else ["band, unknown"] * 2
    return (
        ("scene", "left out by the scene", "a wider band, or a lower floor, in [footstep.tactile] of the protocol"),
        ("rate", "output rate", "an actuator.rate_hz at least twice the highest recorded frequency"),
        ("below", f"below the rig's {low}", f"a panel that carries, and was measured at, frequencies below {low}"),
        ("above", f"above the rig's {high}", f"a panel that carries, and was measured at, frequencies above {high}"),
        ("held_back", "gain limit, highest level", "higher drive levels measured, or a higher gain_limit_v_per_m_s2"),
        (
            "taken_down",
            "limits of panel and amplifier",
            "a higher full scale or, if the board approves, a higher vibration limit",
        ),
        ("inverse", "missed by the inverse", "a longer actuator.inverse_ahead_ms"),
        ("table", "steps of the response table", "more frequencies and levels, closest where the response bends"),
        ("rounding", "rounding", "nothing: it is too small to feel"),
    )


WEAKER = 1e-3
"""What limits take off is told beside what is left out from this share on."""

SHOWN = 5e-6
"""A share is shown as a number, and what would lower it is told, from here on: 0.0005 %."""
