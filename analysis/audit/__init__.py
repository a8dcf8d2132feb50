"""Printed numbers compared with a dataset, or with one another.

`published` numbers come in and, where there is a dataset, its `identification.results`. Lines come out, each with a
verdict and, where a number does not stand, the simplest mistake that gives it. Statistics are intervals here, because
print leaves digits open. The room knows nothing of reports.
"""
