"""What a loopback heard, set beside what was intended: where it began, how loud it was, and what else was there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import signal

FOUND = 0.5
"""Correlation from which on something heard is the intended waveform; noise of any length stays far below."""

LEAST_DB = -200.0
"""Residual of a waveform that came back bit for bit: less than any converter leaves."""


@dataclass(frozen=True)
class Alignment:
    """Where and how the intended waveform was heard.

    Attributes:
        onset: sample of what was heard at which its first sample lies.
        gain: heard by intended; negative where the polarity is reversed.
        residual_db: power of what delay and gain do not explain, relative to the intended waveform, dB; at least
            `LEAST_DB`.
        correlation: of both over the length of the waveform, -1 to 1.
    """

    onset: int
    gain: float
    residual_db: float
    correlation: float


@dataclass(frozen=True)
class Tolerance:
    """What may differ; see `rig_audio.DeliveredRig`."""

    onset_ms: float
    contact_ms: float | None
    gain_db: float
    residual_db: float


def align(heard: NDArray[np.floating[Any]], intended: NDArray[np.floating[Any]], *, gain: float) -> Alignment | None:
    """Find the intended waveform in what was heard.

    The onset is where a multiple of the waveform leaves the least of what was heard unexplained: the maximum of their
    cross-correlation, for white noise the most likely one.

    Args:
        heard: samples, shape (m,), m at least n.
        intended: samples, shape (n,), not all zero.
        gain: what the loopback makes of a sample of 1.0; residuals are relative to the intended waveform so scaled.

    Returns:
        None where nothing heard resembles it.
    """
    wanted, found = intended.astype(np.float64), heard.astype(np.float64)
    energy = float(wanted @ wanted)
    products = signal.correlate(found, wanted, mode="valid", method="fft")
    onset = int(np.argmax(np.abs(products)))
    part = found[onset : onset + wanted.size]
    # Of the FFT only the place is taken; what is reported is summed anew.
    product, present = float(part @ wanted), float(part @ part)
    if present == 0 or abs(product) < FOUND * np.sqrt(energy * present):
        return None
    rest = found.copy()
    rest[onset : onset + wanted.size] -= product / energy * wanted
    unexplained = float(rest @ rest) / (gain**2 * energy)
    return Alignment(
        onset=onset,
        gain=product / energy,
        residual_db=10 * float(np.log10(max(unexplained, 10 ** (LEAST_DB / 10)))),
        correlation=product / float(np.sqrt(energy * present)),
    )


def silence_objection(heard: NDArray[np.floating[Any]], *, gain: float, tolerance: Tolerance) -> str:
    """Why an intended silence does not count as delivered; empty where it does.

    A silence has no power that what was heard could be relative to, so its loudest sample is set beside full scale.

    Args:
        heard: samples, shape (m,), m at least 1.
        gain: what the loopback makes of a sample of 1.0.
        tolerance: what may differ.
    """
    loudest = float(np.max(np.abs(heard))) / gain
    if loudest <= 10 ** (tolerance.residual_db / 20):
        return ""
    return (
        f"something was heard at {20 * np.log10(loudest):.1f} dB of full scale where silence was intended; "
        f"allowed: {tolerance.residual_db:g} dB"
    )


def objection(
    alignment: Alignment, *, onset_error_ms: float, contact_error_ms: float, gain: float, tolerance: Tolerance
) -> str:
    """Why what was heard does not count as delivered; empty where it does.

    Args:
        alignment: of what was heard.
        onset_error_ms: measured minus asked, ms.
        contact_error_ms: measured minus contact, ms.
        gain: what the loopback makes of a sample of 1.0.
        tolerance: what may differ.
    """
    if alignment.gain <= 0:
        return "its polarity is reversed"
    off_db = 20 * float(np.log10(alignment.gain / gain))
    if abs(off_db) > tolerance.gain_db:
        return f"its level is off by {off_db:+.1f} dB; allowed: {tolerance.gain_db:g} dB"
    if alignment.residual_db > tolerance.residual_db:
        return f"something else was heard at {alignment.residual_db:.1f} dB; allowed: {tolerance.residual_db:g} dB"
    if abs(onset_error_ms) > tolerance.onset_ms:
        return f"it came {onset_error_ms:+.2f} ms off; allowed: {tolerance.onset_ms:g} ms"
    if tolerance.contact_ms is not None and abs(contact_error_ms) > tolerance.contact_ms:
        return f"it came {contact_error_ms:+.2f} ms from contact; allowed: {tolerance.contact_ms:g} ms"
    return ""
