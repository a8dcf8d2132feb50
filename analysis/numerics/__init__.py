"""`palpate numerics`: error against run time of synthesis, voltages, samples, resampling, shaping, noise and contact.

`numerics` times each way and compares it with `oracle`, which shares no line with what it judges; `cases` holds the
ways to compute a stimulus and what must hold of them at extreme speeds and spectra. `played` does so for what a rig in
volts plays, and has condition numbers and the error budget beside the truth; `contact` for the steppers of a virtual
block. `report` makes tables and JSON of the result, and `figures` draws it. All spectra, rigs and impacts are made up
and labelled SIMULATED: no recording and no dataset is read here.
"""
