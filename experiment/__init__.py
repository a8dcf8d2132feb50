"""palpate runs vibrotactile psychophysics experiments, from protocol file to published tables."""

__version__ = "0.1.0"
