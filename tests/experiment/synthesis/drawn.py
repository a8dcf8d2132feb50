"""Materials drawn at random: every shape, size and magnitude of spectra that a bound is claimed for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from palpate.experiment.synthesis.crinkle import LOUDEST_M_S2, CrinkleSpectra

RATE_HZ = 50
SHAPES = ("flat", "falling", "peak", "comb", "equal")
SIGNS = ("random", "positive", "negative", "alternating")
LEVELS = ("alike", "any", "rising", "falling", "silent at an end")


@dataclass(frozen=True)
class Family:
    """What the materials of one batch have in common.

    Attributes:
        bins: K.
        silent: bins recorded beyond these, left out.
        speeds: how many were measured.
        output_rate_hz: at which they are rendered, Hz.
        shape: over frequency.
        decades: of amplitude, from the loudest bin of a shape to the quietest.
        sounding: part of the bins that are not zero.
        signs: pattern over frequency.
        levels: from speed to speed.
        exponent: of ten, of the loudest amplitude.
    """

    bins: int
    silent: int
    speeds: int
    output_rate_hz: int
    shape: str
    decades: float
    sounding: float
    signs: str
    levels: str
    exponent: float


def families() -> st.SearchStrategy[Family]:
    """Families, small numbers of bins (1, 2, odd and prime ones among them) and speeds more often than large ones."""
    bins = st.one_of(st.integers(2, 24), st.integers(2, 12), st.sampled_from([1, 31, 33, 65, 97, 128]))
    drawn = st.builds(
        Family,
        bins=bins,
        silent=st.sampled_from([0, 0, 3]),
        speeds=st.sampled_from([2, 2, 2, 3, 3, 4, 4, 12]),
        output_rate_hz=st.sampled_from([480, 441, 50, 53, 37, 20]),
        shape=st.sampled_from(SHAPES),
        decades=st.one_of(st.floats(0, 6), st.floats(0, 300)),
        sounding=st.one_of(st.just(1.0), st.floats(0.1, 1.0)),
        signs=st.sampled_from(SIGNS),
        levels=st.sampled_from(LEVELS),
        exponent=st.one_of(st.floats(-3, 3), st.floats(-323, 300), st.floats(-316, -300), st.just(300.0)),
    )
    return drawn.filter(
        lambda family: (
            2 * (family.bins + family.silent) * family.output_rate_hz > RATE_HZ
            and family.bins * family.output_rate_hz <= 7000
        )
    )


def material(family: Family, rng: np.random.Generator) -> CrinkleSpectra:
    """One material of a family; no two share a spectrum, but for the silent and the smallest."""
    shape = (family.speeds, family.bins)
    scatter = np.ones(shape) if family.shape == "equal" else np.abs(rng.normal(size=shape))
    amplitudes = _envelope(family, rng) * scatter * (rng.random(shape) < family.sounding)
    amplitudes *= _levels(family, rng)
    loudest = amplitudes.max()
    if loudest > 0:
        with np.errstate(under="ignore"):
            amplitudes = amplitudes / loudest * 10.0**family.exponent * rng.uniform(0.5, 1.0)
    amplitudes *= min(1.0, 0.9 / max(float((amplitudes / LOUDEST_M_S2).sum(axis=1).max()), 1e-300))
    samples = family.bins + family.silent
    return CrinkleSpectra(
        speeds_mm_s=np.cumsum(rng.lognormal(3.0, 1.0, family.speeds)),
        rate_hz=RATE_HZ,
        amplitudes=amplitudes,
        signs=_signs(family, rng),
        recorded=samples if family.silent else None,
    )


def feet_mm_s(s: CrinkleSpectra, rng: np.random.Generator) -> list[float]:
    """Foot speeds: two between measured ones, one of these or right beside it, and one beyond at either end."""
    v = s.speeds_mm_s
    place = int(rng.integers(0, v.size - 1))
    measured = float(rng.choice(v))
    towards = float(rng.choice([0.0, measured, np.inf]))
    slow = float(rng.choice([0.0, v[0] * rng.random()]))
    fast = float(v[-1] + (v[-1] - v[-2]) * 10.0 ** rng.uniform(-3, 4))
    inside = (v[place] + rng.random(2) * (v[place + 1] - v[place])).tolist()
    return [*inside, float(np.nextafter(measured, towards)), slow, fast]


def _envelope(family: Family, rng: np.random.Generator) -> NDArray[np.float64]:
    place = np.arange(family.bins) / max(family.bins - 1, 1)
    if family.shape == "falling":
        depth = place
    elif family.shape == "peak":
        depth = np.abs(place - rng.random())
    elif family.shape == "comb":
        depth = (np.arange(family.bins) % rng.integers(2, 6) != 0).astype(np.float64)
    else:
        depth = np.zeros(family.bins)
    return np.asarray(10.0 ** (-family.decades * depth))


def _levels(family: Family, rng: np.random.Generator) -> NDArray[np.float64]:
    levels = np.ones((family.speeds, 1))
    if family.levels == "any":
        levels = 10.0 ** rng.uniform(-family.decades / 2, 0, levels.shape)
    elif family.levels in ("rising", "falling"):
        levels = np.cumsum(rng.random(levels.shape), axis=0)
        levels = levels if family.levels == "rising" else levels[::-1]
    elif family.levels == "silent at an end":
        levels[rng.choice([0, -1])] = 0.0
    return np.asarray(levels)


def _signs(family: Family, rng: np.random.Generator) -> NDArray[np.float64]:
    shape = (family.speeds, family.bins)
    if family.signs == "random":
        return rng.choice([-1.0, 1.0], size=shape)
    if family.signs == "alternating":
        return np.broadcast_to((-1.0) ** np.arange(family.bins), shape).copy()
    return np.full(shape, 1.0 if family.signs == "positive" else -1.0)
