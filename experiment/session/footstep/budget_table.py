"""The error budget of a task as `palpate plan` shows it: each cause in percent, and what would lower it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from experiment.apparatus.rig import Rig
from experiment.protocol.models import Protocol
from experiment.session.footstep.fidelity import Fidelity, aim_ms, fidelity, refusal, speeds_mm_s

if TYPE_CHECKING:
    from experiment.synthesis.budget import Budget

CAUSES = (
    ("scene", "left out by the scene", "a wider band, or a lower floor, in [footstep.tactile] of the protocol"),
    ("rate", "output rate", "an actuator.rate_hz of twice the highest frequency recorded"),
    ("band", "band of the response table", "the response of the panel measured at lower and higher frequencies"),
    (
        "held_back",
        "gain limit, highest level",
        "the response measured at higher drive levels, or a higher actuator.shaping.gain_limit_v_per_m_s2",
    ),
    (
        "taken_down",
        "limits of panel and amplifier",
        "a higher full scale, or a higher exposure.vibration_peak_m_s2 where the board approves it",
    ),
    (
        "table",
        "steps of the response table",
        "more frequencies and levels in the table, closest where the response bends",
    ),
    ("rounding", "rounding", "nothing that anybody could feel"),
)
"""Each share of a budget by its field, what it is called, and what would lower it."""

SHOWN = 5e-6
"""A share is shown as a number, and what would lower it is told, from here on: 0.0005 %."""


@dataclass(frozen=True)
class ErrorBudget:
    """How far what a rig plays lies from what is asked for, by material, and how well the onset is known.

    `aims_ms` are the standard errors of contact at each speed when the onset is moved for the last time; None where it
    is not. `refused` says why no participant is run on the rig, empty where they are.
    """

    materials: dict[str, Fidelity]
    aims_ms: tuple[float | None, ...]
    refused: str

    @property
    def speeds_mm_s(self) -> tuple[float, ...]:
        """The speeds of the foot, from the slowest that counts to the fastest."""
        return next(iter(self.materials.values())).speeds_mm_s

    def as_dict(self) -> dict[str, object]:
        """Return everything for JSON; shares are parts of the rms asked for."""
        return {
            "speeds_mm_s": list(self.speeds_mm_s),
            "materials": {
                material: {
                    "speeds": [asdict(b) | {"left_out": b.left_out, "total": b.total} for b in of.budgets],
                    "nearest_material_m_s2": list(of.nearest_m_s2),
                    "other_reading": list(of.other_reading),
                    "interpolation": of.interpolation,
                    "averaging": of.averaging,
                }
                for material, of in self.materials.items()
            },
            "contact_standard_error_ms": list(self.aims_ms),
            "refused": self.refused or None,
        }

    def lines(self) -> list[str]:
        """Return it for a terminal."""
        slowest, *_, fastest = self.speeds_mm_s
        return [
            "error budget: percent (rms) of what equations (1) to (5) ask for, least and most over "
            f"{len(self.speeds_mm_s)} speeds",
            f"from {slowest:.4g} to {fastest:.4g} mm/s",
            *_table([["", *self.materials], *self._causes()]),
            "",
            "beside it, and in no total",
            *_table(self._beside()),
            f"  {self._timing()}",
            "",
            "what would lower it",
            *self._lowered(),
            *(["", f"REFUSED for participants: {self.refused}"] if self.refused else []),
        ]

    def _causes(self) -> list[list[str]]:
        each = list(self.materials.values())
        rows = [[name, *(percent(*one.range(partial(_share, field))) for one in each)] for field, name, _ in CAUSES]
        rows.append(["all of it", *(percent(*one.range(lambda budget: budget.total)) for one in each)])
        return rows

    def _beside(self) -> list[list[str]]:
        each = list(self.materials.values())
        off = [one.range(lambda budget: budget.dissimilarity_m_s2) for one in each]
        rows = [
            ["", *self.materials],
            ["dissimilarity (6) to what was asked for, m/s^2", *(_between(*one, _three) for one in off)],
            ["the same to the most similar material, m/s^2", *(_of(one.nearest_m_s2, _three) for one in each)],
            ["a recorded speed told from its neighbours", *(_most(one.interpolation) for one in each)],
            ["standard error of the mean over takes", *(_most(one.averaging) for one in each)],
        ]
        if each[0].other_reading:
            name = "W interpolated, not A inverted (equation 7)"
            rows.append([name, *(_of(one.other_reading, _percent) for one in each)])
        return rows

    def _timing(self) -> str:
        known = [(v, ms) for v, ms in zip(self.speeds_mm_s, self.aims_ms, strict=True) if ms is not None]
        if not known:
            return "timing: the stimulus sounds after contact, for the onset cannot be scheduled or never in time"
        slow, fast = known[0], known[-1]
        return (
            f"timing: contact has a standard error of {slow[1]:.2f} ms at {slow[0]:.0f} mm/s and {fast[1]:.2f} ms at "
            f"{fast[0]:.0f} mm/s when the onset is moved last"
        )

    def _lowered(self) -> list[str]:
        each = list(self.materials.values())
        told = [
            f"  {name}: {remedy}"
            for field, name, remedy in CAUSES
            if max(one.range(partial(_share, field))[1] for one in each) >= SHOWN
        ]
        if any(one.interpolation is not None for one in each):
            told.append("  speeds and takes: recordings at more speeds, more takes of each")
        return [*told, "  timing: a tracker with less noise or more frames, or a shorter latency of the output"]


def error_budget(*, protocol: Protocol, rig: Rig, rig_folder: Path, recordings: Path) -> ErrorBudget:
    """Return the error budget of a study's recordings on a rig; errors as in `fidelity`."""
    found = fidelity(protocol=protocol, rig=rig, rig_folder=rig_folder, recordings=recordings)
    aims_ms = tuple(aim_ms(protocol, rig, v) for v in speeds_mm_s(protocol))
    return ErrorBudget(found, aims_ms, refusal(protocol, rig, found))


def percent(low: float, high: float) -> str:
    """Return shares from the least to the most, in percent."""
    return _between(low, high, _percent)


def _table(rows: list[list[str]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  " + "  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]


def _share(field: str, budget: Budget) -> float:
    return float(getattr(budget, field))


def _percent(share: float) -> str:
    return "<0.001" if 0 < share < SHOWN else f"{share * 100:.3g}"


def _three(value: float) -> str:
    return "<0.001" if 0 < value < 5e-4 else f"{value:.3g}"


def _of(values: tuple[float, ...], shown: Callable[[float], str]) -> str:
    return _between(min(values), max(values), shown)


def _between(low: float, high: float, shown: Callable[[float], str]) -> str:
    first, last = shown(low), shown(high)
    return first if first == last else f"{first} to {last}"


def _most(share: float | None) -> str:
    return "unknown" if share is None else f"up to {_percent(share)}"
