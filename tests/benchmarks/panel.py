"""How far a panel with a phase is off from what equation (7) asks of it: run `python -m tests.benchmarks.panel`.

The simulated materials at ten speeds, shaped for the shipped rig, move the shipped causal panel (minimum phase, with
the magnitude of the shipped table). Errors are of bins with their sign, of their magnitudes, and of third octaves from
20 to 500 Hz that hold a thousandth of the energy or more, beside the budget's total, which knows magnitudes alone.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.panel.conditioning import open_drive
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.kinds.footstep import recorded_takes
from palpate.experiment.rehearsal.wires.modes import MovingPanel, read
from palpate.experiment.session import scene
from palpate.experiment.session.kinds.footstep import preparation
from palpate.experiment.synthesis.budget import of_voltages
from palpate.experiment.synthesis.spectra import spectrum
from palpate.experiment.synthesis.voltages import Drive
from palpate.experiment.synthesis.waveforms import Basis, Stimulus, prepare

SPEEDS_MM_S = np.geomspace(20.0, 600.0, 10)
LIMIT_M_S2 = 30.0
THIRDS_HZ = 1000.0 * 10.0 ** (np.arange(-17, -2) / 10)
"""Nominal 20 to 500 Hz (IEC 61260-1)."""

LEAST_SHARE = 1e-3


def thirds(waveform_m_s2: NDArray[np.float64], rate_hz: int) -> NDArray[np.float64]:
    """Energy in each third octave, shape (15,)."""
    power = np.abs(np.fft.rfft(waveform_m_s2, 4 * rate_hz)) ** 2
    f = np.arange(power.size) / 4
    return np.array([power[(f >= mid * 10**-0.05) & (f < mid * 10**0.05)].sum() for mid in THIRDS_HZ])


def off() -> dict[str, NDArray[np.float64]]:
    """Errors of each material, a row a speed: signed bins, magnitudes, the budget's total, the worst third octave in
    dB; and the peak, m/s^2, shape (10, 5).
    """
    rig = shipped("rigs/rehearsal.toml")
    actuator, panel = rigs.load(rig).actuator, MovingPanel(read(shipped("rigs/rehearsal-panel.toml")))
    drive = open_drive(rig.parent, actuator, limit_m_s2=LIMIT_M_S2)
    assert drive is not None
    return {m: np.array([off_at(basis.at(v), drive, panel) for v in SPEEDS_MM_S]) for m, basis in bases().items()}


def bases() -> dict[str, Basis]:
    """The simulated materials, prepared for the shipped rig."""
    protocol, actuator = files.load(shipped("okamoto2012.toml")), rigs.load(shipped("rigs/rehearsal.toml")).actuator
    with tempfile.TemporaryDirectory() as folder:
        made = recorded_takes.make_recordings(Path(folder) / "recordings", protocol=protocol, seed=1).parent
        virtual = scene.plan(protocol=protocol, task_id="virtual")
        materials = preparation.load_spectra(scene=virtual, protocol=protocol, recordings=made)
    return {m: prepare(spectra, material=m, output_rate_hz=actuator.rate_hz) for m, spectra in materials.items()}


def off_at(stimulus: Stimulus, drive: Drive, panel: MovingPanel) -> tuple[float, float, float, float, float]:
    """One row of `off`."""
    rate_hz, asked_m_s2 = stimulus.rate_hz, stimulus.waveform_m_s2
    volts_v, scale, _ = drive(stimulus)
    _, shaped = drive.worked_out(stimulus, scale)
    budget = of_voltages(stimulus, handed_v=volts_v, voltages_v=volts_v, shaped=shaped, response=drive.response)
    moved_m_s2 = panel.moved(volts_v, rate_hz=rate_hz)
    asked, moved = spectrum(asked_m_s2), spectrum(moved_m_s2[: asked_m_s2.size])
    whole = np.linalg.norm(asked)
    wanted, found = thirds(asked_m_s2, rate_hz), thirds(moved_m_s2, rate_hz)
    counted = wanted >= LEAST_SHARE * wanted.sum()
    return (
        float(np.linalg.norm(moved - asked) / whole),
        float(np.linalg.norm(np.abs(moved) - np.abs(asked)) / whole),
        budget.total,
        float(np.abs(10 * np.log10(found[counted] / wanted[counted])).max()),
        float(np.abs(moved_m_s2).max()),
    )


def main() -> None:
    heads = ("signed bins", "magnitudes", "budget", "third octaves, dB", "peak, m/s^2")
    print(f"{'material':<16}" + "".join(f"{head:>20}" for head in heads))
    for material, rows in off().items():
        low, high = rows.min(axis=0), rows.max(axis=0)
        cells = [f"{100 * low[i]:.0f} to {100 * high[i]:.0f} %" for i in range(3)]
        cells += [f"{low[i]:.1f} to {high[i]:.1f}" for i in (3, 4)]
        print(f"{material:<16}" + "".join(f"{cell:>20}" for cell in cells))


if __name__ == "__main__":
    main()
