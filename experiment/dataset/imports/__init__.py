"""Datasets of answers that were measured elsewhere, or that a paper printed as counts."""
