"""The panel with states: against a matrix exponential and `scipy.signal.lsim`, by its own file, in time."""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import linalg, signal

from palpate.experiment.errors import ProtocolError
from palpate.experiment.rehearsal.wires.modes import FINER, RINGS_S, MovingPanel, read, respond
from palpate.experiment.rehearsal.wires.panel import gain
from tests.benchmarks.felt import moved_m_s2
from tests.benchmarks.panel import off

RATE_HZ = 20_000
HEAD = "format = 1\nsimulated = true\n"
SUSPENSION = "[suspension]\nfrequency_hz = 35.0\ndamping = 0.5\n"
MODES = (
    (180.0, 0.05, 0.3),
    (360.0, 0.12, 1.0),
    (510.0, 0.03, -0.4),
    (1250.0, 0.4, 0.1),
)
"""Frequency, Hz, damping, part."""

Panel = Callable[..., Path]


@pytest.fixture
def file(tmp_path: Path) -> Panel:
    def written(modes: tuple[tuple[float, float, float], ...] = MODES, *, head: str = "", tail: str = "") -> Path:
        tables = [f"[[modes]]\nfrequency_hz = {f}\ndamping = {z}\npart = {p}\n" for f, z, p in modes]
        path = tmp_path / "panel.toml"
        path.write_text(f"{HEAD}gain_m_s2_per_v = 4.0\n{head}{SUSPENSION}{''.join(tables)}{tail}")
        return path

    return written


def transfer(
    modes: tuple[tuple[float, float, float], ...], *, gain_m_s2_per_v: float = 4.0, suspension_hz: float = 35.0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The polynomials of H in s, multiplied out: no pole and no residue."""
    under = 2 * np.pi * suspension_hz
    above: NDArray[np.float64] = np.zeros(1)
    below: NDArray[np.float64] = np.ones(1)
    for f, z, part in modes:
        w = 2 * np.pi * f
        divisor = np.array([1.0, 2 * z * w, w**2])
        above = np.asarray(np.polyadd(np.polymul(above, divisor), part * w**2 * below), dtype=np.float64)
        below = np.asarray(np.polymul(below, divisor), dtype=np.float64)
    suspended = np.array([1.0, 2 * 0.5 * under, under**2])
    numerator, denominator = np.polymul(gain_m_s2_per_v * above, [1.0, 0.0, 0.0]), np.polymul(below, suspended)
    return np.asarray(numerator, dtype=np.float64), np.asarray(denominator, dtype=np.float64)


def by_matrix_exponential(
    above: NDArray[np.float64], below: NDArray[np.float64], drive_v: NDArray[np.float64], rate_hz: float
) -> NDArray[np.float64]:
    """The controller form in units of 1,000 rad/s, stepped a sample at a time, with drive and slope as states."""
    unit = 1e3
    scaled = [poly * unit ** np.arange(poly.size)[::-1] for poly in (above, below)]
    n = below.size - 1
    top, bottom = np.pad(scaled[0], (n + 1 - scaled[0].size, 0)) / scaled[1][0], scaled[1] / scaled[1][0]
    a, b, c = np.zeros((n, n)), np.zeros((n, 1)), top[1:]
    a[0], b[0] = -bottom[1:], 1.0
    a[1:, :-1] += np.eye(n - 1)
    whole = np.zeros((n + 2, n + 2))
    whole[:n, :n], whole[:n, n : n + 1], whole[n, n + 1] = a * unit / rate_hz, b * unit / rate_hz, 1.0
    step = linalg.expm(whole)
    state, moved = np.zeros(n), np.zeros(drive_v.size)
    before = 0.0
    for i, volts in enumerate(drive_v):
        # Zero before the first sample, as of a converter that begins at rest.
        state = (step @ np.concatenate([state, [before, volts - before]]))[:n]
        moved[i], before = c @ state, volts
    return moved


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_it_moves_as_a_matrix_exponential_of_its_differential_equation_does(count: int, file: Panel) -> None:
    drive_v = np.random.default_rng(count).normal(size=2000)
    modes = MODES[:count]
    wanted = by_matrix_exponential(*transfer(modes), drive_v, RATE_HZ)
    found = respond(read(file(modes)), drive_v, rate_hz=RATE_HZ)
    assert np.abs(found - wanted).max() <= 1e-10 * np.abs(wanted).max()


def test_it_moves_as_lsim_says(file: Panel) -> None:
    drive_v = np.concatenate([[0.0], np.random.default_rng(5).normal(size=4000)])
    times_s = np.arange(drive_v.size) / RATE_HZ
    modes = MODES[1:3]
    with np.errstate(all="ignore"):
        _, wanted, _ = signal.lsim(signal.TransferFunction(*transfer(modes)), drive_v, times_s, interp=True)
    found = respond(read(file(modes)), drive_v, rate_hz=RATE_HZ)
    assert np.abs(found - wanted).max() <= 1e-6 * np.abs(wanted).max()


def test_no_sample_moves_the_panel_before_it_comes(file: Panel) -> None:
    panel = read(file())
    drive_v = np.random.default_rng(3).normal(size=500)
    later = drive_v.copy()
    later[300:] = 0.0
    one, other = (respond(panel, volts, rate_hz=RATE_HZ) for volts in (drive_v, later))
    assert np.array_equal(one[:300], other[:300])
    assert not np.allclose(one[300:310], other[300:310])


@pytest.mark.parametrize("f_hz", [20.0, 60.0, 200.0, 350.0, 480.0, 590.0])
def test_the_shipped_panel_is_in_magnitude_what_the_shipped_table_was_measured_on(
    f_hz: float, repository_root: Path
) -> None:
    panel = MovingPanel(read(repository_root / "protocols" / "rigs" / "rehearsal-panel.toml"))
    rate_hz = 5000
    times_s = np.arange(rate_hz) / rate_hz
    moved = panel.moved(np.sin(2 * np.pi * f_hz * times_s), rate_hz=rate_hz)[: times_s.size]
    settled = times_s >= 0.5
    waves = np.exp(-2j * np.pi * f_hz * times_s[settled])
    amplitude = 2 * abs(np.mean(moved[settled] * waves))
    assert amplitude == pytest.approx(float(gain(np.array([f_hz]))[0]), rel=2e-3)


def amplitudes(panel: MovingPanel, f_hz: float, volts: float) -> tuple[float, float]:
    """Those at a frequency and at three times that, of a sinusoid's last half."""
    rate_hz = 5000
    times_s = np.arange(rate_hz) / rate_hz
    moved = panel.moved(volts * np.sin(2 * np.pi * f_hz * times_s), rate_hz=rate_hz)[2500:5000]
    first, third = (2 * abs(np.mean(moved * np.exp(-2j * np.pi * k * f_hz * times_s[2500:]))) for k in (1, 3))
    return first, third


def test_a_coil_that_saturates_adds_harmonics_and_takes_amplitude(file: Panel) -> None:
    """Of E asinh(e / E): e (1 - e^2 / 8 E^2) and, to the next order, e^3 / 24 E^2 (1 - 9 e^2 / 16 E^2)."""
    soft, straight = (MovingPanel(read(file(head=head))) for head in ("soft_v = 5.0\n", ""))
    (first, third), (whole, none) = amplitudes(soft, 100.0, 1.0), amplitudes(straight, 100.0, 1.0)
    assert first / whole == pytest.approx(1 - 1 / 200, rel=3e-4)
    assert none < 1e-6 * whole
    passes = amplitudes(straight, 300.0, 1.0)[0]
    assert third / passes == pytest.approx(1 / 600 * (1 - 9 / 400), rel=3e-3)


def test_a_load_takes_gain_and_frequencies_down_and_drift_comes_with_each_stimulus(file: Panel) -> None:
    panel = read(
        file(
            tail='[load]\nname = "sand"\nmass = 0.44\ndamping = 0.1\n[drift]\ngain_db = -0.5\nfrequency_part = 0.001\n'
        )
    )
    loaded, later = panel.after(0), panel.after(10)
    assert loaded.gain_m_s2_per_v == pytest.approx(4.0 / 1.44)
    assert loaded.suspension.frequency_hz == pytest.approx(35.0 / sqrt(1.44))
    assert [mode.frequency_hz for mode in loaded.modes] == pytest.approx([f / 1.2 for f, _, _ in MODES])
    assert [mode.damping for mode in loaded.modes] == pytest.approx([z + 0.1 for _, z, _ in MODES])
    assert later.gain_m_s2_per_v == pytest.approx(loaded.gain_m_s2_per_v * 10 ** (-5 / 20))
    assert later.modes[0].frequency_hz == pytest.approx(loaded.modes[0].frequency_hz * 1.001**10)
    moving, volts = MovingPanel(panel), np.sin(np.arange(400) / 10)
    first, second = (moving.moved(volts, rate_hz=5000) for _ in range(2))
    assert np.abs(second).max() / np.abs(first).max() == pytest.approx(10 ** (-0.5 / 20), rel=0.01)


def test_phase_costs_what_the_plan_and_the_decisions_say_it_does() -> None:
    """With the gains of the table exactly: 99 to 178 % of signed bins, and 10.0 dB in a third octave."""
    signed, magnitudes, budget, thirds_db, _ = np.concatenate(list(off().values())).T
    assert [signed.min(), signed.max()] == pytest.approx([0.99, 1.78], abs=0.006)
    assert [magnitudes.min(), magnitudes.max()] == pytest.approx([0.47, 0.93], abs=0.006)
    assert [budget.min(), budget.max()] == pytest.approx([0.11, 0.39], abs=0.006)
    assert [thirds_db.min(), thirds_db.max()] == pytest.approx([0.2, 10.0], abs=0.06)


def test_it_moves_as_a_simulation_says_that_was_written_from_its_words_alone(file: Panel) -> None:
    """Saturated, loaded and with four modes; that one draws its band-limited line by a Fourier transform."""
    panel = read(file(head="soft_v = 3.0\n", tail='[load]\nname = "sand"\nmass = 0.44\ndamping = 0.1\n'))
    rng, rate_hz = np.random.default_rng(6), 5000
    volts = signal.sosfiltfilt(signal.butter(4, 500, fs=rate_hz, output="sos"), rng.normal(0.0, 4.0, 2500))
    moved = MovingPanel(panel).moved(volts * np.hanning(2500), rate_hz=rate_hz)
    wanted = moved_m_s2(panel, volts * np.hanning(2500), rate_hz=rate_hz, size=moved.size)
    assert np.linalg.norm(moved - wanted) <= 2e-3 * np.linalg.norm(wanted)


def test_it_rings_on_after_the_last_sample(file: Panel) -> None:
    moved = MovingPanel(read(file())).moved(np.ones(1000), rate_hz=5000)
    assert moved.size == 1000 + round(5000 * RINGS_S)
    assert np.abs(moved[1000:1050]).max() > 0.1 > np.abs(moved[-5:]).max()
    assert FINER > 1


@pytest.mark.parametrize(
    ("modes", "head", "field"),
    [
        (((35.1, 0.1, 1.0),), "", "modes[0].frequency_hz"),
        (((100.0, 0.1, 1.0), (100.5, 0.1, 1.0)), "", "modes[1].frequency_hz"),
        (((100.0, 1.0, 1.0),), "", "modes[0].damping"),
        ((*MODES, (900.0, 0.1, 1.0)), "", "modes"),
        (MODES, "soft_v = 0.0\n", "soft_v"),
    ],
)
def test_a_panel_that_has_no_residues_or_too_many_modes_is_refused(
    modes: tuple[tuple[float, float, float], ...], head: str, field: str, file: Panel
) -> None:
    with pytest.raises(ProtocolError) as refused:
        read(file(modes, head=head))
    assert [finding.field for finding in refused.value.findings] == [field]
