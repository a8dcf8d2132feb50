"""What a task needs, and the opening of just that."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiment import scene, scene_cost
from experiment.apparatus import rig as rigs
from experiment.protocol import load
from experiment.protocol.models import Protocol
from experiment.protocol.shipped import shipped
from experiment.rehearsal import takes
from experiment.synthesis import engine
from experiment.synthesis.crinkle import at_speed

STIMULUS = ("experiment.synthesis", "experiment.recordings.", "experiment.apparatus.pcm_actuator", "scipy")


@pytest.fixture(scope="module")
def protocol() -> Protocol:
    return load.load(shipped("okamoto2012.toml"))


@pytest.fixture(scope="module")
def recordings(protocol: Protocol, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return takes.make_recordings(tmp_path_factory.mktemp("made") / "r", protocol=protocol, seed=1).parent


def test_a_real_task_needs_no_synthesis_no_actuator_and_no_spectra(protocol: Protocol) -> None:
    real = scene.plan(protocol=protocol, task_id="real")
    assert (real.synthesis, real.actuator, real.place, real.materials) == (False, False, True, ())
    virtual = scene.plan(protocol=protocol, task_id="virtual")
    assert (virtual.synthesis, virtual.actuator, virtual.place, len(virtual.materials)) == (True, True, False, 4)


def test_a_session_of_the_real_task_imports_none_of_their_modules(repository_root: Path, tmp_path: Path) -> None:
    # The whole of `palpate run` up to the tracker's port, which is missing.
    code = f"""
import sys
from pathlib import Path
from datetime import date, timedelta
from experiment import enrolment, roster, study
from experiment.console.terminal import TerminalConsole
from experiment.errors import TrackerError
from experiment.protocol import load, seal
from experiment.protocol.shipped import shipped
here = Path({str(tmp_path)!r})
file, rig = here / "study.toml", here / "rig.toml"
file.write_bytes(shipped("okamoto2012.toml").read_bytes())
text = shipped("rigs/rehearsal.toml").read_text().replace("simulated = true", "simulated = false")
text = text.replace("[tracker]", f"[tracker]\\ncalibrated_on = {{date.today()}}\\ncalibration_days = 30")
rig.write_text(text.replace('"rehearsal"', '"127.0.0.1:9"'))
(here / "rehearsal-response.csv").write_bytes(shipped("rigs/rehearsal-response.csv").read_bytes())
protocol = load.load(file)
today = date.today()
seal.write(file, protocol, approval_number="1", board="b", approved_on=today, expires_on=today + timedelta(1))
seed = next(s for s in range(99) if roster.allocate(protocol, s)[0].tasks[0] == "real")
enrolment.enrol(file, "01", today, root=here / "dataset", seed=seed)
console = TerminalConsole(write=sys.stderr, ask=input, heading="")
try:
    study.run(protocol_file=file, rig_file=rig, participant="01", task_id="real", root=here / "dataset",
              recordings=None, console=console)
except TrackerError:
    print([name for name in sys.modules if name.startswith({STIMULUS!r})])
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=repository_root, capture_output=True, text=True, check=False
    )
    assert done.stdout.strip() == "[]", done.stdout + done.stderr


def test_what_is_rendered_is_the_exact_stimulus_up_to_the_bins_that_are_not_felt(
    protocol: Protocol, recordings: Path
) -> None:
    virtual = scene.plan(protocol=protocol, task_id="virtual")
    render = scene.open_stimuli(scene=virtual, protocol=protocol, recordings=recordings, output_rates_hz=(5000,))
    held = scene.load_spectra(scene=virtual, protocol=protocol, recordings=recordings)
    for material, spectra in held.items():
        exact = engine.choose(spectra, output_rate_hz=5000).prepare(spectra, output_rate_hz=5000)
        promised = scene.choose(spectra, protocol, 5000).estimate.relative_error
        for speed in (40.0, 100.0, 137.0, 380.0):
            right = exact(speed).waveform_m_s2
            found = render(material, speed, 5000).waveform_m_s2
            assert np.sqrt(np.mean((found - right) ** 2)) <= promised * np.sqrt(np.mean(right**2)) + 1e-12


def test_no_bin_that_is_left_out_reaches_the_floor_at_any_speed_that_counts(
    protocol: Protocol, recordings: Path
) -> None:
    virtual = scene.plan(protocol=protocol, task_id="virtual")
    held = scene.load_spectra(scene=virtual, protocol=protocol, recordings=recordings)
    pruned = 0
    for spectra in held.values():
        if scene.choose(spectra, protocol, 5000).estimate.relative_error <= engine.EXACT:
            continue
        pruned += 1
        for speed in np.linspace(0, scene.fastest_mm_s(protocol), 61):
            outside = np.abs(at_speed(spectra, speed_mm_s=speed).coefficients[501:])
            assert outside.max() < protocol.tactile.floor_m_s2
    assert 0 < pruned < 4, "copy paper is felt beyond the band at 600 mm/s, the quiet materials are not"


def test_a_material_that_is_felt_beyond_the_band_is_rendered_exactly(protocol: Protocol, recordings: Path) -> None:
    tactile = protocol.tactile.model_copy(update={"floor_m_s2": 1e-6})
    fine = protocol.model_copy(update={"tactile": tactile})
    virtual = scene.plan(protocol=protocol, task_id="virtual")
    for spectra in scene.load_spectra(scene=virtual, protocol=protocol, recordings=recordings).values():
        choice = scene.choose(spectra, fine, 5000)
        assert choice.estimate.relative_error <= engine.EXACT


def test_the_plan_lists_and_measures_what_each_task_leaves_out(protocol: Protocol, recordings: Path) -> None:
    rig = rigs.load(shipped("rigs/rehearsal.toml"))
    real = scene_cost.plan(protocol=protocol, rig=rig, task_id="real", recordings=recordings)
    assert {omission.kind for omission in real.left_out} == {"parts", "imports", "materials", "channels", "steps"}
    assert not any("synthesis" in need or "actuator" in need or "spectra" in need for need in real.needs)
    assert len([omission for omission in real.left_out if omission.saves is not None]) == 4
    assert all(omission.saves.ms > 0 for omission in real.left_out if omission.saves is not None)
    assert real.ways == ()
    virtual = scene_cost.plan(protocol=protocol, rig=rig, task_id="virtual", recordings=recordings)
    bins = [omission for omission in virtual.left_out if omission.kind == "bins"]
    left_out = [omission.what.split(" of ")[2].split(",")[0] for omission in bins]
    assert left_out == ["aluminum foil", "polypropylene", "typing paper"]
    assert all(omission.saves_kb is not None and omission.saves_kb > 0 for omission in bins)
    assert all(f"  {name}: {when}" in virtual.text() for name, when in engine.TAKEN.items())
    for planned in (real, virtual):
        assert "never left out: tracker, gate and contact, limiter, exposure account, journal" in planned.text()


def test_no_part_is_measured_with_the_spectra_of_the_materials(
    protocol: Protocol, recordings: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stimuli are prepared from spectra that are there: loading them is the row of the materials alone."""
    running: list[str] = []
    load, measured = scene.load_spectra, scene_cost._measured
    loaded_within = []

    def watched(call: Callable[[], object]) -> tuple[scene_cost.Taken, float]:
        running.append("row")
        loaded_within.append(0)
        result = measured(call)
        running.pop()
        return result

    def counted(**given: Any) -> object:
        if running:
            loaded_within[-1] += 1
        return load(**given)

    monkeypatch.setattr(scene_cost, "_measured", watched)
    monkeypatch.setattr(scene, "load_spectra", counted)
    rig = rigs.load(shipped("rigs/rehearsal.toml"))
    scene_cost.plan(protocol=protocol, rig=rig, task_id="real", recordings=recordings)
    assert loaded_within == [scene_cost.REPEATS + 1, 0]


def test_what_lies_within_the_spread_of_the_repeats_is_no_saving() -> None:
    noise, gain, loss = (
        scene_cost.Omission("bins", "some", scene_cost.Taken(ms, 0.002), 128.0, "nothing")
        for ms in (-0.0001, 0.05, -0.05)
    )
    assert noise.saved() == "saves 128 kB; no measurable difference in time (-0.1 us, repeats spread over 2.0 us)"
    assert (noise.as_dict()["saves_ms"], noise.as_dict()["spread_ms"]) == (None, 0.002)
    assert gain.saved() == "saves 50.0 us (repeats spread over 2.0 us) and 128 kB"
    assert loss.as_dict()["saves_ms"] == -0.05


def test_a_spread_is_that_between_the_quartiles() -> None:
    assert scene_cost._taken([5.0, 1.0, 2.0, 4.0, 3.0]) == scene_cost.Taken(3.0, 2.0)


def test_what_the_plan_says_is_imported_is_not_there_before() -> None:
    time, kb = scene_cost.import_cost(("json",))
    more, more_kb = scene_cost.import_cost(scene_cost.STIMULUS_MODULES)
    assert more.ms > time.ms
    assert kb is None or (more_kb is not None and more_kb > kb)
