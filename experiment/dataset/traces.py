"""Writes what a session recorded on a grid of times: BIDS `_physio` files beside its table."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from palpate.experiment import storage
from palpate.experiment.dataset import bids
from palpate.experiment.records.entries import Header

LONGEST_GAP_S = 600.0
"""After a longer pause a trace continues in a new recording."""


def write(
    root: Path,
    header: Header,
    name: str,
    *,
    places: NDArray[np.float64],
    columns: Mapping[str, bids.PhysioColumn],
    rate_hz: float,
    description: str,
    origin: bids.Origin,
    facts: Mapping[str, object] = {},
) -> None:
    """Write a trace of a session; its `columns` are of samples at whole `places` of a grid, shape (n,).

    The grid has `rate_hz` and begins where the events' clock does. Places between the samples are n/a. `facts` are
    further keys of each sidecar.
    """
    cuts = np.flatnonzero(np.diff(places) > LONGEST_GAP_S * rate_hz) + 1
    own = bids.beh_path(root, header.participant, header.task, f"recording-{name}")
    # Earlier versions cut the trace at a clock that was set back too.
    for trace in own.parent.glob(f"{own.name}*_physio.*"):
        numbered = trace.name.removeprefix(own.name).partition("_")[0]
        if numbered.isdecimal() and int(numbered) > len(cuts) + 1:
            storage.remove(trace)
    for number, at in enumerate(np.split(np.arange(places.size), cuts), start=1):
        begins = places[at].min()
        place = (places[at] - begins).astype(np.int64)
        grid = np.full((len(columns), int(place.max()) + 1), np.nan)
        for row, column in zip(grid, columns.values(), strict=True):
            row[place] = column.values[at]
        bids.write_physio(
            own.with_name(f"{own.name}{number if number > 1 else ''}_physio.tsv.gz"),
            {key: replace(column, values=row) for row, (key, column) in zip(grid, columns.items(), strict=True)},
            rate_hz=rate_hz,
            start_s=round(float(begins) / rate_hz, 6),
            task=header.task,
            description=description,
            origin=origin,
            facts=facts,
        )
