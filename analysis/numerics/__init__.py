"""`palpate numerics`: the error of synthesis, resampling, shaping and noise against their run time, and extreme cases.

`numerics` times each way and compares it with `oracle`, which shares no line with what it judges; `cases` holds the
ways to compute a stimulus and what must hold of them at extreme speeds and spectra. `report` makes tables, JSON and a
figure of the result. All spectra are made up and labelled SIMULATED: no recording and no dataset is read here.
"""
