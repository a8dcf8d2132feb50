"""The voltages of a stimulus: prepared for each material where possible, as sums of two waveforms, else computed.

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
from palpate.experiment.synthesis.waveforms import Basis, Stimulus, Waveform

FASTEST = 1.5
"""Waveforms are held up to this multiple of the fastest measured speed: 450 mm/s in the study of Okamoto et al."""

WASTE = 0.005
"""Part by which a stimulus in the middle between knots may be scaled down further than needed, and twice that beside it
(as far as a line lies above a convex curve): about the error of the bound `highest`.
"""

MISSED = 1e-12
"""A piece is not prepared if a weighted sum is off by this part of its largest voltage; transforms are by 1e-15."""

MOST_BYTES = 2**25
"""Of waveforms, held for one material: 174 of 0.5 s at 48 kHz."""


class Knot(NamedTuple):
    """A speed at which a bin bends, or a piece ends, a `part` of the way from a piece's lower end to its upper one.

    `scale`, at most 1, keeps the stimulus within the limits. `waveform_v`, V, (n,), is None if no weighted sum is
    valid.
    """

    part: float
    scale: float
    waveform_v: NDArray[np.float64] | None


@dataclass(frozen=True)
class Piece:
    """The speeds with the same measured speeds around and the same nearest; `parts` of `knots` rise from 0 to 1."""

    from_mm_s: float
    to_mm_s: float
    knots: tuple[Knot, ...]
    parts: tuple[float, ...]


@dataclass(frozen=True)
class DrivenBasis:
    """The voltages of one material, prepared: its pieces by `Stimulus.interval` and `Stimulus.nearer`."""

    pieces: dict[tuple[int, int], Piece]

    def at(self, stimulus: Stimulus) -> tuple[NDArray[np.float64], float] | None:
        """Return the voltages, V, shape (n,), and the scale, as `shaping.drive` with that; None if not prepared."""
        piece = self.pieces.get((stimulus.interval, stimulus.nearer))
        if piece is None or not piece.from_mm_s <= stimulus.speed_mm_s <= piece.to_mm_s:
            return None
        part = (stimulus.speed_mm_s - piece.from_mm_s) / (piece.to_mm_s - piece.from_mm_s)
        place = min(bisect_right(piece.parts, part), len(piece.knots) - 1)
        return _between(piece.knots[place - 1], piece.knots[place], part)

    @property
    def nbytes(self) -> int:
        """Memory of the waveforms held."""
        return sum(
            knot.waveform_v.nbytes
            for piece in self.pieces.values()
            for knot in piece.knots
            if knot.waveform_v is not None
        )


def _between(low: Knot, high: Knot, part: float) -> tuple[NDArray[np.float64], float] | None:
    """Return the weighted sum of two neighbours, V, shape (n,), and its scale; None if one of them is not held."""
    if low.waveform_v is None or high.waveform_v is None:
        return None
    way = (part - low.part) / (high.part - low.part)
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
    at: AtBins
    bends_m_s2: NDArray[np.float64]
    whole: Callable[..., tuple[NDArray[np.float64], Shaped]]
    limited: Callable[..., tuple[NDArray[np.float64], Shaped]]

    def piece(self, bending: NDArray[np.float64]) -> Piece:
        knots = [self._knot(part) for part in bending.tolist()]
        knots += [knot for low, high in pairwise(knots) for knot in self._taken_down(low, high)]
        # Where two knots coincide, the one without a waveform stays, so that nothing is held there.
        knots.sort(key=lambda knot: (knot.part, knot.waveform_v is None))
        knots = list({knot.part: knot for knot in knots}.values())
        loudest_v = max(float(np.abs(knot.waveform_v).max()) for knot in knots if knot.waveform_v is not None)
        gaps = (self._gap(low, high, loudest_v) for low, high in pairwise(knots))
        knots += [gap for gap in gaps if gap is not None]
        knots.sort(key=lambda knot: knot.part)
        return Piece(*self.ends_mm_s, tuple(knots), tuple(knot.part for knot in knots))

    def bending(self) -> NDArray[np.float64]:
        """Return where any bin bends, as parts of the way, 0 and 1 among them."""
        return self._bending(self._amplitudes(0.0), self._amplitudes(1.0))

    def _bending(self, first_m_s2: NDArray[np.float64], last_m_s2: NDArray[np.float64]) -> NDArray[np.float64]:
        first, last = first_m_s2[self.at.known], last_m_s2[self.at.known]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            parts = (self.bends_m_s2 - first) / (last - first)
        return np.unique(np.concatenate([[0.0, 1.0], parts[(parts > 0) & (parts < 1)]]))

    def _taken_down(self, low: Knot, high: Knot) -> list[Knot]:
        """Return what lies between two neighbours, of which at least one is taken down."""
        if low.scale == high.scale == 1:
            return []

        first, last = (np.maximum(self._amplitudes(end.part), 0.0) * end.scale for end in (low, high))
        bending = self._bending(first, last)[1:-1]
        # From parts of the way between the spectra taken down to parts of the way between the speeds.
        ways = bending * high.scale / (bending * high.scale + (1 - bending) * low.scale)
        found = []
        for way in ways.tolist():
            part, scale = low.part * (1 - way) + high.part * way, 1 / ((1 - way) / low.scale + way / high.scale)
            knot = self._knot(part, scale)
            found.append(knot if knot.scale == scale else knot._replace(waveform_v=None))
        return found

    def _gap(self, low: Knot, high: Knot, loudest_v: float) -> Knot | None:
        """Return a knot without a waveform between two neighbours whose middle their weighted sum misses."""
        part = (low.part + high.part) / 2
        found = _between(low, high, part)
        if found is None:
            return None
        held_v, scale = found
        wanted_v, _ = self.whole(self._bins(part), scale=scale)
        missed = np.abs(held_v - wanted_v).max() > MISSED * loudest_v
        wasted = scale < 1 and self.limited(self._bins(part))[1].scale * (1 - WASTE) > scale
        return Knot(part, scale, None) if missed or wasted else None

    def _knot(self, part: float, scale: float = 1.0) -> Knot:
        waveform_v, shaped = self.limited(self._bins(part), scale=scale)
        return Knot(part, shaped.scale, waveform_v)

    def _bins(self, part: float) -> Bins:
        coefficients = np.maximum(self._amplitudes(part), 0.0) * self.spectra.signs[sum(self.place)]
        return Bins(coefficients, self.spectra.samples, self.spectra.rate_hz)

    def _amplitudes(self, part: float) -> NDArray[np.float64]:
        """Return amplitudes before they are floored, m/s^2, shape (K,)."""
        lower, (slow, fast) = self.place[0], self.ends_mm_s
        speeds, levels = self.spectra.speeds_mm_s, self.spectra.amplitudes
        v = slow * (1 - part) + fast * part
        way = (v - speeds[lower]) / (speeds[lower + 1] - speeds[lower])
        if way <= 1:
            return np.asarray(levels[lower] * (1 - way) + levels[lower + 1] * way)
        # From the nearer speed on, as in `at_speed`.
        return np.asarray(levels[lower + 1] + (levels[lower + 1] - levels[lower]) * (way - 1))


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
            place: _Line(spectra, place, ends_mm_s, at, bends_m_s2, self._whole, self._limited)
            for place, ends_mm_s in _ends_mm_s(spectra).items()
        }
        bending = {place: line.bending() for place, line in lines.items()}
        basis = DrivenBasis({})
        if sum(parts.size for parts in bending.values()) * on.count * 8 > MOST_BYTES:
            return basis
        for place, line in lines.items():
            basis.pieces[place] = line.piece(bending[place])
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
