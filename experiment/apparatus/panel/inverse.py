"""Samples that move a measured panel as a stimulus asks, with its phase: a causal filter beside equation (7).

The filter is finite: it may begin `ahead_s` before the stimulus, which is what the prediction of contact leaves, and
rings for `TAIL_S`. Of all such filters it brings the panel nearest, by least squares over `BAND_HZ`, each octave
counting alike, to what is asked for (Kirkeby and Nelson 1999, J. Audio Eng. Soc. 47, 583-595, with a delay and a
penalty of each frequency). No frequency takes more gain than
`MOST_GAIN`; near a null less is asked for, and a null that no causal filter can invert stays in the error, which is
stated: `budget` has it of each stimulus, by the measured response, with the highest gain within the band and what
moves before the stimulus.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import fft, linalg

from palpate.experiment.apparatus.panel.movement import Movement
from palpate.experiment.errors import RigError
from palpate.experiment.synthesis import budget

if TYPE_CHECKING:
    from palpate.experiment.apparatus.panel.conditioning import Played
    from palpate.experiment.synthesis.waveforms import Waveform

BAND_HZ = (8.9, 563.0)
"""The third octaves from 10 to 500 Hz with their edges (IEC 61260-1)."""

TAIL_S = 0.3
"""How long the filter rings after the stimulus, s: ours, some 3 periods of the band's lowest frequency."""

MOST_GAIN = 1000.0
"""Times the gain of the usable band, at most: ours. A panel on a suspension of 60 Hz takes 67 at 10 Hz, and a filter
that begins 10 ms ahead up to 830 at 0 to 5 Hz: with 200 at most, third octaves are off by 2 dB and profiles by 18 %."""

INSIDE, BELOW, ABOVE = 1e-7, 1e-8, 1e-4
"""What a filter's power costs beside the error, inside the band, below and above it: ours, found by trial."""

NEAR, HARDER, ROUNDS = 0.9, 1.5, 20
"""Where a gain is nearer to the most than this part it costs more, by this factor and the excess squared."""


class Inverse:
    """The inverse of one measured panel. Its `taps`, shape (L,), begin `ahead` samples before a stimulus."""

    def __init__(self, movement: Movement, *, ahead_s: float) -> None:
        """Design the filter. Raises `RigError` if the panel was not measured up to the band, or has no filter."""
        rate_hz, lines_hz = movement.rate_hz, movement.reference.lines_hz
        if lines_hz[0] > BAND_HZ[0] or lines_hz[-1] < BAND_HZ[1]:
            got = f"a panel measured from {lines_hz[0]} to {lines_hz[-1]} Hz"
            raise RigError("actuator.inverse_ahead_ms", f"got {got}", "leave out the key", allowed="10 to 563 Hz")
        self._movement = movement
        self.ahead_s, self.ahead = ahead_s, round(ahead_s * rate_hz)
        count = self.ahead + round(TAIL_S * rate_hz)
        size = fft.next_fast_len(2 * count + rate_hz, real=True)
        f = np.fft.rfftfreq(size, 1 / rate_hz).astype(np.float64)
        full_scale = movement.measured.full_scale_m_s2
        response = movement.response_m_s2(f) / full_scale
        inside = (f >= BAND_HZ[0]) & (f <= BAND_HZ[1])
        weights = np.where(inside, BAND_HZ[0] / np.maximum(f, BAND_HZ[0]), 0.0)
        wanted = np.minimum(1.0, MOST_GAIN * np.abs(response)) * np.exp(-2j * np.pi * f * self.ahead / rate_hz)
        right = fft.irfft(np.conj(response) * weights * wanted, size)[:count]
        cost = np.where(inside, INSIDE * weights, np.where(f < BAND_HZ[0], BELOW, ABOVE))
        for _ in range(ROUNDS):
            column = fft.irfft(np.abs(response) ** 2 * weights + cost, size)[:count]
            taps = linalg.solve_toeplitz(column, right)
            gain = np.abs(fft.rfft(taps, size)) / MOST_GAIN
            if gain.max() <= 1:
                break
            cost = np.where(gain > NEAR, cost * HARDER * np.maximum(gain / NEAR, 1) ** 2, cost)
        else:
            what = f"no inverse within a gain of {MOST_GAIN:g}"
            raise RigError(
                "actuator.inverse_ahead_ms", what, "leave out the key", allowed="a panel that has such an inverse"
            )
        self.taps: NDArray[np.float64] = taps / full_scale
        self.highest_gain = float(gain.max()) * MOST_GAIN
        highest = int(np.argmax(gain * inside))
        self.gain, self.gain_hz = float(gain[highest]) * MOST_GAIN, float(f[highest])
        """The highest within the band, and where, Hz: at a null, or far below the panel's resonance."""

    def __call__(self, stimulus: Waveform) -> tuple[NDArray[np.float64], float]:
        """Return samples, shape (n + L - 1,), 1.0 being full scale, and by what they were taken down to reach it."""
        waveform = stimulus.waveform_m_s2
        size = fft.next_fast_len(waveform.size + self.taps.size - 1, real=True)
        spectrum = fft.rfft(waveform, size) * self._filter(size)
        samples: NDArray[np.float64] = fft.irfft(spectrum, size)[: waveform.size + self.taps.size - 1]
        highest = max(float(samples.max()), -float(samples.min()))
        return (samples, 1.0) if highest <= 1 else (samples / highest, 1 / highest)

    def budget(self, played: Played) -> budget.Budget:
        """Return how a played stimulus moves the panel beside what was asked for, by the measured response."""
        asked, down = played.stimulus, played.scale * played.panel_scale
        whole_m_s2, wanted = (
            self._movement.moved_m_s2(played.samples),
            down * float(np.linalg.norm(asked.waveform_m_s2)),
        )
        before = float(np.linalg.norm(whole_m_s2[: self.ahead])) / wanted if wanted else 0.0
        moved_m_s2 = whole_m_s2[self.ahead :][: asked.waveform_m_s2.size]
        found = budget.of_accelerations(asked, handed_m_s2=moved_m_s2, limited=1, carries_hz=BAND_HZ)
        found = replace(found, before=before, gain=self.gain, gain_hz=self.gain_hz)
        if down < 1:
            own = budget.of_accelerations(asked, handed_m_s2=moved_m_s2 / down, limited=1, carries_hz=BAND_HZ)
            missed = min(own.taken_down, found.taken_down)
            return replace(found, taken_down=float(np.sqrt(found.taken_down**2 - missed**2)), inverse=missed)
        return replace(found, taken_down=0.0, inverse=found.taken_down)

    @lru_cache(maxsize=4)  # noqa: B019
    def _filter(self, size: int) -> NDArray[np.complex128]:
        return np.asarray(fft.rfft(self.taps, size))
