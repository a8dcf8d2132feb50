"""How probably a person notices the difference between two vibrations: A MODEL, by published thresholds.

Nobody tested it on a rig like palpate's. A third octave of I_i, m^2/s^4 (mean square), is felt over an internal noise
N_i. Whether J_i in its place is felt to differ follows from decibels:

    D_i = 10 |lg((J_i + N_i) / (I_i + N_i))|,  N_i = T_i^2 / ((1 + w)^2 - 1),  d'_i = d'_c D_i / (20 lg(1 + w)).

So the detection threshold T_i beside silence, and a difference of the Weber fraction w beside a strong vibration, are
noticed as often as such thresholds are defined: 79.4 % of two intervals are correct (three down, one up; Levitt 1971,
J. Acoust. Soc. Am. 49, 467-477). P = Phi(d' / 2^(1/2)) are correct at a d' (Green and Swets 1966, Signal Detection
Theory), of which 2 P - 1 without guessing: that counts as noticed. At least, the third octave that differs most is
judged alone; at most, all are judged, independently (d' is the root of the sum of squares); of the smallest and the
largest w published, either takes the one that makes it so. Near the threshold a small w has the larger noise. When
within a vibration something differs is not in the model.
"""

from dataclasses import dataclass
from math import erf, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfinv, ndtri

from palpate.experiment.synthesis.spectra import finite

THIRDS_HZ = 10 ** (np.arange(10, 28) / 10)
"""Middles of third octaves, nominally 10 to 500 Hz (IEC 61260-1)."""


CRITERION = sqrt(2) * float(ndtri(0.5 ** (1 / 3)))
"""d' at a threshold, where three of three are correct in half of all cases."""


@dataclass(frozen=True, eq=False)
class Site:
    """Where a vibration is felt, with detection thresholds, m/s^2 rms, shape (18,), and Weber fractions of amplitude.

    `source` says in words where they are from, and over which frequencies.
    """

    detected_m_s2: NDArray[np.float64]
    least_fraction: float
    most_fraction: float
    source: str


_PROBE_M_S2 = 1.2e-6 * (2 * np.pi * 200) ** 2 / sqrt(2)
_DOUBLINGS = 7

SOLE = Site(
    np.minimum(_PROBE_M_S2 * (THIRDS_HZ / 40) ** 2, _PROBE_M_S2 / 10 ** (3 * _DOUBLINGS / 20)),
    0.052,
    0.58,
    "sole: 1.2 um detected at 200 Hz under a probe, Kowalzik et al. 1996; across frequency as in Gu and Griffin 2011, "
    "20 to 250 Hz; 21 dB less for a whole sole, Verrillo 1963; Weber fractions 0.052 (seated, 4 to 80 Hz, "
    "Matsumoto et al. 2002) to 0.58 (palm, 10 Hz, Forta et al. 2012)",
)
"""Kowalzik, Hermann, Biedermann and Peiper 1996, Foot Ankle Int. 17, 629-634; Gu and Griffin 2011, Somatosens. Mot.
Res. 28, 86-93: one displacement to 40 Hz, and above the Pacinian channel, which detects one acceleration; that sums
over the area by 3 dB a doubling (Verrillo 1963, J. Acoust. Soc. Am. 35, 1962-1966: to 2.9 cm^2, seven doublings).
Ours: a sole is no more sensitive than after these seven, and as sensitive to 500 Hz; 1.2 um is an amplitude. No Weber
fraction of the sole alone was at hand: the least is of a vibrating seat (Matsumoto, Maeda and Oji 2002, Ind. Health
40, 313-319: medians of 0.052 to 0.065)."""

FINGERTIP = Site(
    np.full(THIRDS_HZ.size, 0.1),
    0.20,
    0.58,
    "fingertip: 100 dB re 1e-6 m/s^2 detected from 8 to 500 Hz, Lundstrom et al. 1992, the most sensitive one; "
    "Weber fractions 0.20 (palm, 125 Hz) to 0.58 (palm, 10 Hz), Forta et al. 2012",
)
"""Lundstrom, Stromberg and Lundborg 1992, Int. Arch. Occup. Environ. Health 64, 201-207: about 100 to 140 dB, by age
and frequency; Forta, Griffin and Morioka 2012, Somatosens. Mot. Res. 29, 28-37: medians at the thenar eminence."""

RARELY = 0.01
"""What is noticed less often counts as noticed by nobody. Ours."""


class Noticed(NamedTuple):
    """The probability that a difference is noticed, without guessing, by the model: at least and at most."""

    least: float
    most: float


def noticed(asked_db: NDArray[np.float64], given_db: NDArray[np.float64], site: Site) -> Noticed:
    """Return how probably two vibrations are noticed to differ, by levels of third octaves, dB re 1 m/s^2 rms, (18,).

    The level of silence is -inf. Raises `SynthesisError` for levels that are not numbers, or infinite.
    """
    asked, given = (finite(10 ** (db / 10), what=what) for db, what in ((asked_db, "asked_db"), (given_db, "given_db")))

    def apart(fraction: float) -> NDArray[np.float64]:
        noise = site.detected_m_s2**2 / ((1 + fraction) ** 2 - 1)
        off = np.abs(np.log((given + noise) / (asked + noise)))
        return np.asarray(CRITERION * off / (2 * np.log1p(fraction)))

    ends = [apart(fraction) for fraction in (site.least_fraction, site.most_fraction)]
    least, most = min(float(one.max()) for one in ends), max(float(np.linalg.norm(one)) for one in ends)
    return Noticed(erf(least / 2), erf(most / 2))


def noticed_where_alike(share: float, site: Site) -> float:
    """Return `Noticed.most` of a strong vibration of which each third octave is off alike, by this share of its rms.

    Where third octaves differ, the same share of the whole may be noticed more often: this is no bound.

    Raises `SynthesisError` for a share that is not finite.
    """
    fractions = float(np.log1p(finite([share], what="share"))[0] / np.log1p(site.least_fraction))
    return erf(sqrt(THIRDS_HZ.size) * CRITERION * fractions / 2)


def unnoticed_share(site: Site) -> float:
    """Return the share below which that is noticed less often than `RARELY`."""
    apart = 2 * float(erfinv(RARELY)) / (sqrt(THIRDS_HZ.size) * CRITERION)
    return float(np.expm1(apart * np.log1p(site.least_fraction)))


def third_octave_energies(waveform: NDArray[np.float64], size: int, rate_hz: int) -> NDArray[np.float64]:
    """Return the energy in each third octave, the sum of squares of samples times `size`, shape (18,).

    The waveform, shape (n,), ends with zeros up to 2 `size` samples, n <= `size`. Raises `SynthesisError` unless it is
    finite.
    """
    power = np.square(np.abs(np.fft.rfft(finite(waveform, what="waveform"), 2 * size)))
    ends = np.searchsorted(np.fft.rfftfreq(2 * size, 1 / rate_hz), [*(THIRDS_HZ / 10**0.05), THIRDS_HZ[-1] * 10**0.05])
    return np.diff(np.concatenate([[0.0], np.cumsum(power)])[ends])
