"""Every number of a study of identification, from its trials.

A study as `reading` made it comes in; `results.Results` comes out: confusion matrices, tests, analyses of variance,
information, similarities, models of single trials and the course of the tasks. What is not defined is None beside a
statement that says why. The room knows nothing of tables, figures or papers.
"""
