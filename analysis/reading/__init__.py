"""A dataset on disk, or several, as one study.

The BIDS files come in, with the protocol's copy where there is one; a `study.Study` comes out, with its facts, one row
for each attempt, and a reason for everything that is left out. What is broken is refused with its file and line. The
room computes no statistic, and knows nothing of journals.
"""
