"""palpate runs vibrotactile psychophysics experiments, from protocol file to published tables.

A protocol and a rig file come in; a dataset on disk goes out, which `analysis` reads. A trial flows one way through the
rooms: no room imports one above it in the list of layers in `pyproject.toml`. `README.md` beside this file follows one
trial through them and names every module; `decisions.md` says why they are as they are. `import experiment` imports
nothing heavy.
"""

__version__ = "0.1.0"
