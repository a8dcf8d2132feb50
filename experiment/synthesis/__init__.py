"""Pure numerics, all in SI: the waveform, or the voltages, of one step's stimulus; the vibration and force of a tap.

What comes in are takes of recordings, a rig's measured response, and the speed of a foot; or the samples of a hand.
What goes out is a `waveforms.Stimulus`, its voltages where the rig takes them, and the masker's noise; or the vibration
of a tap and the force of a block. The order of the equations is that of the modules: `spectra` (1), (5) and (6) of
Okamoto et al., `crinkle` (2) to (4), `waveforms` (3) to (5) prepared, `shaping` (7), `voltages` (7) prepared. Of
Wellman and Howe, `tap` has (1) to (3), and `contact/` (4) to (6); `stepping/` compares, checks and bounds what that
does. Every function says its shapes, units and errors, and every approximation
its bound.

This room knows of no device, file, session or clock. `import palpate.experiment` does not import it, for it takes
numpy and scipy.
"""
