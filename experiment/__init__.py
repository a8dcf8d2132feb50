"""palpate runs vibrotactile psychophysics experiments, from protocol file to published tables.

A trial flows one way through the rooms (layers in `pyproject.toml`). `README.md` follows a trial; `decisions.md`
gives the reasons. Importing this brings in nothing heavy.
"""

if __name__ != "palpate.experiment":
    said = f"got {__name__}; palpate's is palpate.experiment: run palpate, or python -m palpate.experiment"
    raise ImportError(said, name=__name__)
