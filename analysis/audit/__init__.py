"""Printed numbers held against a dataset, or against one another.

What comes in are `published` numbers and, where there is a dataset, its `identification.results`; out come lines, each
with a verdict and, where a number does not stand, the simplest mistake that gives it. Statistics are intervals here,
because print leaves digits open. The room knows nothing of reports.
"""
