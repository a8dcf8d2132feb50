"""What a task needs, and the opening of just that."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.apparatus import opening
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.audio.masker import masker_noise
from palpate.experiment.apparatus.audio.stream import StreamSettings
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.kinds.footstep import Footstep
from palpate.experiment.protocol.models import Probe, Protocol
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.rehearsal.kinds.footstep import recorded_takes
from palpate.experiment.session import scene
from palpate.experiment.session.kinds.footstep import preparation, scene_cost
from palpate.experiment.session.kinds.footstep import scene_cost as cost
from palpate.experiment.synthesis import waveforms
from palpate.experiment.synthesis.crinkle import CrinkleSpectra, at_speed, subtract
from palpate.experiment.synthesis.spectra import inverse

STIMULUS = (
    "palpate.experiment.synthesis",
    "palpate.experiment.recordings.",
    "palpate.experiment.apparatus.panel.pcm",
    "scipy",
)


@pytest.fixture(scope="module", autouse=True)
def _once() -> Iterator[None]:
    """What a plan measures is measured once: of a spread there is a test of its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cost, "REPEATS", 1)
        yield


@pytest.fixture(scope="module")
def protocol() -> Protocol:
    return files.load(shipped("okamoto2012.toml"))


@pytest.fixture(scope="module")
def recordings(protocol: Protocol, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded_takes.make_recordings(tmp_path_factory.mktemp("made") / "r", protocol=protocol, seed=1).parent


def test_a_real_task_needs_no_synthesis_no_actuator_and_no_spectra(protocol: Protocol) -> None:
    real = scene.plan(protocol=protocol, task_id="real")
    assert (real.synthesis, real.actuator, real.materials) == (False, False, ())
    virtual = scene.plan(protocol=protocol, task_id="virtual")
    assert (virtual.synthesis, virtual.actuator, len(virtual.materials)) == (True, True, 4)


def presenting(protocol: Protocol, **materials: tuple[str, ...]) -> Protocol:
    """The protocol whose tasks present these materials."""
    tasks = (task.model_copy(update={"materials": materials.get(task.id)}) for task in protocol.tasks)
    return protocol.model_copy(update={"tasks": tuple(tasks)})


def test_a_task_holds_the_spectra_of_what_it_presents_and_of_the_maskers_probe(protocol: Protocol) -> None:
    some = presenting(protocol, virtual=("copy paper", "polypropylene"), real=("typing paper",))
    assert scene.plan(protocol=some, task_id="virtual").materials == ("copy paper", "polypropylene")
    assert scene.plan(protocol=some, task_id="real").materials == ()
    assert [one.materials for one in scene.played(some)] == [("copy paper", "polypropylene")]
    # No virtual task plays typing paper.
    assert scene.virtual(some).materials == ("copy paper", "polypropylene")
    probe = Probe(material="aluminum foil", speed_mm_s=200.0)
    probed = some.model_copy(update={"masker": some.masker.model_copy(update={"probe": probe})})
    assert scene.plan(protocol=probed, task_id="virtual").materials == ("copy paper", "aluminum foil", "polypropylene")
    quiet = probed.model_copy(update={"tasks": (probed.tasks[0].model_copy(update={"masker": "none"}),)})
    assert scene.plan(protocol=quiet, task_id="virtual").materials == ("copy paper", "polypropylene")
    real = protocol.model_copy(update={"tasks": protocol.tasks[1:]})
    # What a task without stimuli leaves out.
    assert len(scene.virtual(real).materials) == len(protocol.materials)


def test_the_plan_measures_the_spectra_that_a_task_does_not_present(
    protocol: Protocol, recordings: Path, approved: SnapshotAssertion
) -> None:
    rig_file = shipped("rigs/rehearsal.toml")
    here: dict[str, Any] = {"rig": rigs.load(rig_file), "rig_folder": rig_file.parent, "recordings": recordings}
    only = scene_cost.plan(protocol=presenting(protocol, virtual=("polypropylene",)), task_id="virtual", **here)
    (held,) = (need for need in only.needs if need.startswith("material"))
    assert held.startswith("material  polypropylene: ")
    (others,) = (omission for omission in only.left_out if omission.kind == "materials")
    assert f"{others.what}: {others.costs}" == approved
    # 2,500 amplitudes in double precision at each of the speeds are the least that a spectrum takes.
    assert others.saves_kb is not None
    assert others.saves_kb > 3 * 2500 * 8 * len(protocol.table(Footstep).synthesis.speeds_mm_s) / 1000
    assert only.budget is not None
    assert list(only.budget.materials) == ["polypropylene"]
    text = only.text()
    assert "  from the nearest " in text
    assert "copy paper" not in text.partition("error budget")[2]


def test_a_session_of_the_real_task_imports_none_of_their_modules(repository_root: Path, tmp_path: Path) -> None:
    # The whole of `palpate run` up to the tracker's port, which is missing.
    code = f"""
import sys
from pathlib import Path
from datetime import date, timedelta
from palpate.experiment.desk.terminal import TerminalConsole
from palpate.experiment.errors import TrackerError
from palpate.experiment.protocol import approval, files
from palpate.experiment.protocol.approval import sealing
from palpate.experiment.protocol.files import shipped
from palpate.experiment.session import run
from palpate.experiment.study.people import enrolling
from palpate.experiment.study.schedule import allocate
here = Path({str(tmp_path)!r})
file, rig = here / "study.toml", here / "rig.toml"
file.write_bytes(shipped("okamoto2012.toml").read_bytes())
text = shipped("rigs/rehearsal.toml").read_text().replace("simulated = true", "simulated = false")
text = text.replace("[tracker]", f"[tracker]\\ncalibrated_on = {{date.today()}}\\ncalibration_days = 30")
rig.write_text(text.replace('"rehearsal"', '"127.0.0.1:9"'))
(here / "rehearsal-response.csv").write_bytes(shipped("rigs/rehearsal-response.csv").read_bytes())
protocol = files.load(file)
today = date.today()
board, tomorrow = protocol.ethics.board, today + timedelta(1)
sealing.write(file, protocol, approval_number="1", board=board, approved_on=today, expires_on=tomorrow)
seed = next(s for s in range(99) if allocate(protocol, s)[0].tasks[0] == "real")
enrolling.enrol(file, "01", today, root=here / "dataset", seed=seed)
console = TerminalConsole(write=sys.stderr, ask=lambda _: "y", heading="")
try:
    run.run(protocol_file=file, rig_file=rig, participant="01", task_id="real", root=here / "dataset",
              recordings=None, console=console, given=())
except TrackerError:
    print([name for name in sys.modules if name.startswith({STIMULUS!r})])
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=repository_root, capture_output=True, text=True, check=False
    )
    assert done.stdout.strip() == "[]", done.stdout + done.stderr


def opens(monkeypatch: pytest.MonkeyPatch, protocol: Protocol, rig: Rig, task_id: str) -> StreamSettings:
    """What a task opens of the audio device."""
    asked: list[StreamSettings] = []
    monkeypatch.setattr(
        "palpate.experiment.apparatus.audio.stream.AudioStream", lambda settings, _: asked.append(settings)
    )
    planned = scene.plan(protocol=protocol, task_id=task_id)
    noise = None
    if planned.masker is not None:
        samples = scene.masker_samples(colour=planned.masker, rate_hz=48_000, seconds=1.0)
        full_scale_db_a = opening.audio_of(rig).headphones.full_scale_db_a
        noise = masker_noise(samples, rate_hz=48_000, pink_full_scale_db_a=full_scale_db_a, limit_db_a=70.0)
    opening.open_audio(
        rig,
        limits_m_s2=protocol.limits_m_s2 if planned.actuator else {},
        listens=planned.listens,
        masker=noise,
        clock=ManualClock(0),
        today=date(2026, 1, 1),
        device="a card",
    )
    return asked[0]


def listening(protocol: Protocol) -> Protocol:
    return protocol.model_copy(update={"answers": protocol.answers.model_copy(update={"microphone": True})})


def test_the_scene_decides_which_channels_of_the_audio_device_are_opened(
    protocol: Protocol, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Headphones on outputs 1 and 2, the actuator on 3; a microphone on input 1, the actuator's loopback on 2.
    rig = rigs.load(shipped("rigs/headless.toml"))
    virtual = opens(monkeypatch, protocol, rig, "virtual")
    assert (len(virtual.ceilings), virtual.inputs, virtual.sent, virtual.stimuli) == (3, 2, None, True)
    real = opens(monkeypatch, protocol, rig, "real")
    assert (real.ceilings, real.inputs, real.sent, real.stimuli) == (virtual.ceilings[:2], 0, None, False)
    heard = opens(monkeypatch, listening(protocol), rig, "real")
    assert (len(heard.ceilings), heard.inputs, heard.sent, heard.stimuli) == (2, 1, 0, False)


def with_masker(protocol: Protocol, task_id: str, masker: str) -> Protocol:
    tasks = tuple(t.model_copy(update={"masker": masker}) if t.id == task_id else t for t in protocol.tasks)
    return protocol.model_copy(update={"tasks": tasks})


def test_the_masker_is_a_property_of_a_task(protocol: Protocol, monkeypatch: pytest.MonkeyPatch) -> None:
    assert scene.plan(protocol=with_masker(protocol, "real", "white"), task_id="real").masker == "white"
    quiet = with_masker(protocol, "virtual", "none")
    assert scene.plan(protocol=quiet, task_id="real").masker == "pink"
    assert scene.plan(protocol=quiet, task_id="virtual").masker is None
    # The actuator sounds on its output, and the headphones stay silent.
    rig = rigs.load(shipped("rigs/headless.toml"))
    virtual = opens(monkeypatch, quiet, rig, "virtual")
    assert (virtual.ceilings[:2], virtual.ceilings[2] > 0) == ((0.0, 0.0), True)


def test_a_task_without_masker_opens_no_audio_device_unless_something_else_of_it_is_needed(protocol: Protocol) -> None:
    audio, panel = (rigs.load(shipped(f"rigs/{name}.toml")) for name in ("headless", "rehearsal"))
    quiet = with_masker(with_masker(protocol, "real", "none"), "virtual", "none")
    real, virtual = (scene.plan(protocol=quiet, task_id=task) for task in ("real", "virtual"))
    assert (real.sounds(audio), virtual.sounds(audio), virtual.sounds(panel)) == (False, True, False)
    assert scene.plan(protocol=listening(quiet), task_id="real").sounds(audio)
    assert scene_cost.sound(real, quiet, audio) == ("masker    no noise",)


def test_an_actuator_below_the_headphones_is_opened_with_them_and_stays_silent(
    protocol: Protocol, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = rigs.load(shipped("rigs/headless.toml"))
    assert rig.audio is not None
    channels = rig.audio.channels.model_copy(update={"actuator": 1, "headphones": (2, 3)})
    rig = rig.model_copy(update={"audio": rig.audio.model_copy(update={"channels": channels})})
    silent, *played = opens(monkeypatch, protocol, rig, "real").ceilings
    assert silent == 0.0
    assert len(played) == 2
    assert min(played) > 0


@pytest.fixture(scope="module")
def held(protocol: Protocol, recordings: Path) -> dict[str, CrinkleSpectra]:
    virtual = scene.plan(protocol=protocol, task_id="virtual")
    return preparation.load_spectra(scene=virtual, protocol=protocol, recordings=recordings)


def counting_up_to(protocol: Protocol, limit_mm_s: float) -> Protocol:
    """The same study, of which trials of feet above this speed do not count."""
    rules = tuple(
        rule.model_copy(update={"limit": limit_mm_s}) if rule.when == "speed-above" else rule
        for rule in protocol.exclusion
    )
    return protocol.model_copy(update={"exclusion": rules})


def outside_rms(spectra: CrinkleSpectra, speed_mm_s: float) -> float:
    """Rms of the waveform, less that of its part up to 500 Hz, in samples rather than by Parseval."""
    c = at_speed(spectra, speed_mm_s=speed_mm_s).coefficients.copy()
    c[:501] = 0.0
    return float(np.sqrt(np.mean(inverse(c) ** 2)))


def bands(spectra: dict[str, CrinkleSpectra], protocol: Protocol) -> set[str]:
    """The bands outside of which bins are left out, of all materials."""
    prepared = preparation.prepare_stimuli(spectra, protocol=protocol, output_rate_hz=5000)
    return {basis.band for basis in prepared.values()}


def test_the_shipped_study_leaves_out_no_bin_for_copy_paper_is_felt_beyond_the_band(
    protocol: Protocol, held: dict[str, CrinkleSpectra]
) -> None:
    assert bands(held, protocol) == {""}
    loudest, level = preparation.felt_outside(held, protocol)
    assert loudest == "copy paper"
    assert level == pytest.approx(outside_rms(held["copy paper"], 600.0), rel=1e-12)
    assert level > protocol.table(Footstep).tactile.floor_m_s2


def test_a_study_of_slow_feet_leaves_out_what_lies_beyond_the_band_of_every_material(
    protocol: Protocol, held: dict[str, CrinkleSpectra], recordings: Path
) -> None:
    slow = counting_up_to(protocol, 120.0)
    for spectra in held.values():
        assert max(outside_rms(spectra, v) for v in np.linspace(0, 120, 61)) < slow.table(Footstep).tactile.floor_m_s2
    virtual = scene.plan(protocol=slow, task_id="virtual")
    opened = preparation.open_stimuli(scene=virtual, protocol=slow, recordings=recordings, output_rate_hz=5000)
    for material, spectra in held.items():
        whole, band = waveforms.prepare(spectra, material=material, output_rate_hz=5000), opened[material]
        assert (band.material, band.band) == (material, ", 0 to 500 Hz")
        for speed in (40.0, 100.0, 137.0, 380.0):
            missing = whole.at(speed).waveform_m_s2 - band.at(speed).waveform_m_s2
            assert np.sqrt(np.mean(missing**2)) == pytest.approx(outside_rms(spectra, speed), rel=1e-9)
            assert band.at(speed).floored_bins <= whole.at(speed).floored_bins
        assert band.at(380.0).floored_bins > 0


def test_one_material_that_is_felt_beyond_the_band_keeps_all_bins_of_all(
    protocol: Protocol, held: dict[str, CrinkleSpectra]
) -> None:
    """At up to 350 mm/s polypropylene and typing paper would stay below 0.3 m/s^2 rms, copy paper and foil do not."""
    some = counting_up_to(protocol, 350.0)
    reached = {material: max(outside_rms(s, v) for v in (0.0, 300.0, 350.0)) for material, s in held.items()}
    assert {material for material, level in reached.items() if level < 0.3} == {"polypropylene", "typing paper"}
    assert bands(held, some) == {""}
    quiet = {material: held[material] for material in ("polypropylene", "typing paper")}
    assert bands(quiet, some) == {", 0 to 500 Hz"}


def test_where_any_speed_counts_nothing_is_left_out(protocol: Protocol, held: dict[str, CrinkleSpectra]) -> None:
    any_speed = protocol.model_copy(update={"exclusion": ()})
    assert bands(held, any_speed) == {""}


@pytest.mark.parametrize(("rms_m_s2", "pruned"), [(0.27, True), (0.33, False)])
@pytest.mark.parametrize("seconds", [0.25, 0.5, 2.0, 4.0])
def test_what_is_felt_does_not_depend_on_how_long_it_was_recorded(
    protocol: Protocol, rms_m_s2: float, pruned: bool, seconds: float
) -> None:
    """One noise above 500 Hz, of known rms, beside a tone at 100 Hz: in longer takes each bin holds less of it."""
    samples = round(5000 * seconds)
    t = np.arange(samples) / 5000
    f = np.fft.rfftfreq(samples, 1 / 5000)
    rng = np.random.default_rng(8)
    noise = np.fft.irfft(((f > 600) & (f < 2000)) * np.exp(2j * np.pi * rng.random(f.size)), samples)
    noise *= rms_m_s2 / np.sqrt(np.mean(noise**2))
    take = noise + np.sin(2 * np.pi * 100 * t)
    spectra = subtract(
        speeds_mm_s=[50.0, 300.0],
        rate_hz=5000,
        panel_object_takes=np.broadcast_to(take, (2, 1, samples)),
        panel_takes=np.zeros((2, 1, samples)),
    )
    assert bands({"noise": spectra}, protocol) == {", 0 to 500 Hz" if pruned else ""}
    assert preparation.felt_outside({"noise": spectra}, protocol)[1] == pytest.approx(rms_m_s2, rel=0.02)


def test_the_plan_lists_and_measures_what_each_task_leaves_out(
    protocol: Protocol, recordings: Path, approved: SnapshotAssertion
) -> None:
    rig = rigs.load(shipped("rigs/rehearsal.toml"))
    here: dict[str, Any] = {"rig": rig, "rig_folder": shipped("rigs/rehearsal.toml").parent, "recordings": recordings}
    real = scene_cost.plan(protocol=protocol, task_id="real", **here)
    assert {omission.kind for omission in real.left_out} == {"parts", "imports", "materials", "channels", "steps"}
    assert not any("synthesis" in need or "actuator" in need or "spectra" in need for need in real.needs)
    assert len([omission for omission in real.left_out if omission.saves is not None]) == 5
    assert all(omission.saves.ms > 0 for omission in real.left_out if omission.saves is not None)
    virtual = scene_cost.plan(protocol=protocol, task_id="virtual", **here)
    assert [omission.kind for omission in virtual.left_out] == ["steps"]
    felt = "all frequencies are requested: the part outside 0 to 500 Hz reaches 3 m/s^2 rms at up to 600 mm/s"
    assert f"bins {felt}" in " ".join(virtual.text().split())
    # The rig's response begins at 10 and ends at 600 Hz.
    assert any(need.startswith("fidelity ") and "34.64% (rms)" in need for need in virtual.needs)
    assert all(len(line) <= 100 for one in (real, virtual) for line in one.text().splitlines())
    assert " 23.9 to 39.1 % (rms)" in virtual.text()
    plain = here | {"rig": rigs.load(shipped("rigs/laboratory.toml"))}
    whole = scene_cost.plan(protocol=protocol, task_id="virtual", **plain)
    assert f"bins {felt}" in " ".join(whole.text().split())
    # How much memory a part takes differs with the machine.
    needs = [re.sub(r"\d+ kB", "N kB", need) for plan in (real, virtual, whole) for need in plan.needs]
    assert needs == approved
    assert real.budget is None
    slow = scene_cost.plan(protocol=counting_up_to(protocol, 120.0), task_id="virtual", **here)
    bins = [omission for omission in slow.left_out if omission.kind == "bins"]
    assert [omission.what.split(" of ")[2].split(",")[0] for omission in bins] == [m.id for m in protocol.materials]
    assert all(omission.saves_kb is not None and omission.saves_kb > 0 for omission in bins)
    assert all("below the floor 0.3" in omission.costs for omission in bins)
    assert all(re.match(r"[\d.]+ to [\d.]+ % \(rms\) of ", omission.costs) for omission in bins)
    never = {line for plan in (real, virtual, slow) for line in plan.text().splitlines() if "never left out" in line}
    assert never == approved(name="never left out")


def test_the_plan_names_masker_and_stream_and_what_of_the_device_is_left_out(
    protocol: Protocol, recordings: Path, approved: SnapshotAssertion
) -> None:
    # Held are 30 s of every input and of what the headphones were sent where a microphone listens, and eight places for
    # stimuli of 4 s, all float32 at 48 kHz: 11.5 MB for two inputs, and 6.1 MB.
    rig_file = shipped("rigs/headless.toml")
    here: dict[str, Any] = {"rig": rigs.load(rig_file), "rig_folder": rig_file.parent, "recordings": recordings}
    real = scene_cost.plan(protocol=protocol, task_id="real", **here)
    (channels,) = (omission for omission in real.left_out if omission.kind == "channels")
    stream = real.needs[1].partition(", ")[0]
    assert [real.needs[0], stream, channels.what] == approved
    assert channels.saves_kb == pytest.approx(48 * 4 * (30 * 2 + 8 * 4), rel=0.01)
    (sound,) = (need for need in scene_cost.sound(scene.virtual(protocol), protocol, here["rig"])[1:])
    assert sound.startswith("stream    3 outputs and 2 ")
    assert " at 48000 Hz, 17" in sound


def test_no_part_is_measured_with_the_spectra_of_the_materials(
    protocol: Protocol, recordings: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stimuli are prepared from spectra that are there: loading them is the row of the materials alone."""
    running: list[str] = []
    load, measured = preparation.load_spectra, cost.measured
    loaded_within = []

    def watched(call: Callable[[], object]) -> tuple[cost.Timing, float]:
        running.append("row")
        loaded_within.append(0)
        result = measured(call)
        running.pop()
        return result

    def counted(**given: Any) -> object:
        if running:
            loaded_within[-1] += 1
        return load(**given)

    monkeypatch.setattr(cost, "measured", watched)
    monkeypatch.setattr(preparation, "load_spectra", counted)
    rig = rigs.load(shipped("rigs/rehearsal.toml"))
    folder = shipped("rigs/rehearsal.toml").parent
    scene_cost.plan(protocol=protocol, rig=rig, rig_folder=folder, task_id="real", recordings=recordings)
    assert loaded_within == [cost.REPEATS + 1, 0, 0]


def test_what_lies_within_the_spread_of_the_repeats_is_no_saving(approved: SnapshotAssertion) -> None:
    noise, gain, loss = (
        scene_cost.Omission("bins", "some", cost.Timing(ms, 0.002), 128.0, "nothing") for ms in (-0.0001, 0.05, -0.05)
    )
    assert (noise.as_dict()["saves_ms"], noise.as_dict()["spread_ms"]) == (None, 0.002)
    assert loss.as_dict()["saves_ms"] == -0.05
    unmeasured = scene_cost.Omission("steps", "some", None, None, "nothing")
    assert [one.saved() for one in (noise, gain, unmeasured)] == approved


def test_a_spread_is_that_between_the_quartiles() -> None:
    assert cost.taken([5.0, 1.0, 2.0, 4.0, 3.0]) == cost.Timing(3.0, 2.0)


def test_what_the_plan_says_is_imported_is_not_there_before() -> None:
    time, kb = cost.import_cost(("json",))
    more, more_kb = cost.import_cost(scene_cost.STIMULUS_MODULES)
    assert more.ms > time.ms
    assert kb is None or (more_kb is not None and more_kb > kb)
