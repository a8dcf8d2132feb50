"""What answers say of a sense: thresholds, sensitivity and magnitudes.

Counts or numbers of one participant come in; frozen values go out, each with its source. Nothing
here knows a study, and a participant is never pooled with another.
"""
