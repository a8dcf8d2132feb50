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
from palpate.experiment.rehearsal.footstep import recorded_takes
from palpate.experiment.rehearsal.footstep.modes import MovingPanel, read
from palpate.experiment.session import scene
from palpate.experiment.synthesis.budget import of_voltages
from palpate.experiment.synthesis.spectra import spectrum
from palpate.experiment.synthesis.waveforms import prepare

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


def main() -> None:
    protocol, rig = files.load(shipped("okamoto2012.toml")), shipped("rigs/rehearsal.toml")
    actuator, modes = rigs.load(rig).actuator, read(shipped("rigs/rehearsal-panel.toml"))
    rate_hz = actuator.rate_hz
    with tempfile.TemporaryDirectory() as folder:
        made = recorded_takes.make_recordings(Path(folder) / "recordings", protocol=protocol, seed=1).parent
        virtual = scene.plan(protocol=protocol, task_id="virtual")
        materials = scene.load_spectra(scene=virtual, protocol=protocol, recordings=made)
    drive = open_drive(rig.parent, actuator, limit_m_s2=LIMIT_M_S2)
    assert drive is not None
    heads = ("signed bins", "magnitudes", "budget", "third octaves, dB", "peak, m/s^2")
    print(f"{'material':<16}" + "".join(f"{head:>20}" for head in heads))
    for material, spectra in materials.items():
        basis, panel = prepare(spectra, material=material, output_rate_hz=rate_hz), MovingPanel(modes)
        rows = []
        for speed_mm_s in SPEEDS_MM_S.tolist():
            stimulus = basis.at(speed_mm_s)
            driven = drive(stimulus)
            moved = panel.moved(driven.voltages_v, rate_hz=rate_hz)
            _, shaped = drive.worked_out(stimulus, driven.scale)
            asked_m_s2 = stimulus.waveform_m_s2
            asked, got = spectrum(asked_m_s2), spectrum(moved[: asked_m_s2.size])
            whole = float(np.linalg.norm(asked))
            budget = of_voltages(
                stimulus,
                handed_v=driven.voltages_v,
                voltages_v=driven.voltages_v,
                shaped=shaped,
                response=drive.response,
            )
            wanted, found = thirds(asked_m_s2, rate_hz), thirds(moved, rate_hz)
            counted = wanted >= LEAST_SHARE * wanted.sum()
            off_db = np.abs(10 * np.log10(found[counted] / wanted[counted]))
            rows.append(
                (
                    float(np.linalg.norm(got - asked)) / whole,
                    float(np.linalg.norm(np.abs(got) - np.abs(asked))) / whole,
                    budget.total,
                    float(off_db.max()),
                    float(np.abs(moved).max()),
                )
            )
        low, high = (edge(np.array(rows), axis=0) for edge in (np.min, np.max))
        cells = [f"{100 * low[i]:.0f} to {100 * high[i]:.0f} %" for i in range(3)]
        cells += [f"{low[i]:.1f} to {high[i]:.1f}" for i in (3, 4)]
        print(f"{material:<16}" + "".join(f"{cell:>20}" for cell in cells))


if __name__ == "__main__":
    main()
