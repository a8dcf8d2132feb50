"""`import palpate`: what it hands out, its examples, and its notebook in a folder with a lab's own files."""

from __future__ import annotations

import doctest
import json
import os
import re
import subprocess
import sys
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

import palpate
from palpate import library
from palpate.analysis import published
from palpate.experiment.errors import (
    DatasetError,
    PowerError,
    ProtocolError,
    PublishedError,
    RecordingError,
    SynthesisError,
)
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.study import rehearse

if TYPE_CHECKING:
    from collections.abc import Callable

ROOT = Path(palpate.__file__).parent.parent
RECONSTRUCTION = ROOT / "participants" / "okamoto2012"

LONGEST_REPR = 300


def test_what_it_hands_out_is_documented_and_nothing_else() -> None:
    defined = {name for name, value in vars(library).items() if getattr(value, "__module__", "") == library.__name__}
    assert {name for name in defined if not name.startswith("_")} == set(palpate.__all__)
    assert set(dir(palpate)) == {*palpate.__all__, "__version__"}
    stub = (ROOT / "palpate" / "__init__.pyi").read_text("utf-8")
    assert re.findall(r"(\w+) as \1$", stub, re.MULTILINE) == palpate.__all__
    for name in palpate.__all__:
        text = getattr(palpate, name).__doc__
        assert all(f"\n    {part}\n    ---" in text for part in ("Parameters", "Returns", "Raises")), name
    with pytest.raises(AttributeError):
        _ = palpate.rehearse  # type: ignore[attr-defined]


def test_it_imports_nothing_until_it_is_asked() -> None:
    loaded = "import palpate, sys; print([name for name in sys.modules if name.startswith('palpate.')])"
    done = subprocess.run([sys.executable, "-c", loaded], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_its_examples_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    found = doctest.testmod(library)
    assert found.attempted >= 10
    assert found.failed == 0


@pytest.mark.parametrize(
    "made",
    [
        lambda: palpate.read(RECONSTRUCTION),
        lambda: palpate.identify(RECONSTRUCTION),
        lambda: palpate.audit("okamoto2012"),
        lambda: palpate.power("okamoto2012", participants=[5, 6], studies=20),
        lambda: palpate.contact([0.0, 0.1], [0.1, 0.0], stiffness_n_m=100.0),
    ],
)
def test_a_result_is_short_to_read_and_becomes_a_frame(made: Callable[[], object]) -> None:
    result = made()
    assert len(repr(result)) <= LONGEST_REPR
    assert len(result.to_frame()) > 1  # type: ignore[attr-defined]


def test_a_spectrum_warns_of_what_the_command_cautions_of(tmp_path: Path) -> None:
    """100 Hz, in milliseconds that are said to be seconds: 0.1 Hz, which no skin feels."""
    time_ms = np.arange(400)
    rows = (f"{t};{v:.6f}".replace(".", ",") for t, v in zip(time_ms, np.sin(0.2 * np.pi * time_ms), strict=True))
    file = tmp_path / "logger.txt"
    file.write_text("\n".join(["zeit;a", *rows]), "cp1252")
    with pytest.warns(UserWarning, match="ms"):
        palpate.spectrum(file, time_column="zeit", time_unit="s", encoding="cp1252", decimal=",")
    with warnings.catch_warnings(action="error"):
        found = palpate.spectrum(file, time_column="zeit", time_unit="ms", encoding="cp1252", decimal=",")
    assert found.peaks[0].frequency_hz == pytest.approx(100.0, abs=0.01)
    numbered = palpate.spectrum(file, channel=1, time_column="zeit", time_unit="ms", encoding="cp1252", decimal=",")
    assert numbered.recording.channel == "a"


def test_a_spectrum_of_samples_without_times_has_the_rate_that_is_stated(tmp_path: Path) -> None:
    file = tmp_path / "samples.txt"
    file.write_text("a\n" + "".join(f"{v:.6f}\n" for v in np.sin(0.2 * np.pi * np.arange(400))), "utf-8")
    for rate in (1000, 2000):
        assert palpate.spectrum(file, rate=rate).peaks[0].frequency_hz == pytest.approx(rate / 10, rel=1e-3)


def test_the_power_of_a_notebook_has_a_bar_when_asked(capfd: pytest.CaptureFixture[str]) -> None:
    for asked in (False, True):
        palpate.power("okamoto2012", participants=(5,), studies=1, progress=asked)
        assert bool(capfd.readouterr().err) == asked


def test_every_row_of_power_names_its_correction() -> None:
    frame = palpate.power("okamoto2012", participants=[5, 6], studies=20).to_frame()
    what = ["planned_test", "tasks", "subject", "correction", "model", "participants"]
    assert not frame.duplicated(what).any()
    assert set(frame["correction"]) == {"none", "Holm"}


def test_a_spring_pushes_as_deep_as_the_hand_is() -> None:
    times_s = np.linspace(0.0, 0.1, 11)
    height_m = 0.01 - 0.2 * times_s
    touch = palpate.contact(times_s, height_m, stiffness_n_m=300.0)
    np.testing.assert_allclose(touch.to_frame()["x_n"], 300.0 * np.maximum(-height_m, 0.0), atol=1e-12)


def test_a_study_of_another_kind_names_the_function_that_takes_it() -> None:
    with pytest.raises(DatasetError) as error:
        palpate.compare(RECONSTRUCTION)
    assert "palpate.identify" in str(error.value.finding.remedy)


@pytest.mark.parametrize(
    ("wrong", "error"),
    [
        (lambda folder: palpate.read(folder / "none"), DatasetError),
        (lambda folder: palpate.identify(folder / "none"), DatasetError),
        (lambda folder: palpate.audit(folder / "none"), PublishedError),
        (lambda folder: palpate.power(folder / "none.toml"), ProtocolError),
        (lambda _: palpate.power("okamoto2012", alpha=2.0), PowerError),
        (lambda folder: palpate.spectrum(folder / "none.wav"), RecordingError),
        (lambda folder: palpate.crinkle(folder / "none", "copy paper", 60.0), RecordingError),
    ],
)
def test_what_is_not_there_is_refused(tmp_path: Path, wrong: Callable[[Path], object], error: type[Exception]) -> None:
    with pytest.raises(error):
        wrong(tmp_path)


def test_a_heights_shape_is_refused() -> None:
    with pytest.raises(SynthesisError):
        palpate.contact([0.0, 0.1], [0.1], stiffness_n_m=1.0)


NOTEBOOK = """
import json, sys
import matplotlib.pyplot as plt

shared, seen = {}, []
for cell in json.load(open(sys.argv[1], encoding="utf-8"))["cells"]:
    if cell["cell_type"] == "code":
        exec("".join(cell["source"]), shared)
tables = {task: shared["table"](task).round(2).to_numpy().tolist() for task in ("virtual", "real")}
import analysis, experiment
print(json.dumps({"tables": tables, "figures": len(plt.get_fignums()), "own": [analysis.OWN, experiment.OWN]}))
"""


def test_the_notebook_runs_beside_a_labs_own_files(tmp_path: Path) -> None:
    for name in ("analysis.py", "experiment.py"):
        (tmp_path / name).write_text("OWN = True\n", "utf-8")
    (tmp_path / "participants").symlink_to(ROOT / "participants")
    protocol, rig = shipped("okamoto2012.toml"), shipped("rigs/rehearsal.toml")
    rehearse(protocol_file=protocol, rig_file=rig, out=tmp_path / "rehearsal", participants=1, seed=1)
    notebook = ROOT / "analysis" / "notebook.ipynb"
    assert len(json.loads(notebook.read_text("utf-8"))["cells"]) >= 10
    done = subprocess.run(
        [sys.executable, "-c", NOTEBOOK, str(notebook)],
        cwd=tmp_path,
        env={**os.environ, "MPLBACKEND": "Agg"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["own"] == [True, True]
    assert found["figures"] == 3
    printed = published.load("okamoto2012")
    assert printed is not None
    materials = list(palpate.read(RECONSTRUCTION).materials)
    compared = 0
    for cell in printed.tables():
        if cell.presented == cell.answered and cell.task in found["tables"]:
            place = materials.index(cell.presented)
            assert abs(found["tables"][cell.task][place][place] - float(cell.mean.text)) <= 0.0051
            compared += 1
    assert compared == 8
