"""Equation (7) of Okamoto et al. for a spectrum by itself."""

from numpy.typing import ArrayLike

from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis.shaping import Response, Shaped, at_bins, shape_at
from palpate.experiment.synthesis.spectra import finite


def shape(
    coefficients: ArrayLike,
    *,
    frequencies_hz: ArrayLike,
    response: Response,
    gain_limit_v_per_m_s2: float,
    scale: float = 1.0,
) -> Shaped:
    """Return each bin of a spectrum weighted by W(f, a), the inverse of the rig's measured response.

    Bin 0 is omitted, as by (5) and (7). `coefficients` are C_k with its sign, m/s^2, at `frequencies_hz`, both (N,). No
    bin takes more than `gain_limit_v_per_m_s2`, above zero, for each m/s^2. Voltages are for the spectrum times
    `scale`, above 0, at most 1; losses are of `coefficients`. Raises `SynthesisError` for values that are not finite or
    shapes, limits or scales that do not fit. Source: Okamoto et al., section 4, 'Frequency shaping', and equation (7).
    """
    signed, f = finite(coefficients, what="coefficients"), finite(frequencies_hz, what="frequencies_hz")
    if signed.ndim != 1 or signed.shape != f.shape:
        raise SynthesisError(
            f"coefficients: got shape {signed.shape} for frequencies of shape {f.shape}; allowed: one spectrum, both "
            "of shape (N,); pass the frequency of each bin"
        )
    return shape_at(signed, at_bins(response, f), gain_limit_v_per_m_s2=gain_limit_v_per_m_s2, scale=scale)
