"""Tables 1 to 3 as printed, typed from the paper for the tests alone.

S. Okamoto, S. Ishikawa, H. Nagano, Y. Yamada: Spectrum-based synthesis of vibrotactile stimuli: active footstep display
for crinkle of fragile structures. Tables 1 and 2 stand in sections 5.2 and 5.3, Table 3 in section 6.1.
"""

from __future__ import annotations

MATERIALS = ("copy paper", "aluminum foil", "polypropylene", "typing paper")
"""In the order of the tables."""

TABLE_1 = (
    (0.79, 0.047, 0.053, 0.11),
    (0.033, 0.39, 0.21, 0.36),
    (0.013, 0.19, 0.65, 0.12),
    (0.007, 0.48, 0.23, 0.29),
)
"""Mean answer ratios with virtual stimuli; rows presented, columns answered."""

TABLE_2 = (
    (0.97, 0.01, 0.01, 0.01),
    (0.02, 0.51, 0.22, 0.25),
    (0.0, 0.15, 0.63, 0.22),
    (0.01, 0.36, 0.15, 0.48),
)
"""The same with real ones."""

TABLE_3 = {
    ("copy paper", "aluminum foil"): 0.74,
    ("copy paper", "polypropylene"): 1.00,
    ("copy paper", "typing paper"): 0.79,
    ("aluminum foil", "polypropylene"): 0.29,
    ("aluminum foil", "typing paper"): 0.25,
    ("polypropylene", "typing paper"): 0.32,
}
"""Dissimilarity of spectra at 200 mm/s, divided by the highest."""
