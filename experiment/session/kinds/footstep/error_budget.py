"""The error budget of a rig, as `palpate plan` prints it: each cause at each speed, and how well an onset is known."""

from __future__ import annotations

import textwrap
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from importlib import import_module
from operator import attrgetter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus.panel.validity import simulated_table
from palpate.experiment.apparatus.rig import Rig, tracker_of
from palpate.experiment.apparatus.tracker.landing import NOISE_MM, LandingPredictor
from palpate.experiment.protocol.kinds.footstep import Footstep
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.recordings import manifest
from palpate.experiment.session import scene as scenes
from palpate.experiment.session.kinds.footstep import preparation, sampling
from palpate.experiment.session.kinds.footstep.felt import FELT, FELT_ROWS, felt_on, gain_sentence
from palpate.experiment.session.kinds.footstep.fidelity import (
    SHOWN,
    UNKNOWN,
    Fidelity,
    MostLeftOut,
    carried_hz,
    causes,
    fidelity,
    most_left_out,
    played,
    refusal,
    speeds_mm_s,
)
from palpate.experiment.synthesis.budget import Budget, other_reading
from palpate.experiment.synthesis.crinkle import CrinkleSpectra, at_speed
from palpate.experiment.synthesis.felt import Felt
from palpate.experiment.synthesis.signals.dissimilarity import dissimilarity
from palpate.experiment.synthesis.spectra import bin_frequencies_hz

WATCHED_US = 4_000_000
"""So much of a slow foot's way is enough to know how well it is predicted, microseconds."""


def aim_ms(protocol: Protocol, rig: Rig, speed_mm_s: float, ahead_ms: float = 0.0) -> float | None:
    """Return the predictor's standard error of contact at the last move of an onset so long before it, ms, if any."""
    if rig.actuator.driver != "audio" or rig.audio is None:
        return None
    step, tracker = protocol.table(Footstep).step, tracker_of(rig)
    predictor = LandingPredictor(step, noise_mm=NOISE_MM if tracker.noise_mm is None else tracker.noise_mm)
    lead_us = (rig.audio.latency.output_ms + (rig.actuator.inverse_ahead_ms or 0.0) + ahead_ms) * 1e3
    lead_us += 2e6 * rig.audio.block / rig.audio.rate_hz
    last_us = int(min((step.gate_top_mm - step.contact_mm) / speed_mm_s * 1e6 - lead_us, 1e15))
    state, found = predictor.init(), None
    for us in range(max(0, last_us - WATCHED_US), last_us, round(1e6 / tracker.rate_hz)):
        height_mm = step.gate_top_mm - speed_mm_s * us / 1e6
        state = predictor.step(state, us, height_mm)
        landing = predictor.landing(state) if state is not None and height_mm <= step.gate_bottom_mm else None
        found = found if landing is None else landing.standard_error_us / 1e3
    return found


@dataclass(frozen=True)
class Detailed(Fidelity):
    """Budgets with further shares of the rms requested.

    `nearest_m_s2` is the dissimilarity (6) to the most similar other material of the scene at each speed, empty without
    one. `other_reading` is that of equation (7), empty for accelerations. `interpolation` and `averaging` are the
    largest over the speeds recorded; None for too few speeds or takes. `felt` is what a measured panel makes of each
    stimulus, empty for one that nobody measured; `profile` that of `signals.phase.profile_error`, empty without one.
    """

    nearest_m_s2: tuple[float, ...]
    other_reading: tuple[float, ...]
    interpolation: float | None
    averaging: float | None
    felt: tuple[Felt, ...] = ()
    profile: tuple[float | None, ...] = ()

    def range(self, of: Callable[[Budget], float]) -> tuple[float, float]:
        """Return the least and the most of a value of the budgets over the speeds."""
        values = [of(one) for one in self.budgets]
        return min(values), max(values)


def detailed(
    *, scene: scenes.Scene, protocol: Protocol, rig: Rig, rig_folder: Path, recordings: Path
) -> dict[str, Detailed]:
    """Return what `fidelity` does, in detail."""
    spectra = preparation.load_spectra(scene=scene, protocol=protocol, recordings=recordings)
    taken = manifest.load(recordings, synthesis=protocol.table(Footstep).synthesis, material_ids=scene.materials)
    found, speeds = {}, speeds_mm_s(protocol)
    every = played(spectra, protocol=protocol, rig=rig, rig_folder=rig_folder)
    felt = felt_on(every, rig=rig, rig_folder=rig_folder)
    for material, each in every.items():
        budgets = [one.budget() for one in each]
        found[material] = Detailed(
            speeds,
            tuple(budget for budget, _ in budgets),
            nearest_m_s2=tuple(_nearest_m_s2(material, spectra, v) for v in speeds) if len(spectra) > 1 else (),
            other_reading=tuple(
                other_reading(one.stimulus, shaped=shaped, response=one.drive.response)
                for one, (_, shaped) in zip(each, budgets, strict=True)
                if shaped is not None and one.drive is not None
            ),
            interpolation=_most(sampling.interpolation(spectra[material])),
            averaging=_most(
                sampling.averaging(
                    spectra[material], panel_object_takes=taken.objects[material], panel_takes=taken.panel
                )
            ),
            felt=felt[material],
            profile=import_module(preparation.PHASE).profile_error(spectra[material]) if scene.phase else (),
        )
    return found


def _nearest_m_s2(material: str, spectra: dict[str, CrinkleSpectra], speed_mm_s: float) -> float:
    own = spectra[material]
    f = bin_frequencies_hz(bins=own.samples, rate_hz=own.rate_hz)[1:]
    at = {name: at_speed(of, speed_mm_s=speed_mm_s).coefficients[1:] for name, of in spectra.items()}
    return min(
        float(dissimilarity(at[material], other, frequencies_hz=f)) for name, other in at.items() if name != material
    )


def _most(shares: NDArray[np.float64]) -> float | None:
    """Return the largest share that is known."""
    known = shares[np.isfinite(shares)]
    return float(known.max()) if known.size else None


@dataclass(frozen=True)
class ErrorBudget:
    """How far what a rig plays lies from what is asked for, by material, and how well the onset is known.

    `aims_ms` are the standard errors of contact at each speed when the onset is moved for the last time; None where it
    is not. `carries_hz` is the band that the rig was measured in, None where it never was, and `schedules` says whether
    its actuator can be told when to begin. `refused` says why no participant is run on the rig, empty where they are.
    A stimulus begins `ahead_ms` before contact.
    """

    materials: dict[str, Detailed]
    aims_ms: tuple[float | None, ...]
    carries_hz: tuple[float, float] | None
    schedules: bool | None
    refused: str
    ahead_ms: float = 0.0

    @property
    def most_left_out(self) -> MostLeftOut:
        """What the rig leaves out at most."""
        return most_left_out([self.materials], self.carries_hz)

    @property
    def speeds_mm_s(self) -> tuple[float, ...]:
        """The speeds of the foot, from the slowest that counts to the fastest."""
        return next(iter(self.materials.values())).speeds_mm_s

    def as_dict(self) -> dict[str, object]:
        """Return everything for JSON; shares are parts of the rms asked for."""
        return {
            "speeds_mm_s": list(self.speeds_mm_s),
            "materials": {
                material: asdict(of) | {name: [getattr(b, name) for b in of.budgets] for name in ("left_out", "total")}
                for material, of in self.materials.items()
            },
            "contact_standard_error_ms": list(self.aims_ms),
            "ahead_ms": self.ahead_ms,
            "carries_hz": self.carries_hz,
            "assumes": ASSUMED if self._takes_volts else None,
            "refused": self.refused or None,
        }

    @property
    def _takes_volts(self) -> bool:
        return any(of.other_reading for of in self.materials.values())

    @property
    def _inverted(self) -> bool:
        return any(one.gain for of in self.materials.values() for one in of.budgets)

    @property
    def _is_measured(self) -> bool:
        return any(of.felt for of in self.materials.values())

    def lines(self) -> list[str]:
        """Return it for a terminal."""
        slowest, *_, fastest = self.speeds_mm_s
        unknown = f"  {UNKNOWN[0].upper()}{UNKNOWN[1:]}: the budget assumes it carries all frequencies."
        return [
            f"error budget: percent (rms) of equations (1) to (5), range across {len(self.speeds_mm_s)} speeds",
            f"from {slowest:.4g} to {fastest:.4g} mm/s",
            *_table([["", *self.materials], *self._causes()]),
            *(wrapped(unknown) if self.carries_hz is None else []),
            *(wrapped(f"  {ASSUMED}") if self._takes_volts else []),
            "",
            "reported separately, not in the total",
            *_table(self._companion_rows()),
            *wrapped(f"  {BESIDE}"),
            *(wrapped(f"  {FELT}") if self._is_measured else []),
            *(wrapped(f"  {gain_sentence(next(iter(self.materials.values())).budgets[0])}") if self._inverted else []),
            *wrapped(f"  {self._timing()}"),
            "",
            "what would lower it",
            *(line for told in self._lowered() for line in wrapped(f"  {told}")),
        ]

    def _causes(self) -> list[list[str]]:
        each = list(self.materials.values())
        rows = [
            [name, *(percent(*one.range(attrgetter(field))) for one in each)]
            for field, name, _ in causes(self.carries_hz)
            if field != "inverse" or self._inverted
        ]
        rows.append(["total", *(percent(*one.range(attrgetter("total"))) for one in each)])
        return rows

    def _companion_rows(self) -> list[list[str]]:
        each = list(self.materials.values())
        off = [one.range(attrgetter("dissimilarity_m_s2")) for one in each]
        rows = [
            ["", *self.materials],
            ["from the request, (6)", *(_range_words(*one, "{:.3g}".format) for one in off)],
            ["from the nearest material, (6)", *(_range_of(one.nearest_m_s2, "{:.3g}".format) for one in each)],
            ["a speed from its neighbors", *(_up_to(one.interpolation) for one in each)],
            ["standard error across takes", *(_up_to(one.averaging) for one in each)],
        ]
        rows += sampling.profile_rows([one.profile for one in each], _up_to)
        if self._takes_volts:
            rows.append(["W interpolated, (7)", *(_range_of(one.other_reading, _percent) for one in each)])
        if self._inverted:
            rows.append(["before onset, by the inverse", *(percent(*one.range(attrgetter("before"))) for one in each)])
        if self._is_measured:
            for name, value, shown in FELT_ROWS:
                rows.append([name, *(_range_of(tuple(map(value, one.felt)), shown) for one in each)])
        return rows

    def _timing(self) -> str:
        known = [(v, ms) for v, ms in zip(self.speeds_mm_s, self.aims_ms, strict=True) if ms is not None]
        if not known and self.schedules is None:
            return f"timing: unknown; {OWN}; without lead_s the stimulus starts after contact"
        if not known:
            why = (
                "its onset can never be scheduled in time"
                if self.schedules
                else "this actuator cannot start at a set time"
            )
            return f"timing: the stimulus starts only after contact, because {why}"
        slow, fast = known[0], known[-1]
        early = f", {self.ahead_ms:g} ms before it," if self.ahead_ms else ""
        return (
            f"timing: contact has a standard error of {slow[1]:.2f} ms at {slow[0]:.0f} mm/s and {fast[1]:.2f} ms at "
            f"{fast[0]:.0f} mm/s when the onset{early} is last updated"
        )

    def _lowered(self) -> list[str]:
        each = list(self.materials.values())
        told = [
            f"{name}: {remedy}"
            for field, name, remedy in causes(self.carries_hz)
            if max(one.range(attrgetter(field))[1] for one in each) >= SHOWN
        ]
        if any(one.interpolation is not None for one in each):
            told.append("speeds and takes: recordings at more speeds, and more takes at each")
        if self.schedules is None:
            return [*told, f"timing: a driver that states lead_s ({OWN})"]
        if not self.schedules:
            return [*told, "timing: an actuator on a channel of the audio device, which can start at a set time"]
        return [*told, "timing: a tracker with less noise or a higher frame rate, or a shorter output latency"]


def error_budget(*, task_id: str, protocol: Protocol, rig: Rig, rig_folder: Path, recordings: Path) -> ErrorBudget:
    """Return the error budget of what a task plays on a rig, refused for any task; errors as in `fidelity`."""
    carries_hz = carried_hz(rig, rig_folder)
    own = scenes.plan(protocol=protocol, task_id=task_id)
    found = detailed(scene=own, protocol=protocol, rig=rig, rig_folder=rig_folder, recordings=recordings)
    given = partial(fidelity, protocol=protocol, rig=rig, rig_folder=rig_folder, recordings=recordings)
    others = [one for one in scenes.played(protocol) if (one.materials, one.phase) != (own.materials, own.phase)]
    worst = most_left_out([found, *(given(scene=one) for one in others)], carries_hz)
    ahead_ms = 0.0 if (ahead := protocol.task(task_id).ahead) is None else -ahead.delay_ms
    aims_ms = tuple(aim_ms(protocol, rig, v, ahead_ms) for v in speeds_mm_s(protocol))
    schedules = None if ":" in rig.actuator.driver else rig.actuator.driver == "audio"
    refused = simulated_table(f"rig '{rig.rig.name}'", rig_folder, rig) or refusal(protocol, rig, worst, carries_hz)
    return ErrorBudget(found, aims_ms, carries_hz, schedules, refused.sentence() if refused else "", ahead_ms)


OWN = "`palpate doctor` shows this driver's lead_s"
"""What is said of an actuator behind a driver of one's own, which a plan does not run."""

WIDTH = 100
"""No line of a plan is wider, in characters."""

BESIDE = (
    "(6) is the dissimilarity in m/s^2 from the request and from the most similar material. The other rows are in "
    "percent: the error when a recorded speed is interpolated from its two neighbors, the standard error of the mean "
    "across takes, and the error when W is interpolated instead of inverting A, equation (7)."
)
"""What the lines beside a budget are."""

ASSUMED = (
    "Equation (7) and this budget assume that the panel responds to each frequency independently, with a real-valued "
    "gain; phase is ignored. On a simulated panel with the same gains and minimum phase, vibrations were off by 99 "
    "to 178 % (rms), and by up to 10 dB in a third octave."
)
"""What the error of shaping leaves out, with what `python -m tests.benchmarks.panel` finds of it."""


def wrapped(line: str, indent: int = 4) -> list[str]:
    """Return a line of a plan as lines of at most `WIDTH` characters, each further one indented."""
    return textwrap.wrap(line, WIDTH, subsequent_indent=" " * indent, break_long_words=False, break_on_hyphens=False)


def percent(low: float, high: float) -> str:
    """Return shares from the least to the most, in percent."""
    return _range_words(low, high, _percent)


def _table(rows: list[list[str]]) -> list[str]:
    """Return a table in lines, as many of its columns beside one another as there is room for."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    fits, used = 1, 2 + widths[0]
    while fits < len(widths) and (fits == 1 or used + 2 + widths[fits] <= WIDTH):
        used += 2 + widths[fits]
        fits += 1
    shown = ["  " + "  ".join(map(str.ljust, row[:fits], widths)).rstrip() for row in rows]
    return shown if fits == len(widths) else [*shown, "", *_table([[row[0], *row[fits:]] for row in rows])]


def _percent(share: float) -> str:
    return "<0.001" if 0 < share < SHOWN else f"{share * 100:.3g}"


def _range_of(values: tuple[float, ...], shown: Callable[[float], str]) -> str:
    return _range_words(min(values), max(values), shown) if values else "none"


def _range_words(low: float, high: float, shown: Callable[[float], str]) -> str:
    first, last = shown(low), shown(high)
    return first if first == last else f"{first} to {last}"


def _up_to(share: float | None) -> str:
    return "unknown" if share is None else f"up to {_percent(share)}"
