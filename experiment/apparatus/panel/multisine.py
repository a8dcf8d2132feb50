"""A panel's complex response from periodic multisines: what is played, and what is computed from what was heard.

A multisine has a line at each of `lines`, whole Hz, so that it repeats every second. Its phases are drawn anew for each
level: what a panel adds of its own, or another panel does, then differs from level to level. Player and sensor share no
clock, so each play has an unknown delay, and periods drift apart by what the clocks differ. Both are computed from the
phases and taken out. The response is the least-squares one of all periods and levels (H1; Pintelon and Schoukens,
System Identification, 2nd ed., chapter 2), and its standard error is what these differ by.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import spence

LOW_HZ, HIGHEST_PART = 5.0, 0.4
"""The lines: from the one, Hz, up to the other as a part of the lower sampling rate."""

APART = 1.01
"""From line to line, but a whole Hz at least."""

DRAWS = 50
"""So many draws of phases are made, and the one with the lowest peak is taken."""

COHERENT = 0.9
"""A line with less coherence says nothing of the panel's phase."""

_FINE = 1 << 17
"""Delays that are tried, in a second."""

_STEP = 0.01
"""Of the natural logarithm of the frequency, where a phase is computed from magnitudes."""


def lines(rate_hz: int) -> NDArray[np.int64]:
    """Return the frequencies of a multisine, whole Hz, shape (K,); `rate_hz` is the lower one of player and sensor."""
    highest = HIGHEST_PART * rate_hz
    steps = int(np.log(highest / LOW_HZ) / np.log(APART)) + 1
    return np.unique(np.rint(LOW_HZ * APART ** np.arange(steps)).astype(np.int64))


def drawn(lines_hz: NDArray[np.int64], *, rate_hz: int, rng: np.random.Generator) -> NDArray[np.complex128]:
    """Return the amplitude of each line, complex, shape (K,), of a multisine whose highest sample is 1.0.

    Power falls with the frequency, for panels move little where it is low.
    """
    shape = 1 / np.sqrt(lines_hz)
    tried = [shape * np.exp(2j * np.pi * rng.random(lines_hz.size)) for _ in range(DRAWS)]
    peaks = [float(np.abs(period(one, lines_hz, rate_hz=rate_hz)).max()) for one in tried]
    lowest = int(np.argmin(peaks))
    return np.asarray(tried[lowest] / peaks[lowest])


def period(amplitudes: NDArray[np.complex128], lines_hz: NDArray[np.int64], *, rate_hz: int) -> NDArray[np.float64]:
    """Return one second of a multisine, shape (rate_hz,)."""
    spectrum = np.zeros(rate_hz // 2 + 1, np.complex128)
    spectrum[lines_hz] = amplitudes * rate_hz / 2
    samples: NDArray[np.float64] = np.fft.irfft(spectrum, rate_hz)
    return samples


def begins(heard: NDArray[np.float64], length: int) -> int:
    """Return where the stretch of `length` samples with the most power begins in a record, shape (n,)."""
    power = np.concatenate([[0.0], np.cumsum(np.square(heard - heard.mean()))])
    return int(np.argmax(power[length:] - power[:-length]))


def spectra(steady: NDArray[np.float64], lines_hz: NDArray[np.int64], *, rate_hz: int) -> NDArray[np.complex128]:
    """Return the complex amplitude of each line in each whole second of a record, shape (P, K)."""
    whole = steady[: steady.size // rate_hz * rate_hz].reshape(-1, rate_hz)
    found: NDArray[np.complex128] = np.fft.rfft(whole, axis=1)[:, lines_hz] * 2 / rate_hz
    return found


@dataclass(frozen=True, eq=False)
class Level:
    """One level of a measurement.

    Attributes:
        played: complex amplitude of each line as it was played, 1.0 being full scale, shape (K,).
        heard: of each line in each period, m/s^2, shape (P, K).
    """

    played: NDArray[np.complex128]
    heard: NDArray[np.complex128]

    @property
    def rms(self) -> float:
        """Of what was played."""
        return float(np.sqrt(np.square(np.abs(self.played)).sum() / 2))


@dataclass(frozen=True, eq=False)
class Estimate:
    """A panel's response for a small drive. Arrays have shape (K,), one value a line.

    Attributes:
        lines_hz: the frequencies.
        response_m_s2: acceleration of a sample of 1.0, complex, without any delay: what the phase has of one beside the
            least phase of a causal panel with these magnitudes is taken out.
        standard_error_m_s2: of its real part, and of its imaginary part alike.
        coherence: 1 where all that was heard is what was played, times the response.
        gains: of each level, relative to a small drive.
        drift_ppm: how much slower the sensor's clock is than the player's.
    """

    lines_hz: NDArray[np.int64]
    response_m_s2: NDArray[np.complex128]
    standard_error_m_s2: NDArray[np.float64]
    coherence: NDArray[np.float64]
    gains: tuple[float, ...]
    drift_ppm: float

    @property
    def upright(self) -> float:
        """How well its phases are the least ones of a causal panel, as `agreement` has it; negative upside down.

        Then the sensor lies so, or the actuator's wires are exchanged: nothing that moves the panel tells which.
        """
        crossed = _beside_least_phase(self.response_m_s2, self.coherence, self.lines_hz)
        return 0.0 if crossed is None else _alike(crossed, self.lines_hz)

    @property
    def standard_error_db(self) -> NDArray[np.float64]:
        """Of the response's level, dB; of its phase it is 6.6 degrees for each dB."""
        return np.asarray(20 / np.log(10) * self.standard_error_m_s2 / np.abs(self.response_m_s2))


def estimate(levels: Sequence[Level], lines_hz: NDArray[np.int64], within: NDArray[np.bool_]) -> Estimate:
    """Return the response from levels of rising amplitude, two or more; the lines `within` say how gains differ."""
    # Of the loudest level, which is heard best.
    drift_s = _drift_s(levels[-1].heard, lines_hz)
    heard = [_without_drift(level.heard, lines_hz, drift_s) for level in levels]
    means = [one.mean(axis=0) / level.played for one, level in zip(heard, levels, strict=True)]
    delays = [_delay_s(mean * means[-1].conj(), lines_hz) for mean in means]
    means = [mean * _later(lines_hz, delay) for mean, delay in zip(means, delays, strict=True)]
    heard = [one * _later(lines_hz, delay) for one, delay in zip(heard, delays, strict=True)]
    # Weighted by what is heard best, so that no line of the response is as uncertain as these gains are.
    loudest = (np.square(np.abs(levels[-1].played)) * means[-1].conj())[within]
    beside_loudest = [float((mean[within] * loudest).sum().real) for mean in means]
    gains = relative_gains([level.rms for level in levels], beside_loudest)
    played = np.concatenate(
        [np.broadcast_to(level.played * gain, one.shape) for level, gain, one in zip(levels, gains, heard, strict=True)]
    )
    everything, power = np.concatenate(heard), np.square(np.abs(played)).sum(axis=0)
    response = (everything * played.conj()).sum(axis=0) / power
    left = np.square(np.abs(everything - response * played)).sum(axis=0) / (2 * (len(everything) - 1))
    weights = np.stack([np.square(np.abs(level.played)) for level in levels])
    apart = np.stack([np.square(np.abs(mean / gain - response)) for mean, gain in zip(means, gains, strict=True)])
    # What is no noise, such as what a soft coil adds, repeats in each period and differs between levels.
    independent = np.square(weights.sum(axis=0)) / np.square(weights).sum(axis=0)
    between = (weights * apart).sum(axis=0) / (2 * (independent - 1) * weights.sum(axis=0))
    coherence = np.square(np.abs(response)) * power / np.square(np.abs(everything)).sum(axis=0)
    return Estimate(
        lines_hz=lines_hz,
        response_m_s2=response * _later(lines_hz, _own_delay_s(response, coherence, lines_hz)),
        standard_error_m_s2=np.sqrt(np.maximum(left / power, between)),
        coherence=coherence,
        gains=gains,
        drift_ppm=1e6 * drift_s,
    )


def without_drift(heard: NDArray[np.complex128], lines_hz: NDArray[np.int64]) -> NDArray[np.complex128]:
    """Return the lines of each period, shape (P, K), without what the clocks of player and sensor differ by."""
    return _without_drift(heard, lines_hz, _drift_s(heard, lines_hz))


def agreement(heard: NDArray[np.complex128], expected: NDArray[np.complex128], lines_hz: NDArray[np.int64]) -> float:
    """Return how well phases of what was heard are those of lines that were expected, shape (K,), after one delay.

    1 is all of them, -1 all upside down, and strange phases have less than 0.3 of two hundred lines in magnitude.
    """
    return _alike(heard * expected.conj(), lines_hz)


def _alike(crossed: NDArray[np.complex128], lines_hz: NDArray[np.int64]) -> float:
    """Return the mean of what lines are turned by beside others, after one delay; lines of 0 do not count."""
    turned = crossed / np.maximum(np.abs(crossed), np.finfo(float).tiny)
    left = (turned * _later(lines_hz, _delay_s(turned, lines_hz))).sum() / np.count_nonzero(turned)
    return float(np.copysign(np.abs(left), left.real))


def _without_drift(
    heard: NDArray[np.complex128], lines_hz: NDArray[np.int64], drift_s: float
) -> NDArray[np.complex128]:
    return heard * _later(lines_hz, drift_s * np.arange(len(heard), dtype=np.float64)[:, None])


def _later(lines_hz: NDArray[np.int64], delay_s: float | NDArray[np.float64]) -> NDArray[np.complex128]:
    """Return what takes a delay out of complex amplitudes."""
    return np.asarray(np.exp(2j * np.pi * lines_hz * delay_s))


def _drift_s(heard: NDArray[np.complex128], lines_hz: NDArray[np.int64]) -> float:
    """Return by how much each period, of shape (P, K), comes later than the one before it, s."""
    delays = [_delay_s(one * heard[0].conj(), lines_hz) for one in heard]
    return float(np.polyfit(np.arange(len(delays)), delays, 1)[0])


def _delay_s(crossed: NDArray[np.complex128], lines_hz: NDArray[np.int64]) -> float:
    """Return the delay, s, from -0.5 to 0.5, of lines beside others, by their product with the others' conjugates.

    They may be upside down.
    """
    spectrum = np.zeros(_FINE // 2 + 1, np.complex128)
    spectrum[lines_hz] = crossed
    fits = np.fft.irfft(spectrum, _FINE)
    at = int(np.argmax(np.abs(fits)))
    sign, delay = float(np.sign(fits[at])), at / _FINE
    for _ in range(2):
        left = np.angle(sign * crossed * _later(lines_hz, delay))
        weights = np.abs(crossed) * lines_hz
        delay -= float((weights * left).sum() / (2 * np.pi * (weights * lines_hz).sum()))
    return (delay + 0.5) % 1.0 - 0.5


def relative_gains(rms: Sequence[float], gains: Sequence[float]) -> tuple[float, ...]:
    """Return gains relative to that of no drive: a soft spring or coil changes it as the drive's power does."""
    at_zero = np.polyfit(np.square(rms), gains, 1)[1]
    return tuple(float(gain / at_zero) for gain in gains)


def _own_delay_s(
    response: NDArray[np.complex128], coherence: NDArray[np.float64], lines_hz: NDArray[np.int64]
) -> float:
    """Return the delay, s, that a response has beside the least phase that its magnitudes leave."""
    crossed = _beside_least_phase(response, coherence, lines_hz)
    return 0.0 if crossed is None else _delay_s(crossed, lines_hz)


def _beside_least_phase(
    response: NDArray[np.complex128], coherence: NDArray[np.float64], lines_hz: NDArray[np.int64]
) -> NDArray[np.complex128] | None:
    """Return what each clear line is turned by beside the least phase, 0 for others; None where too few are clear."""
    clear = coherence >= COHERENT
    if clear.sum() < 2:
        return None
    least = minimum_phase(lines_hz[clear], np.abs(response[clear]))
    crossed = np.zeros(lines_hz.size, np.complex128)
    crossed[clear] = np.exp(1j * (np.angle(response[clear]) - least))
    return crossed


def minimum_phase(frequencies_hz: NDArray[np.int64], magnitudes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the phase, rad, shape (K,), of a causal system of these magnitudes that delays as little as one can.

    Bode's relation (Network Analysis and Feedback Amplifier Design, 1945, chapter 14): the slope of ln |H| over
    ln f, times 1 / pi ln coth(|u| / 2). Beyond both ends the slope of the last half octave goes on.
    """
    logs, levels = np.log(frequencies_hz), np.log(magnitudes)
    nodes = np.linspace(logs[0], logs[-1], int((logs[-1] - logs[0]) / _STEP) + 2)
    slopes = np.diff(np.interp(nodes, logs, levels)) / np.diff(nodes)
    low, high = logs <= logs[0] + np.log(2) / 2, logs >= logs[-1] - np.log(2) / 2
    first, last = (float(np.polyfit(logs[end], levels[end], 1)[0]) for end in (low, high))
    reached = _weight(nodes[None, :] - nodes[:, None])
    phase = np.diff(reached, axis=1) @ slopes
    phase += first * (reached[:, 0] + np.pi**2 / 4) + last * (np.pi**2 / 4 - reached[:, -1])
    return np.asarray(np.interp(logs, nodes, phase / np.pi))


def _weight(u: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the integral of ln coth(|u| / 2) from 0 to u: pi^2 / 4 at infinity, by Legendre's chi of exp(-|u|)."""
    z = np.exp(-np.abs(u))
    chi = (spence(1 - z) - spence(1 + z)) / 2
    return np.asarray(np.sign(u) * 2 * (np.pi**2 / 8 - chi))
