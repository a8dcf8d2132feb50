"""palpate runs vibrotactile psychophysics experiments, from protocol file to published tables.

A protocol and a rig file come in; a dataset on disk goes out, which `analysis` reads. A trial flows one way through the
rooms: no room imports one above it in the list of layers in `pyproject.toml`. `README.md` beside this file follows one
trial through them and names every module; `decisions.md` says why they are as they are. Importing this brings in
nothing heavy.
"""

if __name__ != "palpate.experiment":
    said = f"got {__name__}; palpate's is palpate.experiment: run palpate, or python -m palpate.experiment"
    raise ImportError(said, name=__name__)
