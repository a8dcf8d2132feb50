"""What few speeds and few takes leave open, by hand."""

from math import cos, pi

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.session.kinds.footstep import sampling
from palpate.experiment.synthesis.crinkle import CrinkleSpectra, subtract


def test_interpolation_is_what_leaving_a_speed_out_misses() -> None:
    """At 100 of 50 and 200 mm/s two thirds of the way are left: (2 * 1 + 4) / 3 = 2 where 3 was recorded."""
    amplitudes = np.array([[7.0, 1.0, 0.0], [7.0, 3.0, 0.0], [7.0, 4.0, 0.0]])
    spectra = CrinkleSpectra(np.array([50.0, 100.0, 200.0]), 5000, amplitudes, np.ones((3, 3)))
    np.testing.assert_allclose(sampling.interpolation(spectra), [np.nan, 1 / 3, np.nan])


def test_averaging_is_the_standard_error_over_takes() -> None:
    """One bin at 3 and 5 with the object, so 4 with a standard error of 1; at 1 and 1 without; 3 are left."""
    i = np.arange(8)

    def take(amplitude: float) -> NDArray[np.float64]:
        return np.array([amplitude * cos(pi * 2 * (n + 0.5) / 8) for n in i])

    both = np.array([[take(3.0), take(-5.0)]] * 2)
    bare = np.array([[take(1.0), take(1.0)]] * 2)
    spectra = subtract(speeds_mm_s=[1, 2], rate_hz=1000, panel_object_takes=both, panel_takes=bare)
    found = sampling.averaging(spectra, panel_object_takes=both, panel_takes=bare)
    np.testing.assert_allclose(found, [1 / 3, 1 / 3])
    assert np.isnan(sampling.averaging(spectra, panel_object_takes=both[:, :1], panel_takes=bare)).all()
