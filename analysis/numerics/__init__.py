"""`palpate numerics`: error against run time of synthesis, resampling, shaping, noise and contact, and extreme cases.

`numerics` times each way and compares it with `oracle`, which shares no line with what it judges; `cases` holds the
ways to compute a stimulus and what must hold of them at extreme speeds and spectra. `contact` does both for the
steppers of a virtual block, and `contact_report` draws them. `report` makes tables, JSON and figures of the result. All
spectra and impacts are made up and labelled SIMULATED: no recording and no dataset is read here.
"""
