"""SIMULATED sessions of recording: which speed the foot has, and what the panel does, at every attempt at every take.

There is one way to draw them: `palpate record --simulated` has them pass through the ports, `make_recordings` writes
them at once, and fresh takes are drawn alike. A take that is kept is the first attempt at it that is on target.

Where a plan asks for recordings as the paper made them (its rate, length, takes, four materials, and 200 mm/s among the
speeds), sessions are drawn until equation (6) at 200 mm/s gives Table 3 within `TABLE_3_TOLERANCE` for all six pairs.
Nothing else is chosen among sessions: on which speeds takes are put (Figure 7) is left to chance.
It is met by takes as they are drawn; recorded ones begin 2 ms before their trigger, which moves it by about 0.01.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from experiment.errors import RecordingError
from experiment.protocol.models import Protocol
from experiment.recordings.manifest import Recordings
from experiment.recordings.store import FASTEST_MM_S, SIMULATED, Condition, Plan, Take, plan, write
from experiment.recordings.workflow import SPEED_TOLERANCE
from experiment.rehearsal.footstep.materials import CRACKLES, REFERENCE_SPEED_MM_S, SimulatedMaterials, known
from experiment.synthesis.spectra import bin_frequencies_hz, dissimilarity_matrix, spectrum

AIM_SIGMA = 0.07
"""Standard deviation of the log speed of a foot that aims at a target: about five steps of six are within 10 %."""

TABLE_3: Mapping[tuple[str, str], float] = MappingProxyType(
    {
        ("copy paper", "aluminum foil"): 0.74,
        ("copy paper", "polypropylene"): 1.00,
        ("copy paper", "typing paper"): 0.79,
        ("aluminum foil", "polypropylene"): 0.29,
        ("aluminum foil", "typing paper"): 0.25,
        ("polypropylene", "typing paper"): 0.32,
    }
)
"""Normalised dissimilarities as printed (Okamoto et al., Table 3)."""

TABLE_3_TOLERANCE = 0.018
"""Below the promised 0.02, so that rounding to the float32 of a WAV file cannot cross it."""

MOST_SESSIONS = 1000


@dataclass(frozen=True)
class Attempt:
    """One step of the simulated foot.

    Attributes:
        speed_mm_s: of the foot through the gate, mm/s.
        samples_m_s2: of the panel from first contact on, m/s^2, shape (n,).
    """

    speed_mm_s: float
    samples_m_s2: NDArray[np.float64]


class RecordingSession:
    """One simulated session; every draw is named, so attempts may be asked for in any order."""

    def __init__(self, planned: Plan, *, seed: int, number: int) -> None:
        """Begin.

        Args:
            planned: what is recorded.
            seed: names every random draw, together with the plan and what follows.
            number: of the session, from 0.

        Raises:
            RecordingError: a material without simulation.
        """
        for material in planned.materials:
            known(material)
        self.planned = planned
        self.number = number
        self._seed = seed
        self._materials = SimulatedMaterials(planned.rate_hz, planned.samples)

    def rng(self, condition: Condition, attempt: int, purpose: int) -> np.random.Generator:
        """What one attempt draws from; two plans with one seed share no draw.

        Args:
            condition: of the take.
            attempt: from 1.
            purpose: of the draws, a small number.
        """
        name = f"{self.planned.source} {self.planned.speeds_mm_s} {self.planned.takes} {condition}"
        named = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "big")
        return np.random.default_rng((self._seed, self.number, named, attempt, purpose))

    def attempt(self, condition: Condition, attempt: int) -> Attempt:
        """Attempt at a take, from 1."""
        rng = self.rng(condition, attempt, 0)
        aimed = condition.speed_mm_s * float(np.exp(AIM_SIGMA * rng.normal()))
        v = min(aimed, FASTEST_MM_S)
        if condition.material is None:
            return Attempt(v, self._materials.panel_take(speed_mm_s=v, rng=rng))
        return Attempt(v, self._materials.crinkle_take(condition.material, speed_mm_s=v, rng=rng))

    def kept(self, condition: Condition) -> Attempt:
        """The first attempt that is on target."""
        attempts = (self.attempt(condition, number) for number in count(1))
        return next(a for a in attempts if abs(a.speed_mm_s / condition.speed_mm_s - 1) <= SPEED_TOLERANCE)

    def recordings(self) -> Recordings:
        """Every kept take, as arrays."""
        planned = self.planned

        def of(material: str | None) -> NDArray[np.float64]:
            numbers = range(1, planned.takes + 1)
            return np.array(
                [[self.kept(Condition(material, v, n)).samples_m_s2 for n in numbers] for v in planned.speeds_mm_s]
            )

        return Recordings(
            label=planned.source,
            simulated=True,
            rate_hz=planned.rate_hz,
            speeds_mm_s=np.array(planned.speeds_mm_s),
            panel=of(None),
            objects={material: of(material) for material in planned.materials},
        )


def session(planned: Plan, *, seed: int) -> RecordingSession:
    """The first session of a seed that meets Table 3; where the plan is not the paper's, the first.

    Raises:
        RecordingError: a material without simulation, or no session that meets the table.
    """
    first = RecordingSession(planned, seed=seed, number=0)
    if not _as_published(planned):
        return first
    for number in range(MOST_SESSIONS):
        drawn = RecordingSession(planned, seed=seed, number=number)
        if strays_from_table_3(drawn) <= TABLE_3_TOLERANCE:
            return drawn
    raise RecordingError(
        f"none of {MOST_SESSIONS} simulated sessions came within {TABLE_3_TOLERANCE} of Table 3; "
        "the parameters of the simulated materials need fitting anew"
    )


def make_recordings(directory: Path, *, protocol: Protocol, seed: int) -> Path:
    """Write a whole set of SIMULATED recordings for a protocol: its materials and the bare panel, at each speed.

    Args:
        directory: new or empty.
        protocol: materials, speeds, takes, rate and length.
        seed: of this set; the same seed gives the same recordings.

    Returns:
        Path of the manifest.

    Raises:
        RecordingError: as `session`; or a directory in use.
    """
    drawn = session(plan(protocol, source=source(seed), simulated=True), seed=seed)
    takes = []
    for condition in drawn.planned.conditions():
        kept = drawn.kept(condition)
        takes.append(
            Take(
                condition.material,
                condition.speed_mm_s,
                condition.number,
                kept.samples_m_s2,
                achieved_mm_s=round(kept.speed_mm_s, 3),
            )
        )
    return write(
        directory,
        takes=takes,
        rate_hz=drawn.planned.rate_hz,
        simulated=True,
        label=SIMULATED,
        note=f"{drawn.planned.source}, {note(drawn)}",
    )


def source(seed: int) -> str:
    """What plan and manifest say of recordings that a simulation makes."""
    return f"SIMULATED, seed {seed}"


def note(drawn: RecordingSession) -> str:
    """What a manifest says of a session: its number, and what was fitted or chosen so that it is as published."""
    if not _as_published(drawn.planned):
        return f"session {drawn.number}; materials fitted to Table 3 of Okamoto et al."
    return (
        f"session {drawn.number}, the first from 0 on within {TABLE_3_TOLERANCE} of Table 3 of Okamoto et al. as "
        "drawn; the materials were fitted to that table too: agreement with it is made, not found"
    )


def strays_from_table_3(drawn: RecordingSession) -> float:
    """Largest departure of any pair from Table 3: section 6.1, equations (2) and (6) at 200 mm/s."""
    numbers = range(1, drawn.planned.takes + 1)

    def magnitudes(material: str | None) -> NDArray[np.float64]:
        takes = [drawn.kept(Condition(material, REFERENCE_SPEED_MM_S, n)).samples_m_s2 for n in numbers]
        averaged: NDArray[np.float64] = np.abs(spectrum(takes)).mean(axis=0)
        return averaged

    panel = magnitudes(None)
    amplitudes = np.array([np.maximum(magnitudes(material) - panel, 0.0) for material in CRACKLES])
    frequencies_hz = bin_frequencies_hz(bins=drawn.planned.samples, rate_hz=drawn.planned.rate_hz)
    matrix = dissimilarity_matrix(amplitudes, frequencies_hz=frequencies_hz)
    place = {material: i for i, material in enumerate(CRACKLES)}
    return max(abs(float(matrix[place[a], place[b]]) - printed) for (a, b), printed in TABLE_3.items())


def _as_published(planned: Plan) -> bool:
    return (
        (planned.rate_hz, planned.samples, planned.takes) == (5000, 2500, 3)
        and REFERENCE_SPEED_MM_S in planned.speeds_mm_s
        and set(planned.materials) == set(CRACKLES)
    )
