"""`palpate numerics`: the error of synthesis, resampling, shaping and noise against their run time, and extreme cases.

`measured` times each way and sets it against `oracle`, which shares no line with what it judges; `cases` holds the ways
to compute a stimulus and what must hold of them at extreme speeds and spectra. `numerics` runs all of it, and `report`
says it as tables, JSON and a figure. All spectra are made to order and labelled SIMULATED: no recording and no dataset
is read here.
"""
