"""Timing of the rig, as its sessions measured it: predictions, onsets, scheduling, and the dead time between trials.

Every attempt counts of participants of whom the analysis takes anything, those that were done again among them: what
the rig missed is not hidden by the repetition.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.study import Study

QUANTITIES = {
    "contact, predicted minus actual": "prediction_error_s",
    "onset, measured minus asked": "delivery_error_s",
    "gate to scheduled": "gate_to_scheduled_s",
    "dead time after an answer": "dead_time_s",
}
"""What is measured, and its column."""


@dataclass(frozen=True)
class Timing:
    """One quantity in the attempts of one task, ms.

    `p99_ms`, `p999_ms` and `largest_ms` are of the magnitude; the percentiles are None where too few values could lie
    beyond them, `sd_ms` below two values.
    """

    quantity: str
    attempts: int
    median_ms: float
    sd_ms: float | None
    p99_ms: float | None
    p999_ms: float | None
    largest_ms: float


def timing(study: Study) -> dict[str, tuple[Timing, ...]]:
    """What is known of each task; a task of which nothing is known is left out."""
    attempts = study.attempts
    used = attempts[attempts["participant"].isin(attempts.loc[attempts["included"], "participant"])]
    found: dict[str, tuple[Timing, ...]] = {}
    for task in study.tasks:
        rows = used[used["task"] == task.id]
        known = {name: _known_ms(rows[column].to_numpy(dtype=np.float64)) for name, column in QUANTITIES.items()}
        if spreads := tuple(_spread(name, values_ms) for name, values_ms in known.items() if values_ms.size):
            found[task.id] = spreads
    return found


def _known_ms(values_s: NDArray[np.float64]) -> NDArray[np.float64]:
    return values_s[np.isfinite(values_s)] * 1e3


def _spread(quantity: str, values_ms: NDArray[np.float64]) -> Timing:
    sizes_ms = np.abs(values_ms)
    return Timing(
        quantity,
        values_ms.size,
        float(np.median(values_ms)),
        float(values_ms.std(ddof=1)) if values_ms.size > 1 else None,
        _percentile(sizes_ms, 0.99),
        _percentile(sizes_ms, 0.999),
        float(sizes_ms.max()),
    )


def _percentile(sizes_ms: NDArray[np.float64], share: float) -> float | None:
    # So that one value in as many may lie beyond it.
    return float(np.quantile(sizes_ms, share)) if sizes_ms.size >= round(1 / (1 - share)) else None
