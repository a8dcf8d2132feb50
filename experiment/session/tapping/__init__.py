"""Comparisons as a kind of trial: two samples are laid out, the participant tries both and says which has more of what
the study compares.

A protocol's table `[comparison]` comes in, and what goes on record of each pair goes out. The room asks for no device:
real samples need none. It never imports `footstep/`.
"""
