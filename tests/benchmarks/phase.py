"""What a phase keeps of a profile in time, and costs: run `python -m tests.benchmarks.phase`, with how many sessions.

SIMULATED takes of the four materials, three at each of four speeds. Errors are medians over materials, speeds and
sessions, and at most: of profiles (5 ms) as a part of the takes', and of when the energy comes, ms. At 100 and 200 mm/s
takes are left out, and the profile is told from the neighbours: with phases that are zero, drawn, or the signs of (4);
with those of the group delay, or of minimum and excess phase, between the neighbours' first takes; with the times of
bursts moved in v, and in 1/v as `synthesis/signals/phase.py` does, of first takes and of all. `found` is with phases
found. It is compared with the three takes, and with the profile of 30 others, which takes differ less from. A ratio of
times is of one run, in turns. Not a test: it asserts nothing.
"""

from __future__ import annotations

import sys
from collections import defaultdict

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from palpate.experiment.rehearsal.kinds.footstep.recorded_takes import CRACKLES, SimulatedMaterials
from palpate.experiment.synthesis.crinkle import leave_out, subtract
from palpate.experiment.synthesis.noticing import third_octave_energies
from palpate.experiment.synthesis.signals import phase
from palpate.experiment.synthesis.spectra import inverse
from palpate.experiment.synthesis.waveforms import prepare
from tests.benchmarks.synthesis import times_us

RATE_HZ, SAMPLES, OUTPUT_HZ = 5000, 2500, 48_000
SPEEDS_MM_S = [50.0, 100.0, 200.0, 300.0]
TAKES, MANY = 3, 30
LONG = 8192

Array = NDArray[np.float64]


def takes(material: str | None, rng: np.random.Generator, number: int) -> Array:
    made = SimulatedMaterials(RATE_HZ, SAMPLES)
    return np.array(
        [[made.take(material, speed_mm_s=v, rng=rng) for _ in range(number)] for v in SPEEDS_MM_S], dtype=np.float64
    )


def recorded_phase(of: Array, bare: Array) -> phase.Phased:
    spectra = subtract(speeds_mm_s=SPEEDS_MM_S, rate_hz=RATE_HZ, panel_object_takes=of, panel_takes=bare)
    made = phase.with_phase({"": spectra}, {"": of}, "recorded")[""]
    if not isinstance(made, phase.Phased) or made.profiles is None or made.starts is None:
        raise RuntimeError("no phase is recorded")
    return made


def minimum_phase(magnitudes: Array) -> Array:
    """Return the phase of least delay that goes with magnitudes, by the folded cepstrum (Oppenheim and Schafer)."""
    cepstrum = fft.irfft(np.log(np.maximum(magnitudes, 1e-4 * magnitudes.max())), LONG)
    folded = np.concatenate([[1.0], np.full(LONG // 2 - 1, 2.0), [1.0], np.zeros(LONG // 2 - 1)])
    return np.asarray(np.imag(fft.rfft(cepstrum * folded)))


def profiles_by_way(of: phase.Phased, place: int) -> dict[str, Array]:
    """Return the profile at a speed that is left out, by each way."""
    assert of.profiles is not None
    assert of.starts is not None
    low, high = place - 1, place + 1
    v, slow, fast = (float(of.speeds_mm_s[i]) for i in (place, low, high))
    way, inverse_way = (v - slow) / (fast - slow), (1 / v - 1 / slow) / (1 / fast - 1 / slow)
    near = low if way <= 0.5 else high
    asked = (1 - way) * of.amplitudes[low] + way * of.amplitudes[high]
    firsts = [fft.rfft(of.starts[i], LONG) for i in (low, high)]
    magnitudes = (1 - way) * np.abs(firsts[0]) + way * np.abs(firsts[1])
    whole = [np.unwrap(np.angle(one)) for one in firsts]
    excess = [np.unwrap(np.angle(one) - minimum_phase(np.abs(one))) for one in firsts]

    def profile(samples: Array) -> Array:
        return phase.profile(samples, rate_hz=RATE_HZ)

    def turned(by: Array) -> Array:
        return profile(fft.irfft(magnitudes * np.exp(1j * by), LONG)[:SAMPLES])

    own = [profile(one) for one in of.starts]
    found, drawn = phase.left_out(of, place)
    return {
        "zero": profile(inverse(asked)),
        "drawn": drawn,
        "signs of (4)": profile(inverse(asked * of.signs[near])),
        "group delay": turned((1 - way) * whole[0] + way * whole[1]),
        "minimum, excess": turned(minimum_phase(magnitudes) + (1 - way) * excess[0] + way * excess[1]),
        "bursts in v, first takes": phase.interpolated(own[low], own[high], way),
        "bursts in 1/v, first takes": phase.interpolated(own[low], own[high], inverse_way),
        "bursts in v": phase.interpolated(of.profiles[low], of.profiles[high], way),
        "bursts in 1/v": phase.interpolated(of.profiles[low], of.profiles[high], inverse_way),
        "found": found,
        "other three takes": profile(np.zeros(SAMPLES)),
    }


def main() -> None:
    sessions = int(sys.argv[1]) if len(sys.argv) > 1 else 4
    off: dict[str, list[tuple[float, ...]]] = defaultdict(list)
    recorded: dict[str, list[float]] = defaultdict(list)
    levels_db: list[float] = []
    for session in range(sessions):
        rng = np.random.default_rng([42, session])
        bare = takes(None, rng, TAKES)
        for material in CRACKLES:
            of = recorded_phase(takes(material, rng, TAKES), bare)
            many = recorded_phase(takes(material, rng, MANY), takes(None, rng, MANY))
            others = recorded_phase(takes(material, rng, TAKES), bare)
            assert of.profiles is not None
            assert many.profiles is not None
            assert others.profiles is not None
            basis = prepare(of.in_time(of), material=material, output_rate_hz=OUTPUT_HZ)
            plain = prepare(leave_out(of, band_hz=(0, 2500)), material=material, output_rate_hz=OUTPUT_HZ)
            for j, v in enumerate(SPEEDS_MM_S):
                made = basis.at(v).waveform_m_s2
                has = phase.profile(made, rate_hz=OUTPUT_HZ)
                recorded[f"{material} {v:g}"].append(phase.shape_error(has, of.profiles[j]))
                with_it, without = (
                    third_octave_energies(one, 2 * made.size, OUTPUT_HZ) for one in (made, plain.at(v).waveform_m_s2)
                )
                counts = without > 1e-2 * without.sum()
                levels_db += (10 * np.log10(with_it[counts] / without[counts])).tolist()
            for j in (1, 2):
                for name, one in profiles_by_way(of, j).items():
                    one = others.profiles[j] if name.startswith("other") else one
                    off[name].append(
                        tuple(
                            error(one, wanted[j])
                            for wanted in (of.profiles, many.profiles)
                            for error in (phase.shape_error, phase.late_ms)
                        )
                    )
    print("at recorded speeds, %,median,most")
    for name, shares in recorded.items():
        print(f"{name},{100 * np.median(shares):.1f},{100 * max(shares):.1f}")
    print("left out,of 3 takes %,ms,of 30 takes %,ms")
    for name, errors in off.items():
        share, ms, share_many, ms_many = np.median(errors, axis=0)
        print(f"{name},{100 * share:.0f},{ms:.0f},{100 * share_many:.0f},{ms_many:.0f}")
    print(f"third octaves beside the signs of (4), of 1 % of the energy or more, dB,{np.mean(levels_db):.2f}")
    print(f"their SD, dB,{np.std(levels_db):.2f}")
    speeds = np.random.default_rng(0).uniform(55, 290, 64)
    turn = iter(np.tile(speeds, 100).tolist())
    times = times_us(
        {"without": lambda: plain.at(next(turn)).waveform_m_s2, "with": lambda: basis.at(next(turn)).waveform_m_s2}
    )
    without_us, with_us = (float(np.median(times[name])) for name in ("without", "with"))
    print(f"a step, us,{without_us:.1f},with phase,{with_us:.1f},ratio,{with_us / without_us:.2f}")
    print(f"memory of a material, MB,{plain.nbytes / 1e6:.1f},with phase,{basis.nbytes / 1e6:.1f}")


if __name__ == "__main__":
    main()
