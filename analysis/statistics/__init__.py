"""Statistics as functions of numbers: tests, analyses of variance, reliabilities, intervals.

Numbers come in, frozen values come out; a random generator is an argument. One study's ratios are fractions until the
last step, many studies' are float64, by the same functions. The room knows nothing of studies, tasks or files.
"""
