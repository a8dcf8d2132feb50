"""Pure numerics, all in SI: the waveform, or the voltages, of one step's stimulus; the vibration and force of a tap.

In the order of the equations of Okamoto et al.: `spectra` (1), (5) and (6), `crinkle` (2) to (4), `waveforms` (3) to
(5) prepared, `shaping` (7), `voltages` (7) prepared. Of Wellman and Howe, `tap` has (1) to (3), and `contact/` (4) to
(6), which `stepping/` compares and bounds. Every approximation states its bound. `import palpate.experiment` does not
import this room, which needs numpy and scipy.
"""
