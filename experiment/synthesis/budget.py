"""The error budget of a waveform: what its device is handed, against what its equations ask for.

For volts it assumes what equation (7) does: the panel answers each bin alone, with a real gain. Its phase is ignored.

Each share is an rms, as a part of the rms requested, by Parseval over the bins. Every bin counts once, under what
limited it last, so the squares of the shares add up:

- `scene`: bins that the scene left out, because they are not felt, or that a recording has beyond the output rate;
- `rate`: bins at or above half of the output rate;
- `below`, `above`: bins outside the frequencies at which the panel was measured, or that its device carries; what a tap
  has at 0 Hz is below all that does not begin there;
- `held_back`: bins that the gain limit or the highest level measured limits;
- `taken_down`: what the limits of panel and amplifier take from all the others, and what the limiter cuts off;
- `table`: an estimate of what straight lines between measured values miss: how far the cubic through the four nearest
  values lies from the lines, in frequency and in level;
- `inverse`: what the inverse of a measured panel misses within its band, by the measured response, with its phase;
- `rounding`: of transforms, weights and float32 samples, from the samples themselves. Voltages are weighed with the
  steepest response in the table, so theirs is a bound.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from math import hypot, inf, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis.shaping import AtBins, Response, Shaped, response_at
from palpate.experiment.synthesis.spectra import BAND_HZ, bin_frequencies_hz, finite, inverse_on
from palpate.experiment.synthesis.waveforms import LEAST, Waveform

SHORT = 1e-9
"""A bin that falls short of what it was taken down to by more than this part was held back."""


@dataclass(frozen=True)
class Budget:
    """The shares of one stimulus, as parts of the rms `asked_m_s2`; 0 if that is 0.

    `dissimilarity_m_s2` is that of equation (6) between what is reached and what was requested. In no total are what an
    inverse moves `before` the stimulus, and its highest `gain`, at `gain_hz`, by the mean of its band; 0 without one.
    """

    asked_m_s2: float
    dissimilarity_m_s2: float
    scene: float = 0.0
    rate: float = 0.0
    below: float = 0.0
    above: float = 0.0
    held_back: float = 0.0
    taken_down: float = 0.0
    table: float = 0.0
    inverse: float = 0.0
    rounding: float = 0.0
    before: float = 0.0
    gain: float = 0.0
    gain_hz: float = 0.0

    @property
    def left_out(self) -> float:
        """The share that the rig does not carry: of bins that get nothing, and of what others are held back by."""
        return hypot(self.scene, self.rate, self.below, self.above, self.held_back)

    @property
    def total(self) -> float:
        """The share of all of it."""
        return hypot(self.left_out, self.taken_down, self.table, self.inverse, self.rounding)


def of_accelerations(
    stimulus: Waveform, *, handed_m_s2: NDArray[np.float64], limited: int, carries_hz: tuple[float, float] = (0.0, inf)
) -> Budget:
    """Return the budget of a device that takes accelerations; it was handed these, m/s^2, shape (n,).

    The limiter changed `limited` samples; the device moves the panel only at the frequencies `carries_hz`. Raises as
    `at_speed`, and `SynthesisError` for samples that are not finite and for frequencies that do not rise.
    """
    low_hz, high_hz = carries_hz
    if not low_hz < high_hz:
        raise SynthesisError(
            f"carries_hz: got {low_hz:g} to {high_hz:g} Hz; allowed: a lowest frequency below the highest"
        )
    asked, mean = _requested_amplitudes(stimulus), stimulus.mean_m_s2
    # Against the equations, and not against the waveform that was prepared, which may be wrong itself.
    off_m_s2 = finite(handed_m_s2, what="handed_m_s2") - inverse_on(asked, stimulus.on) - mean
    wanted = asked[: stimulus.on.carried]
    cut = _projected(off_m_s2, stimulus) if limited else np.zeros(wanted.size)
    beyond = _beyond(stimulus, carries_hz)
    # What the limiter changes of bins that the device does not carry changes nothing of the panel.
    unfelt = beyond["below"] | beyond["above"]
    off = sqrt(max(float(np.mean(off_m_s2**2)) - _rms(cut[unfelt]) ** 2, 0.0))
    reached = np.where(unfelt, 0.0, np.abs(wanted + cut))
    cause = "taken_down" if limited else "rounding"
    return _budget(stimulus, reached, beyond, **{cause: _share(off, _rms_asked(stimulus))})


def of_voltages(
    stimulus: Waveform,
    *,
    handed_v: NDArray[np.float64],
    voltages_v: NDArray[np.float64],
    shaped: Shaped,
    response: Response,
) -> Budget:
    """Return the budget of a device that takes volts; it was handed these, V, shape (n,). Raises as `of_accelerations`.

    `voltages_v`, V, shape (n,), and `shaped` are those of `shaping.drive` with that `response` and the scale used.
    """
    asked, whole, carried = _requested_amplitudes(stimulus), _rms_asked(stimulus), stimulus.on.carried
    missing_v = finite(handed_v, what="handed_v") - finite(voltages_v, what="voltages_v")
    within = _bending(response, stimulus)
    wanted = np.abs(asked[:carried])
    reached = np.abs(shaped.reached_m_s2)
    short = wanted - reached
    known = np.isin(np.arange(carried), np.arange(carried)[within.at.known])
    # No voltage moves a panel at 0 Hz.
    carries_hz = max(float(response.frequencies_hz[0]), LEAST), float(response.frequencies_hz[-1])
    held_back = known & (shaped.scale * wanted - reached > SHORT * wanted)
    missed = within.missed_m_s2(np.abs(shaped.coefficients_v[within.at.known]))
    steepest_m_s2_per_v = (np.diff(within.at.curves, axis=0) / np.diff(within.at.levels_v)[:, None]).max(initial=0.0)
    off_m_s2 = float(steepest_m_s2_per_v) * sqrt(float(np.mean(missing_v**2)))
    return _budget(
        stimulus,
        reached,
        _beyond(stimulus, carries_hz),
        held_back=_share(_rms(short[held_back]), whole),
        taken_down=_share(_rms(short[known & ~held_back]) if shaped.scale < 1 else 0.0, whole),
        table=_share(_rms(missed), whole),
        rounding=_share(off_m_s2, whole),
    )


def _beyond(stimulus: Waveform, carries_hz: tuple[float, float]) -> dict[str, NDArray[np.bool_]]:
    """Return which of the carried bins lie below and above a band, by the names of their shares, shape (K,) each."""
    of, (low_hz, high_hz) = stimulus.bins, carries_hz
    f = bin_frequencies_hz(bins=of.samples, rate_hz=of.rate_hz)[: stimulus.on.carried]
    return {"below": f < low_hz, "above": f > high_hz}


def _budget(
    stimulus: Waveform, reached: NDArray[np.float64], beyond: dict[str, NDArray[np.bool_]], **shares: float
) -> Budget:
    """Return a budget with the shares of what nothing carries: `reached`, m/s^2, and those `beyond` a band, (K,)."""
    asked, whole = np.abs(_requested_amplitudes(stimulus)), _rms_asked(stimulus)
    carried = reached.size
    f = bin_frequencies_hz(bins=stimulus.bins.samples, rate_hz=stimulus.bins.rate_hz)[: asked.size]
    felt = (f >= BAND_HZ[0]) & (f <= BAND_HZ[1])
    differs = asked.copy()
    differs[:carried] = np.abs(reached - asked[:carried])
    missing = {name: _rms(differs[:carried][bins]) for name, bins in beyond.items()}
    if beyond["below"][0]:
        differs[0] = 2 * abs(stimulus.mean_m_s2)
        missing["below"] = hypot(missing["below"], stimulus.mean_m_s2)
    return Budget(
        asked_m_s2=whole,
        dissimilarity_m_s2=float(differs[felt].sum()) + stimulus.omitted_m_s2[1],
        scene=_share(stimulus.omitted_m_s2[0], whole),
        rate=_share(_rms(asked[carried:]), whole),
        **{name: _share(part, whole) for name, part in missing.items()},
        **shares,
    )


def _requested_amplitudes(stimulus: Waveform) -> NDArray[np.float64]:
    """Return C'_k(v) with its sign, m/s^2, shape (K,), without the bin at 0 Hz, which sounds in no stimulus."""
    asked = stimulus.bins.coefficients.copy()
    asked[0] = 0.0
    return asked


def _rms_asked(stimulus: Waveform) -> float:
    return hypot(_rms(_requested_amplitudes(stimulus)), stimulus.omitted_m_s2[0], stimulus.mean_m_s2)


def _rms(amplitudes: NDArray[np.float64]) -> float:
    return sqrt(float(np.sum(amplitudes**2)) / 2)


def _share(part: float, whole: float) -> float:
    return part / whole if whole > 0 else 0.0


def _projected(waveform_m_s2: NDArray[np.float64], stimulus: Waveform) -> NDArray[np.float64]:
    """Return the amplitude of a waveform at each carried bin but that at 0 Hz, m/s^2."""
    on = stimulus.on
    padded = np.zeros(on.p)
    padded[: on.count] = waveform_m_s2
    amplitudes: NDArray[np.float64] = fft.dct(padded, type=2)[: on.carried * on.q : on.q] / on.count
    amplitudes[0] = 0.0
    return amplitudes


@dataclass(frozen=True, eq=False)
class Bending:
    """What straight lines between a table's values miss at the bins within it, K of them.

    `at` is the table at these bins; `in_frequency` what is missed at 0 V and each level, m/s^2, shape (1 + L, K). A bin
    is a part `way`, shape (K,), from the frequency measured at `lower` to the next.
    """

    at: AtBins
    in_frequency: NDArray[np.float64]
    lower: NDArray[np.intp]
    way: NDArray[np.float64]

    def missed_m_s2(self, voltages_v: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return how far each bin's acceleration lies from the lines, with sign, m/s^2, at one voltage a bin, (K,)."""
        levels_v, bins = self.at.levels_v, np.arange(voltages_v.size)
        lower = np.searchsorted(levels_v[1:-1], voltages_v)
        volts = np.minimum(voltages_v, levels_v[-1])
        way = (volts - levels_v[lower]) / (levels_v[lower + 1] - levels_v[lower])
        missed = self.in_frequency[lower, bins] * (1 - way) + self.in_frequency[lower + 1, bins] * way
        for row, weight in _beside_the_line(levels_v, volts, lower):
            missed += weight * self.at.curves[row, bins]
        return np.asarray(missed)


def _bending(response: Response, stimulus: Waveform) -> Bending:
    of = stimulus.bins
    return _bending_at(response, of.samples, of.rate_hz, stimulus.on.carried)


@lru_cache(maxsize=4)
def _bending_at(response: Response, samples: int, rate_hz: int, bins: int) -> Bending:
    """Return what a response's lines miss at the carried bins of recordings; it is found once and kept."""
    at = response_at(response, samples, rate_hz, bins)
    f, table_hz = bin_frequencies_hz(bins=samples, rate_hz=rate_hz)[:bins][at.known], response.frequencies_hz
    lower = np.clip(np.searchsorted(table_hz, f, side="right") - 1, 0, table_hz.size - 2)
    in_frequency = np.zeros(at.curves.shape)
    for row, weight in _beside_the_line(table_hz, f, lower):
        in_frequency[1:] += weight * response.accelerations_m_s2[row].T
    return Bending(at, in_frequency, lower, (f - table_hz[lower]) / (table_hz[lower + 1] - table_hz[lower]))


def _beside_the_line(
    measured: NDArray[np.float64], x: NDArray[np.float64], lower: NDArray[np.intp]
) -> Iterator[tuple[NDArray[np.intp], NDArray[np.float64]]]:
    """Yield places and weights, both (K,), whose weighted sum is the cubic at x (K,) less the straight line there.

    The cubic goes through the four nearest measured values, or fewer if there are fewer.
    """
    most = min(4, measured.size)
    first = np.clip(lower - 1, 0, measured.size - most)
    nodes = [measured[first + j] for j in range(most)]
    for j, node in enumerate(nodes):
        weight = np.ones_like(x)
        for other in (*nodes[:j], *nodes[j + 1 :]):
            weight *= (x - other) / (node - other)
        yield first + j, weight
    way = (x - measured[lower]) / (measured[lower + 1] - measured[lower])
    yield lower, way - 1
    yield lower + 1, -way


def other_reading(stimulus: Waveform, *, shaped: Shaped, response: Response) -> float:
    """Return how far the other reading of equation (7) would lie from what is played, as a share of what was requested.

    Played is the inverse of A, interpolated in f and e. The other interpolates W itself in f and a, between the
    inverses at the neighboring frequencies measured. Limited bins are the same in both. Raises as `at_speed`.
    """
    table = _bending(response, stimulus)
    at, measured = table.at, response.accelerations_m_s2
    wanted = np.abs(_requested_amplitudes(stimulus)[: stimulus.on.carried][at.known])
    reached, a = np.abs(shaped.reached_m_s2[at.known]), shaped.scale * wanted
    low_v, high_v = (
        AtBins(slice(None), at.levels_v, np.pad(measured[row].T, ((1, 0), (0, 0)))).voltages_v(a)
        for row in (table.lower, table.lower + 1)
    )
    other = at.amplitudes_m_s2(low_v * (1 - table.way) + high_v * table.way)
    return _share(_rms((other - reached)[a - reached <= SHORT * wanted]), _rms_asked(stimulus))
