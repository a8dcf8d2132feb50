"""The voltages of a stimulus: prepared for each material where possible, as sums of two waveforms, else computed.

Between two knots a bin's voltage W is a straight line of the speed, but for rounding: a knot lies d beside the bend
that it is for, and what is asked has an error e. With w, the rise of W from 2 d + e below a knot to 2 d + e above it, a
weighted sum is off by at most 2 (w_1 + w_2) a bin, however steep W is (derived in `experiment/decisions.md`). Where
that, summed over bins, with the rounding of voltages and transforms passes `MISSED`, nothing is held.

`experiment/decisions.md` has why nothing is approximated, and why every limit is kept.
"""

from bisect import bisect_right
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from math import inf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.synthesis.crinkle import CrinkleSpectra
from palpate.experiment.synthesis.shaping import AtBins, Response, Shaped, drive, response_at
from palpate.experiment.synthesis.spectra import Bins
from palpate.experiment.synthesis.waveforms import (
    LEAST,
    ROUNDING,
    Basis,
    Stimulus,
    Waveform,
    denormal_error_m_s2,
    transform_error,
)

FASTEST = 1.5
"""Waveforms are held up to this multiple of the fastest measured speed: 450 mm/s in the study of Okamoto et al."""

WASTE = 0.005
"""Part by which a stimulus in the middle between knots may be scaled down further than needed, and twice that beside it
(as far as a line lies above a convex curve): about the error of the bound `highest`.
"""

MISSED = 4e-13
"""No sample of a weighted sum is off by more than this part of the largest voltage of its piece."""

ASKED_ROUNDINGS, PLACE_ROUNDINGS, VOLTAGE_ROUNDINGS = 12, 32, 70
"""Of what is asked of a bin; of its largest amplitude and the speed, where a knot is placed; of a voltage: counted in
`experiment/decisions.md`."""

MOST_BYTES = 2**25
"""Of waveforms, held for one material: 174 of 0.5 s at 48 kHz."""


class Knot(NamedTuple):
    """A speed at which a bin bends, or a piece ends.

    `scale`, at most 1, keeps the stimulus within the limits. `waveform_v`, V, (n,), is None if no weighted sum is
    valid.
    """

    speed_mm_s: float
    scale: float
    waveform_v: NDArray[np.float64] | None


@dataclass(frozen=True)
class Piece:
    """The speeds with the same measured speeds around and the same nearest; those of `knots` rise from end to end."""

    knots: tuple[Knot, ...]
    speeds_mm_s: tuple[float, ...]


@dataclass(frozen=True)
class DrivenBasis:
    """The voltages of one material, prepared: its pieces by `Stimulus.interval` and `Stimulus.nearer`."""

    pieces: dict[tuple[int, int], Piece]

    def at(self, stimulus: Stimulus) -> tuple[NDArray[np.float64], float] | None:
        """Return the voltages, V, shape (n,), and the scale, as `shaping.drive` with that; None if not prepared."""
        piece, v = self.pieces.get((stimulus.interval, stimulus.nearer)), stimulus.speed_mm_s
        if piece is None or not piece.speeds_mm_s[0] <= v <= piece.speeds_mm_s[-1]:
            return None
        place = min(bisect_right(piece.speeds_mm_s, v), len(piece.knots) - 1)
        return _blend(piece.knots[place - 1], piece.knots[place], v)

    @property
    def nbytes(self) -> int:
        """Memory of the waveforms held."""
        return sum(
            knot.waveform_v.nbytes
            for piece in self.pieces.values()
            for knot in piece.knots
            if knot.waveform_v is not None
        )


def _blend(low: Knot, high: Knot, speed_mm_s: float) -> tuple[NDArray[np.float64], float] | None:
    """Return the weighted sum of two neighbours, V, shape (n,), and its scale; None if one of them is not held."""
    if low.waveform_v is None or high.waveform_v is None:
        return None
    way = (speed_mm_s - low.speed_mm_s) / (high.speed_mm_s - low.speed_mm_s)
    of_low, of_high = (1 - way) / low.scale, way / high.scale
    over = of_low + of_high
    voltages_v: NDArray[np.float64] = low.waveform_v * (of_low / over)
    voltages_v += high.waveform_v * (of_high / over)
    return voltages_v, 1 / over


def _ends_mm_s(spectra: CrinkleSpectra) -> dict[tuple[int, int], tuple[float, float]]:
    """Return both ends of each piece."""
    speeds = spectra.speeds_mm_s.tolist()
    ends = {}
    for i in range(len(speeds) - 1):
        middle = (speeds[i] + speeds[i + 1]) / 2
        ends[i, 0] = speeds[i], middle
        ends[i, 1] = middle, speeds[i + 1]
    *_, last = ends
    ends[last] = ends[last][0], FASTEST * speeds[-1]
    return ends


@dataclass(frozen=True)
class _Line:
    """One piece, to be prepared; `place` as in `DrivenBasis.pieces`."""

    spectra: CrinkleSpectra
    place: tuple[int, int]
    ends_mm_s: tuple[float, float]
    rate_hz: int
    at: AtBins
    bends_m_s2: NDArray[np.float64]
    gain_limit_v_per_m_s2: float
    limited: Callable[..., tuple[NDArray[np.float64], Shaped]]

    def piece(self, bending_mm_s: NDArray[np.float64]) -> Piece:
        knots = [self._knot(speed_mm_s) for speed_mm_s in bending_mm_s.tolist()]
        knots += [knot for low, high in pairwise(knots) for knot in self._taken_down(low, high)]
        # Where two knots coincide, the one without a waveform stays, so that nothing is held there.
        knots.sort(key=lambda knot: (knot.speed_mm_s, knot.waveform_v is None))
        knots = list({knot.speed_mm_s: knot for knot in knots}.values())
        loudest_v = max(float(np.abs(knot.waveform_v).max()) for knot in knots if knot.waveform_v is not None)
        gaps = (self._gap(low, high, loudest_v) for low, high in pairwise(knots))
        knots += [gap for gap in gaps if gap is not None]
        knots.sort(key=lambda knot: knot.speed_mm_s)
        return Piece(tuple(knots), tuple(knot.speed_mm_s for knot in knots))

    def bending_mm_s(self) -> NDArray[np.float64]:
        """Return the speeds at which any bin bends, both ends among them."""
        slow, fast = self.ends_mm_s
        parts = self._bending(self._amplitudes(slow), self._amplitudes(fast))[1:-1]
        return np.unique(np.concatenate([[slow, fast], np.clip(slow + parts * (fast - slow), slow, fast)]))

    def _bending(self, first_m_s2: NDArray[np.float64], last_m_s2: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where any bin bends between two ends, as parts of the way, 0 and 1 among them."""
        first, last = first_m_s2[self.at.known], last_m_s2[self.at.known]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            parts = (self.bends_m_s2 - first) / (last - first)
        return np.unique(np.concatenate([[0.0, 1.0], parts[(parts > 0) & (parts < 1)]]))

    def _taken_down(self, low: Knot, high: Knot) -> list[Knot]:
        """Return what lies between two neighbours, of which at least one is taken down."""
        if low.scale == high.scale == 1:
            return []

        first, last = (np.maximum(self._amplitudes(end.speed_mm_s), 0.0) * end.scale for end in (low, high))
        bending = self._bending(first, last)[1:-1]
        # From parts of the way between the spectra taken down to parts of the way between the speeds.
        ways = bending * high.scale / (bending * high.scale + (1 - bending) * low.scale)
        found = []
        for way in ways.tolist():
            speed_mm_s = min(low.speed_mm_s + (high.speed_mm_s - low.speed_mm_s) * way, high.speed_mm_s)
            scale = 1 / ((1 - way) / low.scale + way / high.scale)
            knot = self._knot(speed_mm_s, scale)
            found.append(knot if knot.scale == scale else knot._replace(waveform_v=None))
        return found

    def _gap(self, low: Knot, high: Knot, loudest_v: float) -> Knot | None:
        """Return a knot without a waveform between two neighbours whose weighted sum may miss or waste too much."""
        speed_mm_s = (low.speed_mm_s + high.speed_mm_s) / 2
        found = _blend(low, high, speed_mm_s)
        if found is None:
            return None
        scale = found[1]
        missed = loudest_v > 0 and self._missed_v(low, high) > MISSED * loudest_v
        wasted = scale < 1 and self.limited(self._bins(speed_mm_s))[1].scale * (1 - WASTE) > scale
        return Knot(speed_mm_s, scale, None) if missed or wasted else None

    def _missed_v(self, low: Knot, high: Knot) -> float:
        """Return the bound on what any sample between two neighbours is off by, V: see the module."""
        known, lower, on = self.at.known, self.place[0], self.spectra.grid(self.rate_hz)
        nearer = self.spectra.amplitudes[sum(self.place)][known]
        steps = high.speed_mm_s / (high.speed_mm_s - low.speed_mm_s)
        rises_v, volts_v = 0.0, np.zeros(nearer.size)
        with np.errstate(over="ignore", invalid="ignore"):
            first, last = (self._amplitudes(end.speed_mm_s)[known] * end.scale for end in (low, high))
            largest = np.vstack([self.spectra.amplitudes[lower : lower + 2, known], first, last]).max(axis=0)
            placed = PLACE_ROUNDINGS * ROUNDING * (largest + np.abs(last - first) * steps)
            for end in (first, last):
                away = np.abs(self.bends_m_s2 - end)
                off = np.where(away <= placed, away, 0.0).max(axis=0)
                beside = 2 * off + ASKED_ROUNDINGS * (ROUNDING * np.maximum(end, nearer) + LEAST)
                above_v = self._volts_v(end + beside)
                rises_v += float((above_v - self._volts_v(end - beside)).sum())
                np.maximum(volts_v, above_v, out=volts_v)
        rounded = VOLTAGE_ROUNDINGS * ROUNDING + 2 * transform_error(on)
        return 2 * rises_v + rounded * float(volts_v.sum()) + denormal_error_m_s2(self.spectra.samples)

    def _volts_v(self, amplitudes_m_s2: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return W of each known bin within the gain limit, V, (K,), as `shape_at`."""
        asked = np.maximum(amplitudes_m_s2, 0.0)
        return np.minimum(self.at.voltages_v(asked), asked * self.gain_limit_v_per_m_s2)

    def _knot(self, speed_mm_s: float, scale: float = 1.0) -> Knot:
        waveform_v, shaped = self.limited(self._bins(speed_mm_s), scale=scale)
        return Knot(speed_mm_s, shaped.scale, waveform_v)

    def _bins(self, speed_mm_s: float) -> Bins:
        coefficients = np.maximum(self._amplitudes(speed_mm_s), 0.0) * self.spectra.signs[sum(self.place)]
        return Bins(coefficients, self.spectra.samples, self.spectra.rate_hz)

    def _amplitudes(self, speed_mm_s: float) -> NDArray[np.float64]:
        """Return amplitudes as those of `at_speed`, before they are floored, m/s^2, shape (K,)."""
        lower = self.place[0]
        (slow, fast), (first, second) = (
            of[lower : lower + 2] for of in (self.spectra.speeds_mm_s, self.spectra.amplitudes)
        )
        if speed_mm_s <= fast:
            gap = fast - slow
            return np.asarray(first * ((fast - speed_mm_s) / gap) + second * ((speed_mm_s - slow) / gap))
        return np.asarray(second + (second - first) * ((speed_mm_s - fast) / (fast - slow)))


def _bends_m_s2(at: AtBins, gain_limit_v_per_m_s2: float) -> NDArray[np.float64]:
    """Return amplitudes at which a known bin may bend, m/s^2, shape (3 L + 1, K), with the gain limit; else NaN."""
    low, high = at.curves[:-1], at.curves[1:]
    low_v, high_v = at.levels_v[:-1, None], at.levels_v[1:, None]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        rise = (high_v - low_v) / (high - low)
        limited = (low_v - rise * low) / (gain_limit_v_per_m_s2 - rise)
        held_back = np.broadcast_to(high_v / gain_limit_v_per_m_s2, high.shape).copy()
    limited[~((low < limited) & (limited < high))] = np.nan
    held_back[held_back < high] = np.nan
    return np.concatenate([at.curves, limited, held_back])


class Driven(NamedTuple):
    """The voltages of a stimulus, V, shape (n,), `prepared` as a weighted sum or not, and the scale of all of it."""

    voltages_v: NDArray[np.float64]
    scale: float
    prepared: bool


class Drive:
    """What a rig that takes volts is given for each stimulus, within the limits of its panel and its amplifier."""

    def __init__(
        self,
        materials: Mapping[str, Basis],
        *,
        rate_hz: int,
        response: Response,
        gain_limit_v_per_m_s2: float,
        limit_m_s2: float = inf,
        limit_v: float = inf,
    ) -> None:
        """Prepare the voltages of these materials, by id; others are computed. Raises as `shaping.drive`."""
        self._rate_hz = rate_hz
        self.response = response
        self._gain_limit_v_per_m_s2 = gain_limit_v_per_m_s2
        self.limit_m_s2 = limit_m_s2
        self._whole = partial(drive, rate_hz=rate_hz, response=response, gain_limit_v_per_m_s2=gain_limit_v_per_m_s2)
        self._limited = partial(self._whole, limit_m_s2=limit_m_s2, limit_v=limit_v)
        self._held = {material: self.prepared(basis.spectra) for material, basis in materials.items()}

    def prepared(self, spectra: CrinkleSpectra) -> DrivenBasis:
        """Find the knots of one material and hold their waveforms. Errors are those of `shaping.drive`."""
        on = spectra.grid(self._rate_hz)
        at = response_at(self.response, spectra.samples, spectra.rate_hz, on.carried)
        bends_m_s2 = _bends_m_s2(at, self._gain_limit_v_per_m_s2)
        lines = {
            place: _Line(
                spectra, place, ends_mm_s, self._rate_hz, at, bends_m_s2, self._gain_limit_v_per_m_s2, self._limited
            )
            for place, ends_mm_s in _ends_mm_s(spectra).items()
        }
        bending_mm_s = {place: line.bending_mm_s() for place, line in lines.items()}
        basis = DrivenBasis({})
        if sum(speeds.size for speeds in bending_mm_s.values()) * on.count * 8 > MOST_BYTES:
            return basis
        for place, line in lines.items():
            basis.pieces[place] = line.piece(bending_mm_s[place])
            if basis.nbytes > MOST_BYTES:
                return DrivenBasis({})
        return basis

    @property
    def nbytes(self) -> int:
        """Memory of the voltages that are prepared."""
        return sum(held.nbytes for held in self._held.values())

    def __call__(self, stimulus: Waveform) -> Driven:
        """Return the voltages of a stimulus. Errors are those of `shaping.drive`."""
        if (
            isinstance(stimulus, Stimulus)
            and (held := self._held.get(stimulus.basis.material)) is not None
            and (found := held.at(stimulus)) is not None
        ):
            return Driven(*found, prepared=True)
        voltages_v, shaped = self._limited(stimulus.bins)
        return Driven(voltages_v, shaped.scale, prepared=False)

    def worked_out(self, stimulus: Waveform, scale: float) -> tuple[NDArray[np.float64], Shaped]:
        """Return the voltages of a stimulus that was taken down to a scale, and what shaping did, both made anew."""
        return self._whole(stimulus.bins, scale=scale)
