"""Traces on a grid: values come back, the same bytes however they come, a long pause begins anew."""

from __future__ import annotations

import gzip
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from palpate.experiment.dataset import traces
from tests.experiment.session.bench import HEADER

values = st.lists(st.one_of(st.just(float("nan")), st.floats(-1e4, 1e4)), min_size=1, max_size=60)


def written(
    folder: Path, places: Sequence[float], samples: Sequence[NDArray[np.float64]], decimals: int = 2
) -> dict[str, bytes]:
    """Return the tables of a trace at 2 kHz, by their names, unpacked."""
    traces.write(
        folder,
        HEADER,
        "foot",
        places=np.array(places, np.float64),
        samples=samples,
        columns={"height": traces.Column("Height.", "mm", decimals), "gap": traces.Column("Along.", "N", 1)},
        rate_hz=2000.0,
        description="A foot.",
        origin="REHEARSAL",
    )
    return {one.name.split("_")[2]: gzip.decompress(one.read_bytes()) for one in folder.rglob("*.tsv.gz")}


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(values, st.integers(0, 4))
def test_samples_come_back_to_the_last_decimal(tmp_path: Path, values: list[float], decimals: int) -> None:
    samples = np.column_stack([values, np.full(len(values), np.nan)])
    (text,) = written(tmp_path, range(len(values)), [samples], decimals).values()
    rows = [line.split("\t") for line in text.decode().splitlines()]
    assert len(rows) == len(values)
    for (cell, gap), value in zip(rows, values, strict=True):
        assert gap == "n/a"
        if np.isnan(value):
            assert cell == "n/a"
        else:
            assert float(cell) == pytest.approx(value, abs=0.500001 * 10.0**-decimals)


def test_the_sidecar_describes_the_recording(tmp_path: Path) -> None:
    written(tmp_path, [-1000.0], [np.ones((1, 2))])
    (path,) = tmp_path.rglob("*.json")
    sidecar = json.loads(path.read_text())
    assert (sidecar["SamplingFrequency"], sidecar["StartTime"]) == (2000.0, -0.5)
    assert sidecar["Columns"] == ["height", "gap"]
    assert sidecar["height"] == {"Description": "Height.", "Units": "mm"}
    assert str(sidecar["Description"]).startswith("REHEARSAL")


@pytest.mark.parametrize("seed", range(4))
def test_a_trace_in_blocks_is_the_one_of_a_grid_in_one_piece(tmp_path: Path, seed: int) -> None:
    """Blocks step back by some places, share some, are empty, and one has a pause after which a new trace begins.

    The reference is all of the grid as text, packed at once, as releases until 0.2.0 wrote it.
    """
    rng = np.random.default_rng(seed)
    steps = rng.choice([-3, 0, 1, 1, 1, 1, 2, 40], 400)
    steps[250], steps[310] = 700 * 2000, 70_000
    places, samples = 50.0 + np.cumsum(steps), rng.normal(0, 3, (400, 2))
    samples[rng.random((400, 2)) < 0.2] = np.nan
    cuts = np.sort(rng.integers(0, 400, 12))
    found = written(tmp_path, places.tolist(), [*np.split(samples, cuts), np.empty((0, 2))])
    assert len(found) == 2
    for name, at in {"recording-foot": slice(250), "recording-foot2": slice(250, 400)}.items():
        grid = np.full((int(np.ptp(places[at])) + 1, 2), np.nan)
        for place, row in zip((places[at] - places[at].min()).astype(int), samples[at], strict=True):
            grid[place] = row
        lines = [f"{height:.2f}\t{gap:.1f}\n" for height, gap in grid.tolist()]
        assert found[name] == "".join(lines).replace("nan", "n/a").encode()
    for packed in tmp_path.rglob("*.tsv.gz"):
        content = packed.read_bytes()
        assert content == gzip.compress(gzip.decompress(content), compresslevel=4, mtime=0)
