"""A phase spectrum beside the amplitudes of a crinkle, so that its profile in time is kept.

Okamoto et al., section 6.2: "In order to retain the profile of the stimuli in the time domain, the synthesis of the
phase spectrum should be introduced in the method." Equations (3) and (4) take the signs of the nearer speed's take. A
task may ask for another phase of the same amplitudes:

- `zero`: every sign of (5) is +, a click at contact; `random`: signs drawn once, for every session, speed and material;
- `recorded`: the profile, rms in windows of `WINDOW_S`, is that of the takes, and between recorded speeds that of

      T(q; v) = (1 - w) T(q; v_i) + w T(q; v_i+1),   w = (1/v - 1/v_i) / (1/v_i+1 - 1/v_i),

  T(q; v) being the time until which a part q of the energy has come. It is exact for all that happens at a depth under
  the foot, a fixed delay after it, and never outside the two recorded; beyond all recorded speeds the nearest is kept.

For `recorded`, a bin of the discrete Fourier transform of N samples has the amplitude A_m of the elements of (1) at and
beside it, A_m^2 = C'_2m^2 + (C'_2m-1^2 + C'_2m+1^2) / 2, which keeps their energy. Its phase is found by going to and
fro between amplitudes and profile (Gerchberg and Saxton 1972, Optik 35, 237-246), from the phase of the nearer speed's
first take; at a recorded speed the signs of (4) stay where they come nearer. Phases stay while the foot's speed is
within a cell, `CELLS` from one recorded speed to the next, and amplitudes move along the lines of (3); so a step costs
what it costs without. The coefficients of (1) of the sum are prepared, whose magnitudes are no longer C'_k but those of
a take with that phase.

The profile of takes is that of the object: a gain takes from each bin what equation (2) takes from those around it, by
`SMOOTHED_HZ`, whose answer is over within some 25 ms. `tests/benchmarks/phase.py` compares this with group delay, and
with minimum and excess phase.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import inf
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.ndimage import uniform_filter1d

from palpate.experiment.synthesis.crinkle import CrinkleSpectra, LeftOut, at_speed
from palpate.experiment.synthesis.spectra import inverse, spectrum

Phase = Literal["zero", "random", "recorded"]

WINDOW_S = 0.005
"""How long a window of the profile is, s: ours, about what touch tells apart."""

SMOOTHED_HZ = 40.0
"""Over so wide a band the gain of the object is averaged, Hz: ours; simulated profiles are nearest to the object's."""

CELLS = 3
"""Phases from one recorded speed to the next: within a cell a burst moves by a sixth of its way at most."""

GAP = 1e-6
"""Between two cells, as a part of the speed."""

ROUNDS, NEAR, BEYOND = 100, 0.005, 1.5
"""Most rounds of a search, the error of the profile that ends it, and by which power a round corrects: ours."""

LEAST = 1e-300
"""Of a transform, m/s^2, that has a phase."""

QUIET = 0.01
"""No round lifts a window below this part of the loudest further than from there."""


@dataclass(frozen=True)
class Phased(CrinkleSpectra):
    """Spectra to which a phase is to be given.

    `profiles` are those of the object, m/s^2, shape (S, W), and `starts` the first takes of it, m/s^2, shape (S, N);
    both only for `recorded`.
    """

    phase: Phase = "recorded"
    profiles: NDArray[np.float64] | None = None
    starts: NDArray[np.float64] | None = None

    def in_time(self, kept: CrinkleSpectra) -> CrinkleSpectra:
        """Return the bins that are `kept` of these with their phase, at more speeds for `recorded`."""
        if self.profiles is None or self.starts is None:
            signs = _drawn(kept.samples)[: kept.signs.shape[1]] if self.phase == "random" else 1.0
            return replace(kept, signs=np.broadcast_to(signs, kept.signs.shape))
        return _in_cells(kept, self.profiles, self.starts)


def _drawn(bins: int) -> NDArray[np.float64]:
    """Return signs of bins, the same in every session."""
    return np.asarray(np.random.default_rng(0).choice((-1.0, 1.0), bins))


def with_phase(
    spectra: Mapping[str, CrinkleSpectra], takes: Mapping[str, NDArray[np.float64]], phase: Phase
) -> dict[str, CrinkleSpectra]:
    """Return spectra by material with a phase; `takes`, m/s^2, (S, T, N), are those of panel and object behind them."""
    return {material: _phased(of, takes[material], phase) for material, of in spectra.items()}


def _phased(of: CrinkleSpectra, takes: NDArray[np.float64], phase: Phase) -> Phased:
    same = {name: getattr(of, name) for name in ("speeds_mm_s", "rate_hz", "amplitudes", "signs", "recorded")}
    if phase != "recorded":
        return Phased(**same, phase=phase)
    coefficients = spectrum(takes)
    bins = max(round(SMOOTHED_HZ * 2 * of.samples / of.rate_hz), 1)
    whole, alone = (uniform_filter1d(one, bins) for one in (np.abs(coefficients).mean(axis=1), of.amplitudes))
    gain = np.divide(alone, whole, out=np.zeros_like(whole), where=whole > 0)
    objects = inverse(coefficients * gain[:, None])
    profiles = np.sqrt(np.square(profile(objects, rate_hz=of.rate_hz)).mean(axis=1))
    return Phased(**same, phase=phase, profiles=profiles, starts=objects[:, 0])


def profile(samples: NDArray[np.float64], *, rate_hz: float) -> NDArray[np.float64]:
    """Return the rms of each window of samples, shape (..., N), one after the other, shape (..., W)."""
    edges, lengths = _windows(samples.shape[-1], rate_hz)
    return np.asarray(np.sqrt(np.add.reduceat(np.square(samples), edges, axis=-1) / lengths))


def _windows(samples: int, rate_hz: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return where windows begin, and their lengths in samples, shape (W,) each; the last one may be shorter."""
    edges = np.arange(0, samples, max(round(WINDOW_S * rate_hz), 1))
    return edges, np.diff(np.append(edges, samples))


def interpolated(slow: NDArray[np.float64], fast: NDArray[np.float64], way: float) -> NDArray[np.float64]:
    """Return the profile a part of the way, in 1/v, from one to another, all of shape (W,), of energy 1.

    One that is silent has its energy spread evenly.
    """
    edges = np.arange(slow.size + 1.0)
    parts = [_arrived(one) for one in (slow, fast)]
    # All parts at which either bends, so that straight lines between them miss nothing.
    q = np.unique(np.concatenate(parts))
    times = (1 - way) * np.interp(q, parts[0], edges) + way * np.interp(q, parts[1], edges)
    return np.asarray(np.sqrt(np.diff(np.interp(edges, times, q))))


def _arrived(of: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return which part of the energy has come at each edge of a profile's windows, shape (W + 1,), strictly rising."""
    energies = np.square(of)
    # Lest two edges coincide, whose time would be anything between.
    energies = energies + (1e-12 * energies.sum() or 1.0)
    arrived = np.append(0.0, np.cumsum(energies))
    return np.asarray(arrived / arrived[-1])


def elements(amplitudes: NDArray[np.float64], samples: int) -> NDArray[np.float64]:
    """Return A_m, shape (N // 2 + 1,), of C'_k, shape (K,), K <= N `samples`; both m/s^2. See the module."""
    energies = np.zeros(2 * (samples // 2) + 3)
    energies[1 : amplitudes.size] = np.square(amplitudes[1:])
    even, odd = energies[0:-1:2], energies[1::2]
    shared = odd / 2
    shared[0] = odd[0]  # all of it, since nothing sounds at 0 Hz
    even[1:] += shared[:-1]
    even[1:] += odd[1:] / 2
    even[0] = 0.0
    return np.sqrt(even)


def _waveform(amplitudes: NDArray[np.float64], turns: NDArray[np.complex128], samples: int) -> NDArray[np.float64]:
    return np.asarray(fft.irfft(amplitudes * turns * (samples / 2), samples))


def phases(
    amplitudes: NDArray[np.float64], wanted: NDArray[np.float64], start: NDArray[np.float64], *, rate_hz: float
) -> NDArray[np.complex128]:
    """Return exp(i phase) of each element, shape (N // 2 + 1,), whose sum comes nearest to the profile `wanted`, (W,).

    `amplitudes` are A_m, m/s^2, `start` are samples, shape (N,), whose phase is the first. A profile's level is free.
    """
    samples = start.size
    _, lengths = _windows(samples, rate_hz)
    energy = float(np.square(wanted) @ lengths)
    if energy <= 0 or not amplitudes.any():
        return np.ones(amplitudes.size, dtype=np.complex128)
    level = np.sqrt(np.square(amplitudes).sum() / 2 * samples / energy)
    aim = np.maximum(wanted, 0.0) * level
    best, moved, least = np.ones(amplitudes.size, dtype=np.complex128), start, inf
    for _ in range(ROUNDS):
        transform = fft.rfft(moved)
        turns = transform / np.maximum(np.abs(transform), LEAST)
        waveform = _waveform(amplitudes, turns, samples)
        has = profile(waveform, rate_hz=rate_hz)
        off = float(np.linalg.norm(has - aim) / np.linalg.norm(aim))
        if off < least:
            best, least = turns, off
        if off < NEAR:
            break
        gains = (aim / np.maximum(has, QUIET * aim.max())) ** BEYOND
        moved = waveform * np.repeat(gains, lengths)
    return best


class _Cell(NamedTuple):
    """Speeds, mm/s, rising, at which the phase is that for `speed_mm_s`, from the take at the place `nearer`."""

    speeds_mm_s: tuple[float, ...]
    speed_mm_s: float
    lower: int
    way: float
    nearer: int


def _cells(speeds: NDArray[np.float64]) -> list[_Cell]:
    cells, last = [], speeds.size - 1

    def at(lower: int, way: float) -> float:
        return float(1 / ((1 - way) / speeds[lower] + way / speeds[lower + 1]))

    half = 1 / (2 * CELLS)
    for j, v in enumerate(speeds.tolist()):
        low = (at(j - 1, 1 - half) * (1 + GAP),) if j else ()
        high = (at(j, half),) if j < last else ()
        lower = min(j, last - 1)
        cells.append(_Cell((*low, v, *high), v, lower, float(j - lower), j))
        for n in range(1, CELLS if j < last else 1):
            way = n / CELLS
            ends = at(j, way - half) * (1 + GAP), at(j, way + half)
            middle = at(j, way)
            cells.append(_Cell(ends, middle, j, way, j if 2 * middle <= v + speeds[j + 1] else j + 1))
    return cells


def _in_cells(kept: CrinkleSpectra, profiles: NDArray[np.float64], starts: NDArray[np.float64]) -> CrinkleSpectra:
    """Return spectra at the speeds of all cells, whose magnitudes and signs are those of the sum."""
    samples, speeds = kept.samples, kept.speeds_mm_s
    sounds = kept.amplitudes.any(axis=0)
    places, coefficients = [], []
    for cell in _cells(speeds):
        if cell.way in (0.0, 1.0):
            turns = _recorded(kept, cell.nearer, profiles[cell.nearer], starts[cell.nearer])[0]
        else:
            wanted = interpolated(profiles[cell.lower], profiles[cell.lower + 1], cell.way)
            turns = phases(_elements_at(kept, cell.speed_mm_s), wanted, starts[cell.nearer], rate_hz=kept.rate_hz)
        for speed_mm_s in cell.speeds_mm_s:
            places.append(speed_mm_s)
            if turns is None:
                coefficients.append(_magnitudes_at(kept, speed_mm_s) * kept.signs[cell.nearer])
            else:
                summed = spectrum(_waveform(_elements_at(kept, speed_mm_s), turns, samples))[: sounds.size]
                coefficients.append(np.where(sounds, summed, 0.0))
    signed, at_mm_s = np.array(coefficients), np.array(places)
    return replace(
        kept,
        speeds_mm_s=at_mm_s,
        amplitudes=np.abs(signed),
        signs=np.where(signed < 0, -1.0, 1.0),
        left_out=_left_out(kept, at_mm_s),
    )


def _elements_at(kept: CrinkleSpectra, speed_mm_s: float) -> NDArray[np.float64]:
    return elements(_magnitudes_at(kept, speed_mm_s), kept.samples)


def _magnitudes_at(kept: CrinkleSpectra, speed_mm_s: float) -> NDArray[np.float64]:
    return np.abs(at_speed(kept, speed_mm_s=speed_mm_s).coefficients)


def _recorded(
    kept: CrinkleSpectra, place: int, wanted: NDArray[np.float64], start: NDArray[np.float64]
) -> tuple[NDArray[np.complex128] | None, NDArray[np.float64]]:
    """Return the phases at a recorded speed, None where the signs of (4) come nearer, and the profile they have."""
    amplitudes = elements(kept.amplitudes[place], kept.samples)
    turns = phases(amplitudes, wanted, start, rate_hz=kept.rate_hz)
    own = np.zeros(kept.samples)
    own[: kept.amplitudes.shape[1]] = kept.amplitudes[place] * kept.signs[place]
    has, signed = (
        profile(one, rate_hz=kept.rate_hz) for one in (_waveform(amplitudes, turns, kept.samples), inverse(own))
    )
    return (None, signed) if shape_error(signed, wanted) <= shape_error(has, wanted) else (turns, has)


def _left_out(kept: CrinkleSpectra, speeds_mm_s: NDArray[np.float64]) -> LeftOut | None:
    """Return what is known of bins left out, at more speeds: between the recorded ones they are straight lines."""
    if kept.left_out is None:
        return None
    weights = np.array([np.interp(speeds_mm_s, kept.speeds_mm_s, one) for one in np.eye(kept.speeds_mm_s.size)]).T
    return LeftOut(weights @ kept.left_out.products @ weights.T, weights @ kept.left_out.sums)


def shape_error(has: NDArray[np.float64], wanted: NDArray[np.float64]) -> float:
    """Return how far a profile is from another, both (W,) and of energy 1, as a part of it; NaN for a silent one."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.linalg.norm(has / np.linalg.norm(has) - wanted / np.linalg.norm(wanted)))


def late_ms(has: NDArray[np.float64], wanted: NDArray[np.float64]) -> float:
    """Return how much earlier or later the energy of one profile comes than that of another, both (W,), mean, ms."""
    edges, parts = np.arange(has.size + 1.0), [_arrived(one) for one in (has, wanted)]
    q = np.unique(np.concatenate(parts))
    apart = np.abs(np.interp(q, parts[0], edges) - np.interp(q, parts[1], edges))
    return float(np.trapezoid(apart, q)) * WINDOW_S * 1e3


def profile_error(of: Phased) -> tuple[float | None, ...]:
    """Return how far profiles are from those of the takes at the worst speed; nothing if the phase is not `recorded`.

    First of what is asked for at recorded speeds, as a part of the takes' profile. Then at inner speeds whose takes are
    left out: the same, with phases drawn instead, and `late_ms` of both; None where there is no inner speed. Speeds at
    which what is compared is silent are left out.
    """
    if of.profiles is None or of.starts is None:
        return ()
    recorded, told = [], list[list[float]]()
    for j in range(of.speeds_mm_s.size):
        has = _recorded(of, j, of.profiles[j], of.starts[j])[1]
        recorded.append([shape_error(has, of.profiles[j])])
        if 0 < j < of.speeds_mm_s.size - 1:
            both = left_out(of, j)
            told.append([off(one, of.profiles[j]) for off in (shape_error, late_ms) for one in both])
    return *_worst(recorded, 1), *_worst(told, 4)


def _worst(of: list[list[float]], size: int) -> list[float | None]:
    """Return the largest of each of so many columns over rows without NaN; None where there is no such row."""
    rows = [row for row in of if not np.isnan(row).any()]
    return [max(each) for each in zip(*rows, strict=True)] or [None] * size


def left_out(of: Phased, place: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the profile at an inner speed, (W,), told from its neighbours alone, and with phases drawn instead."""
    if of.profiles is None or of.starts is None:
        raise ValueError("only recorded phases have a profile")
    others, v = [place - 1, place + 1], float(of.speeds_mm_s[place])
    less = CrinkleSpectra(of.speeds_mm_s[others], of.rate_hz, of.amplitudes[others], of.signs[others])
    slow, fast = less.speeds_mm_s.tolist()
    wanted = interpolated(of.profiles[others[0]], of.profiles[others[1]], (1 / v - 1 / slow) / (1 / fast - 1 / slow))
    amplitudes, near = _elements_at(less, v), others[int(2 * v > slow + fast)]
    turns = phases(amplitudes, wanted, of.starts[near], rate_hz=of.rate_hz)
    drawn = inverse(_magnitudes_at(less, v) * _drawn(of.samples))
    told, without = (profile(one, rate_hz=of.rate_hz) for one in (_waveform(amplitudes, turns, of.samples), drawn))
    return told, without
