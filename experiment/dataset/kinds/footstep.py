"""Footsteps in a dataset: a row for each step, on the session's clock, and traces of the foot."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from palpate.experiment import storage
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.rig import tracker_of
from palpate.experiment.apparatus.tracker import frames
from palpate.experiment.apparatus.tracker.clock_map import ClockMap
from palpate.experiment.dataset import bids, traces
from palpate.experiment.dataset.build import ORIGINS, Cells, DatasetKind, heard_cells, raw_frames
from palpate.experiment.dataset.checks import Dataset
from palpate.experiment.errors import DatasetError
from palpate.experiment.records import bridging, entries
from palpate.experiment.records.journal import Contents
from palpate.experiment.records.kinds.footstep import BrokenOff, FootStep, Zeroed
from palpate.experiment.records.stimulus import Onset, Stimulus

FOOT_COLUMNS = {
    "foot_height": traces.Column("Height of the sole above the panel.", "mm", 3),
    "foot_along": traces.Column("Position of the sole along the face, from the calibrated planar tracker.", "mm", 3),
    "foot_force": traces.Column("Force on the panel, measured by the sensor under it.", "N", 2),
}
"""What a trace of the foot tells; the second where the tracker was planar, the third where the force was recorded."""


@dataclass(frozen=True)
class Placed:
    """A step on the session's clock.

    `at_us` is the device time of its contact or break, `at_s` the same in s from the tracker's first frame; `drift_ppm`
    is the session's clock against the device's. `zero_mm` is how far from contact the foot rested when last zeroed.
    """

    step: FootStep | BrokenOff
    at_us: float
    at_s: float
    drift_ppm: float
    zero_mm: float

    def seconds(self, device_us: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return device times, any shape, on the clock of `at_s`, s."""
        passed_s = (device_us - self.at_us) / 1e6
        return np.asarray(self.at_s + passed_s * (1 + self.drift_ppm * 1e-6), np.float64)


def placed_steps(path: Path, contents: Contents) -> list[Placed]:
    """Return the steps of a journal at which any frame came. Raises `DatasetError` for one before its tracker."""
    zero_ns: int | None = None
    zero_mm = 0.0
    steps: list[Placed] = []
    for entry, shift_ns in bridging.shifted(contents):
        if isinstance(entry, entries.TrackerOpened):
            zero_ns = entry.t_ns + shift_ns if zero_ns is None else zero_ns
        elif isinstance(entry, Zeroed):
            zero_mm = entry.offset_mm
        elif isinstance(entry, FootStep | BrokenOff):
            at_us, clock = entry.at_us if isinstance(entry, BrokenOff) else entry.contact_us, entry.clock
            if at_us is None or clock is None:
                # No frame came.
                continue
            if zero_ns is None:
                raise DatasetError(
                    path,
                    "has a step before its tracker was opened",
                    "restore the journal from a backup",
                    allowed="the tracker first",
                )
            at_ns = ClockMap(clock.anchor_us, clock.anchor_ns, clock.drift_ppm).session_ns(at_us)
            at_s = (at_ns + shift_ns - zero_ns) / 1e9
            steps.append(Placed(entry, at_us, at_s, clock.drift_ppm, zero_mm))
    return steps


def _cells(path: Path, contents: Contents) -> Iterator[tuple[entries.Outcome, Cells]]:
    for placed in placed_steps(path, contents):
        step = placed.step
        stimulus = step.stimulus
        onset, force = (step.onset, step.force) if isinstance(step, FootStep) else (None, None)
        heard = onset.delivered if onset else None
        off_ns = heard.onset_ns - onset.contact_ns if onset and heard and heard.onset_ns is not None else None
        yield (
            step,
            {
                "onset": round(placed.at_s, 6),
                "duration": stimulus.lasts_s if stimulus else None,
                "presented": " | ".join(step.presented),
                "foot_speed": round(step.speed_mm_s, 3) if step.speed_mm_s is not None else None,
                "frames_lost": step.link.lost + step.link.damaged,
                "floored_bins": stimulus.floored_bins if stimulus else None,
                "delivered": heard.delivered if heard else None,
                "onset_error": None if off_ns is None else round(off_ns / 1e9, 6),
                **({"redo_reason": step.reason} if isinstance(step, BrokenOff) else {}),
                **_timing_s(step, onset),
                **_played(stimulus),
                **({"foot_force": force.mean_n, "foot_force_peak": force.peak_n} if force else {}),
                **heard_cells(stimulus),
            },
        )


def _timing_s(step: FootStep | BrokenOff, onset: Onset | None) -> dict[str, object]:
    """Return what is known of a step's timing, by column, s."""
    heard = onset.delivered if onset else None
    known_ms = {
        "contact_standard_error": step.contact_standard_error_ms if isinstance(step, FootStep) else None,
        "prediction_error": onset.prediction_error_ms if onset else None,
        "delivery_error": heard.onset_error_ms if heard else None,
        "gate_to_scheduled": onset.gate_to_scheduled_ms if onset else None,
        "dead_time": step.dead_time_ms,
    }
    return {column: round(ms / 1e3, 6) for column, ms in known_ms.items() if ms is not None}


def _played(stimulus: Stimulus | None) -> dict[str, object]:
    """Return what is known of how a stimulus was played, by column; nothing where a journal is from before that."""
    made = stimulus.computed if stimulus is not None else None
    if made is None or made.left_out is None or made.dissimilarity_m_s2 is None:
        return {}
    return {
        "stimulus_method": made.method,
        "stimulus_error": round(made.relative_error, 9),
        "left_out": round(made.left_out, 9),
        "dissimilarity": round(made.dissimilarity_m_s2, 9),
    }


def write_foot(root: Path, path: Path, contents: Contents, parts: Iterable[bytes], origin: bids.Origin) -> None:
    """Write the foot's height (and place, if planar) on a grid of the rig's rate that begins anew with each step.

    Between steps it is n/a. A device's clock that drifts leaves a place empty now and then, or has two frames in one.
    """
    header, steps = contents.header, placed_steps(path, contents)
    if not steps:
        return
    tracker = tracker_of(rigs.session_rig(storage.rig_path(path), header.rig_sha256))
    rate_hz, weighed = tracker.rate_hz, any(isinstance(one.step, FootStep) and one.step.force for one in steps)
    columns = ["foot_height"] + ["foot_along"] * (tracker.along_calibration is not None) + ["foot_force"] * weighed
    places: list[NDArray[np.float64]] = []
    read: list[NDArray[np.float64]] = []
    for placed, part in zip(steps, parts, strict=True):
        _, decoded = frames.Decoder(near_us=int(placed.at_us), readings=tracker.readings).feed(part)
        seconds = placed.seconds(decoded.device_us)
        places.append(np.rint(seconds[:1] * rate_hz) + np.rint((seconds - seconds[:1]) * rate_hz))
        second = tracker.force_n(decoded.along) if weighed else tracker.along_mm(decoded.along)
        heights_mm = tracker.height_mm(decoded.counts) - placed.zero_mm
        read.append(np.column_stack([heights_mm, *([] if second is None else [second])]))
    traces.write(
        root,
        header,
        "foot",
        places=np.concatenate(places),
        samples=read,
        columns={name: FOOT_COLUMNS[name] for name in columns},
        rate_hz=rate_hz,
        description="Foot height from the tracker, from arming to just after contact; n/a between steps.",
        origin=origin,
    )


def _write(dataset: Dataset, path: Path, contents: Contents) -> None:
    parts = raw_frames(path, [placed.step for placed in placed_steps(path, contents)])
    write_foot(dataset.root, path, contents, parts, ORIGINS[dataset.purpose])


DATASET = DatasetKind(_cells, write=_write)
