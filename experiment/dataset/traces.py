"""Writes what a session recorded on a grid of times: BIDS `_physio` files beside its table, block by block."""

import zlib
from collections.abc import Iterable, Iterator, Mapping
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.experiment import storage
from palpate.experiment.dataset import bids
from palpate.experiment.records.entries import Header

LONGEST_GAP_S = 600.0
"""After a longer pause a trace continues in a new recording."""

GZIP_BITS, ROWS_AT_ONCE = 31, 1 << 14
"""Has `zlib` write a gzip file without a time; and so many rows are text at a time."""

Samples = NDArray[np.float64]
"""Shape (samples, columns)."""


class Column(NamedTuple):
    """One column of a trace."""

    description: str
    units: str
    decimals: int


def write(
    root: Path,
    header: Header,
    name: str,
    *,
    places: NDArray[np.float64],
    samples: Iterable[Samples],
    columns: Mapping[str, Column],
    rate_hz: float,
    description: str,
    origin: bids.Origin,
    facts: Mapping[str, object] = {},
) -> None:
    """Write a trace of a session as `_physio.tsv.gz`, without a header as BIDS asks, and its sidecar.

    `samples`, NaN where nothing was recorded, are at whole `places` of a grid, shape (n,), in the same order. They come
    in blocks of any length, of which one is in memory at a time. The grid has `rate_hz` and begins where the events'
    clock does. Places between the samples are n/a. `facts` are further keys of each sidecar.
    """
    cuts = np.flatnonzero(np.diff(places) > LONGEST_GAP_S * rate_hz) + 1
    own = bids.beh_path(root, header.participant, header.task, f"recording-{name}")
    # Earlier versions cut the trace at a clock that was set back too.
    for trace in own.parent.glob(f"{own.name}*_physio.*"):
        numbered = trace.name.removeprefix(own.name).partition("_")[0]
        if numbered.isdecimal() and int(numbered) > len(cuts) + 1:
            storage.remove(trace)
    decimals = [column.decimals for column in columns.values()]
    for number, blocks in groupby(_apart(samples, cuts), itemgetter(0)):
        at = np.split(places, cuts)[number]
        begins = at.min()
        packer = zlib.compressobj(4, wbits=GZIP_BITS)
        rows = _rows((at - begins).astype(np.int64), (block for _, block in blocks), len(columns))
        packed = [packer.compress(_text(part, decimals)) for part in rows]
        trace = own.with_name(f"{own.name}{number + 1 if number else ''}_physio")
        storage.write_bytes(trace.with_suffix(".tsv.gz"), b"".join([*packed, packer.flush()]))
        sidecar: dict[str, object] = {
            "SamplingFrequency": rate_hz,
            "StartTime": round(float(begins) / rate_hz, 6),
            "Columns": list(columns),
            "PhysioType": "generic",
            "TaskName": header.task,
            "Description": bids.labelled(description, origin),
            **facts,
            **{key: {"Description": text, "Units": units} for key, (text, units, _) in columns.items()},
        }
        storage.write_json(trace.with_suffix(".json"), sidecar)


def _apart(samples: Iterable[Samples], cuts: NDArray[np.int64]) -> Iterator[tuple[int, Samples]]:
    """Yield blocks of samples, none of them empty or across a cut, each with the number of its recording, from 0."""
    at = 0
    for block in samples:
        for part in np.split(block, cuts[(cuts > at) & (cuts < at + len(block))] - at):
            if len(part):
                yield int(np.searchsorted(cuts, at, side="right")), part
                at += len(part)


def _rows(places: NDArray[np.int64], blocks: Iterable[Samples], columns: int) -> Iterator[Samples]:
    """Yield a grid from place 0 on, some rows at a time, as soon as no sample to come is earlier."""
    earliest = np.minimum.accumulate(places[::-1])[::-1]
    kept, done, at = np.empty((0, columns)), 0, 0
    for block in blocks:
        place, ready = places[at : at + len(block)] - done, int(earliest[at]) - done
        gap = np.broadcast_to(np.nan, (max(ready - len(kept), 0), columns))
        for rows in (kept[:ready], gap):
            yield from (rows[n : n + ROWS_AT_ONCE] for n in range(0, len(rows), ROWS_AT_ONCE))
        kept, old = np.full((max(len(kept), int(place.max()) + 1) - ready, columns), np.nan), kept[ready:]
        kept[: len(old)] = old
        kept[place - ready] = block
        done, at = done + ready, at + len(block)
    yield kept


def _text(rows: Samples, decimals: Iterable[int]) -> bytes:
    text = ("\t".join(f"%.{one}f" for one in decimals) + "\n") * len(rows)
    values = np.where(np.isfinite(rows), rows, np.nan).ravel().tolist()
    return (text % tuple(values)).replace("nan", bids.MISSING).encode()
