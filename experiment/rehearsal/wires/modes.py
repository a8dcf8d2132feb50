"""SIMULATED panel with states: causal, in time, from a file of its modes.

It shares neither code nor assumption with what shapes: it has no bins, no table, and a phase. Volts pass a converter,
which draws a band-limited line through the samples, and a coil, which saturates softly in time. Force passes the
suspension, under everything, and then the modes side by side. Acceleration for each volt of a small drive:

    H(s) = G s^2 / (s^2 + 2 z_0 w_0 s + w_0^2) * sum_i p_i w_i^2 / (s^2 + 2 z_i w_i s + w_i^2).

A load m times as heavy as what moves takes G and each w^2 down to a part 1 / (1 + m), and adds damping. H is the sum
of its residues over its poles, each of which is one state: with a drive in straight lines between fine samples the
solution is exact to rounding (first-order hold; Franklin, Powell and Workman, Digital Control, 3rd ed., section 6.3.2).
"""

from collections.abc import Iterator
from itertools import combinations
from math import pi, sqrt
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy import signal

from palpate.experiment.settings import load
from palpate.experiment.settings.load import Broken, Confined, Line, Rules

FINER = 8
"""Times as fine as the samples of the device: what a coil adds in harmonics does not come back into the band."""

RINGS_S = 0.1
"""How long a stimulus is felt after its last sample, s."""

APART = 0.01
"""Two resonances differ by this part at the least: poles that coincide have no residues of their own."""


class Resonance(Confined):
    """An oscillation that dies away.

    Attributes:
        frequency_hz: undamped.
        damping: as a part of the critical.
    """

    frequency_hz: Annotated[float, Field(ge=1, le=5000)]
    damping: Annotated[float, Field(gt=0, lt=1)]

    @property
    def natural_rad_s(self) -> float:
        return 2 * pi * self.frequency_hz

    @property
    def pole_rad_s(self) -> complex:
        """The pole above the real axis; the other one mirrors it."""
        return self.natural_rad_s * complex(-self.damping, sqrt(1 - self.damping**2))

    def divisor(self, s: complex) -> complex:
        """Return s^2 + 2 z w s + w^2."""
        return (s - self.pole_rad_s) * (s - self.pole_rad_s.conjugate())

    def loaded(self, mass: float, damping: float) -> Self:
        """Return it with a mass, as a part of what moves, and damping added."""
        return self.model_copy(
            update={
                "frequency_hz": self.frequency_hz / sqrt(1 + mass),
                "damping": min(self.damping + damping, 0.999),
            }
        )


class Mode(Resonance):
    """A resonance of the panel.

    Attributes:
        part: of the movement well below it; negative where it moves against the others.
    """

    part: Annotated[float, Field(ge=-10, le=10)]


class Load(Confined):
    """What stands on the panel.

    Attributes:
        name: what it is.
        mass: as a part of what moves.
        damping: what it adds to each resonance, as a part of the critical.
    """

    name: Line
    mass: Annotated[float, Field(ge=0, le=10)]
    damping: Annotated[float, Field(ge=0, lt=1)]


class Drift(Confined):
    """What each stimulus changes of the next one, slowly.

    Attributes:
        gain_db: of the gain.
        frequency_part: of each frequency of a mode.
    """

    gain_db: Annotated[float, Field(ge=-1, le=1)]
    frequency_part: Annotated[float, Field(ge=-0.01, le=0.01)]


def _mode_rules(table: Any) -> Iterator[Broken]:
    resonances = [table.get("suspension"), *(table.get("modes") or ())]
    hz = [one.get("frequency_hz") if isinstance(one, dict) else None for one in resonances]
    for (_, first), (place, other) in combinations(enumerate(hz), 2):
        if isinstance(first, int | float) and isinstance(other, int | float) and abs(first - other) < APART * first:
            allowed = f"{100 * APART:g} % or more from every other resonance ({first} Hz)"
            yield Broken(("modes", place - 1, "frequency_hz"), allowed)


class Modes(Confined):
    """A simulated panel, as its file states it.

    Attributes:
        simulated: no laboratory has it.
        gain_m_s2_per_v: of a small drive between the suspension and the first mode.
        soft_v: where the coil saturates, E in E asinh(e / E); without it the coil is linear.
        suspension: what everything rests on.
        modes: one to four.
        load: what stands on the panel; nothing without it.
        drift: none without it.
    """

    RULES: ClassVar[Rules] = _mode_rules

    format: Literal[1]
    simulated: Literal[True]
    gain_m_s2_per_v: Annotated[float, Field(gt=0, le=1000)]
    soft_v: Annotated[float, Field(gt=0, le=1000)] | None = None
    suspension: Resonance
    modes: Annotated[tuple[Mode, ...], Field(min_length=1, max_length=4)]
    load: Load | None = None
    drift: Drift | None = None

    def after(self, stimuli: int) -> Self:
        """Return the panel with its load on it, after so many stimuli."""
        mass, damping = (self.load.mass, self.load.damping) if self.load is not None else (0.0, 0.0)
        gain_db, part = (self.drift.gain_db, self.drift.frequency_part) if self.drift is not None else (0.0, 0.0)
        gain, higher = 10 ** (stimuli * gain_db / 20), (1 + part) ** stimuli
        modes = (mode.loaded((1 + mass) / higher**2 - 1, damping) for mode in self.modes)
        return self.model_copy(
            update={
                "gain_m_s2_per_v": self.gain_m_s2_per_v * gain / (1 + mass),
                "suspension": self.suspension.loaded(mass, damping),
                "modes": tuple(modes),
            }
        )


def read(path: Path) -> Modes:
    """Return a file's panel. Raises `ProtocolError` with all problems."""
    return load.read(path, Modes)


def poles_and_residues(of: Modes) -> list[tuple[complex, complex]]:
    """Return the poles of H above the real axis, 1/s, and their residues, m/s^2/V/s, as it stands, without load."""

    def passed(s: complex) -> complex:
        return sum((mode.part * mode.natural_rad_s**2 / mode.divisor(s) for mode in of.modes), start=0j)

    base = of.suspension.pole_rad_s
    found = [(base, of.gain_m_s2_per_v * base**2 * passed(base) / (2j * base.imag))]
    for mode in of.modes:
        pole = mode.pole_rad_s
        residue = of.gain_m_s2_per_v * pole**2 / of.suspension.divisor(pole)
        found.append((pole, residue * mode.part * mode.natural_rad_s**2 / (2j * pole.imag)))
    return found


def respond(of: Modes, drive_v: NDArray[np.float64], *, rate_hz: float) -> NDArray[np.float64]:
    """Return the acceleration, m/s^2, shape (n,), of a panel at rest driven by straight lines between samples, (n,)."""
    moved = np.zeros(drive_v.size)
    for pole, residue in poles_and_residues(of):
        z = pole / rate_hz
        first = np.expm1(z) / z
        second = (first - 1) / z
        taps = [residue / rate_hz * second, residue / rate_hz * (first - second)]
        moved += 2 * signal.lfilter(taps, [1.0, -np.exp(z)], drive_v).real
    return moved


class MovingPanel:
    """The panel behind one port, at rest before each stimulus, of which it counts how many it got."""

    def __init__(self, modes: Modes) -> None:
        self._modes = modes
        self._stimuli = 0

    def moved(self, waveform_v: NDArray[np.float64], *, rate_hz: int) -> NDArray[np.float64]:
        """Return what one delivered stimulus, V, shape (n,), moves at the same rate, and `RINGS_S` longer, m/s^2."""
        now = self._modes.after(self._stimuli)
        self._stimuli += 1
        longer = np.pad(waveform_v, (0, round(RINGS_S * rate_hz)))
        drive_v = signal.resample_poly(longer, FINER, 1)
        if now.soft_v is not None:
            drive_v = now.soft_v * np.arcsinh(drive_v / now.soft_v)
        return respond(now, drive_v, rate_hz=FINER * rate_hz)[::FINER]
