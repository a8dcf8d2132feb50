"""The sections and figures of an analysis.

A study, its results and its comparison with print come in; sections for `documents` come out, each table with the
records behind it, and drawings. Nothing is computed here that stands in `results.json`.
"""
