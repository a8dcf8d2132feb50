"""Taps on two materials in a dataset: a row for each pair that was laid out, and a trace of the force that was sent."""

from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from palpate.experiment import storage
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.rig import tracker_of
from palpate.experiment.apparatus.servo.record import CYCLE, cycles_of
from palpate.experiment.apparatus.servo.settings import largest_force_n
from palpate.experiment.dataset import traces
from palpate.experiment.dataset.build import ORIGINS, Cells, DatasetKind, heard_cells, raw_frames
from palpate.experiment.dataset.checks import Dataset
from palpate.experiment.dataset.outside.losses import cut_off
from palpate.experiment.protocol.kinds.tapping import Tapping
from palpate.experiment.records import bridging
from palpate.experiment.records.entries import Outcome
from palpate.experiment.records.journal import Contents
from palpate.experiment.records.kinds.tapping import PairLaidOut, Pushed, Tapped

ABOUT = (
    "Force sent by the servo in each cycle while a block was rendered and the hand was near or pushing it; otherwise "
    "n/a. A position is n/a if the tracker sent no sample."
)

COLUMNS = {
    "hand_height": ("Height of the hand above the face of the block; negative inside the block.", "mm"),
    "force_asked": ("Force out of the block that its force law requests, from the servo's position and speed.", "N"),
    "force_sent": ("Force out of the block, as sent.", "N"),
    "hand_along": ("Position of the hand along the face.", "mm"),
    "force_asked_along": ("Force along the face that the block's force law requests.", "N"),
    "force_sent_along": ("Force along the face, as sent.", "N"),
}
"""What a trace of the force tells; the last three stand where the tracker was planar."""

DECIMALS = 5


def _cells(_: Path, contents: Contents) -> Iterator[tuple[Outcome, Cells]]:
    begun_ns = contents.lines[0].t_ns
    taps = {(one.trial, one.attempt): one for one in contents.entries if isinstance(one, Tapped) and one.stimulus.heard}
    for entry, shift_ns in bridging.shifted(contents):
        if isinstance(entry, PairLaidOut):
            first, second = entry.presented
            tap = taps.get((entry.trial, entry.attempt))
            yield (
                entry,
                {
                    "onset": round((entry.laid_ns + shift_ns - begun_ns) / 1e9, 6),
                    "first": first,
                    "second": second,
                    **(heard_cells(tap.stimulus, tap.material) if tap is not None else {}),
                },
            )


def _write_force(dataset: Dataset, path: Path, contents: Contents) -> None:
    """Write what the servo sent on a grid of its rate, and beside it the block's law."""
    named = [(entry, shift_ns) for entry, shift_ns in bridging.shifted(contents) if isinstance(entry, Pushed)]
    cut, unnamed = cut_off(path, [entry for entry, _ in named])
    pushed = [one for place, one in enumerate(named) if place not in cut]
    if not pushed:
        return
    header, protocol = contents.header, dataset.version(contents.header)
    virtual, rig = protocol.table(Tapping), rigs.session_rig(storage.rig_path(path), header.rig_sha256)
    begun_ns = contents.lines[0].t_ns

    def parts() -> Iterator[NDArray[np.void]]:
        read = raw_frames(path, [entry for entry, _ in pushed])
        for part, (_, shift_ns) in zip(read, pushed, strict=True):
            yield cycles_of(part, later_ns=shift_ns - begun_ns)

    planar = tracker_of(rig).along_calibration is not None
    places = _places(parts(), sum(entry.trace.length for entry, _ in pushed) // CYCLE.itemsize, virtual.rate_hz)
    traces.write(
        dataset.root,
        header,
        "force",
        places=places,
        samples=(_columns(cycles)[:, : 6 if planar else 3] for cycles in parts()),
        columns={
            name: traces.Column(text, unit, DECIMALS) for name, (text, unit) in [*COLUMNS.items()][: 6 if planar else 3]
        },
        rate_hz=virtual.rate_hz,
        description=ABOUT,
        origin=ORIGINS[dataset.purpose],
        facts={
            "Force": {
                "StiffnessNewtonPerMetre": virtual.stiffness_n_m,
                "DampingNewtonSecondPerMetre": virtual.damping_n_s_m,
                **({} if virtual.mass_kg is None else {"BlockKilogram": virtual.mass_kg}),
                **({"CrossoversHertz": list(virtual.crossovers_hz)} if virtual.crossovers_hz else {}),
                "LimitNewton": largest_force_n(protocol.exposure.force_peak_n, rig.servo),
                "Cycles": places.size,
                "LostCycles": sum(entry.lost for entry, _ in named)
                + sum(named[place][0].cycles for place in cut)
                + -(-unnamed // CYCLE.itemsize),
            }
        },
    )


def _columns(cycles: NDArray[np.void]) -> NDArray[np.float64]:
    """Return the values of `COLUMNS`, shape (n, 6)."""
    read = np.where(cycles["samples"][:, None] > 0, cycles["place_mm"], np.nan)
    each = [one[:, axis] for axis in (0, 1) for one in (read, cycles["asked_n"], cycles["sent_n"])]
    return np.column_stack(each).astype(np.float64)


def _places(parts: Iterable[NDArray[np.void]], size: int, rate_hz: float) -> NDArray[np.float64]:
    """Return where so many cycles stand on the grid, shape (n,): by the servo's deadlines since it was opened."""
    met, late, anew = np.empty(size), np.empty(size), [0]
    at, newest = 0, -1
    for cycles in parts:
        own = slice(at, at + cycles.size)
        met[own] = cycles["cycle"]
        late[own] = cycles["t_ns"] * (rate_hz / 1e9) - met[own]
        numbers = np.append(newest, cycles["number"].astype(np.int64))
        anew += (np.flatnonzero(np.diff(numbers) <= 0) + at).tolist()
        at, newest = own.stop, int(numbers[-1])
    for begun, ended in pairwise([*anew, size]):
        met[begun:ended] += np.rint(np.median(late[begun:ended]))
    return met


DATASET = DatasetKind(_cells, write=_write_force)
