"""How far the force that was sent is from the block's law on the place that was recorded, cause by cause.

A servo's trace (`recording-force_physio.tsv.gz`) has, each cycle, the place of the hand, the force that the law asked
of what the servo believed, and the force that was sent until the next cycle. The law here is that of the smoothed place
and its speed (Savitzky and Golay, Analytical Chemistry 36, 1964), which know what came later, as no servo does:

    F = K r + C dr/dt within the block, never below 0 N

An error is the rms of a force less that law within the limit of force, as a part of that law's rms, `PARTS` times a
cycle. Causes come one after the other, each beside those before it.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from math import nan, sqrt
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from palpate.analysis.documents.tables import Column, Record, Section, number, tabulate
from palpate.analysis.reading.study import Study

WINDOW, DEGREE = 17, 2
"""Cycles and degree of the smoothing. Ours, by simulation of hands that the force moves."""

PARTS = 8

CAUSES = ("hold", "observer and noise", "sent", "limit")
"""The law of each cycle, held until the next; what the servo asked for, within the limit, held; what was sent, held;
and that beside the law without a limit."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Law:
    """What a trace's sidecar says of the block and the servo: K, N/m, C, N s/m, the limit, N, and cycles a second."""

    stiffness_n_m: float
    damping_n_s_m: float
    limit_n: float
    rate_hz: float

    def force_n(self, inside_m: Floats, m_s: Floats) -> Floats:
        """Return the law without a limit, N, at places and speeds into the block, shape as given."""
        force: Floats = self.stiffness_n_m * inside_m + self.damping_n_s_m * m_s
        return np.where(inside_m > 0.0, np.maximum(force, 0.0), 0.0)


@dataclass(frozen=True)
class Sums:
    """Sums of squares over recorded cycles, N^2: of the errors of `CAUSES`, of the law within the limit, and of it
    whole.

    `cycles` are counted, and those among them that the law asks for something; `noise_n2` is the variance that noise
    of the place leaves in the law.
    """

    errors: Floats
    within: float
    whole: float
    cycles: int
    pushed: int
    noise_n2: float

    def plus(self, other: Sums) -> Sums:
        """Return both together."""
        n = self.pushed + other.pushed
        noise = (self.noise_n2 * self.pushed + other.noise_n2 * other.pushed) / n if n else 0.0
        within, whole = self.within + other.within, self.whole + other.whole
        return Sums(self.errors + other.errors, within, whole, self.cycles + other.cycles, n, noise)

    def parts(self) -> dict[str, float]:
        """Return each cause's error as a part of the law's rms; NaN where the law asked for nothing."""
        of = [*[self.within] * (len(CAUSES) - 1), self.whole]
        return {
            cause: sqrt(error / law) if law else nan for cause, error, law in zip(CAUSES, self.errors, of, strict=True)
        }

    def noise_part(self) -> float:
        """Return how far off the law itself may be by noise of the place, as a part of its rms."""
        return sqrt(self.noise_n2 * self.pushed * PARTS / self.within) if self.within else nan


NOTHING = Sums(np.zeros(len(CAUSES)), 0.0, 0.0, 0, 0, 0.0)


def run_sums(law: Law, height_mm: Floats, asked_n: Floats, sent_n: Floats) -> Sums:
    """Return the sums over a run of cycles without a gap, shape (n,) each; places may be NaN. Short ones give none."""
    known = np.flatnonzero(np.isfinite(height_mm))
    if known.size < 2 or height_mm.size < WINDOW:
        return NOTHING
    from scipy.signal import savgol_filter

    times_s = np.arange(height_mm.size) / law.rate_hz
    read_m = -1e-3 * np.interp(times_s, times_s[known], height_mm[known])
    inside_m = savgol_filter(read_m, WINDOW, DEGREE)
    m_s = savgol_filter(read_m, WINDOW, DEGREE, deriv=1, delta=1 / law.rate_hz)
    at_s = (np.arange((times_s.size - 1) * PARTS) + 0.5) / (PARTS * law.rate_hz)
    whole = law.force_n(np.interp(at_s, times_s, inside_m), np.interp(at_s, times_s, m_s))
    within = np.minimum(whole, law.limit_n)
    held = [
        np.minimum(law.force_n(inside_m, m_s), law.limit_n),
        np.clip(asked_n, -law.limit_n, law.limit_n),
        sent_n,
    ]
    errors = [float(((np.repeat(one[:-1], PARTS) - within) ** 2).sum()) for one in held]
    errors.append(float(((np.repeat(sent_n[:-1], PARTS) - whole) ** 2).sum()))
    spread_m2 = float(((read_m - inside_m) ** 2).mean()) * WINDOW / (WINDOW - DEGREE - 1)
    noise_n2 = spread_m2 * (law.damping_n_s_m * law.rate_hz) ** 2 * 12 / (WINDOW * (WINDOW**2 - 1))
    pushed = int((whole > 0.0).sum()) // PARTS
    return Sums(np.array(errors), float((within**2).sum()), float((whole**2).sum()), height_mm.size, pushed, noise_n2)


def trace_sums(table: Path) -> tuple[Sums, int]:
    """Return the sums over a trace on disk, and how many cycles are lost.

    No sums for a block that gives way, or is felt up to a crossover.

    Raises `OSError`, `ValueError` and `KeyError` for a trace that cannot be read.
    """
    sidecar = json.loads(table.with_name(table.name.removesuffix(".tsv.gz") + ".json").read_text("utf-8"))
    facts, rate_hz = sidecar["Force"], float(sidecar["SamplingFrequency"])
    if {"BlockKilogram", "CrossoversHertz"} & set(facts):
        return NOTHING, facts["LostCycles"]
    law = Law(facts["StiffnessNewtonPerMetre"], facts["DampingNewtonSecondPerMetre"], facts["LimitNewton"], rate_hz)
    frame = pd.read_csv(table, sep="\t", names=sidecar["Columns"], na_values="n/a", dtype=float)
    columns = frame[["hand_height", "force_asked", "force_sent"]].to_numpy()
    rows = np.flatnonzero(np.isfinite(columns[:, 2]))
    total = NOTHING
    for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
        total = total.plus(run_sums(law, *columns[run].T))
    return total, facts["LostCycles"]


def _percent(part: float) -> str:
    return number(100 * part, 1)


FORCE = (
    Column("task", left=True), Column("recordings"), Column("cycles"), Column("lost"),
    *(Column(cause, f"{cause} %", show=_percent) for cause in CAUSES),
    Column("law", "law ± %", show=_percent),
)  # fmt: skip

ABOUT = (
    "This table compares the force that was sent with the block's force law at the recorded position, for analyzed "
    "participants: the rms difference along the normal, as a percentage of the rms of the law within the force "
    "limit. Each column adds one cause: the law held constant within a cycle; the servo's request, with its "
    "observer, noise and counts; the force sent; and the force sent against the law without a limit. The force that "
    "the device produced was not recorded. `palpate plan` shows the expected values; `tests/README.md` in palpate's "
    "repository shows how to compute the table with another program."
)


NOISE = "± is the uncertainty of the law from position noise."


def force_sections(study: Study) -> tuple[Section, ...]:
    """Return the section of the force, or none where none is on record."""
    included = study.attempts.loc[study.attempts["included"], "participant"].unique()
    records = []
    for task in study.tasks:
        tables = [one for who in included for one in study.forces.get((who, task.id), ())]
        found = [trace_sums(table) for table in tables]
        if found:
            total = NOTHING
            for sums, _ in found:
                total = total.plus(sums)
            records.append(_record(task.id, len(found), total, sum(lost for _, lost in found)))
    if not records:
        return ()
    table = tabulate("Force sent, by task", FORCE, records, (NOISE,))
    return (Section("force", "The force sent", (ABOUT,), (table,)),)


def _record(task: str, recordings: int, sums: Sums, lost: int) -> Record:
    return {
        "task": task,
        "recordings": recordings,
        "cycles": sums.cycles,
        "lost": lost,
        **sums.parts(),
        "law": sums.noise_part(),
    }
