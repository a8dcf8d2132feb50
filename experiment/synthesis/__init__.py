"""Pure numerics, all in SI: from recordings to the waveform, or the voltages, of one step's stimulus.

What comes in are takes of recordings, a rig's measured response, and the speed of a foot. What goes out is a
`waveforms.Stimulus`, its voltages where the rig takes them, and the masker's noise. The order of the equations is that
of the modules: `spectra` (1), (5) and (6) of Okamoto et al., `crinkle` (2) to (4), `waveforms` (3) to (5) prepared,
`shaping` (7), `voltages` (7) prepared. Every function says its shapes, units and errors, and every approximation its
bound.

This room knows of no device, file, session or clock. `import experiment` does not import it, for it takes numpy and
scipy.
"""
