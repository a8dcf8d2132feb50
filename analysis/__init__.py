"""What an analyst makes of a dataset on disk: tables, tests, figures, one report; audits, validation and power.

A BIDS dataset comes in; files in a folder of results come out. Nothing here runs an experiment or reads a journal.
`README.md` beside this file follows one number through the rooms.
"""

if __name__ != "palpate.analysis":
    raise ImportError(f"got {__name__}; palpate's is palpate.analysis: run palpate, or import palpate.analysis")
