"""Profiles in time against closed forms, and against numpy's own transforms."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from palpate.experiment.errors import ProtocolError
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.kinds import phases as page_phases
from palpate.experiment.rehearsal.kinds.footstep import recorded_takes
from palpate.experiment.session import scene
from palpate.experiment.session.kinds.footstep import preparation, sampling
from palpate.experiment.synthesis.crinkle import leave_out, subtract
from palpate.experiment.synthesis.signals import phase
from palpate.experiment.synthesis.spectra import spectrum
from palpate.experiment.synthesis.waveforms import prepare

RATE_HZ, SAMPLES = 2000, 500
SPEEDS_MM_S = [50.0, 100.0, 200.0]
SILENT = np.zeros((3, 1, SAMPLES))


def burst(at_s: float, *, frequency_hz: float = 150.0, decay_per_s: float = 60.0) -> NDArray[np.float64]:
    """A damped sinusoid, the answer of a minimum-phase resonance to an impulse, that begins at a time."""
    t = np.maximum(np.arange(SAMPLES) / RATE_HZ - at_s, 0.0)
    return np.asarray(np.exp(-decay_per_s * t) * np.sin(2 * np.pi * frequency_hz * t))


def bursting(*depths_mm: float) -> phase.Phased:
    """A material that bursts at these depths under the foot, so at a time of 1/v, recorded once at each speed."""
    takes = np.array([[sum(burst(depth / v) for depth in depths_mm)] for v in SPEEDS_MM_S])
    bare = subtract(speeds_mm_s=SPEEDS_MM_S, rate_hz=RATE_HZ, panel_object_takes=takes, panel_takes=SILENT)
    made = phase.with_phase({"m": bare}, {"m": takes}, "recorded")["m"]
    assert isinstance(made, phase.Phased)
    return made


def naive_profile(samples: NDArray[np.float64], rate_hz: int) -> NDArray[np.float64]:
    window = round(rate_hz * 0.005)
    return np.array([np.sqrt(np.mean(samples[i : i + window] ** 2)) for i in range(0, samples.size, window)])


def test_a_burst_at_a_depth_comes_between_two_speeds_when_the_foot_is_there() -> None:
    """Windows 40 and 20 at 50 and 100 mm/s are a depth of 10 mm: at 80 mm/s it is reached after 125 ms, window 25."""
    slow, fast, wanted = (np.eye(1, 50, k)[0] for k in (40, 20, 25))
    np.testing.assert_allclose(
        phase.interpolated(slow, fast, (1 / 80 - 1 / 50) / (1 / 100 - 1 / 50)), wanted, atol=1e-5
    )
    # 5 windows of 5 ms.
    assert phase.late_ms(wanted, np.eye(1, 50, 20)[0]) == pytest.approx(25.0, rel=1e-6)
    assert phase.late_ms(slow, slow) == 0.0
    np.testing.assert_allclose(phase.interpolated(0 * slow, 0 * slow, 0.5), np.sqrt(1 / 50), rtol=1e-9)


@pytest.mark.parametrize("samples", [12, 13])
def test_elements_of_the_fourier_transform_keep_the_energy_of_those_of_the_cosine_transform(samples: int) -> None:
    c = np.random.default_rng(1).random(samples)
    naive = np.zeros(samples // 2 + 2)
    for k in range(1, samples):
        shares = {k // 2: 1.0} if k % 2 == 0 else {k // 2: 0.5, k // 2 + 1: 0.5}
        for m, share in shares.items():
            naive[max(m, 1)] += share * c[k] ** 2
    np.testing.assert_allclose(phase.elements(c, samples) ** 2, naive[: samples // 2 + 1], rtol=1e-12)


def test_phases_of_a_known_system_are_found_from_its_amplitudes_and_profile() -> None:
    """From phases of noise: numpy's transform has the amplitudes to the last digits, and the profile within 5 %."""
    asked = burst(0.05) + 0.5 * burst(0.12)
    amplitudes = np.abs(np.fft.rfft(asked)) * 2 / SAMPLES
    amplitudes[[0, -1]] = 0.0
    wanted = naive_profile(asked, RATE_HZ)
    noise = np.random.default_rng(3).normal(size=SAMPLES)
    turns = phase.phases(amplitudes, wanted, noise, rate_hz=RATE_HZ)
    made = np.fft.irfft(amplitudes * turns * SAMPLES / 2, SAMPLES)
    np.testing.assert_allclose(np.abs(np.fft.rfft(made)) * 2 / SAMPLES, amplitudes, atol=1e-14)
    assert phase.shape_error(naive_profile(made, RATE_HZ), wanted) < 0.05
    assert phase.shape_error(naive_profile(noise, RATE_HZ), wanted) > 0.8


def test_at_recorded_speeds_the_profile_is_that_of_the_take_and_between_them_it_comes_in_between() -> None:
    of = bursting(2.0, 5.0)
    basis = prepare(of.in_time(of), material="m", output_rate_hz=8000)
    for v in SPEEDS_MM_S:
        take = burst(2.0 / v) + burst(5.0 / v)
        assert phase.shape_error(naive_profile(basis.at(v).waveform_m_s2, 8000), naive_profile(take, RATE_HZ)) < 0.05
    told, without = phase.left_out(of, 1)
    take = naive_profile(burst(0.02) + burst(0.05), RATE_HZ)
    assert phase.shape_error(told, take) < 0.5 * phase.shape_error(without, take)
    assert phase.late_ms(told, take) < 0.2 * phase.late_ms(without, take)
    recorded, left_out, drawn, late_ms, drawn_late_ms = phase.profile_error(of)
    assert recorded is not None
    assert recorded < 0.05
    assert left_out == pytest.approx(phase.shape_error(told, of.profiles[1] if of.profiles is not None else take))
    assert None not in (drawn, late_ms, drawn_late_ms)
    assert [len(row) for row in sampling.profile_rows([phase.profile_error(of)], str)] == [2] * 5
    assert sampling.profile_rows([()], str) == []


def test_a_silent_take_is_left_out_of_the_worst_and_alone_is_unknown() -> None:
    of = bursting(2.0, 5.0)
    assert of.profiles is not None
    whole = phase.profile_error(of)
    heard = of.profiles.copy()
    for silent in (0, 2):
        of.profiles[silent] = 0.0
        recorded, *_ = phase.profile_error(of)
        assert recorded is not None
        assert not np.isnan(recorded)
        of.profiles[silent] = heard[silent]
    of.profiles[1] = 0.0
    recorded, *inner = phase.profile_error(of)
    assert recorded == pytest.approx(whole[0], abs=0.05)
    assert inner == [None] * 4


def test_phases_stay_within_a_cell_and_the_ends_are_the_recorded_ones() -> None:
    of = bursting(5.0)
    made = of.in_time(of)
    assert (made.speeds_mm_s[0], made.speeds_mm_s[-1]) == (50.0, 200.0)
    assert np.all(np.diff(made.speeds_mm_s) > 0)
    # Three speeds with three cells a gap: 2 + 3 + 2 speeds of the recorded, 4 of those between each two.
    assert made.speeds_mm_s.size == 15
    # Within a cell the waveform is one of the same phases, so it is as like its ends as amplitudes are.
    basis = prepare(made, material="m", output_rate_hz=RATE_HZ)
    low, high = made.speeds_mm_s[2:4]
    first, last = (basis.at(float(v)).waveform_m_s2 for v in (low, high))
    middle = basis.at(float(low + high) / 2).waveform_m_s2
    assert np.linalg.norm(middle - (first + last) / 2) < 0.02 * np.linalg.norm(middle)


@pytest.mark.parametrize(("name", "signs"), [("zero", {1.0}), ("random", {1.0, -1.0})])
def test_other_phases_keep_every_amplitude_and_what_is_left_out(name: phase.Phase, signs: set[float]) -> None:
    bare = bursting(5.0)
    kept = leave_out(bare, band_hz=(20.0, 400.0))
    given = phase.with_phase({"m": bare}, {"m": SILENT}, name)["m"]
    made = given.in_time(kept)
    assert made.amplitudes is kept.amplitudes
    assert set(made.signs.ravel()) == signs
    assert made.left_out is kept.left_out
    # One phase for every speed.
    assert np.array_equal(made.signs[0], made.signs[-1])
    assert isinstance(given, phase.Phased)
    assert phase.profile_error(given) == ()
    recorded = bare.in_time(kept)
    assert recorded.left_out is not None
    assert recorded.left_out.at(0, 0.0) == pytest.approx(kept.left_out.at(0, 0.0) if kept.left_out else None)
    assert not recorded.amplitudes[:, :5].any()


def test_a_task_without_a_phase_gets_the_same_bits_and_no_module_and_one_with_it_its_own(tmp_path: Path) -> None:
    protocol = files.load(shipped("profile.toml"))
    folder = recorded_takes.make_recordings(tmp_path / "r", protocol=protocol, seed=1).parent
    asked = scene.plan(protocol=protocol, task_id="amplitude")
    assert (asked.phase, [one.phase for one in scene.played(protocol)]) == ("random", ["random", "recorded"])
    less = dataclasses.replace(asked, materials=("polypropylene",))
    drawn = preparation.load_spectra(scene=less, protocol=protocol, recordings=folder)["polypropylene"]
    plain_scene, module = dataclasses.replace(less, phase=None), sys.modules.pop(preparation.PHASE)
    plain = preparation.load_spectra(scene=plain_scene, protocol=protocol, recordings=folder)["polypropylene"]
    assert preparation.PHASE not in sys.modules
    sys.modules[preparation.PHASE] = module
    assert plain.in_time(plain) is plain
    assert np.array_equal(drawn.amplitudes, plain.amplitudes)
    made = preparation.prepare_stimuli({"m": drawn}, protocol=protocol, output_rate_hz=5000)["m"]
    n = plain.samples
    oracle = np.cos(np.pi * np.outer(np.arange(n) + 0.5, np.arange(1, n)) / n)
    signs = np.random.default_rng(0).choice((-1.0, 1.0), n)
    amplitudes = plain.amplitudes[1] * (np.arange(n) <= 500 if made.band else 1)
    np.testing.assert_allclose(made.at(100.0).waveform_m_s2, oracle @ (amplitudes * signs)[1:], atol=1e-9)
    assert np.abs(spectrum(made.at(100.0).waveform_m_s2))[1:] == pytest.approx(amplitudes[1:], abs=1e-9)


@pytest.mark.parametrize(
    ("old", "changed"), [('stimulus = "virtual"\nphase', 'stimulus = "real"\nphase'), ("format = 7", "format = 6")]
)
def test_a_phase_of_anything_but_a_virtual_footstep_is_refused(tmp_path: Path, old: str, changed: str) -> None:
    text = shipped("profile.toml").read_text("utf-8")
    assert old in text
    (tmp_path / "study.toml").write_text(text.replace(old, changed), "utf-8")
    with pytest.raises(ProtocolError) as refused:
        files.load(tmp_path / "study.toml")
    assert "tasks[0].phase" in [one.field for one in refused.value.findings]


def test_the_board_reads_each_phase() -> None:
    task = files.load(shipped("profile.toml")).tasks[0]
    names = ("zero", "random", "recorded")
    told = [page_phases.fact(task.model_copy(update={"phase": name})) for name in names]
    assert [words.split(":")[0] for _, words in told] == list(names)
