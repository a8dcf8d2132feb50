"""200 forged datasets from one seed, and what `palpate verify` reports of each: the baseline of every change to it.

`studies.py` makes small clean datasets through the product. Each forgery of `chains.py`, `beside.py`, `tables.py` and
`outside.py`, and of `tests/faults/wrong.py`, changes a copy of one. `records.py` runs `verify` on the copy, and writes
and compares what it reports. `baseline.txt` is what it reports today. All of it is SIMULATED.
"""
